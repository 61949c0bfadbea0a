"""Drives the emulated stage controller with another party's ESP300/ESP301 client, PyMeasure's, and checks what it reads.

    VENV/bin/python tools/peers/esp301_client.py target/release/flankscope

Exits with 1 and says what differed.
"""

import subprocess
import sys
import warnings

import serial
from pymeasure.adapters import SerialAdapter
from pymeasure.instruments.newport import ESP300

warnings.simplefilter("ignore", FutureWarning)
failures = []


def expect(what, got, wanted):
    right = got == wanted
    print(f"{'ok  ' if right else 'FAIL'} {what}: {got!r}" + ("" if right else f", wanted {wanted!r}"))
    if not right:
        failures.append(what)


def errors(controller):
    return [f"{getattr(error, 'axis', '')}{error.error}" for error in controller.errors]


def drive(controller):
    expect("error buffer at the start", controller.error, 0)
    expect("units", [controller.x.units, controller.y.units], ["degree", "millimeter"])
    expect("travel of the vertical axis", [controller.y.left_limit, controller.y.right_limit], [-150.0, 150.0])
    for name, axis, target in [("rotation", controller.x, 12.5), ("vertical", controller.y, 5.0)]:
        expect(f"{name}: motor before it is switched on", axis.enabled, False)
        axis.enable()
        expect(f"{name}: motor", axis.enabled, True)
        axis.home(1)
        axis.wait_for_stop()
        axis.position = target
        expect(f"{name}: done as soon as accepted", axis.motion_done, False)
        axis.wait_for_stop()
        expect(f"{name}: position", axis.position, target)
    expect("errors of all this", errors(controller), [])

    controller.write("1XX3")
    expect("a command that does not exist", errors(controller), ["6"])
    controller.phi.enable()
    expect("an axis that does not exist", errors(controller), ["9"])
    controller.x.position = 1e6
    expect("beyond the travel", errors(controller), ["106"])
    controller.x.disable()
    controller.x.position = 1
    expect("a move with the motor off", errors(controller), ["113"])
    expect("position after the refused moves", controller.x.position, 12.5)


def main():
    bench = subprocess.Popen(
        [sys.argv[1], "bench", "esp301", "--speed", "20"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        port = serial.Serial(bench.stdout.readline().strip(), 19200, timeout=5)
        drive(ESP300(SerialAdapter(port, write_termination="\r", read_termination="\r\n")))
    finally:
        bench.stdin.close()
        bench.wait(10)
    return 1 if failures else 0


sys.exit(main())
