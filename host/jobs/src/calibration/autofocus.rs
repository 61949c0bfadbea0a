//! Autofocus on a target's blank plate: the lens is driven over its range, then in finer steps about the sharpest setting.

use std::path::Path;
use std::sync::Arc;

use flankscope_profilometry::calibrate::{Sharpest, Sharpness, Target, coarse, fine, sharpest};
use flankscope_profilometry::cloud::CellColumn;
use flankscope_profilometry::head::LensDrive;
use flankscope_profilometry::{Accumulator, DecodeError, DecodeOptions, Decoder, HeadModel};

use super::job::CalibrationError;
use super::survey::Surveyor;
use super::views;
use flankscope_frames::SharedRoot;
use flankscope_instrument::acquisition::Progress;
use flankscope_instrument::controller::ClientSettings;
use flankscope_instrument::settings::StationSettings;

/// Captures of the blank plate with a driven lens.
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
        let fine = looks.last().map_or(&[][..], Vec::as_slice);
        let sharpest = sharpest(fine, lens, head)?;
        // A correction may end slightly beyond the range of the lens.
        let ends = lens.range.map(|counts| lens.power_dpt(counts));
        let [least, most] = [ends[0].min(ends[1]), ends[0].max(ends[1])];
        let lens = lens.driven_to(sharpest.setting_dpt.clamp(least, most));
        Ok(Focused {
            lens: lens.map_err(CalibrationError::Focus)?,
            sharpest,
            steps: looks.concat(),
        })
    }
}
