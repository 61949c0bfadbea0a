//! The package's exceptions. Each message says what was found and what would be right.

use std::fmt::Display;

use pyo3::PyErr;
use pyo3::create_exception;
use pyo3::exceptions::PyValueError;

create_exception!(
    flankscope,
    FlankscopeError,
    PyValueError,
    "What every exception of the package is."
);
create_exception!(
    flankscope,
    ArrayError,
    FlankscopeError,
    "An array of another type, shape or layout than is needed."
);
create_exception!(
    flankscope,
    NotFiniteError,
    ArrayError,
    "NaN or infinity in an array."
);
create_exception!(
    flankscope,
    FileError,
    FlankscopeError,
    "A file that cannot be read or does not say what is needed."
);
create_exception!(
    flankscope,
    GeometryError,
    FlankscopeError,
    "Values that are sound one by one and cannot be worked with together."
);

/// A file's error.
pub fn file(error: impl Display) -> PyErr {
    FileError::new_err(error.to_string())
}

/// An error of what was given.
pub fn geometry(error: impl Display) -> PyErr {
    GeometryError::new_err(error.to_string())
}
