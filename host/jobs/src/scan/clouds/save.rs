//! Saves the clouds of a scan as a folder that `scan --clouds` reads.

use std::path::Path;

use flankscope_foundation::date::Date;
use flankscope_metrology::io::Unit;
use flankscope_metrology::io::ply::{Column, Scalar};
use flankscope_metrology::io::points::{Format, PointFile};

use super::{CloudIndex, IndexedCloud};
use crate::scan::grid::Grid;
use crate::scan::job::Scanner;
use crate::scan::session::SessionError;
use flankscope_foundation::files::{hash, write_whole};
use flankscope_instrument::acquisition::RecordedIndex;

/// Why clouds were not saved.
#[derive(Debug, thiserror::Error)]
pub enum SaveCloudsError {
    /// The session folder cannot be read.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A file was not written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: std::path::PathBuf,
        /// Reason.
        source: std::io::Error,
    },
    /// The index cannot be written as text.
    #[error("clouds.toml: {0}")]
    Index(#[from] toml::ser::Error),
}

impl Scanner {
    /// Writes every kept view as a cloud in the camera frame, with the standard uncertainty of every point, and their index.
    /// `head` is the head file in the same folder. Returns the number of views.
    ///
    /// # Errors
    /// The session folder cannot be read, or a file was not written.
    pub fn save_clouds(&self, folder: &Path, head: &Path) -> Result<usize, SaveCloudsError> {
        let mut view = Vec::new();
        for (number, _) in self.store.session.views() {
            let kept = self.store.session.points(number)?.points;
            let points: Vec<[f64; 3]> = kept
                .iter()
                .map(|&[x, y, z, ..]| [x, y, z].map(f64::from))
                .collect();
            let sigma_mm: Vec<f32> = kept.iter().map(|of| of[3]).collect();
            let file = format!("view-{:04}.ply", number + 1);
            let path = folder.join(&file);
            let cloud = PointFile {
                comment: "camera frame, mm; sigma_z is the standard uncertainty of z",
                coordinate: Scalar::F32,
                columns: &[Column::Single("sigma_z", &sigma_mm)],
                ..PointFile::from_points(&points)
            };
            let mut bytes = Vec::new();
            let written = cloud.write(Format::Ply, &mut bytes);
            let written = written.and_then(|()| write_whole(&path, &bytes));
            written.map_err(|source| SaveCloudsError::Write { path, source })?;
            let place = &self.job.plan.views[number];
            view.push(IndexedCloud {
                file: file.into(),
                tooth: Some(place.tooth),
                rotation_rad: Some(place.rotation_rad),
                vertical_mm: Some(place.vertical_mm),
                blake3: Some(hash(&bytes)),
            });
        }
        let count = view.len();
        let index = CloudIndex {
            simulated: self.job.setting.link.is_simulated(),
            taken: Some(Date::today()),
            head: head.file_name().map(Into::into),
            unit: Unit::Mm,
            sigma_um: None,
            grid: self.views.parse::<Grid>().ok().map(|grid| grid.to_string()),
            view,
        };
        let path = folder.join(CloudIndex::FILE);
        let written = write_whole(&path, toml::to_string(&index)?.as_bytes());
        written.map_err(|source| SaveCloudsError::Write { path, source })?;
        Ok(count)
    }
}
