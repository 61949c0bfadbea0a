//! A view's points on the CAD, collected in the cells of the unrolled bore.

use std::collections::BTreeMap;

use flankscope_metrology::gear::{Flank, GearData};
use flankscope_metrology::multiview::adjustment::{
    CameraPose, Pose, ViewInformation, compress_laid,
};
use flankscope_metrology::multiview::cylinder::{
    Around, CellObservation, Layout, cell_observations,
};
use flankscope_metrology::surface::{Closest, Surface};
use flankscope_metrology::wear::{FlankView, Measured, Sight};
use nalgebra::Vector3;

use super::view::KeptView;

/// Cells around the bore per tooth, and their height, mm.
const COLUMNS_PER_TOOTH: usize = 24;
const ROW_MM: f64 = 0.25;

/// Cell grid of a gear's bore.
pub(super) fn layout(gear: &GearData) -> Layout {
    let [low, high] = gear.height_mm;
    Layout {
        columns: COLUMNS_PER_TOOTH * gear.teeth as usize,
        rows: ((high - low) / ROW_MM).ceil().clamp(1.0, 1e4) as usize,
        height_mm: gear.height_mm,
        around: Around::Angle,
    }
}

/// A view's points on the surface.
pub(super) struct Laid<'a> {
    surface: &'a Surface,
    kept: &'a KeptView,
    tool_from_camera: CameraPose,
    /// Positions of the points, tool frame, mm.
    located: Vec<[f64; 3]>,
    closest: Vec<Closest>,
}

impl<'a> Laid<'a> {
    /// Places points on the surface.
    pub fn new(surface: &'a Surface, tool_from_camera: CameraPose, kept: &'a KeptView) -> Self {
        let located: Vec<[f64; 3]> = kept
            .points
            .iter()
            .map(|&[x, y, z, ..]| tool_from_camera.apply([x, y, z].map(f64::from)))
            .collect();
        Self {
            surface,
            kept,
            tool_from_camera,
            closest: surface.closest_many(&located),
            located,
        }
    }

    /// The view's contribution to the cells.
    pub fn cell_observations(&self, layout: &Layout) -> Vec<CellObservation> {
        let sigma_mm = self.sigma_mm();
        cell_observations(layout, &self.closest, &sigma_mm)
    }

    fn sigma_mm(&self) -> Vec<f32> {
        self.kept.points.iter().map(|point| point[3]).collect()
    }

    /// Points of the view on every flank; the head measures at distances of `range_mm`.
    pub fn flanks(&self, gear: &GearData, range_mm: [f64; 2]) -> BTreeMap<(u32, Flank), FlankView> {
        let sigma_mm = self.sigma_mm();
        let directions = self.kept.without_point.iter();
        let without_point: Vec<[f64; 3]> = directions
            .map(|&[x, y]| {
                let direction = Vector3::new(f64::from(x), f64::from(y), 1.0).normalize();
                (self.tool_from_camera.isometry() * direction).into()
            })
            .collect();
        let measured = Measured {
            points: &self.located,
            closest: &self.closest,
            sigma_mm: Some(&sigma_mm),
            sight: Some(Sight {
                surface: self.surface,
                camera_mm: self.tool_from_camera.isometry().translation.vector.into(),
                // The brightness of these rays is not stored, so they give no bound on the surface.
                dark: &without_point,
                undecoded: &[],
                range_mm,
                // Nor is that of the points.
                light: &[],
            }),
        };
        FlankView::by_flank(gear, measured)
    }

    /// The view's information on its pose.
    pub fn information(&self, at: Pose) -> Option<ViewInformation> {
        compress_laid(&self.located, &self.closest, at, self.tool_from_camera)
    }

    /// The points within `reach_mm` of the surface, tool frame, and their signed distances, mm.
    pub fn near(&self, reach_mm: f64) -> (Vec<[f64; 3]>, Vec<f64>) {
        self.located
            .iter()
            .zip(&self.closest)
            .filter(|(_, hit)| hit.signed_distance_mm.abs() <= reach_mm)
            .map(|(point, hit)| (*point, hit.signed_distance_mm))
            .unzip()
    }
}
