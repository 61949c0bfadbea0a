//! A map of all views in cells of a chosen size along the toothing's profile, from which a mesh of that resolution is made.

use flankscope_metrology::gear::GearData;
use flankscope_metrology::multiview::cylinder::{Around, CylinderMap, Layout, Profile};
use flankscope_metrology::tool::Tool;

use super::cell_observations::Laid;
use super::full_cloud::registered;
use super::session::{Session, SessionError};
use flankscope_record::document::scan::Scan;

/// Largest number of cells, at 90 bytes each.
const MOST_CELLS: f64 = 1.5e7;

/// Why there is no finer map.
#[derive(Debug, thiserror::Error)]
pub enum FineMapError {
    /// The spacing gives too many or too few cells.
    #[error(
        "{spacing_mm} mm is no spacing for a mesh of this gear; right would be {least_mm:.3} to {most_mm:.3} mm"
    )]
    Spacing {
        /// Requested spacing.
        spacing_mm: f64,
        /// Smallest spacing: limited by memory.
        least_mm: f64,
        /// Largest spacing: limited by the shape of a tooth.
        most_mm: f64,
    },
    /// The session folder cannot be read.
    #[error(transparent)]
    Session(#[from] SessionError),
}

/// Layout with cells of `spacing_mm` along the profile and the axis.
pub(super) fn layout(gear: &GearData, spacing_mm: f64) -> Result<Layout, FineMapError> {
    let profile = Profile::for_gear(gear);
    let [low, high] = gear.height_mm;
    let least_mm = (profile.length_mm() * (high - low) / MOST_CELLS).sqrt();
    let most_mm = 0.5 * gear.module_mm;
    if !(least_mm..=most_mm).contains(&spacing_mm) {
        return Err(FineMapError::Spacing {
            spacing_mm,
            least_mm,
            most_mm,
        });
    }
    Ok(Layout {
        columns: (profile.length_mm() / spacing_mm).ceil() as usize,
        rows: ((high - low) / spacing_mm).ceil() as usize,
        height_mm: gear.height_mm,
        around: Around::Profile(profile),
    })
}

/// Every registered view in its final pose, read one at a time and merged as in the scan's own map.
pub(super) fn merged(
    scan: &Scan,
    session: &Session,
    tool: &Tool,
    layout: Layout,
) -> Result<CylinderMap, SessionError> {
    let mut map = CylinderMap::new(layout);
    for (view, tool_from_camera) in registered(scan) {
        let kept = session.points(view)?;
        let laid = Laid::new(&tool.surface, tool_from_camera, &kept);
        let back = tool_from_camera.inverse();
        map.add_view(&laid.cell_observations(&layout), |of| {
            let p_camera = back.apply(of.point.map(f64::from));
            scan.quality.variance_mm2(p_camera)
        });
    }
    Ok(map)
}
