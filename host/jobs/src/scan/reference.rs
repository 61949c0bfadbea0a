//! An earlier scan of the same die: says whether it was put down turned by whole teeth since, which the CAD cannot.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use flankscope_metrology::gear::Flank;
use flankscope_metrology::multiview::tooth_identity::{Comparison, FlankMean, compare};
use flankscope_metrology::verdict::{Code, Reason};
use serde::{Deserialize, Serialize};

use super::result::FlankSeen;
use flankscope_record::origin::looked_at;
use flankscope_record::seal::{Kind, SealError, Seals};

/// Why there is nothing to compare with.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReferenceError {
    /// The operating system refuses.
    #[error("{path}: {error}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// Not what a scan writes.
    #[error(
        "{path} is no result of a scan: {error}; the file that scan --json or --report wrote is needed"
    )]
    Document {
        /// The file.
        path: PathBuf,
        /// Why.
        error: serde_json::Error,
    },
    /// A scan that judged no flank.
    #[error("{path} names no flank ({verdict}: {reason}); a scan that could be judged is needed")]
    Empty {
        /// The file.
        path: PathBuf,
        /// Its verdict.
        verdict: String,
        /// Its reason.
        reason: String,
    },
    /// A scan of the simulated bench beside one of a press.
    #[error(
        "{path} is a scan of {}, this is one of {}: they say nothing about each other; name a scan of the same die", looked_at(!simulated), looked_at(*simulated)
    )]
    OtherKind {
        /// The file.
        path: PathBuf,
        /// Whether this scan is of the simulated bench.
        simulated: bool,
    },
    /// Signed neither by this station nor by a key that it trusts.
    #[error(transparent)]
    Seal(#[from] SealError),
    /// A scan against another CAD.
    #[error(
        "{path} was measured against another CAD: its BLAKE3 is {got}, this tool's is {expected}"
    )]
    OtherCad {
        /// The file.
        path: PathBuf,
        /// There.
        got: String,
        /// Here.
        expected: String,
    },
}

/// The fields of a scan's document that a comparison reads.
#[derive(Deserialize)]
struct Document {
    verdict: String,
    reason: String,
    flank_means: Vec<Entry>,
    hashes: BTreeMap<String, String>,
    simulated: bool,
}

#[derive(Deserialize)]
struct Entry {
    tooth: u32,
    flank: Flank,
    mean_um: Option<f64>,
}

/// The flanks of an earlier scan.
#[derive(Clone, Debug)]
pub struct Reference {
    flanks: Vec<FlankMean>,
}

impl Reference {
    /// Reads a scan's document, or that in a report's folder; `cad` is the BLAKE3 of this scan's CAD, `simulated` says
    /// whether it is of the simulated bench.
    ///
    /// # Errors
    /// It cannot be read, is no scan's, judges no flank, is of another CAD, or of the bench where this is of a press.
    pub fn load(
        path: &Path,
        cad: Option<&str>,
        simulated: bool,
        seals: &Seals,
    ) -> Result<Self, ReferenceError> {
        let path = if path.is_dir() {
            path.join("scan.json")
        } else {
            path.to_path_buf()
        };
        let text = flankscope_foundation::files::read_regular(
            &path,
            flankscope_foundation::files::MOST_DOCUMENT_BYTES,
        )
        .map_err(|error| {
            let path = path.clone();
            ReferenceError::Io { path, error }
        })?;
        let no_scan = |error| ReferenceError::Document {
            path: path.clone(),
            error,
        };
        let sealed: serde_json::Value = serde_json::from_slice(&text).map_err(no_scan)?;
        let document: Document = serde_json::from_slice(&text).map_err(no_scan)?;
        let got = document.hashes.get("cad").map_or("", String::as_str);
        if let Some(expected) = cad.filter(|expected| *expected != got) {
            return Err(ReferenceError::OtherCad {
                path,
                got: got.into(),
                expected: expected.into(),
            });
        }
        if document.simulated != simulated {
            return Err(ReferenceError::OtherKind { path, simulated });
        }
        seals.believe(Kind::Scan, &path, &sealed)?;
        let of = |entry: &Entry| flank_mean(entry.tooth, entry.flank, entry.mean_um);
        let flanks: Vec<FlankMean> = document.flank_means.iter().filter_map(of).collect();
        if flanks.is_empty() {
            return Err(ReferenceError::Empty {
                path,
                verdict: document.verdict,
                reason: document.reason,
            });
        }
        Ok(Self { flanks })
    }

    /// Compares with this scan's flanks on a gear of so many teeth.
    pub(super) fn compare(&self, seen: &[FlankSeen], teeth: u32) -> Placement {
        let of = |f: &FlankSeen| flank_mean(f.tooth, f.flank, Some(f.mean_um));
        let now: Vec<FlankMean> = seen.iter().filter_map(of).collect();
        Placement::of(compare(teeth, &self.flanks, &now))
    }
}

/// A mean loss, positive for what is missing, as a deviation.
fn flank_mean(tooth: u32, flank: Flank, loss_um: Option<f64>) -> Option<FlankMean> {
    Some(FlankMean {
        tooth,
        flank,
        deviation_um: -loss_um.filter(|um| um.is_finite())?,
    })
}

/// How the die stands against the earlier scan.
#[derive(Clone, Debug, Serialize)]
pub struct Placement {
    /// `same`, `turned` (by whole teeth), or `unknown`: the flanks' own deviations do not tell.
    pub status: &'static str,
    /// What that means, in one sentence.
    pub reason: String,
    /// Teeth that the die is turned by since, positive counter-clockwise seen from above; absent when unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub turned_teeth: Option<i64>,
    /// Correlation of the flanks' deviations at the best shift.
    pub correlation: Option<f64>,
    /// Teeth that both scans show then.
    pub common_teeth: Option<usize>,
    /// Standard deviations above patterns without relation, at the best and at the next best shift.
    pub sigmas: Vec<f64>,
}

impl Placement {
    fn of(found: Option<Comparison>) -> Self {
        let turned_teeth = found.and_then(|found| found.turned_teeth());
        let (status, reason) = match turned_teeth {
            Some(0) => ("same", "every tooth is the one that it was in the earlier scan".to_string()),
            Some(teeth) => (
                "turned",
                format!(
                    "the die sits {} {} further {} than in the earlier scan: put it down as it was, or tooth numbers mean other \
                     teeth",
                    teeth.abs(),
                    if teeth.abs() == 1 { "tooth" } else { "teeth" },
                    if teeth > 0 { "counter-clockwise" } else { "clockwise" },
                ),
            ),
            None => (
                "unknown",
                "whether the die sits as in the earlier scan cannot be told: the flanks' own deviations are too small, too \
                 few, too regular, or another die's"
                    .to_string(),
            ),
        };
        let sigmas = found.map(|found| {
            let rival = found.rival.map(|rival| rival.sigmas);
            std::iter::once(found.best.sigmas).chain(rival).collect()
        });
        Self {
            status,
            reason,
            turned_teeth,
            correlation: found.map(|found| found.best.correlation),
            common_teeth: found.map(|found| found.best.common_teeth),
            sigmas: sigmas.unwrap_or_default(),
        }
    }

    /// Why the scan is no go, if it is not: its teeth are other ones than they seem.
    pub(super) fn objection(&self) -> Option<Reason> {
        let turned = self.turned_teeth.is_some_and(|teeth| teeth != 0);
        turned.then(|| Reason::instrument(Code::TurnedDie, &self.reason))
    }
}
