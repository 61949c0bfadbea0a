//! Treatment of coordinates of a cloud that are NaN or infinite.

/// Treatment of points whose coordinates are not finite. Organised clouds of scanners hold NaN where nothing was measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NonFinite {
    /// The file is refused at the first of them.
    Refuse,
    /// They are left out and counted.
    Drop,
}
