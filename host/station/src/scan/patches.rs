//! What every view says of the map, kept on the disk until all poses are known: memory does not grow with the views.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use bytemuck::Zeroable;
use flankscope_metrology::cylinder::{Layout, Witness, moved};
use nalgebra::Isometry3;

use super::session::SessionError;

/// Where one view lies in the file.
#[derive(Debug)]
struct Place {
    offset: u64,
    witnesses: usize,
    /// At which it was laid on the CAD.
    tool_from_camera: Isometry3<f64>,
}

/// A file without a name in the session folder: it goes with the process, since all of it follows from the views' points.
#[derive(Debug)]
pub(super) struct Patches {
    folder: PathBuf,
    file: File,
    end: u64,
    places: BTreeMap<usize, Place>,
}

impl Patches {
    /// An empty file in `folder`.
    pub fn new(folder: &Path) -> Result<Self, SessionError> {
        let folder = folder.to_path_buf();
        match tempfile::tempfile_in(&folder) {
            Ok(file) => Ok(Self {
                folder,
                file,
                end: 0,
                places: BTreeMap::new(),
            }),
            Err(error) => Err(SessionError::Io {
                path: folder,
                error,
            }),
        }
    }

    /// Keeps a view's patch instead of an older one.
    pub fn keep(
        &mut self,
        view: usize,
        tool_from_camera: Isometry3<f64>,
        witnesses: &[Witness],
    ) -> Result<(), SessionError> {
        let bytes: &[u8] = bytemuck::cast_slice(witnesses);
        let written = self.file.write_all_at(bytes, self.end);
        written.map_err(|error| self.trouble(error))?;
        let place = Place {
            offset: self.end,
            witnesses: witnesses.len(),
            tool_from_camera,
        };
        self.places.insert(view, place);
        self.end += bytes.len() as u64;
        Ok(())
    }

    /// Pose at which a view was laid on the CAD, if it was.
    pub fn pose(&self, view: usize) -> Option<&Isometry3<f64>> {
        Some(&self.places.get(&view)?.tool_from_camera)
    }

    /// A view's patch as it is once the view has moved to `tool_from_camera`; empty for a view that was never laid.
    pub fn moved_to(
        &self,
        view: usize,
        tool_from_camera: &Isometry3<f64>,
        layout: &Layout,
    ) -> Result<Vec<Witness>, SessionError> {
        let Some(place) = self.places.get(&view) else {
            return Ok(Vec::new());
        };
        let mut witnesses = vec![Witness::zeroed(); place.witnesses];
        let bytes = bytemuck::cast_slice_mut(&mut witnesses);
        let read = self.file.read_exact_at(bytes, place.offset);
        read.map_err(|error| self.trouble(error))?;
        let motion = tool_from_camera * place.tool_from_camera.inverse();
        Ok(moved(&witnesses, layout, &motion))
    }

    fn trouble(&self, error: std::io::Error) -> SessionError {
        SessionError::Io {
            path: self.folder.clone(),
            error,
        }
    }
}
