//! Calibrates a head from images of an ordinary board: a folder with `board.toml` and one folder of images per pose.

use std::path::{Path, PathBuf};

use flankscope_foundation::date::Date;
use flankscope_foundation::textfile::{self, TextFileError};
use flankscope_profilometry::calibrate::Artwork;
use flankscope_profilometry::calibrate::board::{
    self, Board, BoardAdjusted, BoardError, BoardFrames, BoardKind, BoardView,
};
use flankscope_profilometry::cloud::CellColumn;
use flankscope_profilometry::counts::CountRange;
use flankscope_profilometry::decode::{GridKind, OrderConsistency};
use flankscope_profilometry::frame::FrameKind;
use flankscope_profilometry::head::{CalibrationRecord, Pinhole, RigidTransform};
use flankscope_profilometry::io::images::{GreyImage, ImageError, ImageHeader};
use flankscope_profilometry::pattern::Axis;
use flankscope_profilometry::plan::Plan;
use flankscope_profilometry::{DecodeError, DecodeOptions, Decoder, FrameError, HeadModel};
use serde::Deserialize;

use super::job::{SaveError, VALID_DAYS, write};

/// Why images of an ordinary board do not give a head.
#[derive(Debug, thiserror::Error)]
pub enum BoardFolderError {
    /// Entries or files are missing or wrong; all are listed.
    #[error("{} cannot be calibrated from; it lacks:{}", folder.display(), listed(lacks))]
    Lacks {
        folder: PathBuf,
        /// Each one with the expected value.
        lacks: Vec<String>,
    },
    /// `board.toml` cannot be read.
    #[error(transparent)]
    File(#[from] TextFileError),
    /// An image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A frame that does not belong to its view.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A view cannot be decoded.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The calibration failed.
    #[error(transparent)]
    Board(#[from] BoardError),
}

/// Lacks that are listed take about so many characters: a hundred images that one plan names wrongly are no hundred lines.
const MOST_LISTED: usize = 4000;

fn listed(lacks: &[String]) -> String {
    let mut text = String::new();
    for (number, lack) in lacks.iter().enumerate() {
        if text.len() > MOST_LISTED {
            text += &format!("\n  - and {} more", lacks.len() - number);
            break;
        }
        text += &format!("\n  - {lack}");
    }
    text
}

/// `board.toml`. All keys are optional, so that all missing ones can be reported at once.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct BoardFile {
    kind: Option<BoardKind>,
    columns: Option<usize>,
    rows: Option<usize>,
    pitch_mm: Option<f64>,
    pitch_sigma_mm: Option<f64>,
    diameter_mm: Option<f64>,
    #[serde(default)]
    bright: bool,
    columns_plan: Option<PathBuf>,
    rows_plan: Option<PathBuf>,
    poses: Option<Vec<PathBuf>>,
    projector: Option<ProjectorFile>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ProjectorFile {
    width_px: u32,
    height_px: u32,
}

/// Range of points along a side of a board.
const POINTS: std::ops::RangeInclusive<usize> = 3..=200;
const LENGTHS_MM: std::ops::Range<f64> = 1e-3..1e4;
const MOST_PX: u32 = 16_384;

/// A complete folder of poses.
#[derive(Debug)]
pub struct BoardFolder {
    board: Board,
    pitch_sigma_mm: Option<f64>,
    projector_px: [u32; 2],
    camera_px: [u32; 2],
    /// Plans of the fringes that encode columns, and rows.
    plans: [Plan; 2],
    poses: Vec<PathBuf>,
}

/// What is to be printed for the board of this file; plans, poses and projector may be missing yet.
///
/// # Errors
/// The file cannot be read, or says too little of the board, or what no board can be.
pub fn board_artwork(path: &Path) -> Result<Artwork, BoardFolderError> {
    let file: BoardFile = textfile::parse_toml(path, &textfile::read(path)?)?;
    let mut lacks = Vec::new();
    match board_of(&file, &mut lacks) {
        Some(board) => Ok(board.artwork(file.pitch_sigma_mm)),
        None => Err(BoardFolderError::Lacks {
            folder: path.to_owned(),
            lacks,
        }),
    }
}

impl BoardFolder {
    /// The file that describes the board.
    pub const FILE: &str = "board.toml";

    /// Reads the folder's files and checks that every image exists. `file` is `board.toml`, by default that in the folder; plans
    /// are relative to it, poses to the folder.
    ///
    /// # Errors
    /// [`BoardFolderError::Lacks`] with everything that is missing, or a file that is not TOML of this form.
    pub fn open(folder: &Path, file: Option<&Path>) -> Result<Self, BoardFolderError> {
        let path = file.map_or_else(|| folder.join(Self::FILE), Path::to_owned);
        let mut lacks = Vec::new();
        let file: BoardFile = if path.is_file() {
            textfile::parse_toml(&path, &textfile::read(&path)?)?
        } else {
            lacks.push(format!(
                "{}: what board it is and which image shows what (docs/formats/board.md; for plates of a certified target it is captures.toml), with",
                path.display()
            ));
            BoardFile::default()
        };
        let beside = path.parent().unwrap_or(Path::new(""));
        let board = board_of(&file, &mut lacks);
        let projector_px = projector_of(&file, &mut lacks);
        let plans = [
            (&file.columns_plan, "columns_plan", Axis::Columns),
            (&file.rows_plan, "rows_plan", Axis::Rows),
        ]
        .map(|(name, key, axis)| plan_of(name.as_deref(), key, axis, beside, &mut lacks));
        let poses = poses_of(folder, file.poses, &mut lacks);
        let mut camera_px = None;
        for pose in &poses {
            for plan in plans.iter().flatten() {
                images_of(plan, pose, &mut camera_px, &mut lacks);
            }
        }
        match (board, projector_px, plans, camera_px) {
            (Some(board), Some(projector_px), [Some(columns), Some(rows)], Some(camera_px))
                if lacks.is_empty() =>
            {
                Ok(Self {
                    board,
                    pitch_sigma_mm: file.pitch_sigma_mm,
                    projector_px,
                    camera_px,
                    plans: [columns, rows],
                    poses,
                })
            }
            _ => Err(BoardFolderError::Lacks {
                folder: folder.to_owned(),
                lacks,
            }),
        }
    }

    pub fn board(&self) -> &Board {
        &self.board
    }

    /// Finds the board in every pose and adjusts a head to them. `watch` is called with each folder.
    ///
    /// # Errors
    /// A damaged image, no board, or poses that do not determine the head.
    pub fn calibrate(
        &self,
        mut watch: impl FnMut(&Path),
    ) -> Result<BoardAdjusted, BoardFolderError> {
        let views = self.poses.iter().map(|pose| {
            watch(pose);
            self.view(pose)
        });
        let views: Vec<BoardView> = views.collect::<Result<_, _>>()?;
        let geometry = self.board.geometry(self.pitch_sigma_mm);
        let name = format!("by a board: {}", self.board);
        let sizes_px = [self.camera_px, self.projector_px];
        Ok(board::adjust(&views, geometry, &name, sizes_px)?)
    }

    /// Writes the head file and returns its calibration section.
    pub fn save(
        &self,
        adjusted: &BoardAdjusted,
        path: &Path,
        date: Date,
    ) -> Result<CalibrationRecord, SaveError> {
        let record = CalibrationRecord::from_board(
            adjusted,
            &self.board,
            self.pitch_sigma_mm,
            date,
            VALID_DAYS,
        );
        let head = HeadModel {
            name: record.name_of(&adjusted.head.name),
            calibration: Some(record.clone()),
            ..adjusted.head.clone()
        };
        write(path.to_owned(), head.to_toml()?.as_bytes())?;
        Ok(record)
    }

    /// The points of the board in one pose.
    fn view(&self, pose: &Path) -> Result<BoardView, BoardFolderError> {
        let [width, height] = self.camera_px.map(|px| px as usize);
        let mut mean = vec![0f32; width * height];
        let mut of_axis = |plan: &Plan| -> Result<Vec<CellColumn>, BoardFolderError> {
            let mut frames = plan.images(pose, self.camera_px)?;
            let sensor_bits = plan.sensor.map(|sensor| sensor.bits);
            let counts = CountRange::take(&mut frames, sensor_bits);
            let lit = |frame: &&(FrameKind, GreyImage)| frame.0 != FrameKind::Dark;
            let share = 0.5 / frames.iter().filter(lit).count() as f32;
            for (_, image) in frames.iter().filter(lit) {
                for (sum, &count) in mean.iter_mut().zip(&image.pixels) {
                    *sum += share * f32::from(count);
                }
            }
            let decoder = self.decoder(plan, &counts)?;
            let mut sums = decoder.begin();
            for (kind, image) in &frames {
                sums.add(image.view(), *kind)?;
            }
            Ok(decoder.smoothed_columns(&sums)?)
        };
        let [columns, rows] = [of_axis(&self.plans[0])?, of_axis(&self.plans[1])?];
        let fringe_px = [0, 1].map(|axis| {
            f64::from(self.projector_px[axis]) / self.plans[axis].patterns.finest().periods
        });
        let name = pose.file_name().unwrap_or(pose.as_os_str());
        let frames = BoardFrames {
            size_px: self.camera_px,
            mean: &mean,
            columns: &columns,
            rows: &rows,
            fringe_px,
        };
        Ok(board::find(&name.to_string_lossy(), &self.board, &frames)?)
    }

    /// A decoder of phases: columns and rows of the projector do not depend on its pose.
    fn decoder(&self, plan: &Plan, counts: &CountRange) -> Result<Decoder, DecodeError> {
        let ideal = |[width_px, height_px]: [u32; 2]| Pinhole {
            width_px,
            height_px,
            focal_px: [f64::from(width_px); 2],
            principal_px: [width_px, height_px].map(|px| 0.5 * f64::from(px - 1)),
            distortion: [0.0; 5],
            residual: None,
        };
        let mut head = HeadModel::from_lenses(
            "not calibrated",
            ideal(self.camera_px),
            ideal(self.projector_px),
            RigidTransform {
                rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                translation_mm: [-100.0, 0.0, 0.0],
            },
        );
        head.take_sensor(plan.sensor, counts);
        let options = DecodeOptions {
            grid: GridKind::Pixel,
            dark_frame: plan.dark_frame,
            // The same smoothing as `decode`: less than the blur of a lens.
            smoothing_px: 0.7,
            // A board is flat, so a coarse fringe hardly changes over a few pixels.
            coarse_smoothing_px: 4.0,
            consistency: None,
            order_consistency: OrderConsistency::SCENE,
            patches: None,
            ..DecodeOptions::for_head(&head).with_smoothed_orders()
        };
        Decoder::new(&head, &plan.patterns, &plan.exposures_us, options)
    }
}

fn board_of(file: &BoardFile, lacks: &mut Vec<String>) -> Option<Board> {
    let before = lacks.len();
    let mut need = |there: bool, what: &str| {
        if !there {
            lacks.push(what.to_owned());
        }
    };
    need(
        file.kind.is_some(),
        "kind = \"checkerboard\", \"charuco\" or \"circles\"",
    );
    for (key, count) in [("columns", file.columns), ("rows", file.rows)] {
        match count {
            None => need(
                false,
                &format!("{key} = 9: points along that side; of squares their inner crossings"),
            ),
            Some(got) => need(
                POINTS.contains(&got),
                &format!("{key} = {got}: must be 3 to 200 points"),
            ),
        }
    }
    let circles = file.kind == Some(BoardKind::Circles);
    for (key, length, wanted) in [
        ("pitch_mm", file.pitch_mm, true),
        ("diameter_mm", file.diameter_mm, circles),
    ] {
        match length {
            None => need(
                !wanted,
                &format!("{key} = 10.0: millimetres, as printed or measured"),
            ),
            Some(got) => need(
                LENGTHS_MM.contains(&got),
                &format!("{key} = {got}: must be 0.001 to 10000 mm"),
            ),
        }
    }
    if let (Some(sigma), Some(pitch)) = (file.pitch_sigma_mm, file.pitch_mm) {
        need(
            sigma >= 0.0 && sigma < 0.1 * pitch,
            &format!(
                "pitch_sigma_mm = {sigma}: must be at least 0 and below a tenth of pitch_mm; absent if nobody certified it"
            ),
        );
    }
    if let (Some(diameter), Some(pitch)) = (file.diameter_mm, file.pitch_mm) {
        need(
            diameter < pitch,
            &format!("diameter_mm = {diameter}: circles must not touch, pitch_mm is {pitch}"),
        );
    }
    let whole = lacks.len() == before;
    Some(Board {
        kind: file.kind?,
        points: [file.columns?, file.rows?],
        pitch_mm: file.pitch_mm?,
        diameter_mm: file.diameter_mm,
        bright: file.bright,
    })
    .filter(|_| whole)
}

fn projector_of(file: &BoardFile, lacks: &mut Vec<String>) -> Option<[u32; 2]> {
    let Some(ProjectorFile {
        width_px,
        height_px,
    }) = file.projector
    else {
        lacks.push(
            "[projector] with width_px and height_px: its columns and rows as the plans count them"
                .to_owned(),
        );
        return None;
    };
    let size_px = [width_px, height_px];
    if size_px.iter().any(|px| !(2..=MOST_PX).contains(px)) {
        lacks.push(format!(
            "[projector] {width_px} x {height_px}: must be 2 to {MOST_PX} pixels"
        ));
        return None;
    }
    Some(size_px)
}

fn plan_of(
    name: Option<&Path>,
    key: &str,
    axis: Axis,
    beside: &Path,
    lacks: &mut Vec<String>,
) -> Option<Plan> {
    let (counts, along) = match axis {
        Axis::Columns => ("columns", "columns"),
        Axis::Rows => ("rows", "rows"),
    };
    let Some(name) = name else {
        lacks.push(format!(
            "{key} = \"{counts}.toml\": the plan of the fringes that count the projector's {counts} (fringes_along = \"{along}\")"
        ));
        return None;
    };
    match Plan::load(&beside.join(name)) {
        Err(error) => {
            lacks.push(format!("{key}: {error}"));
            None
        }
        Ok(plan) if plan.patterns.axis != axis => {
            lacks.push(format!(
                "{key}: fringes_along = \"{along}\" in {}",
                beside.join(name).display()
            ));
            None
        }
        Ok(plan) => Some(plan),
    }
}

/// The folders of the poses: those listed, or all in the folder.
fn poses_of(folder: &Path, listed: Option<Vec<PathBuf>>, lacks: &mut Vec<String>) -> Vec<PathBuf> {
    let mut poses: Vec<PathBuf> = match listed {
        Some(listed) => listed.iter().map(|pose| folder.join(pose)).collect(),
        None => {
            let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
            let mut folders: Vec<_> = entries
                .map(|entry| entry.path())
                .filter(|path| path.is_dir())
                .collect();
            folders.sort();
            folders
        }
    };
    let (there, gone): (Vec<_>, Vec<_>) = poses.drain(..).partition(|pose| pose.is_dir());
    for pose in gone {
        lacks.push(format!("{}: no such folder", pose.display()));
    }
    if there.len() < board::LEAST_POSES {
        lacks.push(format!(
            "poses: {} folders of images, one per pose, at least {} are needed; tilt the board about different axes",
            there.len(),
            board::LEAST_POSES
        ));
    }
    there
}

/// Checks that a pose has all images of a plan, and that their size is the same.
fn images_of(plan: &Plan, pose: &Path, camera_px: &mut Option<[u32; 2]>, lacks: &mut Vec<String>) {
    let frames = match plan.frames(pose) {
        Ok(frames) => frames,
        Err(error) => return lacks.push(error.to_string()),
    };
    for (_, path) in frames {
        let header = ImageHeader::read(&path).and_then(|header| {
            let size_px = camera_px.get_or_insert([header.width, header.height]);
            header.check(&path, *size_px)
        });
        if let Err(error) = header {
            lacks.push(error.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lacks_is_listed_until_it_floods() {
        let few = listed(&["a plan".to_owned(), "a pose".to_owned()]);
        assert_eq!(few, "\n  - a plan\n  - a pose");
        let many = listed(&vec!["x".repeat(96); 240]);
        // 5 characters before each, 101 in all: 40 are within 4 000 characters less a line, so 200 are counted.
        assert!(many.ends_with("\n  - and 200 more"), "{many}");
        assert!(many.len() < 4200);
    }
}
