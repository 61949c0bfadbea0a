//! Autofocus on a target's blank plate, or on a tooth of the die: the lens is driven over its range, then in finer steps about the sharpest setting.

use std::path::Path;
use std::sync::Arc;

use flankscope_foundation::order::median_of;
use flankscope_profilometry::calibrate::{
    MostContrast, Sharpest, Sharpness, Target, coarse, fine, most_contrast, sharpest,
};
use flankscope_profilometry::cloud::CellColumn;
use flankscope_profilometry::head::LensDrive;
use flankscope_profilometry::{Accumulator, DecodeError, DecodeOptions, Decoder, HeadModel};

use super::job::CalibrationError;
use super::survey::Surveyor;
use super::views;
use crate::plan::ViewPlan;
use crate::subject::Subject;
use flankscope_frames::SharedRoot;
use flankscope_instrument::acquisition::Progress;
use flankscope_instrument::controller::ClientSettings;
use flankscope_instrument::settings::StationSettings;

/// A cell of a die counts as lit with at least this part of the median light: gaps between teeth have noise, and no contrast.
const LIT_RATIO: f64 = 0.1;

/// Captures of one surface with a driven lens.
#[derive(Debug)]
pub struct Autofocus {
    surveyor: Surveyor<Result<Vec<CellColumn>, DecodeError>>,
    head: HeadModel,
    lens: LensDrive,
}

/// Result of an autofocus.
#[derive(Clone, Debug, PartialEq)]
pub struct Focused {
    /// The lens, driven to the nearest setting at which the camera is sharp.
    pub lens: LensDrive,
    /// The sharpest power.
    pub sharpest: Sharpest,
    /// Every setting that was tried, in order.
    pub steps: Vec<Sharpness>,
}

/// Result of an autofocus at the die.
#[derive(Clone, Debug, PartialEq)]
pub struct DieFocus {
    /// The lens, driven to the nearest setting at which the fringes have most contrast.
    pub lens: LensDrive,
    /// That setting.
    pub most: MostContrast,
    /// Every setting that was tried, in order.
    pub steps: Vec<Sharpness>,
}

impl Autofocus {
    /// Starts the threads, with frames arriving below `root`.
    ///
    /// # Errors
    /// The head has no lens or lacks other data, or shared memory cannot be created.
    pub fn open(
        head: HeadModel,
        target: &Target,
        station: &StationSettings,
        root: Arc<SharedRoot>,
    ) -> Result<Self, CalibrationError> {
        let lens = head.lens.ok_or(CalibrationError::NoLens)?;
        let at = [views::facing(&target.blank)];
        let options = DecodeOptions::for_head(&head);
        let to_cells = |decoder: &Decoder, sums: &Accumulator| decoder.columns(sums);
        Ok(Self {
            surveyor: Surveyor::open(&head, options, target, &at, (station, root), to_cells)?,
            head,
            lens,
        })
    }

    /// Starts the threads for a tooth or patch of the die, with frames arriving below `root`: the given one, else the tool file's
    /// first.
    ///
    /// # Errors
    /// The head has no lens, no view follows from tool and head, or shared memory cannot be created.
    pub fn at_die(
        subject: &Subject,
        tooth: Option<u32>,
        root: Arc<SharedRoot>,
    ) -> Result<Self, CalibrationError> {
        let head = HeadModel::clone(&subject.head);
        let lens = head.lens.ok_or(CalibrationError::NoLens)?;
        let plan = ViewPlan::of_one(&subject.tool, &head, &subject.station, tooth)?;
        let decoder = Arc::new(plan.decoder(&head, None)?);
        let program = plan.program(&subject.station);
        let to_cells = |decoder: &Decoder, sums: &Accumulator| decoder.columns(sums).map(lit_cells);
        Ok(Self {
            surveyor: Surveyor::start(program, decoder, root, to_cells)?,
            head,
            lens,
        })
    }

    /// Captures the plate at one setting after the other.
    ///
    /// # Errors
    /// A capture failed, or no setting is the sharpest.
    pub fn search(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        watch: impl FnMut(Progress),
    ) -> Result<Focused, CalibrationError> {
        let looks = self.look(port, settings, watch)?;
        let fine = looks.last().map_or(&[][..], Vec::as_slice);
        let sharpest = sharpest(fine, &self.lens, &self.head)?;
        Ok(Focused {
            lens: self.driven_to(sharpest.setting_dpt)?,
            sharpest,
            steps: looks.concat(),
        })
    }

    /// Captures a tooth of the die at one setting after the other. Its shape is none of a plate, so what a plate tells of field
    /// curvature and projector is not corrected.
    ///
    /// # Errors
    /// A capture failed, or the contrast of the fringes has no maximum.
    pub fn search_die(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        watch: impl FnMut(Progress),
    ) -> Result<DieFocus, CalibrationError> {
        let looks = self.look(port, settings, watch)?;
        let fine = looks.last().map_or(&[][..], Vec::as_slice);
        let most = most_contrast(fine, &self.lens)?;
        Ok(DieFocus {
            lens: self.driven_to(most.setting_dpt)?,
            most,
            steps: looks.concat(),
        })
    }

    /// Coarse settings over the range of the lens, then fine ones about the sharpest.
    fn look(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        watch: impl FnMut(Progress),
    ) -> Result<Vec<Vec<Sharpness>>, CalibrationError> {
        let Self {
            surveyor,
            head,
            lens,
        } = self;
        let (mut at, mut looks): (Vec<u16>, Vec<Vec<Sharpness>>) = Default::default();
        surveyor.through(port, settings, watch, |views| {
            if !at.is_empty() {
                let seen = at.iter().zip(views).map(|(&counts, cells)| {
                    Ok::<_, CalibrationError>(Sharpness::from_view(counts, &cells?, head)?)
                });
                looks.push(seen.collect::<Result<_, _>>()?);
            }
            at = match looks.as_slice() {
                [] => coarse(lens.range),
                [rough] => fine(rough)?,
                _ => Vec::new(),
            };
            let through = |&counts: &u16| LensDrive { counts, ..*lens };
            Ok::<_, CalibrationError>(at.iter().map(through).collect())
        })?;
        Ok(looks)
    }

    /// The lens at the nearest counts; a setting may end slightly beyond its range.
    fn driven_to(&self, setting_dpt: f64) -> Result<LensDrive, CalibrationError> {
        let ends = self.lens.range.map(|counts| self.lens.power_dpt(counts));
        let [least, most] = [ends[0].min(ends[1]), ends[0].max(ends[1])];
        let lens = self.lens.driven_to(setting_dpt.clamp(least, most));
        lens.map_err(CalibrationError::Focus)
    }
}

/// The cells of a die that are lit, so that gaps between teeth do not count.
pub(crate) fn lit_cells(cells: Vec<CellColumn>) -> Vec<CellColumn> {
    let median_e = median_of(cells.iter().map(|cell| cell.mean_e)).unwrap_or(0.0);
    let is_lit = |cell: &CellColumn| cell.mean_e >= LIT_RATIO * median_e;
    cells.into_iter().filter(is_lit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_between_teeth_are_not_lit() {
        let cell = |mean_e: f64| CellColumn {
            pixel: [0.0; 2],
            mean_e,
            contrast: 0.5,
            column_px: None,
        };
        let cells = [1000.0, 900.0, 1100.0, 50.0, f64::NAN, 150.0].map(cell);
        let lit: Vec<f64> = lit_cells(cells.to_vec()).iter().map(|c| c.mean_e).collect();
        assert_eq!(lit, [1000.0, 900.0, 1100.0, 150.0]);
    }
}
