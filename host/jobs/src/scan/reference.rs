//! An earlier scan of the same die, which shows whether the die was rotated by whole teeth since; the CAD cannot.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use flankscope_metrology::gear::Flank;
use flankscope_metrology::multiview::tooth_identity::{FlankMean, compare};
use serde::Deserialize;

use flankscope_record::document::scan::{FlankSeen, Placement};
use flankscope_record::origin::looked_at;
use flankscope_record::seal::{Kind, SealError, Seals};

/// Why a comparison is not possible.
#[derive(Debug, thiserror::Error)]
pub enum ReferenceError {
    /// The operating system returned an error.
    #[error("{path}: {error}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Reason.
        error: std::io::Error,
    },
    #[error(
        "{path} is no result of a scan: {error}; the file that scan --json or --report wrote is needed"
    )]
    Document {
        path: PathBuf,
        /// Reason.
        error: serde_json::Error,
    },
    #[error("{path} names no flank ({verdict}: {reason}); a scan that could be judged is needed")]
    Empty {
        /// The file.
        path: PathBuf,
        verdict: String,
        reason: String,
    },
    /// One of both scans is from the simulated bench, the other from a press.
    #[error(
        "{path} is a scan of {}, this is one of {}: they say nothing about each other; name a scan of the same die", looked_at(!simulated), looked_at(*simulated)
    )]
    OtherKind {
        /// The file.
        path: PathBuf,
        /// Whether this scan is simulated.
        simulated: bool,
    },
    /// The file is neither signed by this station nor trusted.
    #[error(transparent)]
    Seal(#[from] SealError),
    /// The earlier scan is relative to another CAD.
    #[error(
        "{path} was measured against another CAD: its BLAKE3 is {got}, this tool's is {expected}"
    )]
    OtherCad {
        /// The file.
        path: PathBuf,
        /// BLAKE3 in the earlier scan.
        got: String,
        /// BLAKE3 of this scan's CAD.
        expected: String,
    },
}

/// Entries of a scan's document that the comparison reads.
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
    /// Reads a scan's document, or that in a report's folder. `cad` is the BLAKE3 of this scan's CAD, `simulated` states whether
    /// this scan is simulated.
    ///
    /// # Errors
    /// It cannot be read, is not from a scan, judges no flank, has another CAD, or is simulated while this scan is not (or the reverse).
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

    /// Compares with this scan's flanks on a gear with `teeth` teeth.
    pub(super) fn compare(&self, seen: &[FlankSeen], teeth: u32) -> Placement {
        let of = |f: &FlankSeen| flank_mean(f.tooth, f.flank, Some(f.mean_um));
        let now: Vec<FlankMean> = seen.iter().filter_map(of).collect();
        Placement::new(compare(teeth, &self.flanks, &now))
    }
}

/// Converts a mean loss, positive for missing material, to a deviation.
fn flank_mean(tooth: u32, flank: Flank, loss_um: Option<f64>) -> Option<FlankMean> {
    Some(FlankMean {
        tooth,
        flank,
        deviation_um: -loss_um.filter(|um| um.is_finite())?,
    })
}
