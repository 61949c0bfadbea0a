//! To what the form of a die as it was made is known: as stated, from its tolerance class, or from a scan of it when it was new.

use std::path::Path;

use flankscope_foundation::files::{MOST_DOCUMENT_BYTES, read_regular};
use serde::Deserialize;

use super::{Inspect, ToolError};
use crate::gear::evaluation::{CLASSES, Quantity};
use crate::gear::{Flank, GearData};

/// A scan with fewer flanks tells no scatter.
const LEAST_FLANKS: usize = 8;

/// Reasons for which a scan does not determine the form of a die.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AsBuiltError {
    /// The file cannot be read.
    #[error("{0}")]
    Read(#[from] std::io::Error),
    /// The file is no result of `scan`.
    #[error("{0}; right would be what `scan --json` wrote for the new die")]
    Json(#[from] serde_json::Error),
    /// Too few flanks have a mean deviation.
    #[error("it has the mean deviation of {got} flanks, at least {LEAST_FLANKS} are needed")]
    TooFew {
        /// Flanks with a mean.
        got: usize,
    },
}

/// Part of a scan's result file that is read.
#[derive(Deserialize)]
struct Scan {
    features: Vec<ScannedFlank>,
}

#[derive(Deserialize)]
struct ScannedFlank {
    flank: Flank,
    /// Mean loss against CAD, µm; none where the flank was not seen.
    mean_um: Option<f64>,
}

/// Standard uncertainty of a flank's form as built, µm; none when nothing is said of it.
///
/// # Errors
/// More than one source is named, a class needs gear data, or the scan cannot be used.
pub(super) fn as_built_um(
    tool: &Path,
    gear: Option<&GearData>,
    inspect: &Inspect,
) -> Result<Option<f64>, ToolError> {
    let sources = [
        inspect.as_built_um.is_some(),
        inspect.as_built_class.is_some(),
        inspect.as_built_scan.is_some(),
    ];
    let named = sources.iter().filter(|named| **named).count();
    if named > 1 {
        return Err(ToolError::Value {
            path: tool.to_owned(),
            key: "inspect.as_built_um, as_built_class and as_built_scan together",
            value: named as f64,
            expected: "one of them".into(),
        });
    }
    if let Some(scan) = &inspect.as_built_scan {
        let path = tool.parent().unwrap_or(Path::new(".")).join(scan);
        return of_scan_um(&path)
            .map(Some)
            .map_err(|source| ToolError::AsBuilt {
                path: tool.to_owned(),
                scan: path,
                source,
            });
    }
    match (inspect.as_built_class, gear) {
        (None, _) => Ok(inspect.as_built_um),
        (Some(class), Some(gear)) if CLASSES.contains(&class) => Ok(Some(of_class_um(gear, class))),
        (Some(class), gear) => Err(ToolError::Value {
            path: tool.to_owned(),
            key: "inspect.as_built_class",
            value: f64::from(class),
            expected: match gear {
                Some(_) => format!("{} to {}", CLASSES.start(), CLASSES.end()),
                None => "a file with [gear]: a class says nothing without module and size".into(),
            },
        }),
    }
}

/// Of a gear that just keeps its class: pitch to either side by the single pitch tolerance, profile and helix anywhere in their
/// total tolerance, each rectangular (GUM 4.3.7), µm.
fn of_class_um(gear: &GearData, class: u32) -> f64 {
    let half_um = [
        Quantity::SinglePitch.tolerance_um(gear, class),
        0.5 * Quantity::ProfileTotal.tolerance_um(gear, class),
        0.5 * Quantity::HelixTotal.tolerance_um(gear, class),
    ];
    (half_um.iter().map(|um| um * um).sum::<f64>() / 3.0).sqrt()
}

/// Scatter of the flanks' mean deviations about the median of their side, µm: a deviation that all of a side share is not told
/// from how the die sits.
fn of_scan_um(path: &Path) -> Result<f64, AsBuiltError> {
    let scan: Scan = serde_json::from_slice(&read_regular(path, MOST_DOCUMENT_BYTES)?)?;
    let (mut squares, mut count) = (0.0, 0);
    for side in Flank::BOTH {
        let of_side = scan.features.iter().filter(|f| f.flank == side);
        let means: Vec<f64> = of_side
            .filter_map(|f| f.mean_um)
            .filter(|um| um.is_finite())
            .collect();
        let middle = means.iter().sum::<f64>() / means.len().max(1) as f64;
        squares += means.iter().map(|um| (um - middle).powi(2)).sum::<f64>();
        count += means.len();
    }
    if count < LEAST_FLANKS {
        return Err(AsBuiltError::TooFew { got: count });
    }
    // One mean is taken from each side.
    Ok((squares / (count - 2) as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::tests::ring84;

    #[test]
    fn a_class_counts_with_pitch_profile_and_helix() {
        // Class 7 of the ring: f_p 11, F_alpha 14, F_beta 22 um.
        let um = of_class_um(&ring84(), 7);
        assert!(
            (um - ((11.0_f64.powi(2) + 49.0 + 121.0) / 3.0).sqrt()).abs() < 0.5,
            "{um}"
        );
        assert!(of_class_um(&ring84(), 5) < 0.6 * um);
    }

    #[test]
    fn a_scan_counts_with_the_scatter_of_its_flanks() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new.json");
        let write = |flanks: &[(&str, f64)]| {
            let features: Vec<_> = flanks
                .iter()
                .map(|(flank, um)| serde_json::json!({ "tooth": 1, "flank": flank, "mean_um": um }))
                .collect();
            let text = serde_json::json!({ "verdict": "go", "features": features }).to_string();
            std::fs::write(&path, text).unwrap();
        };
        // Sides 20 um apart, as a turned die shows them; every flank 3 um to one or the other side.
        let flanks: Vec<(&str, f64)> = (0..40)
            .map(|i| {
                let own = if i % 4 < 2 { 3.0 } else { -3.0 };
                if i % 2 == 0 {
                    ("left", 10.0 + own)
                } else {
                    ("right", -10.0 + own)
                }
            })
            .collect();
        write(&flanks);
        let um = of_scan_um(&path).unwrap();
        assert!((um - 3.0 * (40.0_f64 / 38.0).sqrt()).abs() < 1e-9, "{um}");
        write(&flanks[..5]);
        let few = of_scan_um(&path).unwrap_err().to_string();
        assert!(few.contains("5 flanks") && few.contains('8'), "{few}");
        std::fs::write(&path, "{\"features\": 3}").unwrap();
        assert!(matches!(of_scan_um(&path), Err(AsBuiltError::Json(_))));
        std::fs::remove_file(&path).unwrap();
        assert!(matches!(of_scan_um(&path), Err(AsBuiltError::Read(_))));
    }
}
