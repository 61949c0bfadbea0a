//! Every point of every registered view in its final pose, with one view in memory at a time.

use std::io::{self, Write};

use flankscope_foundation::npz::NpzWriter;
use flankscope_foundation::rigid::{Camera, Rigid, Tool};
use flankscope_metrology::io::points::Format;

use super::session::{Session, SessionError};
use flankscope_record::document::scan::Scan;

/// Why a cloud was not written.
#[derive(Debug, thiserror::Error)]
pub enum CloudError {
    /// The session folder cannot be read.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The cloud cannot be written.
    #[error(transparent)]
    Write(#[from] io::Error),
}

/// The finally registered views, with their final poses.
pub(super) fn registered(scan: &Scan) -> impl Iterator<Item = (usize, Rigid<Tool, Camera>)> {
    let views = scan.registration.iter();
    views.filter_map(|of| {
        let pose = Rigid::from_rows(of.tool_from_camera.as_ref()?).ok()?;
        Some((of.view, pose))
    })
}

/// The points of a view in the tool frame, mm, each with its standard uncertainty along the ray, mm.
pub(super) fn points_in_tool(
    session: &Session,
    view: usize,
    tool_from_camera: Rigid<Tool, Camera>,
) -> Result<impl Iterator<Item = ([f64; 3], f32)>, SessionError> {
    let kept = session.points(view)?.points;
    Ok(kept.into_iter().map(move |[x, y, z, sigma, _]| {
        let p_tool = tool_from_camera.apply([x, y, z].map(f64::from));
        (p_tool, sigma)
    }))
}

/// Writes the cloud in the tool frame: x, y, z, standard uncertainty along the viewing ray (mm), and the number of its view as in
/// the JSON. Single precision is 4 nm at the radius of the bore. Returns the number of points.
pub(super) fn write(
    scan: &Scan,
    session: &Session,
    format: Format,
    out: &mut dyn Write,
) -> Result<u64, CloudError> {
    let held = |view: usize| session.views().find(|(held, _)| *held == view);
    let views: Vec<View> = registered(scan)
        .map(|(view, tool_from_camera)| View {
            view,
            tool_from_camera,
            count: held(view).map_or(0, |(_, entry)| entry.points),
        })
        .collect();
    let count = views.iter().map(|view| view.count).sum();
    match format {
        Format::Ply => write_ply(&views, count, session, out)?,
        Format::Npz => write_arrays(&views, count, session, out)?,
        Format::Xyz => write_text(&views, session, out)?,
        Format::Stl => {
            let why = "points are no triangles: PLY or arrays hold them";
            return Err(std::io::Error::new(std::io::ErrorKind::InvalidInput, why).into());
        }
    }
    Ok(count as u64)
}

/// A view to be written.
struct View {
    view: usize,
    tool_from_camera: Rigid<Tool, Camera>,
    /// Number of points.
    count: usize,
}

fn write_ply(
    views: &[View],
    count: usize,
    session: &Session,
    out: &mut dyn Write,
) -> Result<(), CloudError> {
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment tool frame, mm; sigma is the standard uncertainty along the ray, mm; view as in the \
         scan's JSON\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\nproperty float sigma\n\
         property ushort view\nend_header\n"
    )?;
    let mut bytes = Vec::new();
    for of in views {
        bytes.clear();
        for (p_tool, sigma) in points_in_tool(session, of.view, of.tool_from_camera)? {
            let [x, y, z] = p_tool.map(|c| c as f32);
            bytes.extend([x, y, z, sigma].into_iter().flat_map(f32::to_le_bytes));
            bytes.extend((of.view as u16).to_le_bytes());
        }
        out.write_all(&bytes)?;
    }
    Ok(())
}

fn write_text(views: &[View], session: &Session, out: &mut dyn Write) -> Result<(), CloudError> {
    for of in views {
        for (p_tool, sigma) in points_in_tool(session, of.view, of.tool_from_camera)? {
            let [x, y, z] = p_tool.map(|c| c as f32);
            writeln!(out, "{x} {y} {z} {sigma} {}", of.view)?;
        }
    }
    Ok(())
}

/// Each array takes one pass over the views, so that none is in memory as a whole.
fn write_arrays(
    views: &[View],
    count: usize,
    session: &Session,
    out: &mut dyn Write,
) -> Result<(), CloudError> {
    let mut npz = NpzWriter::new(out);
    let points = in_turn(views, session, |p_tool, _| p_tool.map(|c| c as f32));
    npz.stream("points_mm", &[count, 3], points)?;
    let sigmas = in_turn(views, session, |_, sigma| sigma);
    npz.stream("sigma", &[count], sigmas)?;
    let numbers = views
        .iter()
        .flat_map(|of| std::iter::repeat_n(of.view as u16, of.count));
    npz.stream("view", &[count], numbers.map(Ok))?;
    npz.finish()?;
    Ok(())
}

/// A property of every point, view after view.
fn in_turn<'a, T: 'a>(
    views: &'a [View],
    session: &'a Session,
    of_point: impl Fn([f64; 3], f32) -> T + Copy + 'a,
) -> impl Iterator<Item = io::Result<T>> + 'a {
    views.iter().flat_map(move |of| {
        let (points, error) = match points_in_tool(session, of.view, of.tool_from_camera) {
            Ok(points) => (Some(points), None),
            Err(error) => (None, Some(Err(io::Error::other(error)))),
        };
        let points = points.into_iter().flatten();
        points
            .map(move |(p_tool, sigma)| Ok(of_point(p_tool, sigma)))
            .chain(error)
    })
}
