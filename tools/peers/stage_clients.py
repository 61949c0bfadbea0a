"""Drives the emulated stage controller with two clients of other people, over its port, and checks what they read.

    target/stage-clients/bin/python tools/peers/stage_clients.py PORT

Every public method and attribute of PyMeasure's ESP300 and of InstrumentKit's NewportESP301 is used; one that is not is a
failure. Exits with 1 and says what differed.
"""

import sys
import warnings

warnings.simplefilter("ignore")

import serial
from instruments.abstract_instruments.comm import SerialCommunicator
from instruments.newport import NewportError, NewportESP301
from instruments.newport.newportesp301 import NewportESP301Axis
from pymeasure.adapters import SerialAdapter
from pymeasure.instruments.newport import ESP300
from pymeasure.instruments.newport.esp300 import Axis

failures = []
calls = 0


def expect(what, got, wanted):
    global calls
    calls += 1
    if got != wanted:
        failures.append(what)
        print(f"FAIL {what}: {got!r}, wanted {wanted!r}")


def public(cls, beside=()):
    return {name for name in vars(cls) if not name.startswith("_")} - set(beside)


class Watched:
    """Notes which attributes of an object are used."""

    def __init__(self, inner, used):
        object.__setattr__(self, "_watched", (inner, used))

    def __getattr__(self, name):
        inner, used = object.__getattribute__(self, "_watched")
        used.add(name)
        return getattr(inner, name)

    def __setattr__(self, name, value):
        inner, used = object.__getattribute__(self, "_watched")
        used.add(name)
        setattr(inner, name, value)


def codes(controller):
    return [f"{getattr(error, 'axis', '')}{error.error}" for error in controller.errors]


def pymeasure_axis(controller, axis, name, unit, limit, target):
    expect(f"{name}: units", axis.units, unit)
    axis.units = unit
    expect(f"{name}: limits", [axis.left_limit, axis.right_limit], [-limit, limit])
    axis.left_limit, axis.right_limit = -limit / 2, limit / 2
    expect(f"{name}: new limits", [axis.left_limit, axis.right_limit], [-limit / 2, limit / 2])
    axis.left_limit, axis.right_limit = -limit, limit
    expect(f"{name}: motor", axis.enabled, False)
    axis.enable()
    expect(f"{name}: motor on", axis.enabled, True)
    axis.home(1)
    axis.wait_for_stop()
    axis.position = target
    expect(f"{name}: done as soon as accepted", axis.motion_done, False)
    axis.wait_for_stop()
    expect(f"{name}: position", axis.position, target)
    axis.zero()
    expect(f"{name}: position after zero", axis.position, 0.0)
    axis.define_position(target)
    expect(f"{name}: position as defined", axis.position, target)
    expect(f"{name}: asked by hand", axis.ask("TP?").strip(), f"{target:.6f}")
    axis.write("ST")
    expect(f"{name}: values", axis.values("SN?"), [7.0 if unit == "degree" else 2.0])
    axis.disable()
    expect(f"{name}: motor off", axis.enabled, False)
    expect(f"{name}: errors of all this", codes(controller), [])


def pymeasure(port):
    used, of_axis = set(), set()
    # Short: what the device does not know, it does not answer.
    connection = serial.Serial(port, 19200, timeout=0.5)
    bare = ESP300(SerialAdapter(connection, write_termination="\r", read_termination="\r\n"))
    controller = Watched(bare, used)
    expect("identity", controller.id, "ESP301 Version 3.0.1 6/1/99")
    expect("error buffer at the start", controller.error, 0)
    pymeasure_axis(controller, Watched(bare.x, of_axis), "rotation", "degree", 361.0, 12.5)
    pymeasure_axis(controller, Watched(bare.y, of_axis), "vertical", "millimeter", 150.0, 5.0)

    # It looks for its axes among all its attributes, and so asks what no ESP301 knows.
    expect("axes", len(controller.axes), 3)
    expect("questions of SCPI, which it does not know", set(codes(controller)), {"6"})
    controller.enable()
    expect("an axis without a stage", "300" in codes(controller), True)
    expect("motors on", [bare.x.enabled, bare.y.enabled], [True, True])
    controller.disable()
    expect("motors off", [bare.x.enabled, bare.y.enabled], [False, False])
    controller.clear_errors()

    bare.write("1ZQ3")
    expect("a command that does not exist", codes(controller), ["6"])
    bare.x.enable()
    bare.x.position = 1e6
    expect("beyond the travel", codes(controller), ["106"])
    bare.x.disable()
    bare.x.position = 1
    expect("a move with the motor off", codes(controller), ["113"])
    controller.shutdown()
    controller.clear_errors()
    expect("never used of ESP300", public(ESP300) - used, set())
    expect("never used of its axis", public(Axis, ["axis", "controller"]) - of_axis, set())


# What each setting of an axis is set to, and is read back as.
REALS = {
    "max_velocity": 60.0, "velocity": 40.0, "max_base_velocity": 5.0, "jog_high_velocity": 20.0,
    "jog_low_velocity": 2.5, "homing_velocity": 30.0, "max_acceleration": 300.0, "max_deceleration": 310.0,
    "acceleration": 150.0, "deceleration": 120.0, "estop_deceleration": 250.0, "jerk": 900.0,
    "encoder_resolution": 0.001, "full_step_resolution": 0.02, "left_limit": -100.0, "right_limit": 120.0,
    "error_threshold": 0.5, "current": 0.8, "voltage": 12.0,
}
PLAIN = {
    "motor_type": 1, "position_display_resolution": 5, "trajectory": 2, "microstep_factor": 10,
    "acceleration_feed_forward": 1.5, "proportional_gain": 12.0, "derivative_gain": 2.5, "integral_gain": 0.5,
    "integral_saturation_gain": 3.5,
}


def refused(what, code, call):
    try:
        call()
    except NewportError as error:
        expect(what, error.errcode if error.axis is None else error.axis * 100 + error.errcode, code)
    else:
        expect(what, None, code)


def instrumentkit_settings(controller, axis):
    for name, value in REALS.items():
        setattr(axis, name, value)
        expect(name, float(getattr(axis, name).magnitude), value)
    for name, value in PLAIN.items():
        setattr(axis, name, value)
        expect(name, getattr(axis, name), value)
    # Of bits it cuts off the last digit with the H: asked by hand as well.
    axis.feedback_configuration = 768
    expect("feedback", (controller.query("1ZB?").strip(), axis.feedback_configuration), ("300H", 0x30))
    axis.hardware_limit_configuration = 35
    expect("limits", (controller.query("1ZH?").strip(), axis.hardware_limit_configuration), ("23H", 2))
    expect("unit", str(axis.units.dimensionality), "deg")
    axis.units = 7
    everything = axis.read_setup()
    expect("setup", (everything["velocity"].magnitude, everything["trajectory"]), (40.0, 2))
    again = axis.setup_axis(
        motor_type=1, units=7, reduce_motor_torque_time=1000, reduce_motor_torque_percentage=50,
        **{name: REALS[name] for name in REALS if not name.endswith("_limit") and name != "max_deceleration"},
        **{name: PLAIN[name] for name in PLAIN if name != "motor_type"},
    )
    expect("setup again", again["velocity"].magnitude, 40.0)


def instrumentkit_motion(controller, axis):
    axis.enable()
    axis.home = 0.0
    expect("home", float(axis.home.magnitude), 0.0)
    axis.search_for_home(1)
    axis.wait_for_stop()
    # Half a second to the place waited for and as much beyond it, for machines that are busy.
    axis.move(40.0)
    expect("under way", axis.is_motion_done, False)
    axis.wait_for_position(20.0)
    passed = float(axis.position.magnitude)
    expect("passed the place it waited for", 20.0 <= passed < 40.0, True)
    axis.wait_for_motion(max_wait=10)
    expect("position", float(axis.position.magnitude), 40.0)
    axis.move(8.0)
    axis.wait_for_stop()
    axis.move(-2.0, absolute=False)
    axis.wait_for_stop()
    expect("moved by", float(axis.position.magnitude), 6.0)
    # It waits for a relative place as for an absolute one, which is not on the way.
    refused("a place that is not on the way", 101, lambda: axis.move(1.0, absolute=False, wait=True))
    axis.wait_for_stop()
    axis.move(9.0, wait=True, block=True)
    expect("bound for", float(axis.desired_position.magnitude), 9.0)
    expect("desired velocity, which it reads as a position", float(axis.desired_velocity.magnitude), 9.0)
    expect("status", axis.get_status()["is_motion_done"], True)
    axis.move(90.0)
    axis.stop_motion()
    axis.wait_for_stop()
    expect("stopped short", float(axis.position.magnitude) < 90.0, True)
    axis.move(0.0)
    axis.abort_motion()
    expect("motor after an abort", controller.query("1MO?").strip(), "0")
    axis.enable()
    axis.disable()
    expect("motor off", controller.query("1MO?").strip(), "0")
    axis.enable()
    # Two readings are the same only of an axis that stands.
    axis.wait_for_stop()
    expect("counts, a label only", float(axis.encoder_position.magnitude) == float(axis.position.magnitude), True)
    # It sends these without a direction, which the device demands.
    refused("to the limit without a direction", 38, axis.move_to_hardware_limit)
    refused("for ever without a direction", 38, axis.move_indefinitely)
    refused("beyond the limit", 106, lambda: axis.move(121.0))
    refused("too fast", 110, lambda: setattr(axis, "velocity", 61.0))


def instrumentkit(port):
    used, of_axis = set(), set()
    bare = NewportESP301(SerialCommunicator(serial.Serial(port, 19200, timeout=10)))
    controller = Watched(bare, used)
    bare_axis = controller.axis[0]
    axis = Watched(bare_axis, of_axis)
    expect("axis", axis.axis_id, 1)
    instrumentkit_settings(bare, axis)
    instrumentkit_motion(bare, axis)

    bare_axis.enable()
    controller.search_for_home(axis=1, search_mode=1)
    bare_axis.wait_for_stop()
    with controller.define_program(15):
        bare_axis.move(3.0)
        bare_axis.wait_for_stop()
    expect("defined, not run", float(bare_axis.position.magnitude), 0.0)
    controller.run_program(15)
    expect("after the program", float(bare_axis.position.magnitude), 3.0)
    with controller.execute_bulk_command():
        bare_axis.move(5.0)
        bare_axis.wait_for_stop()
    expect("after all at once", float(bare_axis.position.magnitude), 5.0)
    refused("a program that is not there", 35, lambda: controller.run_program(16))
    refused("an axis that is not there", 9, lambda: controller.search_for_home(axis=7))
    controller.reset()
    expect("motor after a reset", bare.query("1MO?").strip(), "0")
    # Saved by the setup above, so that it outlives the reset.
    expect("velocity after a reset", float(bare_axis.velocity.magnitude), 40.0)
    expect("never used of NewportESP301", public(NewportESP301) - used, set())
    expect("never used of its axis", public(NewportESP301Axis, ["micro_inch"]) - of_axis, set())


def main():
    port = sys.argv[1]
    pymeasure(port)
    instrumentkit(port)
    print(f"{calls} checks, {len(failures)} failed")
    return 1 if failures else 0


sys.exit(main())
