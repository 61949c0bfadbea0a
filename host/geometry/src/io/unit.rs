//! Lengths in files that do not say their unit.

/// Length unit of a file; formats of meshes and clouds do not say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Unit {
    /// Millimetres.
    #[default]
    Mm,
    /// Metres.
    M,
    /// Micrometres.
    Um,
    /// Inches.
    Inch,
}

impl Unit {
    /// Millimetres per unit.
    pub fn mm(self) -> f64 {
        match self {
            Self::Mm => 1.0,
            Self::M => 1000.0,
            Self::Um => 1e-3,
            Self::Inch => 25.4,
        }
    }
}

impl std::fmt::Display for Unit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Mm => "mm",
            Self::M => "m",
            Self::Um => "um",
            Self::Inch => "inch",
        })
    }
}
