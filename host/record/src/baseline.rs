//! The golden capture of a new tool: wear is what was lost since, and what calibration and as-built form put into both
//! captures cancels.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use flankscope_foundation::seal::Seal;
use flankscope_metrology::gear::Flank;
use flankscope_metrology::verdict::Word;
use flankscope_metrology::wear::{Field, FlankWear, PoseEvidence};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::origin::looked_at;
use crate::seal::{Kind, SealError, Seals};
use flankscope_foundation::files;

/// A file of other people is not read beyond this, bytes: 84 teeth with both flanks need 4 MB.
const MOST_BYTES: u64 = 64 << 20;
/// No flank is so far from its CAD.
const MOST_MM: f64 = 10.0;

/// A baseline's record of what a view showed beside its own tooth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewReference {
    /// Tooth in the middle of the view.
    pub view: u32,
    /// Deviation of the neighbours' flanks from CAD.
    pub flanks: Vec<Reference>,
    /// What the view says of its pose about the axis, as it acts on each neighbour.
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
    /// Whether it is of the simulated bench.
    pub simulated: bool,
    /// The flanks.
    pub flanks: Vec<Reference>,
    /// What each view said of its own pose about the axis, with the neighbours in it.
    pub poses: Vec<PoseEvidence>,
    /// What each view showed beside its own tooth.
    pub in_view: Vec<ViewReference>,
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
    /// Deviations of a flank as measured.
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
#[non_exhaustive]
pub enum BaselineError {
    /// The file cannot be read or written.
    #[error("baseline {}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// The file is no baseline.
    #[error("baseline {}: {source}; right would be a file written by inspect --record-baseline", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: serde_json::Error,
    },
    /// Too large for a baseline.
    #[error("baseline {}: {bytes} bytes, at most {MOST_BYTES} are read", path.display())]
    Size {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
    },
    /// Cells that do not fill their grid.
    #[error("baseline {}: tooth {tooth} {flank} has {cells} cells for a grid of {columns} x {rows}", path.display())]
    Grid {
        /// The file.
        path: PathBuf,
        /// Tooth.
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
    /// A flank that is there twice: which one counts?
    #[error("baseline {}: tooth {tooth} {flank} is there twice", path.display())]
    Twice {
        /// The file.
        path: PathBuf,
        /// Tooth.
        tooth: u32,
        /// Side.
        flank: Flank,
    },
    /// A figure that no measurement gives.
    #[error("baseline {}: tooth {tooth} {flank} has the {what} {value}; right would be {expected}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Tooth.
        tooth: u32,
        /// Side.
        flank: Flank,
        /// Which figure.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        expected: &'static str,
    },
    /// Not this station's word, nor somebody's whom it trusts.
    #[error(transparent)]
    Seal(#[from] SealError),
    /// Something of the instrument changed since.
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
    /// A difference between the simulated bench and a press is no wear.
    #[error(
        "baseline {} was recorded with {}, this is {}: record one here", path.display(), looked_at(!simulated), looked_at(*simulated)
    )]
    OtherKind {
        /// The file.
        path: PathBuf,
        /// Whether the simulated bench is looked at now.
        simulated: bool,
    },
    /// A capture that does not deserve to be a baseline.
    #[error("a check that ended in {verdict} is no baseline of a new tool; it must end in go")]
    NotNew {
        /// Its verdict.
        verdict: Word,
    },
}

impl Baseline {
    /// Reads a baseline for an instrument with these files, at the simulated bench or not.
    ///
    /// # Errors
    /// Unreadable, malformed, not this station's word, recorded with other files, or on the bench where this is a press.
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

    /// What somebody trusts may still be nonsense.
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
            // Where nothing was measured there is no number.
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

    /// The text that its hash is of.
    #[must_use]
    pub fn document(&self) -> String {
        // Names, words and numbers: nothing of it can fail to be JSON.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// BLAKE3 of [`Self::document`].
    #[must_use]
    pub fn hash(&self) -> String {
        files::hash(self.document().as_bytes())
    }

    /// Writes it, signed, whole or not at all.
    ///
    /// # Errors
    /// The operating system's.
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

    /// What the view of a tooth said of its own pose.
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
