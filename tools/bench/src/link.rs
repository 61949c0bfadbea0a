//! Transport of the camera's frames from the bench to the host, and its faults.

use anyhow::ensure;
use serde::{Deserialize, Serialize};

/// How the frames reach the host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum CameraLink {
    /// Written where the host reads them.
    #[default]
    SharedMemory,
    /// As packets of a GigE Vision camera, which another process takes.
    Gige,
}

/// What is wrong with a GigE camera or its link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trouble {
    /// It exposes without being triggered, whatever it is set to.
    FreeRuns,
    /// Its samples are coloured.
    Colour,
    /// Its sensor is smaller than the head's.
    Smaller,
    /// Its samples have eight bits.
    Shallow,
    /// It amplifies by 6 dB.
    Amplified,
    /// It is unplugged at this frame of its first capture, and plugged in again later.
    Unplugged(u32),
    /// This share of its packets gets lost.
    Lost(f64),
}

impl std::str::FromStr for Trouble {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> anyhow::Result<Self> {
        let trouble = match text.split_once(':') {
            None if text == "free-runs" => Self::FreeRuns,
            None if text == "colour" => Self::Colour,
            None if text == "smaller" => Self::Smaller,
            None if text == "shallow" => Self::Shallow,
            None if text == "amplified" => Self::Amplified,
            Some(("unplugged", frame)) => Self::Unplugged(frame.parse()?),
            Some(("lost", share)) => Self::Lost(share.parse()?),
            _ => anyhow::bail!(
                "trouble {text:?}: free-runs, colour, smaller, shallow, amplified, unplugged:FRAME or lost:SHARE is needed, for example lost:0.0005"
            ),
        };
        if let Self::Lost(share) = trouble {
            ensure!(
                (0.0..=1.0).contains(&share),
                "trouble {text:?}: a share is 0 to 1, for example lost:0.0005"
            );
        }
        Ok(trouble)
    }
}
