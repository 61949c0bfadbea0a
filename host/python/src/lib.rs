//! flankscope for Python: the host's libraries on NumPy's arrays.
//!
//! ```text
//!  error         the package's exceptions
//!  array         arrays at the border: borrowed where they lie, checked, and given away without a copy
//!  mesh          CAD, deviations from it, nearest neighbours
//!  registration  one cloud laid on CAD or on another cloud
//!  decode        frames to points
//!  tool          a tool file, wear of its flanks
//! ```
//!
//! Nothing is computed here: each function checks what it is given, releases Python's lock, calls the library that the command
//! calls, and hands over what that returned. `flankscope.pyi` has the types and says what each is.

mod array;
mod decode;
mod error;
mod mesh;
mod registration;
mod tool;

/// Fringe images to points, points on CAD, deviations and wear, on NumPy's arrays. Millimetres and radians.
#[pyo3::pymodule]
mod flankscope {
    #[pymodule_export]
    use crate::decode::{Decoded, Decoder, Head, Plan};
    #[pymodule_export]
    use crate::error::{ArrayError, FileError, FlankscopeError, GeometryError, NotFiniteError};
    #[pymodule_export]
    use crate::mesh::{Mesh, deviation, nearest};
    #[pymodule_export]
    use crate::registration::{Registration, register};
    #[pymodule_export]
    use crate::tool::{FlankWear, Tool, wear};
}
