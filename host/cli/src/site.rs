//! The site of a measurement: station, link and operator; and what a real press requires before a file is used or anything moves.

use std::os::unix::fs::MetadataExt as _;
use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use flankscope_foundation::date;
use flankscope_foundation::display::plain;
use flankscope_instrument::settings::StationSettings;
use flankscope_jobs::subject::Subject;
use flankscope_metrology::kinematics::Moves;
use flankscope_profilometry::HeadModel;
use flankscope_record::origin::{Link, Setting};
use serde::Serialize;

use crate::help;

/// Where it is looked, and for whom: every result says so.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct Place {
    #[arg(long, value_name = help::LINK_VALUES, help = help::LINK)]
    link: Option<Link>,
    /// Name of this station, stated in every result, or its settings file (.toml) [default: the host's name]
    #[arg(long, value_name = "NAME|STATION.toml")]
    station: Option<String>,
}

impl Place {
    /// The site. `real` are options that exclude the built-in demo, each with its name and whether it was given. With one of
    /// them, the link must be named, here or in the station file.
    pub fn site(&self, real: &[(&str, bool)]) -> anyhow::Result<Site> {
        let (file, settings, hash) = self.file()?;
        let in_file = settings.controller.link.as_deref().map(str::parse);
        let in_file = in_file.transpose().context("controller.link")?;
        // A station file belongs to an instrument at a press, and may name a history.
        let of_station = [("--station", file.is_some())];
        let given = real.iter().chain(&of_station).find(|(_, given)| *given);
        let link = match (self.link.clone().or(in_file), given) {
            (Some(link), _) => link,
            (None, None) => Link::Sim,
            (None, Some((option, _))) => anyhow::bail!(
                "{option} without --link: is the die real or simulated? Add --link PORT, the controller's port such as \
                 /dev/ttyACM0, or --link sim (or qemu) for the simulated bench"
            ),
        };
        Ok(self.at(link, settings, hash))
    }

    /// The site of a recording: no controller is used, even if the station file names one.
    pub fn of_recording(&self, recorded: Link) -> anyhow::Result<Site> {
        if let Some(link) = &self.link {
            anyhow::bail!(
                "--link {link} beside --frames or --clouds: {recorded} come from no controller; leave one of them out"
            );
        }
        let (_, settings, hash) = self.file()?;
        Ok(self.at(recorded, settings, hash))
    }

    /// Path of the station file, if any, its settings, and its hash.
    fn file(&self) -> anyhow::Result<(Option<&Path>, StationSettings, Option<String>)> {
        let file = self.station.as_deref().filter(|text| is_file(text));
        let file = file.map(Path::new);
        let (settings, hash) = station_file(file)?;
        Ok((file, settings, hash))
    }

    fn at(&self, link: Link, settings: StationSettings, hash: Option<String>) -> Site {
        let named = self.station.as_deref().filter(|text| !is_file(text));
        let named = named.map(|name| plain(name).into_owned());
        Site {
            setting: Setting {
                link,
                station: named
                    .or_else(|| settings.name.clone())
                    .unwrap_or_else(host_name),
                operator: Some(user_name()),
            },
            settings: Arc::new(settings),
            hash,
        }
    }
}

/// Whether the name of a station is the path of its file.
fn is_file(station: &str) -> bool {
    Path::new(station)
        .extension()
        .is_some_and(|is| is == "toml")
}

/// Settings and hash of a station file; the defaults without one.
pub fn station_file(file: Option<&Path>) -> anyhow::Result<(StationSettings, Option<String>)> {
    let Some(path) = file else {
        return Ok((StationSettings::default(), None));
    };
    let settings = StationSettings::load(path)?;
    let bytes = flankscope_foundation::files::read_regular(
        path,
        flankscope_foundation::files::MOST_DOCUMENT_BYTES,
    )
    .with_context(|| format!("cannot read {}", path.display()))?;
    Ok((settings, Some(flankscope_foundation::files::hash(&bytes))))
}

/// Station, link, operator and instrument.
pub struct Site {
    /// Link, station and operator.
    pub setting: Setting,
    /// Settings of the instrument.
    pub settings: Arc<StationSettings>,
    /// BLAKE3 of the station file, if there is one.
    hash: Option<String>,
}

impl Site {
    /// Refuses a station whose head is moved by an external positioner, because `what` needs the station's own stages.
    pub fn with_own_stages(self, what: &str) -> anyhow::Result<Self> {
        anyhow::ensure!(
            self.settings.stages.moves != Moves::Outside,
            "stages.moves = \"outside\": {what} moves the station's own stages, and the controller claims the press for them alone; \
             it needs moves = \"die\" or \"head\""
        );
        Ok(self)
    }

    /// Refuses a station whose poses come from elsewhere than its stages, because `what` measures by the stages.
    pub fn by_its_stages(self, what: &str) -> anyhow::Result<Self> {
        anyhow::ensure!(
            !self.settings.stages.poses.is_some(),
            "[stages.poses]: {what} by where the station's own stages stand, and would never ask for these poses; if the stages are as \
             good as the station file says, give it a station file without [stages.poses]"
        );
        Ok(self)
    }

    /// The link to the controller.
    pub fn link(&self) -> &Link {
        &self.setting.link
    }

    /// Station and link, for display.
    pub fn words(&self) -> String {
        let Setting {
            link,
            station,
            operator,
        } = &self.setting;
        let what = if link.is_simulated() {
            "the simulated bench"
        } else {
            "a real press"
        };
        let operator = operator.as_deref().unwrap_or("unknown");
        format!("station  {station}, link {link} ({what}), operator {operator}")
    }

    /// Requires a tool file for a real die, which must not be judged by the built-in one.
    ///
    /// # Errors
    /// The link is a real press, and no tool was named.
    pub fn demands_tool(&self, tool: Option<&Path>) -> anyhow::Result<()> {
        let link = self.link();
        anyhow::ensure!(
            tool.is_some() || !matches!(link, Link::Port(_)),
            "--link {link} without --tool: a die in a press is not the built-in demo; add --tool DIR, the folder with \
             its tool.toml and CAD"
        );
        Ok(())
    }

    /// As [`Site::demands_tool`], and requires a head file. The arguments are the tool's folder, and a head file used instead of
    /// the one in it.
    ///
    /// # Errors
    /// The link is a real press, and one of them was not named.
    pub fn demands(&self, [tool, head]: [Option<&Path>; 2]) -> anyhow::Result<()> {
        self.demands_tool(tool)?;
        let (link @ Link::Port(_), Some(folder)) = (self.link(), tool) else {
            return Ok(());
        };
        anyhow::ensure!(
            head.is_some() || folder.join("head.toml").exists() || !folder.is_dir(),
            "--link {link}, but {} has no head.toml: the head in a press is not the built-in one; calibrate it (flankscope \
             calibrate --link {link} --target DIR -o HEAD.toml), and name the result by --head or put it there",
            folder.display()
        );
        Ok(())
    }

    /// Requires a target file for calibrating a head at a real press.
    ///
    /// # Errors
    /// The link is a real press, and no target was named.
    pub fn demands_target(&self, target: Option<&Path>) -> anyhow::Result<()> {
        let link = self.link();
        anyhow::ensure!(
            target.is_some() || !matches!(link, Link::Port(_)),
            "--link {link} without --target: plates at a press are not the built-in ones; add --target DIR, the folder with \
             their target.toml and the head.toml to start from"
        );
        Ok(())
    }

    /// Requires a calibrated head for a real press. A calibration on the simulated bench does not count there.
    ///
    /// # Errors
    /// The link is a real press, and this head is not calibrated for one.
    pub fn takes_head(&self, head: &HeadModel) -> anyhow::Result<()> {
        let link = self.link();
        let made = head.calibration.as_ref();
        if let Some(board) = made.and_then(|made| made.board.as_ref()) {
            anyhow::bail!(
                "head \"{}\" was calibrated by an ordinary board, which does not determine {}: it can be used by flankscope decode, but not for checks; calibrate it by a target of certified plates (flankscope calibrate --target DIR -o HEAD.toml)",
                head.name,
                board.unknown.join(", ")
            );
        }
        anyhow::ensure!(
            link.is_simulated() || made.and_then(|made| made.simulated) != Some(true),
            "head \"{}\" was calibrated on the simulated bench, {link} is a real press: calibrate it there \
             (flankscope calibrate --link {link} --target DIR -o HEAD.toml)",
            head.name
        );
        anyhow::ensure!(
            made.is_some() || !matches!(link, Link::Port(_)),
            "head \"{}\" has no [calibration], {link} is a real press: calibrate it there (flankscope calibrate \
             --link {link} --target DIR -o HEAD.toml), and name the result by --head or put it into the tool's folder as \
             head.toml",
            head.name
        );
        Ok(())
    }

    /// Assigns the station's settings to a subject.
    pub fn stand_before(&self, subject: &mut Subject) {
        subject.station = Arc::clone(&self.settings);
        if let Some(hash) = &self.hash {
            subject.hashes.insert("station", hash.clone());
        }
    }
}

/// Name of this host, by the system.
fn host_name() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    match name.trim() {
        "" => "unknown".into(),
        name => name.to_owned(),
    }
}

/// Name of the user, by the system.
pub fn user_name() -> String {
    let name = ["USER", "LOGNAME"]
        .into_iter()
        .find_map(|name| std::env::var(name).ok());
    // A service or a container has neither variable.
    let name = name.or_else(name_of_uid);
    name.map_or_else(|| "unknown".into(), |name| plain(&name).into_owned())
}

/// Name of this process's user in /etc/passwd; without an entry its number.
fn name_of_uid() -> Option<String> {
    let uid = std::fs::metadata("/proc/self").ok()?.uid().to_string();
    let users = std::fs::read_to_string("/etc/passwd").unwrap_or_default();
    let name = users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1) == Some(&uid)).then(|| name.to_owned())
    });
    Some(name.unwrap_or(uid))
}

/// Origin of a result; images from elsewhere have no link.
#[derive(Serialize)]
pub struct Made<'a> {
    link: Option<String>,
    simulated: Option<bool>,
    station: &'a str,
    operator: Option<&'a str>,
    date: String,
}

impl<'a> Made<'a> {
    /// Origin in this setting, or images from elsewhere.
    pub fn by(setting: &'a Setting, images: bool) -> Self {
        let link = Some(&setting.link).filter(|_| !images);
        Self {
            link: link.map(Link::to_string),
            simulated: link.map(Link::is_simulated),
            station: &setting.station,
            operator: setting.operator.as_deref(),
            date: date::now(),
        }
    }
}
