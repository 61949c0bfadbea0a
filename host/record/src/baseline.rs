//! Baseline: the capture of a new tool. Wear is the change since then, so errors of calibration and as-built form that are in
//! both captures cancel.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use flankscope_foundation::seal::Seal;
use flankscope_metrology::gear::Flank;
use flankscope_metrology::verdict::Word;
use flankscope_metrology::wear::{Approaches, Field, FlankWear, PoseEvidence};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::origin::looked_at;
use crate::seal::{Kind, SealError, Seals};
use flankscope_foundation::files;

/// Largest file that is read, bytes: 84 teeth with both flanks need 4 MB.
const MOST_BYTES: u64 = 64 << 20;
/// Largest plausible deviation of a flank from its CAD, mm.
const MOST_MM: f64 = 10.0;

/// The neighbouring flanks that a baseline recorded in one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewReference {
    /// Tooth in the middle of the view.
    pub view: u32,
    /// Deviation of the neighbours' flanks from CAD.
    pub flanks: Vec<Reference>,
    /// Evidence of the view's rotation about the axis, as it acts on each neighbour.
    pub poses: Vec<PoseEvidence>,
}

/// Every inspected flank of a tool as it was when new.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Baseline {
    /// Name of the tool.
    pub tool: String,
    /// BLAKE3 of tool file, CAD and head file: a difference only means wear when all three are the same.
    pub hashes: BTreeMap<String, String>,
    /// Whether it was captured on the simulated bench.
    pub simulated: bool,
    pub flanks: Vec<Reference>,
    /// Evidence of each view's rotation about the axis, from all flanks in it.
    pub poses: Vec<PoseEvidence>,
    /// Neighbouring flanks recorded in each view.
    pub in_view: Vec<ViewReference>,
    /// Repeatability of the rotary stage; none where the views were approached only once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub approaches: Option<Approaches>,
}

/// One flank's deviation from CAD, cell by cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// Tooth, from 1.
    pub tooth: u32,
    /// Side.
    pub flank: Flank,
    /// Cells, positive for missing material.
    pub field: Field,
}

impl Reference {
    /// The measured deviations of a flank.
    #[must_use]
    pub fn of_flank(wear: &FlankWear) -> Self {
        Self {
            tooth: wear.tooth,
            flank: wear.flank,
            field: wear.field.clone(),
        }
    }
}

/// Why a baseline cannot be recorded or used.
#[derive(Debug, thiserror::Error)]
pub enum BaselineError {
    /// The file cannot be read or written.
    #[error("baseline {}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    #[error("baseline {}: {source}; right would be a file written by inspect --record-baseline", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: serde_json::Error,
    },
    /// The file is too large for a baseline.
    #[error("baseline {}: {bytes} bytes, at most {MOST_BYTES} are read", path.display())]
    Size {
        /// The file.
        path: PathBuf,
        bytes: u64,
    },
    /// The number of cells does not fit the grid.
    #[error("baseline {}: tooth {tooth} {flank} has {cells} cells for a grid of {columns} x {rows}", path.display())]
    Grid {
        /// The file.
        path: PathBuf,
        tooth: u32,
        /// Side.
        flank: Flank,
        /// Cells given.
        cells: usize,
        /// Columns stated.
        columns: usize,
        /// Rows stated.
        rows: usize,
    },
    /// A flank is listed twice.
    #[error("baseline {}: tooth {tooth} {flank} is there twice", path.display())]
    Twice {
        /// The file.
        path: PathBuf,
        tooth: u32,
        /// Side.
        flank: Flank,
    },
    /// A value that no measurement can give.
    #[error("baseline {}: tooth {tooth} {flank} has the {what} {value}; right would be {expected}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        tooth: u32,
        /// Side.
        flank: Flank,
        /// Name of the value.
        what: &'static str,
        value: f64,
        /// Expected values.
        expected: &'static str,
    },
    /// The file is neither signed by this station nor trusted.
    #[error(transparent)]
    Seal(#[from] SealError),
    /// Tool, CAD or head file changed since the baseline was recorded.
    #[error(
        "the baseline was recorded with another {what} file (BLAKE3 {recorded}, now {now}); record it again on a tool known to be new"
    )]
    Changed {
        /// `tool`, `cad` or `head`.
        what: String,
        /// Hash then.
        recorded: String,
        /// Hash now.
        now: String,
    },
    /// One of baseline and check is from the simulated bench, the other from a press; their difference is no wear.
    #[error(
        "baseline {} was recorded with {}, this is {}: record one here", path.display(), looked_at(!simulated), looked_at(*simulated)
    )]
    OtherKind {
        /// The file.
        path: PathBuf,
        /// Whether the present check is on the simulated bench.
        simulated: bool,
    },
    /// The check did not end in "go", so it cannot be a baseline.
    #[error("a check that ended in {verdict} is no baseline of a new tool; it must end in go")]
    NotNew { verdict: Word },
}

impl Baseline {
    /// Reads a baseline for an instrument with these files, on the simulated bench or not.
    ///
    /// # Errors
    /// The file is unreadable, malformed, not signed by this station nor trusted, recorded with other files, or simulated while
    /// the check is not (or the reverse).
    pub fn load(
        path: &Path,
        hashes: &BTreeMap<&'static str, String>,
        simulated: bool,
        seals: &Seals,
    ) -> Result<Self, BaselineError> {
        let file = |source| BaselineError::File {
            path: path.to_owned(),
            source,
        };
        let bytes = std::fs::metadata(path).map_err(file)?.len();
        if bytes > MOST_BYTES {
            return Err(BaselineError::Size {
                path: path.to_owned(),
                bytes,
            });
        }
        let text = files::read_regular(path, files::MOST_DOCUMENT_BYTES).map_err(file)?;
        let syntax = |source| BaselineError::Syntax {
            path: path.to_owned(),
            source,
        };
        let mut document: Value = serde_json::from_slice(&text).map_err(syntax)?;
        seals.believe(Kind::Baseline, path, &document)?;
        if let Some(map) = document.as_object_mut() {
            map.remove(Seal::KEY);
        }
        let baseline: Self = serde_json::from_value(document).map_err(syntax)?;
        baseline.plausible(path)?;
        for one in &baseline.flanks {
            let Field { columns, rows, .. } = one.field;
            let lengths = [one.field.wear_mm.len(), one.field.variance_mm2.len()];
            if columns == 0 || lengths != [columns.saturating_mul(rows); 2] {
                return Err(BaselineError::Grid {
                    path: path.to_owned(),
                    tooth: one.tooth,
                    flank: one.flank,
                    cells: lengths[0],
                    columns,
                    rows,
                });
            }
        }
        if baseline.simulated != simulated {
            let path = path.to_owned();
            return Err(BaselineError::OtherKind { path, simulated });
        }
        for (&what, now) in hashes {
            let recorded = baseline.hashes.get(what).cloned().unwrap_or_default();
            if recorded != *now {
                return Err(BaselineError::Changed {
                    what: what.to_owned(),
                    recorded,
                    now: now.clone(),
                });
            }
        }
        Ok(baseline)
    }

    /// Checks the values, because a trusted file may still hold implausible ones.
    fn plausible(&self, path: &Path) -> Result<(), BaselineError> {
        for (at, one) in self.flanks.iter().enumerate() {
            let Reference {
                tooth,
                flank,
                field,
            } = one;
            let of = |other: &Reference| (other.tooth, other.flank) == (*tooth, *flank);
            if self.flanks[..at].iter().any(of) {
                return Err(BaselineError::Twice {
                    path: path.to_owned(),
                    tooth: *tooth,
                    flank: *flank,
                });
            }
            let bad = |what, value, expected| BaselineError::Value {
                path: path.to_owned(),
                tooth: *tooth,
                flank: *flank,
                what,
                value,
                expected,
            };
            // NaN where nothing was measured.
            let wear = field.wear_mm.iter().find(|mm| mm.abs() > MOST_MM);
            if let Some(&mm) = wear {
                return Err(bad("deviation", mm, "at most 10 mm either way"));
            }
            for (&mm, &mm2) in field.wear_mm.iter().zip(&field.variance_mm2) {
                let measured = (0.0..f64::INFINITY).contains(&mm2);
                if mm.is_finite() && !measured || mm2 < 0.0 {
                    return Err(bad("variance", mm2, "a number, 0 mm2 or more"));
                }
            }
        }
        Ok(())
    }

    /// The JSON text that [`Self::hash`] is computed from.
    pub fn document(&self) -> String {
        // Only names, words and numbers, so it can always be written as JSON.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// BLAKE3 of [`Self::document`].
    pub fn hash(&self) -> String {
        files::hash(self.document().as_bytes())
    }

    /// Signs it and writes it atomically.
    ///
    /// # Errors
    /// Errors of the operating system.
    pub fn save(&self, path: &Path, seals: &Seals) -> Result<(), BaselineError> {
        let syntax = |source| BaselineError::Syntax {
            path: path.to_owned(),
            source,
        };
        let seal = seals.seal(Kind::Baseline, self)?;
        let mut document = serde_json::to_value(self).map_err(syntax)?;
        document[Seal::KEY] = serde_json::to_value(seal).map_err(syntax)?;
        files::write_whole(path, document.to_string().as_bytes()).map_err(|source| {
            BaselineError::File {
                path: path.to_owned(),
                source,
            }
        })
    }

    /// Evidence of the rotation of the view with this tooth in its middle.
    #[must_use]
    pub fn pose(&self, tooth: u32) -> Option<&PoseEvidence> {
        self.poses.iter().find(|pose| pose.tooth == Some(tooth))
    }

    /// A flank's cells.
    #[must_use]
    pub fn field(&self, tooth: u32, flank: Flank) -> Option<&Field> {
        self.flanks
            .iter()
            .find(|one| (one.tooth, one.flank) == (tooth, flank))
            .map(|one| &one.field)
    }
}
