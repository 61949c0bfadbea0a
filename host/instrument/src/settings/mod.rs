//! Instrument settings that depend on the installation: ports, stages, press, light, camera. Read from `station.toml`; each has a default.
//!
//! | section | says |
//! |---|---|
//! | `controller` | port and timeouts |
//! | `camera` | the process that delivers the frames |
//! | `press` | how long it may be held, and how many openings a repeated view may use |
//! | `light` | current of the LED |
//! | `timing` | settling of stages and pattern projector, readout of the camera |
//! | `stages` | position errors, uncertainty of the mounting, clearance of the retracted head; line, axes, travel, dynamics and homing |
//! | `history` | where checks are stored |
//! | `report` | where reports for people are written |

mod axes;

use std::path::{Path, PathBuf};

use flankscope_foundation::textfile::{self, BadValue, TextFileError};
use flankscope_metrology::multiview::adjustment::Local;
use flankscope_protocol::StageConfig;
use serde::{Deserialize, Serialize};

pub use axes::{Flow, Home, ParityBit, Rotation, StageLine, Vertical};

use crate::poses::PoseSettings;
use flankscope_metrology::kinematics::Moves;

/// Contents of a station file; without one, [`StationSettings::default`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StationSettings {
    /// Name of the station, written into every result.
    #[serde(deserialize_with = "flankscope_foundation::display::some_name")]
    pub name: Option<String>,
    pub controller: Controller,
    pub camera: Camera,
    pub press: Press,
    pub light: Light,
    /// Settling and readout times of a capture.
    pub timing: Timing,
    pub stages: Stages,
    /// Where checks are stored.
    pub history: Store,
    /// Where reports are written.
    pub report: Output,
}

/// The controller's port.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Controller {
    /// Serial port, or `sim` or `qemu`, as for `--link`.
    pub link: Option<String>,
}

/// The camera's process.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Camera {
    /// Program and arguments; the folder of the shared memory is appended. Empty: the process is started by other means.
    pub command: Vec<String>,
}

/// The handshake with the press.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Press {
    /// Longest time that a watch holds the press, s.
    pub hold_limit_s: f64,
    /// Longest wait for the next opening, s: after this the press counts as stopped.
    pub opening_patience_s: f64,
    /// Number of openings that may be used for a repeated view: an opening may be over before the command arrives.
    pub openings: u32,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Light {
    /// Current of the LED, mA; never more than the controller allows.
    pub led_ma: u16,
}

/// Settling and readout times of a capture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Timing {
    /// From reaching the position to switching the light on, ms.
    pub settle_ms: u32,
    /// Longest that the DMD's controller fetches an image from its flash, ms; the controller waits for it before it triggers.
    pub pattern_load_ms: u32,
    /// From showing a pattern to the camera's trigger, µs.
    pub pattern_settle_us: u32,
    /// Readout of a frame, µs.
    pub camera_readout_us: u32,
}

/// The stages, by their data sheets. Errors are limits of a rectangular distribution.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Stages {
    /// What the rotary axis turns: die or head.
    pub moves: Moves,
    /// Source of camera poses, if not the stages.
    pub poses: PoseSettings,
    /// Largest error of the rotary stage, millidegrees.
    pub rotation_error_mdeg: f64,
    /// Largest error of the vertical stage, µm.
    pub vertical_error_um: f64,
    /// Largest deviation of the rotary stage from its mean position over approaches of one position from either side
    /// (half of ISO 230-2's bidirectional repeatability), millidegrees. None where only the error is known: then all of the error
    /// may differ between two approaches.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_repeatability_mdeg: Option<f64>,
    /// Largest deviation of the vertical stage from its mean position over approaches of one position, µm, as for the rotary stage.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vertical_repeatability_um: Option<f64>,
    /// Standard uncertainty of the head's mounting position, along each axis, µm.
    pub mount_um: f64,
    /// Largest motion of head against die since a baseline in the same mounting, by temperature and load, in any direction, µm. None
    /// where it is not known: then what the lands of the die show stands for what they do not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mount_drift_um: Option<f64>,
    /// Standard uncertainty of the head's tilt, about each axis, mrad.
    pub mount_mrad: f64,
    /// Run-out of the rotary stage, standard deviation in any direction, µm.
    pub runout_um: f64,
    /// Wobble of the rotary stage, standard deviation about any axis, µrad.
    pub wobble_urad: f64,
    /// Height of the retracted head above the die's upper face, mm.
    pub clearance_mm: f64,
    /// The serial line to the stage controller.
    pub line: StageLine,
    /// The axis that turns die or head.
    pub rotation: Rotation,
    /// The axis that raises the head.
    pub vertical: Vertical,
}

/// Where checks are stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Store {
    /// Path of the history; `--history` overrides it. A relative path starts at the folder of the station file.
    pub file: Option<PathBuf>,
    /// Number of later checks after which the phasors of a "go" are deleted.
    pub keep_phasors: u32,
    /// Largest total size of stored phasors, GB; those of "no-go" checks are kept even above it.
    pub keep_phasors_gb: f64,
}

/// Where reports for people are written.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Output {
    /// The folder; `--report` overrides it. A relative path starts at the folder of the station file.
    pub folder: Option<PathBuf>,
}

impl Default for Press {
    /// A press that does not open for 5 s has stopped, or makes fewer than 12 strokes per minute.
    fn default() -> Self {
        Self {
            hold_limit_s: 12.0,
            opening_patience_s: 5.0,
            openings: 3,
        }
    }
}

impl Default for Light {
    fn default() -> Self {
        Self { led_ma: 1_000 }
    }
}

impl Default for Timing {
    /// After 100 ms the ringing of die and head at 20 Hz and more has decayed (10 periods of 100 Hz). Mirrors settle within tens
    /// of µs. TI names up to 200 ms for an image out of the flash of a DLPC350, and nothing shorter for a DLPC900. Readout: a frame of 1920 x 1200 pixels at 16 bit takes 12.5 ms over USB 3, plus 4 % for other traffic on the link.
    fn default() -> Self {
        Self {
            settle_ms: 100,
            pattern_load_ms: 200,
            pattern_settle_us: 200,
            camera_readout_us: 13_000,
        }
    }
}

impl Default for Stages {
    /// ±15 mdeg and ±5 µm by data sheets; the mounting is an estimate of its calibration; run-out and wobble of an air or
    /// cross-roller bearing.
    fn default() -> Self {
        Self {
            moves: Moves::Die,
            poses: PoseSettings::default(),
            rotation_error_mdeg: 15.0,
            vertical_error_um: 5.0,
            rotation_repeatability_mdeg: None,
            vertical_repeatability_um: None,
            mount_um: 10.0,
            mount_drift_um: None,
            mount_mrad: 0.2,
            runout_um: 0.3,
            wobble_urad: 5.0,
            clearance_mm: 20.0,
            line: StageLine::default(),
            rotation: Rotation::default(),
            vertical: Vertical::default(),
        }
    }
}

impl Default for Store {
    fn default() -> Self {
        Self {
            file: None,
            keep_phasors: 1_000,
            keep_phasors_gb: 10.0,
        }
    }
}

/// Ratio of half-width to standard deviation of a rectangular distribution.
const SQRT_3: f64 = 1.732_050_807_568_877_2;

impl Stages {
    /// The stage configuration that is sent to the controller.
    pub fn config(&self) -> StageConfig {
        axes::config(&self.line, &self.rotation, &self.vertical)
    }

    /// Standard uncertainty of the rotary stage's angle after a move, rad.
    pub fn rotation_sigma_rad(&self) -> f64 {
        self.rotation_error_rad() / SQRT_3
    }

    /// Standard uncertainty of the vertical stage's height after a move, mm.
    pub fn vertical_sigma_mm(&self) -> f64 {
        self.vertical_error_um / 1e3 / SQRT_3
    }

    /// Standard uncertainty of the difference between an approach and the mean of all approaches of the same position: rotary
    /// stage (rad), vertical stage (mm). Equals the stages' whole uncertainty where no repeatability is stated.
    pub fn approach_sigma(&self) -> (f64, f64) {
        let rotation_rad = self
            .rotation_repeatability_mdeg
            .map(|mdeg| (mdeg / 1e3).to_radians() / SQRT_3);
        let vertical_mm = self.vertical_repeatability_um.map(|um| um / 1e3 / SQRT_3);
        (
            rotation_rad.unwrap_or(self.rotation_sigma_rad()),
            vertical_mm.unwrap_or(self.vertical_sigma_mm()),
        )
    }

    /// Standard uncertainty of the mounting's position since a baseline, along each axis, mm; none where it is not stated.
    pub fn mount_drift_mm(&self) -> Option<f64> {
        self.mount_drift_um.map(|um| um / 1e3 / SQRT_3)
    }

    /// Standard uncertainty of the head's mounting: along each axis (mm) and about each axis (rad).
    pub fn mount_sigma(&self) -> (f64, f64) {
        (self.mount_um / 1e3, self.mount_mrad / 1e3)
    }

    /// How far a single view of a scan may deviate from the pose that all views share; the shape of the workpiece is not included.
    pub fn of_single_view(&self) -> Local {
        let even = 1.0 / 3f64.sqrt();
        Local {
            rotation_rad: self.rotation_error_rad() * even,
            vertical_mm: self.vertical_error_um / 1e3 * even,
            runout_mm: self.runout_um / 1e3,
            wobble_rad: self.wobble_urad / 1e6,
            ..Local::default()
        }
    }

    fn rotation_error_rad(&self) -> f64 {
        self.rotation_error_mdeg / 1e3 * std::f64::consts::PI / 180.0
    }
}

impl StationSettings {
    /// Reads a station's file.
    ///
    /// # Errors
    /// The file cannot be read, or a value is wrong: file, line, and the expected value.
    pub fn load(path: &Path) -> Result<Self, TextFileError> {
        let (mut settings, _) = textfile::load_toml(path, textfile::MAX_BYTES, Self::check)?;
        let beside = |of: &mut Option<PathBuf>| {
            if let Some(place) = of {
                *place = path.with_file_name("").join(&*place);
            }
        };
        beside(&mut settings.history.file);
        beside(&mut settings.report.folder);
        beside(&mut settings.stages.poses.file);
        Ok(settings)
    }

    #[rustfmt::skip]
    fn check(&self) -> Result<(), BadValue> {
        let Self { press, light, timing, stages, .. } = self;
        let poses = &stages.poses;
        let has_name = self.name.as_ref().is_none_or(|name| !name.trim().is_empty());
        let has_program = |command: &[String]| !command.first().is_some_and(String::is_empty);
        let one_source = (poses.file.is_none() || poses.command.is_empty()) && has_program(&poses.command);
        let moves_stage = stages.moves != Moves::Outside || poses.is_some();
        // False for a NaN.
        let up_to = |value: f64, most: f64| value > 0.0 && value <= most;
        let within = |value: Option<f64>, most: f64| value.is_none_or(|value| up_to(value, most));
        textfile::require(&[
            (has_name, "name", &"", "a name, or no such line"),
            (has_program(&self.camera.command), "camera.command", &self.camera.command, "the program and its arguments, such as [\"flankscope-camera\", \"folder\", \"DIR\"]"),
            (up_to(press.hold_limit_s, 600.0), "press.hold_limit_s", &press.hold_limit_s, "more than 0 and at most 600 seconds"),
            (up_to(press.opening_patience_s, 600.0), "press.opening_patience_s", &press.opening_patience_s, "more than 0 and at most 600 seconds"),
            ((1..=100).contains(&press.openings), "press.openings", &press.openings, "1 to 100"),
            (light.led_ma > 0, "light.led_ma", &light.led_ma, "1 to 65535 mA; the controller has its own limit below"),
            (timing.settle_ms <= 60_000, "timing.settle_ms", &timing.settle_ms, "0 to 60000 ms"),
            (timing.pattern_load_ms <= 900, "timing.pattern_load_ms", &timing.pattern_load_ms, "0 to 900 ms"),
            (timing.pattern_settle_us <= 1_000_000, "timing.pattern_settle_us", &timing.pattern_settle_us, "0 to 1000000 us"),
            (timing.camera_readout_us <= 1_000_000, "timing.camera_readout_us", &timing.camera_readout_us, "0 to 1000000 us"),
            (up_to(self.history.keep_phasors_gb, 1e6), "history.keep_phasors_gb", &self.history.keep_phasors_gb, "more than 0 and at most 1000000 GB"),
            (up_to(stages.rotation_error_mdeg, 1e3), "stages.rotation_error_mdeg", &stages.rotation_error_mdeg, "more than 0 and at most 1000 millidegrees"),
            (up_to(stages.vertical_error_um, 1e3), "stages.vertical_error_um", &stages.vertical_error_um, "more than 0 and at most 1000 um"),
            (within(stages.rotation_repeatability_mdeg, stages.rotation_error_mdeg), "stages.rotation_repeatability_mdeg", &stages.rotation_repeatability_mdeg, "more than 0 and at most stages.rotation_error_mdeg, or no such line"),
            (within(stages.vertical_repeatability_um, stages.vertical_error_um), "stages.vertical_repeatability_um", &stages.vertical_repeatability_um, "more than 0 and at most stages.vertical_error_um, or no such line"),
            (up_to(stages.mount_um, 1e3), "stages.mount_um", &stages.mount_um, "more than 0 and at most 1000 um"),
            (within(stages.mount_drift_um, 1e3), "stages.mount_drift_um", &stages.mount_drift_um, "more than 0 and at most 1000 um, or no such line"),
            (up_to(stages.runout_um, 1e3), "stages.runout_um", &stages.runout_um, "more than 0 and at most 1000 um"),
            (up_to(stages.mount_mrad, 100.0), "stages.mount_mrad", &stages.mount_mrad, "more than 0 and at most 100 mrad"),
            (up_to(stages.wobble_urad, 1e4), "stages.wobble_urad", &stages.wobble_urad, "more than 0 and at most 10000 urad"),
            (up_to(stages.clearance_mm, 1e3), "stages.clearance_mm", &stages.clearance_mm, "more than 0 and at most 1000 mm"),
            (up_to(poses.limit_s, 600.0), "stages.poses.limit_s", &poses.limit_s, "more than 0 and at most 600 seconds"),
            (one_source, "stages.poses.command", &poses.command, "a file, or the program and its arguments; one of both"),
            (moves_stage, "stages.moves", &"outside", "[stages.poses] beside it, with the file or command that says where the head stands"),
        ])?;
        axes::check(&stages.line, &stages.rotation, &stages.vertical)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<StationSettings, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("station.toml");
        std::fs::write(&path, text).unwrap();
        StationSettings::load(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn what_a_file_leaves_out_is_as_without_one() {
        assert_eq!(load("").unwrap(), StationSettings::default());
        let slow = load("[timing]\nsettle_ms = 250\n").unwrap();
        assert_eq!(slow.timing.settle_ms, 250);
        assert_eq!(slow.timing.camera_readout_us, 13_000);
        let written = toml::to_string(&StationSettings::default()).unwrap();
        assert_eq!(load(&written).unwrap(), StationSettings::default());
    }

    /// The defaults equal the figures that were once compiled in, to the last bit.
    #[test]
    fn without_a_file_the_stages_are_those_of_the_data_sheets() {
        let stages = Stages::default();
        let pi = std::f64::consts::PI;
        assert_eq!(stages.rotation_sigma_rad(), 15e-3 * pi / 180.0 / SQRT_3);
        assert_eq!(stages.vertical_sigma_mm(), 5e-3 / SQRT_3);
        assert_eq!(stages.mount_sigma(), (10e-3, 0.2e-3));
        let whole = (stages.rotation_sigma_rad(), stages.vertical_sigma_mm());
        assert_eq!(stages.approach_sigma(), whole);
        let (one, usual) = (stages.of_single_view(), Local::default());
        assert_eq!(format!("{one:?}"), format!("{usual:?}"));
    }

    #[test]
    fn wrong_values_are_named_with_line_and_what_would_be_right() {
        for (text, named) in [
            (
                "[stages]\nmount_um = -1.0\n",
                ["station.toml:2: ", "mount_um", "at most 1000 um"],
            ),
            (
                "\n[stages]\nrunout_um = nan\n",
                ["station.toml:3: ", "runout_um", "NaN"],
            ),
            (
                "[press]\nhold_limit_s = 0.0\n",
                ["station.toml:2: ", "hold_limit_s", "600 seconds"],
            ),
            (
                "[light]\nled_ma = 0\n",
                ["station.toml:2: ", "led_ma", "1 to 65535 mA"],
            ),
            (
                "[stages]\nmount_drift_um = -1.0\n",
                ["station.toml:2: ", "mount_drift_um", "or no such line"],
            ),
            (
                "[stages]\nrotation_repeatability_mdeg = 16.0\n",
                [
                    "station.toml:2: ",
                    "rotation_repeatability_mdeg",
                    "at most stages.rotation_error_mdeg",
                ],
            ),
            (
                "[stages]\nvertical_repeatability_um = 0.0\n",
                [
                    "station.toml:2: ",
                    "vertical_repeatability_um",
                    "at most stages.vertical_error_um",
                ],
            ),
            (
                "[stages]\nmuont_um = 1.0\n",
                ["station.toml:2: ", "muont_um", "mount_um"],
            ),
            (
                "[stages.rotation]\naxis = 1\nspeed_deg_s = 80\n",
                ["station.toml:1: ", "missing field", "acceleration_deg_s2"],
            ),
            (
                "[press]\nopenings = \"soon\"\n",
                ["station.toml:2: ", "string", "u32"],
            ),
        ] {
            let error = load(text).unwrap_err();
            for word in named {
                assert!(error.contains(word), "{word}: {error}");
            }
        }
    }

    #[test]
    fn what_the_controller_would_refuse_is_refused_in_the_words_of_the_file() {
        let vertical = "[stages.vertical]\naxis = 2\nspeed_mm_s = 100\nacceleration_mm_s2 = 800\n\
            travel_mm = [-150, 150]\nhome_mm = 100\nhome_speed_mm_s = 100\nhome_at = \"switch\"\n";
        assert!(load(vertical).is_ok());
        for (was, is, said) in [
            (
                "speed_mm_s = 100",
                "speed_mm_s = 301",
                "station.toml:3: stages.vertical.speed_mm_s = 301.0: 0.001 to 300 mm/s",
            ),
            (
                "speed_mm_s = 100",
                "speed_mm_s = -5",
                "station.toml:3: stages.vertical.speed_mm_s = -5.0: 0.001 to 300 mm/s",
            ),
            (
                "acceleration_mm_s2 = 800",
                "acceleration_mm_s2 = inf",
                "station.toml:4: stages.vertical.acceleration_mm_s2 = inf: a finite number of mm/s2",
            ),
            (
                "[-150, 150]",
                "[-150, nan]",
                "station.toml:5: stages.vertical.travel_mm = NaN: a finite number of mm at the upper end",
            ),
            (
                "[-150, 150]",
                "[150, -150]",
                "station.toml:5: stages.vertical.travel_mm = -150.0: an upper end above the lower one, 150 mm at the upper end",
            ),
            (
                "[-150, 150]",
                "[-150, 400]",
                "station.toml:5: stages.vertical.travel_mm = 400.0: 0 to 150 mm at the upper end",
            ),
            (
                "home_mm = 100",
                "home_mm = 151",
                "station.toml:6: stages.vertical.home_mm = 151.0: -150 to 150 mm, within the travel",
            ),
            (
                "axis = 2",
                "axis = 4",
                "station.toml:2: stages.vertical.axis = 4.0: 1 to 3",
            ),
            (
                "axis = 2",
                "axis = 1",
                "station.toml:2: stages.vertical.axis = 1: another number than that of the rotary axis",
            ),
            (
                "home_speed_mm_s = 100",
                "home_speed_mm_s = 1",
                "station.toml:7: stages.vertical.home_speed_mm_s = 1.0: a speed at which the whole travel, and a quarter of it, \
                 takes at most 60 s; at this one it takes 375 s",
            ),
        ] {
            let error = load(&vertical.replacen(was, is, 1)).unwrap_err();
            assert!(error.ends_with(said), "{error}");
        }
        let line = load("[stages.line]\nbaud = 300\n").unwrap_err();
        assert!(
            line.ends_with("stages.line.baud = 300.0: 19200 to 921600 baud"),
            "{line}"
        );
        let even = load("[stages.line]\nbaud = 19200\nparity = \"even\"\n").unwrap_err();
        assert!(
            even.contains("19200 8E1") && even.contains("no parity"),
            "{even}"
        );
    }

    #[test]
    fn places_are_beside_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("station.toml");
        let text = "[history]\nfile = \"press.db\"\n[report]\nfolder = \"/srv/reports\"\n";
        std::fs::write(&path, text).unwrap();
        let settings = StationSettings::load(&path).unwrap();
        assert_eq!(settings.history.file, Some(folder.path().join("press.db")));
        assert_eq!(settings.report.folder, Some("/srv/reports".into()));
    }
}
