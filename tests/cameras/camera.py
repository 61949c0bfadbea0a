"""A camera in Python: `camera.py ROOT`, then one exposure per line on standard input, its length in microseconds.

Needs iceoryx2 0.10, xxhash and NumPy from PyPI, and nothing of this repository: layouts, names and order are those of
docs/camera.md. A real camera waits for its trigger where this one waits for a line.
"""

import ctypes
import os
import queue
import sys
import threading
import time

import iceoryx2 as iox2
import numpy as np
import xxhash

WIDTH_PX, HEIGHT_PX = 640, 400
LARGEST_PX = 1920 * 1200
BEYOND = 0xFFFF


def named(name):
    """The type name that both sides must give: that of the layout."""
    return staticmethod(lambda: name)


class Label(ctypes.Structure):
    type_name = named("flankscope/FrameLabel/1")
    _fields_ = [(field, ctypes.c_uint16) for field in ("view", "in_view", "exposure", "pattern")]


class Header(ctypes.Structure):
    type_name = named("flankscope/FrameHeader/1")
    _fields_ = [
        ("session", ctypes.c_uint32),
        ("counter", ctypes.c_uint32),
        ("label", Label),
        ("width_px", ctypes.c_uint32),
        ("height_px", ctypes.c_uint32),
        ("stride_px", ctypes.c_uint32),
        ("measured", ctypes.c_uint32),
        ("exposure_start_us", ctypes.c_uint64),
        ("exposure_end_us", ctypes.c_uint64),
        ("exposure_end_monotonic_ns", ctypes.c_uint64),
        ("published_monotonic_ns", ctypes.c_uint64),
        ("checksum", ctypes.c_uint64),
    ]


class Arm(ctypes.Structure):
    type_name = named("flankscope/Arm/1")
    _fields_ = [("session", ctypes.c_uint32)] + [
        (field, ctypes.c_uint16) for field in ("first_view", "views", "exposures", "patterns")
    ]


class Ready(ctypes.Structure):
    type_name = named("flankscope/Ready/1")
    _fields_ = [
        ("session", ctypes.c_uint32),
        ("counter", ctypes.c_uint32),
        ("width_px", ctypes.c_uint32),
        ("height_px", ctypes.c_uint32),
        ("bits", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("offset_dn", ctypes.c_double),
        ("gain_e_per_dn", ctypes.c_double),
        ("model", ctypes.c_uint8 * 64),
        ("link", ctypes.c_uint8 * 64),
    ]


def label_of(arm, nth):
    """The place of the nth exposure since arming: a dark frame, then every pattern at every exposure."""
    per_view = 1 + arm.exposures * arm.patterns
    view, in_view = divmod(nth, per_view)
    if view >= arm.views:
        return Label(BEYOND, 0, 0, 0)
    exposure, pattern = divmod(in_view - 1, arm.patterns) if in_view else (0, -1)
    return Label((arm.first_view + view) % 65536, in_view, exposure, pattern + 1)


def open_services(root):
    """The host has made them; a camera that guesses a limit wrong is refused here."""
    config = iox2.config.default()
    places = config.global_cfg
    places.root_path = iox2.Path.new(root)
    places.prefix = iox2.FileName.new(os.path.basename(root))
    # The root is this run's alone, and its owner removes it whole.
    places.node.cleanup_dead_nodes_on_creation = False
    places.node.cleanup_dead_nodes_on_destruction = False
    places.service.cleanup_dead_nodes_on_open = False
    iox2.set_log_level(iox2.LogLevel.Fatal)
    # Node and services are kept as long as their ports.
    node = iox2.NodeBuilder.new().config(config).signal_handling_mode(iox2.SignalHandlingMode.Disabled)
    node = node.create(iox2.ServiceType.Ipc)

    def service(name):
        return node.service_builder(iox2.ServiceName.new(name))

    frames = service("frames").publish_subscribe(iox2.Slice[ctypes.c_uint16]).user_header(Header)
    frames = frames.payload_alignment(iox2.Alignment.new(64)).open()
    arm = service("arm").publish_subscribe(Arm).open()
    ready = service("ready").publish_subscribe(Ready).open()
    wake = service("wake").event().open()
    return node, frames, arm, ready, wake


def text(words):
    return (ctypes.c_uint8 * 64)(*words.encode()[:64])


def main(root):
    node, frames, arm, ready, wake = open_services(root)
    publisher = frames.publisher_builder().initial_max_slice_len(LARGEST_PX)
    publisher = publisher.allocation_strategy(iox2.AllocationStrategy.Static).max_loaned_samples(2)
    publisher = publisher.backpressure_strategy(iox2.BackpressureStrategy.DiscardData).create()
    notifier = wake.notifier_builder().create()
    arms = arm.subscriber_builder().history_request(1).create()
    words = ready.publisher_builder().create()

    def speak(session, counter):
        nan = float("nan")
        word = Ready(session, counter, WIDTH_PX, HEIGHT_PX, 12, 0, nan, nan, text("camera.py"), text("standard input"))
        words.send_copy(word)
        notifier.notify()

    triggers = queue.Queue()

    def listen():
        for line in sys.stdin:
            triggers.put(int(line))
        triggers.put(None)

    threading.Thread(target=listen, daemon=True).start()
    picture = (np.arange(WIDTH_PX * HEIGHT_PX) % 4096).astype("<u2")
    armed, exposed, counter = Arm(), 0, 0
    speak(0, counter)
    while True:
        # Between exposures nothing is on its way: the camera is drained.
        newest = None
        while (sample := arms.receive()) is not None:
            newest = Arm.from_buffer_copy(sample.payload().contents)
            sample.delete()
        if newest is not None:
            armed, exposed = newest, 0
            speak(armed.session, counter)
        try:
            exposure_us = triggers.get(timeout=0.001)
        except queue.Empty:
            continue
        if exposure_us is None:
            return
        start_ns = time.monotonic_ns()
        time.sleep(exposure_us / 1e6)
        end_ns = time.monotonic_ns()
        header = Header(armed.session, counter, label_of(armed, exposed), WIDTH_PX, HEIGHT_PX, WIDTH_PX, 2)
        # The exposure is what was commanded; when it ended was measured.
        header.exposure_start_us = start_ns // 1000
        header.exposure_end_us = start_ns // 1000 + exposure_us
        header.exposure_end_monotonic_ns = end_ns
        exposed += 1
        counter += 1
        try:
            slot = publisher.loan_slice_uninit(WIDTH_PX * HEIGHT_PX)
        except iox2.LoanError as lost:  # its number is missing: the host sees it
            print(f"camera.py: {lost}", file=sys.stderr)
            continue
        pixels = slot.payload()
        # The only write of the frame, into the shared memory.
        ctypes.memmove(pixels.data_ptr, picture.ctypes.data, picture.nbytes)
        header.checksum = xxhash.xxh3_64_intdigest(picture)
        header.published_monotonic_ns = time.monotonic_ns()
        ctypes.memmove(slot.user_header_ptr, ctypes.byref(header), ctypes.sizeof(header))
        if slot.assume_init().send() > 0:
            notifier.notify()


if __name__ == "__main__":
    main(sys.argv[-1])
