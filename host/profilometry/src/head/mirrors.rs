//! Arrangement of the mirrors of the projector's DMD: `[mirrors]` in `head.toml`.

use serde::{Deserialize, Serialize};

use super::camera::Pinhole;
use flankscope_foundation::textfile::{self, BadValue};

/// The grid of the mirrors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Arrangement {
    /// Mirrors stand above each other.
    Orthogonal,
    /// Mirrors stand on their corners: every other row is half a column to the right, and rows are half as far apart as
    /// columns (DLP4500: columns 10.8 um, rows 5.4 um).
    Diamond,
}

/// The DMD's mirrors. Columns and rows are those of `[projector]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mirrors {
    /// Their grid.
    pub arrangement: Arrangement,
    /// Mirrors of a row.
    pub columns: u32,
    /// Rows.
    pub rows: u32,
}

/// A DMD's rows and columns are that far from being half as far apart, at most: lenses are round.
const DIAMOND_ASPECT: std::ops::RangeInclusive<f64> = 1.6..=2.4;
/// The same of mirrors that stand above each other.
const ORTHOGONAL_ASPECT: std::ops::RangeInclusive<f64> = 0.8..=1.25;

impl Mirrors {
    /// Mirrors that are the projector's columns and rows, for a head that does not say.
    #[must_use]
    pub fn from_projector(projector: &Pinhole) -> Self {
        Self {
            arrangement: Arrangement::Orthogonal,
            columns: projector.width_px,
            rows: projector.height_px,
        }
    }

    /// Position of a mirror's centre along the rows, in columns.
    ///
    /// Odd rows of diamond mirrors are half a column to the right, as in SLStudio (`cvtools::diamondDownsample` takes column
    /// `2 c + r % 2` of a pattern with twice the columns).
    #[must_use]
    pub fn column_px(&self, column: u32, row: u32) -> f64 {
        match self.arrangement {
            Arrangement::Diamond if row % 2 == 1 => f64::from(column) + 0.5,
            _ => f64::from(column),
        }
    }

    #[rustfmt::skip]
    pub(crate) fn check(&self, projector: &Pinhole) -> Result<(), BadValue> {
        let as_many = "must be as many as [projector] has: its columns and rows are those of the mirrors";
        let [along_columns, along_rows] = projector.focal_px;
        let aspect = along_rows / along_columns;
        let (fits, right) = match self.arrangement {
            Arrangement::Diamond => (
                DIAMOND_ASPECT.contains(&aspect),
                "does not fit projector.focal_px: diamond mirrors have rows half as far apart as columns, so that the focal \
                 length along the rows is about twice the other",
            ),
            Arrangement::Orthogonal => (
                ORTHOGONAL_ASPECT.contains(&aspect),
                "does not fit projector.focal_px: mirrors above each other have rows as far apart as columns; \"diamond\" \
                 has rows half as far apart",
            ),
        };
        textfile::require(&[
            (self.columns == projector.width_px, "mirrors.columns", &self.columns, as_many),
            (self.rows == projector.height_px, "mirrors.rows", &self.rows, as_many),
            (fits, "mirrors.arrangement", &self.arrangement, right),
        ])
    }
}
