//! Calibrates a head from images in folders, captured without the instrument.

use std::path::{Path, PathBuf};

use flankscope_foundation::date::Date;
use flankscope_profilometry::calibrate::cores::{self, FlatField};
use flankscope_profilometry::calibrate::{Captures, StagePose, Target};
use flankscope_profilometry::cloud::CellColumn;
use flankscope_profilometry::head::{CoreMap, SelfTest};
use flankscope_profilometry::plan::Plan;
use flankscope_profilometry::{Accumulator, DecodeOptions, Decoder, HeadModel};

use super::job::{Calibrated, CalibrationError, for_cores};
use super::views::PlateView;
use flankscope_instrument::settings::Stages;

/// Captures of a target in a folder with `captures.toml`.
#[derive(Debug)]
pub struct CaptureFolder {
    path: PathBuf,
    captures: Captures,
    plan: Plan,
    start: HeadModel,
    target: Target,
    stages: Stages,
}

impl CaptureFolder {
    /// Reads manifest and plan; `start` is the head by its design data.
    ///
    /// # Errors
    /// A file, with its line and the expected value, or a head whose sensor gain is not given.
    pub fn open(
        path: &Path,
        mut start: HeadModel,
        target: Target,
    ) -> Result<Self, CalibrationError> {
        let captures = Captures::load(path, &target)?;
        let plan = Plan::load(&path.join(&captures.plan))?;
        start.sensor = plan.sensor.or(start.sensor);
        Ok(Self {
            path: path.to_owned(),
            captures,
            plan,
            start,
            target,
            stages: Stages::default(),
        })
    }

    /// Uses these stages instead of the default ones.
    #[must_use]
    pub fn with_stages(mut self, stages: &Stages) -> Self {
        self.stages = stages.clone();
        self
    }

    /// Reads all views and adjusts the head to them. `watch` is called with each folder.
    ///
    /// # Errors
    /// An image is missing, damaged or of another size, or dots are not found or do not determine the head.
    pub fn calibrate(
        &mut self,
        mut watch: impl FnMut(&Path),
    ) -> Result<Calibrated, CalibrationError> {
        if self.start.core_map.is_none() && self.start.binning > 1 {
            watch(&self.captures.blank);
            self.start.core_map = Some(self.cores()?.into());
        }
        let decoder = self.decoder(&self.start, DecodeOptions::for_head(&self.start))?;
        let mut columns = |folder: &Path| {
            watch(folder);
            self.columns(&decoder, folder)
        };
        let blank = columns(&self.captures.blank)?;
        let views = self.captures.view.iter().map(|view| {
            let place = PlateView {
                plate: view.plate - 1,
                at: StagePose {
                    rotation_rad: view.rotation_rad,
                    vertical_mm: view.vertical_mm,
                },
                kept_aside: view.kept_aside,
            };
            Ok((place, vec![columns(&view.folder)?]))
        });
        Calibrated::of_views(&self.start, &self.target, &self.stages, &[blank], views)
    }

    /// Measures plane and sphere with a head calibrated by these captures; `None` if they show no sphere.
    ///
    /// # Errors
    /// As [`Self::calibrate`], or too few points are seen.
    pub fn self_test(
        &self,
        head: &HeadModel,
        date: Date,
    ) -> Result<Option<SelfTest>, CalibrationError> {
        if self.captures.sphere.is_empty() {
            return Ok(None);
        }
        let decoder = self.decoder(head, DecodeOptions::for_head(head))?;
        let by_each = |folder: &Path| Ok(vec![self.columns(&decoder, folder)?]);
        let plane = by_each(&self.captures.blank)?;
        let spheres = self.captures.sphere.iter().map(|folder| by_each(folder));
        let spheres: Vec<Vec<Vec<CellColumn>>> =
            spheres.collect::<Result<_, CalibrationError>>()?;
        let test = SelfTest::measure(head, &self.target, &[plane], &spheres, date);
        Ok(Some(test?))
    }

    fn cores(&self) -> Result<CoreMap, CalibrationError> {
        let sensor = self.start.sensor.ok_or(CalibrationError::NoSensor)?;
        let (head, options) = for_cores(&self.start);
        let decoder = self.decoder(&head, options)?;
        let sums = self.sums(&decoder, &self.captures.blank)?;
        Ok(cores::find(&FlatField::from_view(
            &sums,
            sensor.offset_dn,
        )?)?)
    }

    fn decoder(
        &self,
        head: &HeadModel,
        options: DecodeOptions,
    ) -> Result<Decoder, CalibrationError> {
        let options = DecodeOptions {
            dark_frame: self.plan.dark_frame,
            ..options
        };
        let Plan {
            patterns,
            exposures_us,
            ..
        } = &self.plan;
        Ok(Decoder::new(head, patterns, exposures_us, options)?)
    }

    fn columns(
        &self,
        decoder: &Decoder,
        folder: &Path,
    ) -> Result<Vec<CellColumn>, CalibrationError> {
        Ok(decoder.columns(&self.sums(decoder, folder)?)?)
    }

    fn sums(&self, decoder: &Decoder, folder: &Path) -> Result<Accumulator, CalibrationError> {
        let camera = &self.start.camera;
        let size_px = [camera.width_px, camera.height_px];
        let mut sums = decoder.begin();
        for (kind, image) in self.plan.images(&self.path.join(folder), size_px)? {
            sums.add(image.view(), kind)?;
        }
        Ok(sums)
    }
}
