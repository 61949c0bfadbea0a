//! Numbers and texts of the manual's list of errors, compared with the tables in published clients (InstrumentKit, PyMeasure).

/// Number and text of an error.
pub(crate) type Refusal = (u32, &'static str);

pub(crate) const UNKNOWN: Refusal = (6, "COMMAND DOES NOT EXIST");
pub(crate) const OUT_OF_RANGE: Refusal = (7, "PARAMETER OUT OF RANGE");
pub(crate) const NO_SUCH_AXIS: Refusal = (9, "AXIS NUMBER OUT OF RANGE");
pub(crate) const NOT_ALLOWED: Refusal = (27, "COMMAND NOT ALLOWED");
pub(crate) const NO_SUCH_PROGRAM: Refusal = (35, "PROGRAM NOT FOUND");
pub(crate) const MISSING_AXIS: Refusal = (37, "AXIS NUMBER MISSING");
pub(crate) const MISSING_PARAMETER: Refusal = (38, "COMMAND PARAMETER MISSING");

// Errors of an axis have its number in front (205 is the lower limit switch of axis 2).
pub(crate) const MOTOR_UNDEFINED: Refusal = (0, "MOTOR TYPE NOT DEFINED");
pub(crate) const PARAMETER_OUT_OF_RANGE: Refusal = (1, "PARAMETER OUT OF RANGE");
pub(crate) const POSITIVE_SWITCH: Refusal = (4, "POSITIVE HARDWARE LIMIT DETECTED");
pub(crate) const NEGATIVE_SWITCH: Refusal = (5, "NEGATIVE HARDWARE LIMIT DETECTED");
pub(crate) const POSITIVE_LIMIT: Refusal = (6, "POSITIVE SOFTWARE LIMIT DETECTED");
pub(crate) const NEGATIVE_LIMIT: Refusal = (7, "NEGATIVE SOFTWARE LIMIT DETECTED");
pub(crate) const VELOCITY_EXCEEDED: Refusal = (10, "MAXIMUM VELOCITY EXCEEDED");
pub(crate) const ACCELERATION_EXCEEDED: Refusal = (11, "MAXIMUM ACCELERATION EXCEEDED");
pub(crate) const MOTOR_OFF: Refusal = (13, "MOTOR NOT ENABLED");
pub(crate) const NO_SUCH_MOVE: Refusal = (32, "INVALID TRAJECTORY MODE FOR MOVING");

/// The error with the number of its axis in front, counted from 1.
pub(crate) fn of_axis(axis: usize, (code, text): Refusal) -> Refusal {
    (axis as u32 * 100 + code, text)
}
