//! One view of a printed plate: where the stages stood, and which dot was seen where.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::CalibrateError;
use super::dots::{self, Scale};
use super::label::label;
use super::target::{StageOffset, Target};
use crate::cloud::CellColumn;
use crate::head::HeadModel;

/// Commanded positions of the rotary and the vertical stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StagePose {
    /// Angle by which the seat is turned.
    pub rotation_rad: f64,
    /// Height by which the head is raised.
    pub vertical_mm: f64,
}

impl StagePose {
    /// Stage position that brings a place of the target, in the tool frame, to the middle of the field.
    #[must_use]
    pub fn before([x, y, z]: [f64; 3]) -> Self {
        Self {
            rotation_rad: -y.atan2(x),
            vertical_mm: z,
        }
    }

    /// The position moved by an offset.
    #[must_use]
    pub fn beside(self, place: StageOffset) -> Self {
        Self {
            rotation_rad: self.rotation_rad + place.turned_rad,
            vertical_mm: self.vertical_mm + place.raised_mm,
        }
    }

    /// The tool frame in that of the stages.
    #[must_use]
    pub fn stage_from_tool(self) -> Isometry3<f64> {
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.rotation_rad);
        Translation3::new(0.0, 0.0, -self.vertical_mm) * turned
    }
}

/// One dot, seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Column and row on the plate, counted from its middle.
    pub place: [i32; 2],
    /// Centre of its image: column, row of the camera.
    pub pixel: [f64; 2],
    /// Projector column that lights it.
    pub column_px: f64,
}

/// One view of one plate.
#[derive(Clone, Debug, PartialEq)]
pub struct Sighting {
    /// Index of the target's plate.
    pub plate: usize,
    /// Commanded position of the stages.
    pub stage: StagePose,
    /// The dots.
    pub marks: Vec<Mark>,
    /// The dots in the light of a second projector; none of a head with one.
    pub by_second: Vec<Mark>,
}

/// With fewer dots a view says too little.
const LEAST_DOTS: usize = 30;

impl Sighting {
    /// Finds and labels the dots in a view's cells, by each projector's light; `view` is its number in messages. `flat_e` is the
    /// light that each cell gets from the blank plate, by each projector.
    ///
    /// # Errors
    /// The plate or its middle is not there.
    pub fn new(
        view: usize,
        plate: usize,
        stage: StagePose,
        cells: &[Vec<CellColumn>],
        flat_e: &[Vec<f64>],
        target: &Target,
        head: &HeadModel,
    ) -> Result<Self, CalibrateError> {
        let volume = head
            .volume
            .ok_or(CalibrateError::HeadLacks { what: "[volume]" })?;
        if plate >= target.plate.len() {
            return Err(CalibrateError::NoSuchPlate {
                view,
                got: plate,
                plates: target.plate.len(),
            });
        }
        let px_per_mm = 2.0 * head.camera.focal_px[0] / (volume.near_mm + volume.far_mm);
        let scale = Scale {
            pitch_px: px_per_mm * target.dots.pitch_mm,
            radius_px: 0.5 * px_per_mm * target.dots.diameter_mm,
        };
        let mut lit = cells.iter().zip(flat_e);
        let mut marks = || match lit.next() {
            Some((cells, flat_e)) => marks(view, cells, flat_e, scale),
            None => Ok(Vec::new()),
        };
        Ok(Self {
            plate,
            stage,
            marks: marks()?,
            by_second: marks()?,
        })
    }

    /// The same view, by the second projector alone.
    #[must_use]
    pub fn by_second_projector(&self) -> Self {
        Self {
            marks: self.by_second.clone(),
            by_second: Vec::new(),
            ..self.clone()
        }
    }
}

/// The dots in one projector's light.
fn marks(
    view: usize,
    cells: &[CellColumn],
    flat_e: &[f64],
    scale: Scale,
) -> Result<Vec<Mark>, CalibrateError> {
    let dots = dots::find(cells, flat_e, scale);
    let few = |got| CalibrateError::FewDots {
        view,
        got,
        limit: LEAST_DOTS,
    };
    if dots.len() < LEAST_DOTS {
        return Err(few(dots.len()));
    }
    let labelled = label(&dots, view)?;
    if labelled.len() < LEAST_DOTS {
        return Err(few(labelled.len()));
    }
    let marks = labelled.into_iter().map(|(place, dot)| Mark {
        place,
        pixel: dots[dot].centre_px,
        column_px: dots[dot].column_px,
    });
    Ok(marks.collect())
}
