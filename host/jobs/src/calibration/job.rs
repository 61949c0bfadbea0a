//! Computes a head from captures: first the bundle's cores, then the dots and their adjustment.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use flankscope_foundation::date::Date;
use flankscope_foundation::textfile::{BadValue, TextFileError};
use flankscope_profilometry::calibrate::cores::{self, FindError, FlatField};
use flankscope_profilometry::calibrate::{
    Adjusted, CalibrateError, NotSharp, SelfTestError, Sighting, StagePose, Target, adjust,
    hold_out,
};
use flankscope_profilometry::cloud::CellColumn;
use flankscope_profilometry::decode::GridKind;
use flankscope_profilometry::head::CoreMap;
use flankscope_profilometry::head::{ApartRecord, CalibrationRecord, HoldOut};
use flankscope_profilometry::io::images::ImageError;
use flankscope_profilometry::{
    Accumulator, DecodeError, DecodeOptions, Decoder, FrameError, HeadModel,
};
use serde::Serialize;

use super::survey::{SurveyError, Surveyor};
use super::views::{self, PlateView};
use crate::plan::PlanningError;
use flankscope_foundation::files;
use flankscope_frames::SharedRoot;
use flankscope_instrument::acquisition::Progress;
use flankscope_instrument::controller::ClientSettings;
use flankscope_instrument::settings::{Stages, StationSettings};
use flankscope_record::origin::Link;

/// Why a calibration failed.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// The captures failed.
    #[error(transparent)]
    Survey(#[from] SurveyError),
    /// A view cannot be decoded.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The cores were not found.
    #[error(transparent)]
    Cores(#[from] FindError),
    /// The captures do not determine a head.
    #[error(transparent)]
    Calibrate(#[from] CalibrateError),
    /// The captures do not give a self-test.
    #[error(transparent)]
    SelfTest(#[from] SelfTestError),
    /// No view of the die follows from tool and head.
    #[error(transparent)]
    Planning(#[from] PlanningError),
    /// The captures do not give a focus.
    #[error(transparent)]
    NotSharp(#[from] NotSharp),
    #[error("the head's file has no [lens]: its focus is not driven")]
    NoLens,
    /// The setting is outside the lens's range.
    #[error("{}: {}", .0.got, .0.expected)]
    Focus(BadValue),
    /// A manifest or plan cannot be read.
    #[error(transparent)]
    File(#[from] TextFileError),
    /// An image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A frame that does not belong to its view.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// The sensor gain of the starting head is not given, so counts cannot be converted to electrons.
    #[error("the starting head says nothing about its sensor: give [sensor]")]
    NoSensor,
}

/// Why a head file was not written.
#[derive(Debug, thiserror::Error)]
pub enum SaveError {
    /// The operating system returned an error.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    #[error("the head cannot be put into words: {0}")]
    Toml(#[from] toml::ser::Error),
}

/// Writes a file atomically.
pub(super) fn write(path: PathBuf, bytes: &[u8]) -> Result<(), SaveError> {
    files::write_whole(&path, bytes).map_err(|source| SaveError::Write { path, source })
}

/// The search for the bundle's cores on the blank plate, captured at every pixel.
#[derive(Debug)]
pub struct CoreSearch(Surveyor<Result<FlatField, FindError>>);

impl CoreSearch {
    /// Starts the threads, with frames arriving below `root`.
    ///
    /// # Errors
    /// The head lacks what the job needs, or shared memory cannot be created.
    pub fn open(
        start: &HeadModel,
        target: &Target,
        station: &StationSettings,
        root: Arc<SharedRoot>,
    ) -> Result<Self, CalibrationError> {
        let sensor = start.sensor.ok_or(CalibrationError::NoSensor)?;
        let (head, options) = for_cores(start);
        let at = [views::facing(&target.blank)];
        let to_flat =
            move |_: &Decoder, sums: &Accumulator| FlatField::from_view(sums, sensor.offset_dn);
        Ok(Self(Surveyor::open(
            &head,
            options,
            target,
            &at,
            (station, root),
            to_flat,
        )?))
    }

    /// Captures the plate and finds the cores.
    ///
    /// # Errors
    /// The capture failed, or shows no cores.
    pub fn find(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        watch: impl FnMut(Progress),
    ) -> Result<CoreMap, CalibrationError> {
        let flats = self.0.survey(port, settings, watch)?;
        let flat = flats.into_iter().next().unwrap_or(Err(FindError::NoFrame));
        Ok(cores::find(&flat?)?)
    }
}

/// The head and decoder options for finding cores.
pub(super) fn for_cores(start: &HeadModel) -> (HeadModel, DecodeOptions) {
    // Cores extend to the bundle's rim, independent of the drawing, and are visible in any light.
    let head = HeadModel {
        image_circle: None,
        second_projector: None,
        ..start.clone()
    };
    let options = DecodeOptions {
        grid: GridKind::Pixel,
        binning: 1,
        ..DecodeOptions::for_head(&head)
    };
    (head, options)
}

/// Captures of all plates, and the head computed from them.
#[derive(Debug)]
pub struct PlateSurvey {
    surveyor: Surveyor<Result<Vec<Vec<CellColumn>>, DecodeError>>,
    start: HeadModel,
    target: Target,
    views: Vec<PlateView>,
    stages: Stages,
}

impl PlateSurvey {
    /// Starts the threads, with frames arriving below `root`; `start` has its core map already, if it needs one.
    ///
    /// # Errors
    /// The head lacks what the job needs, or shared memory cannot be created.
    pub fn open(
        start: HeadModel,
        target: Target,
        station: &StationSettings,
        root: Arc<SharedRoot>,
    ) -> Result<Self, CalibrationError> {
        let views = views::of_target(&target);
        let blank = views::facing(&target.blank);
        let at: Vec<StagePose> = [blank]
            .into_iter()
            .chain(views.iter().map(|view| view.at))
            .collect();
        let options = DecodeOptions::for_head(&start);
        let to_cells = |decoder: &Decoder, sums: &Accumulator| decoder.columns_of_each(sums);
        Ok(Self {
            surveyor: Surveyor::open(&start, options, &target, &at, (station, root), to_cells)?,
            stages: station.stages.clone(),
            start,
            target,
            views,
        })
    }

    /// Captures all plates and adjusts the head to them.
    ///
    /// # Errors
    /// A capture failed, or dots are not found or do not determine the head.
    pub fn calibrate(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        watch: impl FnMut(Progress),
    ) -> Result<Calibrated, CalibrationError> {
        let Self {
            surveyor,
            start,
            target,
            views,
            stages,
        } = self;
        let mut captured = surveyor.survey(port, settings, watch)?.into_iter();
        let blank = captured.next().unwrap_or(Ok(Vec::new()))?;
        let views = views.iter().zip(captured);
        let views = views.map(|(view, cells)| Ok((*view, cells?)));
        Calibrated::of_views(start, target, stages, &blank, views)
    }
}

/// One view of a printed plate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ViewReport {
    /// Plate of the target.
    pub plate: usize,
    /// Commanded angle of the rotary stage.
    pub rotation_deg: f64,
    /// Commanded height of the vertical stage.
    pub vertical_mm: f64,
    /// Dots found.
    pub dots: usize,
    /// Whether it was withheld from the adjustment as a test.
    pub kept_aside: bool,
}

/// A calibrated head, with the results of its calibration.
#[derive(Clone, Debug)]
pub struct Calibrated {
    /// The adjustment.
    pub adjusted: Adjusted,
    /// Plates withheld from the adjustment, measured with the head and with the one without residual fields.
    pub hold_out: [Option<HoldOut>; 2],
    /// Name of the target.
    pub target: String,
    /// Agreement of two projectors.
    pub apart: Option<ApartRecord>,
    /// Results of each view.
    pub views: Vec<ViewReport>,
}

impl Calibrated {
    /// Adjusts a head to views of printed plates, each by every projector. `blank` gives the light of each cell.
    pub(super) fn of_views(
        start: &HeadModel,
        target: &Target,
        stages: &Stages,
        blank: &[Vec<CellColumn>],
        views: impl Iterator<Item = Result<(PlateView, Vec<Vec<CellColumn>>), CalibrationError>>,
    ) -> Result<Self, CalibrationError> {
        let flat = |cells: &Vec<CellColumn>| cells.iter().map(|cell| cell.mean_e).collect();
        let flat_e: Vec<Vec<f64>> = blank.iter().map(flat).collect();
        let (mut sightings, mut kept_aside, mut reports) = (Vec::new(), Vec::new(), Vec::new());
        for (number, view) in views.enumerate() {
            let (view, cells) = view?;
            let plate = view.plate;
            let sighting = Sighting::new(number, plate, view.at, &cells, &flat_e, target, start)?;
            reports.push(ViewReport {
                plate,
                rotation_deg: view.at.rotation_rad.to_degrees(),
                vertical_mm: view.at.vertical_mm,
                dots: sighting.marks.len(),
                kept_aside: view.kept_aside,
            });
            if view.kept_aside {
                kept_aside.push((sighting, cells));
            } else {
                sightings.push(sighting);
            }
        }
        let stage_sigma = [stages.rotation_sigma_rad(), stages.vertical_sigma_mm()];
        let adjusted = adjust(start, target, &sightings, stage_sigma)?;
        let by_first: Vec<_> = kept_aside
            .iter()
            .filter_map(|(sighting, cells)| Some((sighting.clone(), cells.first()?.clone())))
            .collect();
        Ok(Self {
            hold_out: [&adjusted.head, &adjusted.without_field]
                .map(|head| hold_out(head, target, &by_first)),
            apart: ApartRecord::from_views(&adjusted, target, &kept_aside),
            adjusted,
            target: target.name.clone(),
            views: reports,
        })
    }

    /// Cores of the bundle, for a head that has one.
    pub fn cores(&self) -> Option<usize> {
        let map = self.adjusted.head.core_map.as_ref()?;
        Some(map.positions_px.len())
    }

    /// Writes the head file, and beside it the core map, if it has one. Returns the calibration section of the file, with the
    /// link through which it was made; without one for images from elsewhere.
    pub fn save(
        &self,
        path: &Path,
        link: Option<&Link>,
        date: Date,
    ) -> Result<CalibrationRecord, SaveError> {
        save_head(self.adjusted.head.clone(), path, date, |head| {
            CalibrationRecord {
                link: link.map(Link::to_string),
                simulated: link.map(Link::is_simulated),
                ..CalibrationRecord::new(
                    &self.adjusted,
                    head,
                    &self.target,
                    self.hold_out,
                    self.apart,
                    date,
                    VALID_DAYS,
                )
            }
        })
    }
}

/// Days after which a calibration expires.
pub(crate) const VALID_DAYS: u32 = 180;

/// Writes a head file, and beside it the core map, if it has one, with a record of the head's geometry.
pub fn save_head(
    mut head: HeadModel,
    path: &Path,
    date: Date,
    record: impl FnOnce(&HeadModel) -> CalibrationRecord,
) -> Result<CalibrationRecord, SaveError> {
    if let Some(map) = &head.core_map {
        let name = path.with_extension("cores.csv");
        let name = PathBuf::from(name.file_name().unwrap_or_default());
        let (csv, reference) = map.to_csv(&name, date);
        write(path.with_file_name(&name), csv.as_bytes())?;
        head.cores = Some(reference);
    }
    let record = record(&head);
    head.name = record.name_of(&head.name);
    head.calibration = Some(record.clone());
    write(path.to_owned(), head.to_toml()?.as_bytes())?;
    Ok(record)
}
