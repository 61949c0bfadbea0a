//! What says whose word a file is.

use serde::{Deserialize, Serialize};

/// A keyed digest over all of a file, and whose key it is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seal {
    /// Id of the station's key.
    pub station: String,
    /// Keyed BLAKE3 of everything else in the file.
    pub blake3: String,
}

impl Seal {
    /// Its key in a file.
    pub const KEY: &'static str = "seal";
}
