//! Writes exposures into a head file: the value of one key is replaced, comments and every other key stay as they are.

use std::path::{Path, PathBuf};

use flankscope_foundation::files;
use flankscope_profilometry::HeadModel;
use flankscope_record::seal::{Kind, SealError, Seals, Standing};
use serde::Deserialize;

/// Why exposures were not written.
#[derive(Debug, thiserror::Error)]
pub enum HeadFileError {
    /// The file cannot be read or written.
    #[error("cannot write exposures into {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// The file has no such key that could be replaced.
    #[error("{}: cannot find `exposures_us` to replace it ({why}); put `{line}` there yourself", path.display())]
    NoKey {
        /// The file.
        path: PathBuf,
        /// Reason.
        why: String,
        /// The line for the file.
        line: String,
    },
    /// The file is not the one that was read at the start.
    #[error("{}: the file has changed since the view began; put `{line}` there yourself, or begin again", path.display())]
    Changed {
        /// The file.
        path: PathBuf,
        line: String,
    },
    /// A person answers for the file as it is.
    #[error(
        "{}: {by} declared this file trusted as it is, so it is not changed; put `{line}` there yourself, then flankscope trust {} --name WHO",
        path.display(), path.display()
    )]
    TrustedAsItIs {
        /// The file.
        path: PathBuf,
        /// Name of the person.
        by: String,
        line: String,
    },
    /// The file's signature cannot be checked or renewed.
    #[error(transparent)]
    Seal(#[from] SealError),
}

/// The one key that is replaced, with its place in the text.
#[derive(Deserialize)]
struct ExposuresKey {
    exposures_us: toml::Spanned<Vec<u32>>,
}

/// The line of a head file.
pub(super) fn line(exposures_us: &[u32]) -> String {
    format!("exposures_us = {exposures_us:?}")
}

/// The text of a head file with other exposures.
fn with_exposures(text: &str, exposures_us: &[u32]) -> Result<String, String> {
    let key: ExposuresKey = toml::from_str(text).map_err(|error| error.message().to_owned())?;
    let mut text = text.to_owned();
    text.replace_range(key.exposures_us.span(), &format!("{exposures_us:?}"));
    Ok(text)
}

/// The text without the signature that the station has put at its end.
fn without_seal(text: &str) -> &str {
    let seal = text.rfind("\n[seal]\n");
    seal.map_or(text, |at| &text[..=at])
}

/// Replaces the exposures in a head file that was read with this BLAKE3, and signs it anew if this station had signed it. Exposures
/// are no part of what a calibration determines.
///
/// # Errors
/// The file cannot be changed, and is then as it was.
pub fn write_exposures(
    path: &Path,
    blake3: &str,
    exposures_us: &[u32],
    seals: &Seals,
) -> Result<(), HeadFileError> {
    let io = |source| HeadFileError::Io {
        path: path.to_owned(),
        source,
    };
    let text = files::read_text(path).map_err(io)?;
    let line = line(exposures_us);
    if files::hash(text.as_bytes()) != blake3 {
        return Err(HeadFileError::Changed {
            path: path.to_owned(),
            line,
        });
    }
    let refused = |why: String| HeadFileError::NoKey {
        path: path.to_owned(),
        why,
        line: line.clone(),
    };
    let head: HeadModel =
        toml::from_str(&text).map_err(|error| refused(error.message().to_owned()))?;
    let is_signed = match seals.head(path, head.calibration.is_some())? {
        Standing::Signed => true,
        Standing::Trusted { by } => {
            return Err(HeadFileError::TrustedAsItIs {
                path: path.to_owned(),
                by,
                line,
            });
        }
        _ => false,
    };
    let plain = if is_signed {
        without_seal(&text)
    } else {
        &text
    };
    let changed = with_exposures(plain, exposures_us).map_err(refused)?;
    let reads: HeadModel =
        toml::from_str(&changed).map_err(|error| refused(error.message().to_owned()))?;
    let same = reads.exposures_us == exposures_us
        && reads.check().is_ok()
        && !(is_signed && reads.seal.is_some());
    if !same {
        return Err(refused("the changed file would not be a head file".into()));
    }
    files::write_whole(path, changed.as_bytes()).map_err(io)?;
    if is_signed {
        seals.seal_toml(Kind::Head, path)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "name = \"a\" # exposures_us = [1]\n# exposures_us = [2]\nexposures_us = [10000,\n  20000] # ms\nbinning = 3\n\n\
                        [camera]\nwidth_px = 5\n";

    #[test]
    fn one_key_is_replaced_and_the_rest_stays_as_it_is() {
        let got = with_exposures(TEXT, &[6_300, 17_000]).unwrap();
        assert_eq!(got, TEXT.replace("[10000,\n  20000]", "[6300, 17000]"));
        assert!(with_exposures("name = \"a\"\n", &[1]).is_err());
        assert_eq!(line(&[6_300, 17_000]), "exposures_us = [6300, 17000]");
    }

    #[test]
    fn the_signature_is_taken_off_whole() {
        let sealed = format!(
            "{}\n\n[seal]\nstation = \"x\"\nblake3 = \"y\"\n",
            TEXT.trim_end()
        );
        assert_eq!(without_seal(&sealed).trim_end(), TEXT.trim_end());
        assert_eq!(without_seal(TEXT), TEXT);
    }
}
