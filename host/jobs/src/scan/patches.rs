//! Contribution of every view to the map, stored on disk until all poses are known, so that memory does not grow with the number of views.

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

/// Position of one view's data in the file.
#[derive(Debug)]
struct Place {
    offset: u64,
    cell_observations: usize,
    flanks: BTreeMap<(u32, Flank), FlankPlace>,
    /// Pose at which it was registered to the CAD.
    tool_from_camera: CameraPose,
}

/// Position of the points of one flank in the file: first those on it, then those under its edge, then the intersections of rays with it.
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

/// An unnamed file in the session folder. It disappears with the process, because it can be computed again from the views' points.
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

    /// Stores a view's patch and its points by flank, replacing older ones.
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

    /// Appends bytes; returns their position.
    fn write(&mut self, bytes: &[u8]) -> Result<u64, SessionError> {
        let offset = self.end;
        let written = self.file.write_all_at(bytes, offset);
        written.map_err(|error| self.trouble(error))?;
        self.end += bytes.len() as u64;
        Ok(offset)
    }

    /// Every flank that a view shows, view by view.
    pub fn flanks(&self) -> impl Iterator<Item = (u32, Flank)> + '_ {
        self.places
            .values()
            .flat_map(|place| place.flanks.keys().copied())
    }

    /// Points of a view on a flank, and the motion of the view from its stored pose to `tool_from_camera`; `None` without points.
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

    /// Pose at which a view was registered to the CAD, if it was.
    pub fn pose(&self, view: usize) -> Option<&CameraPose> {
        Some(&self.places.get(&view)?.tool_from_camera)
    }

    /// A view's patch after the view has moved to `tool_from_camera`; empty for a view that was never registered.
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
