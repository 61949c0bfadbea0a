//! The subject of a job: tool, head and station, and the keys that verify their files.

use std::collections::BTreeMap;
use std::sync::Arc;

use flankscope_foundation::files;
use flankscope_instrument::settings::StationSettings;
use flankscope_record::baseline::Baseline;
use flankscope_record::die::DieKey;
use flankscope_record::origin::{HeadId, Origin, Setting};
use flankscope_record::seal::Seals;

/// The tool that is measured, and the head and station that measure it.
#[derive(Clone, Debug)]
pub struct Subject {
    pub tool: Arc<flankscope_metrology::tool::Tool>,
    pub head: Arc<flankscope_profilometry::HeadModel>,
    /// Temperature of the tool, °C, if known.
    pub temperature_degc: Option<f64>,
    /// Baseline of the tool when new; if given, wear is relative to it.
    pub baseline: Option<Arc<Baseline>>,
    pub station: Arc<StationSettings>,
    /// Status of the head's signature, in words: signed, trusted by a person, or unsigned.
    pub head_seal: String,
    /// The station's key and the files that it trusts.
    pub seals: Seals,
    /// BLAKE3 of the input files.
    pub hashes: BTreeMap<&'static str, String>,
}

impl Subject {
    /// Key of the die in a history.
    pub fn die(&self) -> DieKey {
        // A gear consists of names and numbers, so it can always be written as JSON.
        let gear = serde_json::to_string(&self.tool.gear).unwrap_or_default();
        let cad = self.hashes.get("cad").map_or("", String::as_str);
        DieKey {
            tool: self.tool.name.clone(),
            geometry: files::hash(format!("{cad} {gear}").as_bytes()),
            serial: self.tool.serial.clone(),
        }
    }

    /// Origin of a result in this setting.
    pub(crate) fn origin(&self, setting: &Setting) -> Origin {
        Origin::new(setting, self.head_id())
    }

    /// The head, with the status of its signature.
    pub fn head_id(&self) -> HeadId {
        HeadId {
            name: self.head.name.clone(),
            blake3: self.hashes.get("head").cloned().unwrap_or_default(),
            seal: self.head_seal.clone(),
        }
    }
}
