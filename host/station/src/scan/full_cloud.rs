//! Every point of every registered view in its final pose, one view in memory after the other.

use std::io::{self, Write};

use flankscope_foundation::rigid::{Camera, Rigid, Tool};
use nalgebra::{Isometry3, Point3};

use super::result::Scan;
use super::session::{Session, SessionError};

/// Why a cloud was not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CloudError {
    /// The session folder cannot be read.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The cloud cannot be written.
    #[error(transparent)]
    Write(#[from] io::Error),
}

/// The views that are registered in the end, with their final poses.
pub(super) fn registered(scan: &Scan) -> impl Iterator<Item = (usize, Isometry3<f64>)> {
    let views = scan.registration.iter();
    views.filter_map(|of| {
        let pose = Rigid::<Tool, Camera>::from_rows(of.tool_from_camera.as_ref()?).ok()?;
        Some((of.view, *pose.isometry()))
    })
}

/// The points of a view in the tool frame, mm, each with its standard uncertainty along the ray, mm.
pub(super) fn points_in_tool(
    session: &Session,
    view: usize,
    tool_from_camera: Isometry3<f64>,
) -> Result<impl Iterator<Item = ([f64; 3], f32)>, SessionError> {
    let kept = session.points(view)?.points;
    Ok(kept.into_iter().map(move |[x, y, z, sigma, _]| {
        let p_tool = tool_from_camera * Point3::new(x, y, z).cast::<f64>();
        (p_tool.into(), sigma)
    }))
}

/// Writes the cloud as a binary PLY in the tool frame: x, y, z, standard uncertainty along the ray that it was seen by (mm), and the
/// number of its view as in the JSON. Single precision is 4 nm at the radius of the bore. Returns the number of points.
pub(super) fn write(
    scan: &Scan,
    session: &Session,
    out: &mut dyn Write,
) -> Result<u64, CloudError> {
    let registered: Vec<(usize, Isometry3<f64>)> = registered(scan).collect();
    let held = |view: usize| session.views().find(|(held, _)| *held == view);
    let points = registered.iter().filter_map(|(view, _)| held(*view));
    let count: u64 = points.map(|(_, entry)| entry.points as u64).sum();
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment tool frame, mm; sigma is the standard uncertainty along the ray, mm; view as in the \
         scan's JSON\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\nproperty float sigma\n\
         property ushort view\nend_header\n"
    )?;
    let mut bytes = Vec::new();
    for (view, tool_from_camera) in registered {
        bytes.clear();
        for (p_tool, sigma) in points_in_tool(session, view, tool_from_camera)? {
            let [x, y, z] = p_tool.map(|c| c as f32);
            bytes.extend([x, y, z, sigma].into_iter().flat_map(f32::to_le_bytes));
            bytes.extend((view as u16).to_le_bytes());
        }
        out.write_all(&bytes)?;
    }
    Ok(count)
}
