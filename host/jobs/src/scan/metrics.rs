//! The article's distance metrics, applied to the same points.
//!
//! For a perfect workpiece and a perfect instrument, the distance to the nearest of many random points on the CAD is half their
//! spacing, so its histogram shows the reference cloud rather than the workpiece. The exact distance is given for comparison.

use flankscope_foundation::rigid::{Camera, Rigid, Tool as ToolFrame};
use flankscope_metrology::deviation::{Order, SampleTree, SampleTreeError, statistics};
use flankscope_metrology::gear::GearData;
use flankscope_metrology::multiview::cylinder::CylinderMap;
use flankscope_metrology::surface::sampling::{Region, SampleError, centre_of_mass};
use flankscope_metrology::tool::Tool;

use super::cell_observations::Laid;
use super::session::{Session, SessionError};
use flankscope_article::MERGED_PER_MM2;
use flankscope_record::document::scan::{Metrics, Scan, TwoMetrics};

/// Number of reference points in the article's window of one view.
const VIEW_SAMPLES: usize = 100_000;
/// Points farther away are excluded in every metric, mm.
const OUTLIER_MM: f64 = 0.5;

/// Why the metrics were not computed.
#[derive(Debug, thiserror::Error)]
pub enum MetricsError {
    /// No reference points could be drawn.
    #[error(transparent)]
    Sample(#[from] SampleError),
    /// The search tree of the reference points failed.
    #[error(transparent)]
    Tree(#[from] SampleTreeError),
    /// The points of the view cannot be read.
    #[error(transparent)]
    Session(#[from] SessionError),
}

/// Computes the metrics; `None` if no view was registered.
pub(super) fn compare(
    scan: &Scan,
    session: &Session,
    tool: &Tool,
    gear: &GearData,
) -> Result<Option<Metrics>, MetricsError> {
    let registered: Vec<_> = scan
        .registration
        .iter()
        .filter_map(|r| Some((r.view, r.tool_from_camera?)))
        .collect();
    let Some(&(view, rows)) = registered.get(registered.len() / 2) else {
        return Ok(None);
    };
    let Ok(pose) = Rigid::<ToolFrame, Camera>::from_rows(&rows) else {
        return Ok(None);
    };
    let kept = session.points(view)?;
    let laid = Laid::new(&tool.surface, pose, &kept);
    let (points, exact_mm) = laid.near(OUTLIER_MM);
    let centre = centre_of_mass(&points).unwrap_or_default();
    let region = Region {
        radial_threshold_mm: gear.radial_threshold_mm,
        ..Region::default()
    };
    let reference = region.sample(centre, &tool.mesh, VIEW_SAMPLES, 1)?;
    let one_view = spread(&points, &exact_mm, &reference)?;

    let points = merged_points(&scan.map);
    let exact_mm: Vec<f64> = scan.map.cells().map(|cell| cell.deviation_mm).collect();
    let whole = Region {
        half_height_mm: f64::MAX,
        half_angle_rad: std::f64::consts::PI,
        radial_threshold_mm: gear.radial_threshold_mm,
    };
    let middle = [1.0, 0.0, 0.0];
    let count = (MERGED_PER_MM2 * gear.area_mm2()).clamp(1.0, 1e7) as usize;
    let reference = whole.sample(middle, &tool.mesh, count, 2)?;
    let merged = spread(&points, &exact_mm, &reference)?;

    Ok(Some(Metrics {
        view,
        one_view,
        merged,
    }))
}

/// The measured position of every cell, mm.
fn merged_points(map: &CylinderMap) -> Vec<[f64; 3]> {
    map.cells().map(|cell| cell.measured()).collect()
}

fn spread(
    points: &[[f64; 3]],
    exact_mm: &[f64],
    reference: &[[f64; 3]],
) -> Result<TwoMetrics, MetricsError> {
    let nearest_mm = SampleTree::new(reference)?.distances(points, Order::Two);
    let um = |mm: &[f64]| mm.iter().map(|d| d * 1e3).collect();
    Ok(TwoMetrics {
        exact: statistics(exact_mm),
        nearest: statistics(&nearest_mm),
        exact_um: um(exact_mm),
        nearest_um: um(&nearest_mm),
    })
}
