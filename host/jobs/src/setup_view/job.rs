//! Captures of one view in a loop, each with its figures.

use std::path::Path;
use std::sync::Arc;

use flankscope_foundation::date;
use flankscope_profilometry::head::Sensor;
use flankscope_profilometry::{DecodeError, Decoder, Picture};
use flankscope_protocol::Limits;

use super::cells::CellFigures;
use super::exposures::{MeasuredLight, propose};
use crate::job::{Job, connect, runtime};
use crate::plan::{PlanningError, ViewPlan};
use crate::subject::Subject;
use flankscope_frames::SharedRoot;
use flankscope_instrument::acquisition::{
    AcquisitionError, AfterStop, Progress, Run, Stop, ViewLevels,
};
use flankscope_instrument::controller::{Client, ClientSettings};
use flankscope_record::document::{
    ExpectedByHead, ExposureLevels, LostCapture, SetupCapture, SetupView,
};
use flankscope_record::origin::Setting;

/// A modulation is enough if the sensor's own noise (read noise and rounding of a pixel) leaves the phase of the finest fringes this
/// standard deviation, rad: a six-hundredth of a period, well below what the light's own noise leaves.
const OWN_PHASE_NOISE_RAD: f64 = 0.01;
/// Level that counts as the brightest: one pixel in ten thousand exceeds it. Single hot pixels do not set an exposure.
const BRIGHT: f64 = 0.9999;

/// Why a live view could not run.
#[derive(Debug, thiserror::Error)]
pub enum LiveViewError {
    /// Controller or camera cannot be used.
    #[error(transparent)]
    Acquisition(#[from] AcquisitionError),
    /// No view follows from this tool and head.
    #[error(transparent)]
    Planning(#[from] PlanningError),
    /// The head model cannot decode.
    #[error(transparent)]
    Decode(#[from] DecodeError),
}

/// A live view of one tooth or patch, with running threads.
#[derive(Debug)]
pub struct LiveView {
    job: Job<Result<CellFigures, DecodeError>>,
    decoder: Arc<Decoder>,
    view: SetupView,
}

impl LiveView {
    /// Starts the threads, with frames arriving below `root`. Without a tooth, the tool file's first one is looked at.
    ///
    /// # Errors
    /// Tool or head lack what the job needs, or shared memory cannot be created.
    pub fn open(
        subject: Subject,
        setting: Setting,
        tooth: Option<u32>,
        root: Arc<SharedRoot>,
    ) -> Result<Self, LiveViewError> {
        let plan = ViewPlan::of_one(&subject.tool, &subject.head, &subject.station, tooth)?;
        let decoder = Arc::new(plan.decoder(&subject.head, None)?);
        let finest_set = plan.patterns.sets.len() - 1;
        let sensor = decoder.sensor();
        let view = SetupView {
            origin: subject.origin(&setting),
            tool: subject.tool.name.clone(),
            tooth: plan.views[0].tooth,
            pattern_set: plan.patterns.name.clone(),
            full_scale_dn: sensor.full_scale_dn(),
            saturation_limit_dn: sensor.saturation_limit_dn(),
            expected: ExpectedByHead {
                dark_dn: sensor.offset_dn,
                contrast: subject.head.fringe_contrast,
                modulation_dn: enough_dn(&sensor, plan.patterns.finest().steps),
            },
            captures: Vec::new(),
            lost: Vec::new(),
            stopped: None,
            proposal: None,
        };
        let (own, head) = (Arc::clone(&decoder), Arc::clone(&subject.head));
        let exposures_us = plan.exposures_us.clone();
        let evaluate =
            move |_, sums: &_| CellFigures::from_sums(&own, &head, sums, &exposures_us, finest_set);
        let circle = subject.head.image_circle;
        let job = Job::start(
            subject,
            setting,
            Arc::new(plan),
            &decoder,
            Some(root),
            evaluate,
        )?;
        job.acquisition.count_levels(circle)?;
        Ok(Self { job, decoder, view })
    }

    /// Captures the view `most` times, or until the operator interrupts it, and shows every capture with its picture. Between
    /// captures the head leaves the die and the press is released, as after a check.
    ///
    /// # Errors
    /// The first capture could not begin, or `show` fails. A capture that fails later ends the view, which says why.
    pub fn watch<E: From<LiveViewError>>(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        most: Option<u32>,
        mut progress: impl FnMut(Progress),
        mut show: impl FnMut(&SetupView, Option<&Picture>) -> Result<(), E>,
    ) -> Result<(), E> {
        let failed = |error: AcquisitionError| E::from(LiveViewError::Acquisition(error));
        runtime().map_err(failed)?.block_on(async {
            let client = connect(&self.job.acquisition, port, settings, &mut progress).await;
            let mut client = client.map_err(failed)?;
            for number in 1..=most.unwrap_or(u32::MAX) {
                let mut run = Run::new(vec![0], None);
                let captured = self.capture(&mut client, &mut run, &mut progress).await;
                let stopped = captured.map_err(failed)?;
                let limits = client.identity().limits;
                let was_captured = self.note(number, &mut run, &limits);
                match stopped {
                    Some(Stop::Interrupted) => {}
                    Some(ref stop) => self.view.stopped = Some(stop.to_string()),
                    None if was_captured => {}
                    None => {
                        let reason = run.problems.get(&0).map(ToString::to_string);
                        self.view.lose(LostCapture {
                            number,
                            reason: reason.unwrap_or_else(|| "it was not evaluated".into()),
                        });
                    }
                }
                show(&self.view, run.pictures.get(&0))?;
                if stopped.is_some() {
                    break;
                }
            }
            Ok(())
        })
    }

    /// All captures so far.
    pub fn view(&self) -> &SetupView {
        &self.view
    }

    async fn capture(
        &mut self,
        client: &mut Client,
        run: &mut Run<Result<CellFigures, DecodeError>>,
        progress: &mut impl FnMut(Progress),
    ) -> Result<Option<Stop>, AcquisitionError> {
        let missing = |run: &mut Run<_>, views: &[usize], _: Option<&Stop>| {
            Ok::<_, AcquisitionError>(run.without_outcome(views))
        };
        let acquisition = &mut self.job.acquisition;
        acquisition
            .capture_settled(client, run, &[0], AfterStop::End, missing, progress)
            .await
    }

    /// Adds a capture whose frames are complete to the view; returns whether there was one.
    fn note(
        &mut self,
        number: u32,
        run: &mut Run<Result<CellFigures, DecodeError>>,
        limits: &Limits,
    ) -> bool {
        let (Some(Ok(cells)), Some(levels)) = (run.outcomes.remove(&0), run.levels.remove(&0))
        else {
            return false;
        };
        let capture = self.figures(number, &cells, &levels);
        let light = MeasuredLight {
            dark_dn: capture.dark_dn.unwrap_or(self.view.expected.dark_dn),
            saturation_limit_dn: f64::from(self.view.saturation_limit_dn),
            bright_dn: capture
                .exposures
                .iter()
                .map(|at| (at.exposure_us, at.bright_dn))
                .collect(),
            weak_dn_per_us: cells.modulation_dn_per_us.map(|[_, weak]| weak),
            enough_dn: self.view.expected.modulation_dn,
        };
        self.view.proposal = propose(&light, limits);
        self.view.add(capture);
        true
    }

    fn figures(&self, number: u32, cells: &CellFigures, levels: &ViewLevels) -> SetupCapture {
        let full_scale_dn = self.decoder.full_scale_dn();
        let exposures = self.job.plan.exposures_us.iter().zip(&levels.exposures);
        let exposures = exposures.enumerate().map(|(at, (&exposure_us, levels))| {
            let level = |share| levels.quantile_dn(share).map_or(0.0, f64::from);
            let modulation = |which: usize| {
                let rates = cells.modulation_dn_per_us?;
                Some(rates[which] * f64::from(exposure_us))
            };
            ExposureLevels {
                exposure_us,
                median_dn: level(0.5),
                bright_dn: level(BRIGHT),
                max_dn: level(1.0),
                saturated_pixel_ratio: levels.share_above(self.view.saturation_limit_dn),
                saturated_cell_ratio: cells.saturated_ratios.get(at).copied().unwrap_or(0.0),
                modulation_dn: modulation(0),
                weak_modulation_dn: modulation(1),
                histogram: levels.binned(ExposureLevels::BINS, full_scale_dn),
            }
        });
        SetupCapture {
            number,
            date: date::now(),
            dark_dn: levels.dark.quantile_dn(0.5).map(f64::from),
            exposures: exposures.collect(),
            contrast: cells.contrast.clone(),
            focus_contrast: cells.focus_contrast,
            cells: cells.cells,
            points: cells.points,
            rejected: cells.rejected,
        }
    }
}

/// Amplitude of `steps` frames per pixel, DN, at which the sensor's own noise leaves the phase [`OWN_PHASE_NOISE_RAD`]:
/// `sigma_phase = sqrt(2 / N) sigma / B`.
fn enough_dn(sensor: &Sensor, steps: u32) -> f64 {
    let own_dn = sensor.dark_variance_e2().sqrt() / sensor.gain_e_per_dn;
    (2.0 / f64::from(steps)).sqrt() * own_dn / OWN_PHASE_NOISE_RAD
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn enough_modulation_follows_from_the_sensors_own_noise() {
        // Read noise of 4 DN and rounding of 1 / sqrt(12) DN, eight steps: half of 4.0104 DN over 0.01 rad.
        let sensor = Sensor {
            full_well_e: 30_000.0,
            gain_e_per_dn: 2.0,
            read_noise_e: 8.0,
            offset_dn: 100.0,
            bits: 12,
        };
        let own_dn = (16.0 + 1.0 / 12.0_f64).sqrt();
        assert!((enough_dn(&sensor, 8) - 50.0 * own_dn).abs() < 1e-9);
    }
}
