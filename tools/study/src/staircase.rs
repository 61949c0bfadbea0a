//! A plane decoded pixel by pixel and core by core: all pixels of one core have the core's single phase.

use std::fmt::Write as _;

use flankscope_profilometry::decode::GridKind;
use flankscope_profilometry::{Cloud, DecodeOptions, Decoder, FrameView, HeadModel, PatternSet};

use flankscope_bench::demo;

use super::chart::Frame;
use flankscope_bench::world::{PatternSpec, World, WorldConfig};

use super::capture::shown;

/// Distance of the plane, in best focus, from the stage's axis, mm; and distance of the camera from that axis.
const PLANE_MM: f64 = 41.5;
const CAMERA_MM: f64 = 19.5;
/// Radius around the centre within which deviations count, mm, and half the length of the line that is drawn.
const FIELD_MM: f64 = 4.5;
const LINE_MM: f64 = 0.4;
const EXPOSURES_US: [u32; 2] = [10_000, 40_000];

/// Deviations of one decoding from the plane.
#[derive(Clone, Debug)]
pub(super) struct Profile {
    /// Root mean square of the deviations about their mean over the field, µm.
    pub rms_um: f64,
    /// Points on a line across the fringes: position, mm, and deviation, µm.
    line: Vec<[f64; 2]>,
}

/// The plane decoded pixel by pixel and core by core, from the same frames.
pub(super) fn profiles(head: &HeadModel) -> anyhow::Result<[Profile; 2]> {
    let mut config = WorldConfig::new(demo::tile(PLANE_MM, [0.0; 2]), demo::gear());
    // The projector's cores, which decoding does not affect, are blurred away.
    config.optics.projector_objective.focus_sigma_pitch = 0.6;
    let world = World::new(&config)?;
    let [pixels, cores] = [(GridKind::Pixel, 0.006), (GridKind::Core, 0.016)];
    let profile = |(grid, half_width_mm)| -> anyhow::Result<Profile> {
        Ok(profile(&capture(&world, head, grid)?, half_width_mm))
    };
    Ok([profile(pixels)?, profile(cores)?])
}

fn capture(world: &World, head: &HeadModel, grid: GridKind) -> anyhow::Result<Cloud> {
    let patterns = PatternSet::named("insitu12")?;
    let options = DecodeOptions {
        grid,
        binning: 1,
        ..DecodeOptions::for_head(head)
    };
    let decoder = Decoder::new(head, &patterns, &EXPOSURES_US, options)?;
    let sets: Vec<(f64, u32)> = patterns.sets.iter().map(|s| (s.periods, s.steps)).collect();
    let view = world.prepare(0.0, 0.0, &PatternSpec::sequence(&sets))?;
    let [width, height] = world.size_px();
    let mut pixels = vec![0; width * height];
    let mut accumulator = decoder.begin();
    for (frame, kind) in (0..).zip(decoder.capture_order()) {
        let (pattern, exposure) = shown(kind, &sets);
        let pattern = u16::try_from(pattern)?;
        world.render(
            &view,
            pattern,
            EXPOSURES_US[exposure],
            true,
            frame,
            &mut pixels,
        )?;
        accumulator.add(FrameView::packed(&pixels, width, height), kind)?;
    }
    Ok(decoder.finish(&accumulator)?.cloud)
}

fn profile(cloud: &Cloud, half_width_mm: f64) -> Profile {
    let off_um = |p: &[f64; 3]| 1e3 * (p[2] - (PLANE_MM - CAMERA_MM));
    let inside: Vec<&[f64; 3]> = cloud
        .points_mm
        .iter()
        .filter(|p| p[0].hypot(p[1]) < FIELD_MM)
        .collect();
    let mean_of = |f: &dyn Fn(&[f64; 3]) -> f64| {
        inside.iter().map(|p| f(p)).sum::<f64>() / inside.len().max(1) as f64
    };
    let mean = mean_of(&off_um);
    let mut line: Vec<[f64; 2]> = inside
        .iter()
        .filter(|p| p[1].abs() < half_width_mm && p[0].abs() < LINE_MM)
        .map(|p| [p[0], off_um(p)])
        .collect();
    line.sort_by(|a, b| a[0].total_cmp(&b[0]));
    Profile {
        rms_um: mean_of(&|p| (off_um(p) - mean).powi(2)).sqrt(),
        line,
    }
}

/// Both lines in one drawing.
pub(super) fn draw([pixels, cores]: &[Profile; 2]) -> Result<String, std::fmt::Error> {
    const SIZE: [f64; 2] = [760.0, 320.0];
    const MARGIN: [f64; 2] = [56.0, 40.0];
    let highest = pixels.line.iter().map(|p| p[1].abs()).fold(1.0, f64::max);
    let [width, height] = SIZE;
    let [left, low] = MARGIN;
    let x = |mm: f64| 0.5 * width + (0.5 * width - left) * mm / LINE_MM;
    let frame = Frame {
        size: SIZE,
        margin: MARGIN,
        reach_um: 10.0 * (highest / 10.0).ceil(),
    };
    let y = |um: f64| frame.y(um);
    let mut svg = frame.begin(0)?;
    for tenths in [-4, -2, 0, 2, 4] {
        let mm = f64::from(tenths) / 10.0;
        write!(
            svg,
            "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{mm} mm</text>",
            x(mm),
            height - low + 20.0
        )?;
    }
    let at = |p: &[f64; 2]| format!("{:.1},{:.1}", x(p[0]), y(p[1]));
    let steps: Vec<String> = pixels.line.iter().map(at).collect();
    write!(
        svg,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"#b2182b\"/>",
        steps.join(" ")
    )?;
    for p in &cores.line {
        write!(
            svg,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\" fill=\"#1f6fb2\"/>",
            x(p[0]),
            y(p[1])
        )?;
    }
    for (row, colour, name, profile) in [
        (0.0, "#b2182b", "pixel by pixel", pixels),
        (1.0, "#1f6fb2", "core by core", cores),
    ] {
        write!(
            svg,
            "<text x=\"{left}\" y=\"{}\" fill=\"{colour}\">{name}: {:.1} µm rms over the field</text>",
            16.0 + 15.0 * row,
            profile.rms_um
        )?;
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}
