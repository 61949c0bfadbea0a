//! What every view says of the map, kept on the disk until all poses are known: memory does not grow with the views.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use bytemuck::Zeroable;
use flankscope_foundation::rigid::{Rigid, Tool as ToolFrame};
use flankscope_metrology::gear::Flank;
use flankscope_metrology::multiview::adjustment::CameraPose;
use flankscope_metrology::multiview::cylinder::{CellObservation, Layout, moved};
use flankscope_metrology::wear::{FlankPoint, FlankView};

use super::session::SessionError;

/// One view of a flank, and the correction of its pose by the common solution.
type MovedView = (FlankView, Rigid<ToolFrame, ToolFrame>);

/// Where one view lies in the file.
#[derive(Debug)]
struct Place {
    offset: u64,
    cell_observations: usize,
    flanks: BTreeMap<(u32, Flank), FlankPlace>,
    /// At which it was laid on the CAD.
    tool_from_camera: CameraPose,
}

/// Where the points of one flank lie in the file: first those on it, then those under its edge, then where rays meet it.
#[derive(Clone, Copy, Debug)]
struct FlankPlace {
    offset: u64,
    on: usize,
    under: usize,
    rays: usize,
    dark: usize,
    undecoded: usize,
    slant: f64,
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

    /// Keeps a view's patch, and its points by flank, instead of older ones.
    pub fn keep(
        &mut self,
        view: usize,
        tool_from_camera: CameraPose,
        cell_observations: &[CellObservation],
        flanks: &BTreeMap<(u32, Flank), FlankView>,
    ) -> Result<(), SessionError> {
        let offset = self.write(bytemuck::cast_slice(cell_observations))?;
        let mut kept = BTreeMap::new();
        for (&key, seen) in flanks {
            let place = FlankPlace {
                offset: self.write(bytemuck::cast_slice(&seen.on))?,
                on: seen.on.len(),
                under: seen.under.len(),
                rays: seen.rays.len(),
                dark: seen.dark.len(),
                undecoded: seen.undecoded.len(),
                slant: seen.slant,
            };
            self.write(bytemuck::cast_slice(&seen.under))?;
            self.write(bytemuck::cast_slice(&seen.rays))?;
            self.write(bytemuck::cast_slice(&seen.dark))?;
            self.write(bytemuck::cast_slice(&seen.undecoded))?;
            kept.insert(key, place);
        }
        let place = Place {
            offset,
            cell_observations: cell_observations.len(),
            flanks: kept,
            tool_from_camera,
        };
        self.places.insert(view, place);
        Ok(())
    }

    /// Appends bytes; returns where they lie.
    fn write(&mut self, bytes: &[u8]) -> Result<u64, SessionError> {
        let offset = self.end;
        let written = self.file.write_all_at(bytes, offset);
        written.map_err(|error| self.trouble(error))?;
        self.end += bytes.len() as u64;
        Ok(offset)
    }

    /// Every flank that a view saw, view by view.
    pub fn flanks(&self) -> impl Iterator<Item = (u32, Flank)> + '_ {
        self.places
            .values()
            .flat_map(|place| place.flanks.keys().copied())
    }

    /// What a view saw of a flank, and how the view has moved from there to `tool_from_camera`; none where it saw nothing.
    pub fn flank(
        &self,
        view: usize,
        key: (u32, Flank),
        tool_from_camera: &CameraPose,
    ) -> Result<Option<MovedView>, SessionError> {
        let Some(place) = self.places.get(&view) else {
            return Ok(None);
        };
        let Some(of) = place.flanks.get(&key) else {
            return Ok(None);
        };
        let count = of.on + of.under + of.rays + of.dark + of.undecoded;
        let mut points = vec![FlankPoint::zeroed(); count];
        let read = self
            .file
            .read_exact_at(bytemuck::cast_slice_mut(&mut points), of.offset);
        read.map_err(|error| self.trouble(error))?;
        let mut under = points.split_off(of.on);
        let mut rays = under.split_off(of.under);
        let mut dark = rays.split_off(of.rays);
        let undecoded = dark.split_off(of.dark);
        let motion = *tool_from_camera * place.tool_from_camera.inverse();
        let seen = FlankView {
            on: points,
            under,
            rays,
            dark,
            undecoded,
            slant: of.slant,
        };
        Ok(Some((seen, motion)))
    }

    /// Pose at which a view was laid on the CAD, if it was.
    pub fn pose(&self, view: usize) -> Option<&CameraPose> {
        Some(&self.places.get(&view)?.tool_from_camera)
    }

    /// A view's patch as it is once the view has moved to `tool_from_camera`; empty for a view that was never laid.
    pub fn moved_to(
        &self,
        view: usize,
        tool_from_camera: &CameraPose,
        layout: &Layout,
    ) -> Result<Vec<CellObservation>, SessionError> {
        let Some(place) = self.places.get(&view) else {
            return Ok(Vec::new());
        };
        let mut cell_observations = vec![CellObservation::zeroed(); place.cell_observations];
        let bytes = bytemuck::cast_slice_mut(&mut cell_observations);
        let read = self.file.read_exact_at(bytes, place.offset);
        read.map_err(|error| self.trouble(error))?;
        let motion = *tool_from_camera * place.tool_from_camera.inverse();
        Ok(moved(&cell_observations, layout, &motion))
    }

    fn trouble(&self, error: std::io::Error) -> SessionError {
        SessionError::Io {
            path: self.folder.clone(),
            error,
        }
    }
}
