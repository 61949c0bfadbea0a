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

/// Writes the cloud as a binary PLY in the tool frame: x, y, z, standard uncertainty along the ray that it was seen by (mm), and the
/// number of its view as in the JSON. Single precision is 4 nm at the radius of the bore. Returns the number of points.
pub(super) fn write(
    scan: &Scan,
    session: &Session,
    out: &mut dyn Write,
) -> Result<u64, CloudError> {
    let pose = |rows: &[[f64; 4]; 4]| {
        let pose = Rigid::<Tool, Camera>::from_rows(rows).ok()?;
        Some(*pose.isometry())
    };
    let registered = scan.registration.iter();
    let registered: Vec<(usize, Isometry3<f64>)> = registered
        .filter_map(|of| Some((of.view, pose(of.tool_from_camera.as_ref()?)?)))
        .collect();
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
        for &[x, y, z, sigma, _] in &session.points(view)?.points {
            let p_tool = tool_from_camera * Point3::new(x, y, z).cast::<f64>();
            let values = [p_tool.x as f32, p_tool.y as f32, p_tool.z as f32, sigma];
            bytes.extend(values.into_iter().flat_map(f32::to_le_bytes));
            bytes.extend((view as u16).to_le_bytes());
        }
        out.write_all(&bytes)?;
    }
    Ok(count)
}
