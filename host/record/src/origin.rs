//! Origin of a result: link, bench or press, head, station and operator.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use flankscope_foundation::date::Date;
use serde::Serialize;

/// Links of results that were made from recorded frames and recorded clouds.
pub const RECORDED_LINKS: [&str; 2] = ["recorded frames", "recorded clouds"];

/// Kind of controller or recording behind an instrument.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Link {
    /// The simulated bench.
    Sim,
    /// The simulated bench, with the firmware image in the emulator.
    Qemu,
    /// A controller at a serial port.
    Port(PathBuf),
    /// No controller: recorded frames.
    Recorded(RecordingId),
    /// No controller and no frames: recorded clouds.
    Clouds(RecordingId),
}

/// Kind of the measured object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum OriginKind {
    /// A die in a press.
    Press,
    /// The simulated bench.
    Bench,
    /// Recorded frames or clouds: nothing was looked at when the result was made.
    Recording,
}

impl OriginKind {
    /// Name in files and messages.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Press => "press",
            Self::Bench => "bench",
            Self::Recording => "recording",
        }
    }
}

/// A recording of frames or clouds, by its index.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RecordingId {
    /// Day on which they were taken, if known.
    pub taken: Option<Date>,
    /// BLAKE3 of the index.
    pub blake3: String,
    /// Whether the recording is simulated.
    #[serde(skip)]
    pub simulated: bool,
}

/// The text is not a link: it is empty, or results of recordings state it as theirs.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("\"{0}\" is not a link; use sim, qemu or the controller's port, such as /dev/ttyACM0")]
pub struct NoLink(pub String);

impl Link {
    /// Whether it is simulated, without a real die.
    pub fn is_simulated(&self) -> bool {
        match self {
            Self::Sim | Self::Qemu => true,
            Self::Port(_) => false,
            Self::Recorded(of) | Self::Clouds(of) => of.simulated,
        }
    }
}

impl FromStr for Link {
    type Err = NoLink;

    fn from_str(text: &str) -> Result<Self, NoLink> {
        match text {
            text if text.is_empty() || RECORDED_LINKS.contains(&text) => Err(NoLink(text.into())),
            "sim" => Ok(Self::Sim),
            "qemu" => Ok(Self::Qemu),
            port => Ok(Self::Port(port.into())),
        }
    }
}

impl fmt::Display for Link {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sim => f.write_str("sim"),
            Self::Qemu => f.write_str("qemu"),
            Self::Port(port) => port.display().fmt(f),
            Self::Recorded(_) => f.write_str(RECORDED_LINKS[0]),
            Self::Clouds(_) => f.write_str(RECORDED_LINKS[1]),
        }
    }
}

/// Link, station and operator of an instrument.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Setting {
    /// Its controller.
    pub link: Link,
    /// Name of the station.
    pub station: String,
    /// Operator, if known.
    pub operator: Option<String>,
}

/// A head by name and digest of its file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct HeadId {
    /// Its name, as its file says.
    pub name: String,
    /// BLAKE3 of its file.
    pub blake3: String,
    /// Status of its signature: built in, signed, trusted by a person, or unsigned.
    pub seal: String,
}

impl HeadId {
    /// Its name and the status of its signature.
    pub fn words(&self) -> String {
        format!("{} ({})", self.name, self.seal)
    }
}

/// Origin of a result, as it is stored.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Origin {
    /// `sim`, `qemu`, the controller's port, `recorded frames` or `recorded clouds`.
    pub link: String,
    /// Whether it is simulated, without a real die.
    pub simulated: bool,
    pub head: HeadId,
    /// Name of the station.
    pub station: String,
    pub operator: Option<String>,
    /// The recording, for recorded frames or clouds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recording: Option<RecordingId>,
}

impl Origin {
    /// Origin of a result from an instrument in this setting with this head.
    #[must_use]
    pub fn new(setting: &Setting, head: HeadId) -> Self {
        Self {
            link: setting.link.to_string(),
            simulated: setting.link.is_simulated(),
            head,
            station: setting.station.clone(),
            operator: setting.operator.clone(),
            recording: match &setting.link {
                Link::Recorded(of) | Link::Clouds(of) => Some(of.clone()),
                _ => None,
            },
        }
    }

    /// Kind of the measured object. A stored result is recognised as a recording by its link.
    #[must_use]
    pub fn kind(&self) -> OriginKind {
        if self.recording.is_some() || RECORDED_LINKS.contains(&self.link.as_str()) {
            OriginKind::Recording
        } else if self.simulated {
            OriginKind::Bench
        } else {
            OriginKind::Press
        }
    }

    /// Measured object, in words.
    pub fn place(&self) -> String {
        let what = match self.simulated {
            true => "simulated bench",
            false => "press",
        };
        format!("{what} ({})", self.link)
    }

    /// Each entry with its name, for a table.
    pub fn particulars(&self) -> Vec<(&'static str, String)> {
        let operator = self.operator.as_deref().unwrap_or("–");
        vec![
            ("looked at", self.place()),
            ("station", self.station.clone()),
            ("operator", operator.into()),
            ("head", self.head.words()),
        ]
    }
}

/// The measured object in words: simulated bench or real die.
pub fn looked_at(simulated: bool) -> &'static str {
    if simulated {
        "the simulated bench"
    } else {
        "a real press"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_read_and_say_whether_a_die_is_there() {
        for (text, simulated) in [("sim", true), ("qemu", true), ("/dev/ttyACM0", false)] {
            let link: Link = text.parse().unwrap();
            assert_eq!(
                (link.to_string().as_str(), link.is_simulated()),
                (text, simulated)
            );
        }
        // A port of such a name would make checks at the press look like recordings, which set no latch.
        for text in ["", "recorded frames", "recorded clouds"] {
            assert_eq!(text.parse::<Link>(), Err(NoLink(text.into())));
        }
    }

    #[test]
    fn an_origin_says_what_was_looked_at() {
        let head = HeadId {
            name: "head".into(),
            blake3: String::new(),
            seal: "unsigned".into(),
        };
        let setting = Setting {
            link: Link::Qemu,
            station: "press 7".into(),
            operator: None,
        };
        let known = Origin::new(&setting, head);
        assert_eq!(known.place(), "simulated bench (qemu)");
        assert!(known.simulated);
        assert_eq!(known.kind(), OriginKind::Bench);
        let port = Origin {
            link: "/dev/ttyACM0".into(),
            simulated: false,
            ..known.clone()
        };
        assert_eq!(port.kind(), OriginKind::Press);
        // Origins as they are read from a history: the recording is in the document alone.
        let recording = RecordingId {
            taken: None,
            blake3: String::new(),
            simulated: false,
        };
        for link in [Link::Recorded(recording.clone()), Link::Clouds(recording)] {
            let stored = Origin {
                link: link.to_string(),
                ..port.clone()
            };
            assert_eq!(stored.kind(), OriginKind::Recording);
        }
    }
}
