//! `plant.toml`: what is read, and where it is shown.

use std::fmt;
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};

use flankscope_foundation::textfile::{self, BadValue, TextFileError};
use serde::Deserialize;

/// A complete settings file, with a sentence for every key.
pub const EXAMPLE: &str = include_str!("plant.toml");

/// Settings of the process. Whoever connects a station to the plant's network writes them once.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// History that `flankscope inspect` or `watch` writes.
    pub history: PathBuf,
    /// Age from which the last verdict no longer counts, s.
    pub stale_after_s: u32,
    /// Folder that `watch --report` writes: pictures and maps of every check.
    pub reports: Option<PathBuf>,
    pub page: Option<PageSettings>,
    pub modbus: Option<ModbusSettings>,
    pub mqtt: Option<MqttSettings>,
    pub opcua: Option<OpcuaSettings>,
}

/// The page, and the metrics beside it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PageSettings {
    pub listen: SocketAddr,
    /// Names and hashes of tokens, written by `flankscope-plant token`.
    pub users: PathBuf,
    /// Name by which a browser reaches the page.
    pub name: Option<String>,
    /// Certificate of that name and those between it and its issuer (PEM): the page encrypts by itself.
    pub certificate: Option<PathBuf>,
    /// Private key of the certificate (PEM), which others must not read.
    pub key: Option<PathBuf>,
}

/// Registers for a line controller.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModbusSettings {
    pub listen: SocketAddr,
}

/// A broker that is sent every check.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
// Without the feature they are read in order to be refused.
#[cfg_attr(not(feature = "mqtt"), expect(dead_code))]
pub struct MqttSettings {
    pub broker: Address,
    /// Certificates of the authority that issued the broker's (PEM). Without it nothing is encrypted.
    pub ca: Option<PathBuf>,
    /// File with `user` and `password`.
    pub login: Option<PathBuf>,
    /// Name of this station at the broker.
    pub name: String,
    /// Sparkplug B in this group instead of plain JSON.
    pub group: Option<String>,
    /// File that keeps how far the broker has the history.
    pub delivered: PathBuf,
    #[serde(default)]
    pub version: MqttVersion,
}

/// A server of results for line controllers and plant systems.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OpcuaSettings {
    pub listen: SocketAddr,
    /// Name under which clients reach this machine; its own certificate carries it.
    pub name: Option<String>,
    /// Names and hashes of tokens, written by `flankscope-plant token`.
    pub users: PathBuf,
    /// Folder with its own certificate and key and with the clients' certificates that are trusted.
    pub certificates: PathBuf,
}

/// Version of MQTT.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
pub enum MqttVersion {
    /// The broker says if it refuses a message.
    #[default]
    #[serde(rename = "5")]
    V5,
    #[serde(rename = "3.1.1")]
    V3,
}

impl fmt::Display for MqttVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::V5 => "5",
            Self::V3 => "3.1.1",
        })
    }
}

/// Name or number of a host, and a port.
#[derive(Clone, Debug, Deserialize)]
#[serde(try_from = "String")]
pub struct Address {
    pub host: String,
    pub port: u16,
}

impl TryFrom<String> for Address {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let parts = text.rsplit_once(':').and_then(|(host, port)| {
            // An IPv6 number stands in brackets.
            let host = host
                .strip_prefix('[')
                .map_or(Some(host), |bracketed| bracketed.strip_suffix(']'))?;
            let is_host = !host.is_empty() && !host.contains(['/', '@', ' ']);
            is_host.then_some((host.to_owned(), port.parse().ok()?))
        });
        let (host, port) = parts
            .ok_or_else(|| format!("'{text}' is no HOST:PORT, as in broker.example.org:8883"))?;
        Ok(Self { host, port })
    }
}

impl Address {
    /// Whether it is this machine.
    fn is_loopback(&self) -> bool {
        let ip = self.host.parse::<IpAddr>();
        self.host == "localhost" || ip.is_ok_and(|ip| ip.is_loopback())
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.host.contains(':') {
            true => write!(f, "[{}]:{}", self.host, self.port),
            false => write!(f, "{}:{}", self.host, self.port),
        }
    }
}

/// Largest settings file, bytes.
const MOST_BYTES: u64 = 64 << 10;
/// Largest age of a verdict that counts: a year.
const MOST_STALE_S: u32 = 365 * 24 * 3600;

impl Settings {
    /// Reads a settings file; paths in it are relative to its folder.
    ///
    /// # Errors
    /// It cannot be read, or asks for nothing, or for what must not be.
    pub fn load(path: &Path) -> Result<Self, TextFileError> {
        let (mut settings, _) = textfile::load_toml(path, MOST_BYTES, Self::check)?;
        let folder = path.parent().unwrap_or(Path::new("."));
        settings.history = folder.join(&settings.history);
        settings.reports = settings.reports.map(|reports| folder.join(reports));
        if let Some(page) = &mut settings.page {
            page.users = folder.join(&page.users);
            page.certificate = page.certificate.as_ref().map(|path| folder.join(path));
            page.key = page.key.as_ref().map(|path| folder.join(path));
        }
        if let Some(mqtt) = &mut settings.mqtt {
            mqtt.ca = mqtt.ca.as_ref().map(|ca| folder.join(ca));
            mqtt.login = mqtt.login.as_ref().map(|login| folder.join(login));
            mqtt.delivered = folder.join(&mqtt.delivered);
        }
        if let Some(opcua) = &mut settings.opcua {
            opcua.users = folder.join(&opcua.users);
            opcua.certificates = folder.join(&opcua.certificates);
        }
        Ok(settings)
    }

    fn check(&self) -> Result<(), BadValue> {
        let page = self.page.as_ref();
        let listen = page.map(|page| page.listen);
        let certificate = page.and_then(|page| page.certificate.as_deref());
        let certificate = certificate.map(Path::display);
        let has_key = page.is_some_and(|page| page.key.is_some());
        let is_loopback = listen.is_none_or(|listen| listen.ip().is_loopback());
        let has_name = page.is_some_and(|page| page.name.is_some());
        let listens = self.page.is_some()
            || self.modbus.is_some()
            || self.mqtt.is_some()
            || self.opcua.is_some();
        let mqtt = self.mqtt.as_ref();
        let broker = mqtt.map(|mqtt| &mqtt.broker);
        let is_tls = mqtt.is_none_or(|mqtt| mqtt.ca.is_some() || mqtt.broker.is_loopback());
        let name = mqtt.map(|mqtt| mqtt.name.as_str());
        let group = mqtt.and_then(|mqtt| mqtt.group.as_deref());
        let opcua = self.opcua.as_ref();
        let opcua_listen = opcua.map(|opcua| opcua.listen);
        let opcua_name = opcua.and_then(|opcua| opcua.name.as_deref());
        let is_reached =
            opcua.is_none_or(|opcua| opcua.name.is_some() || !opcua.listen.ip().is_unspecified());
        let stale = self.stale_after_s;
        textfile::require(&[
            (
                listens,
                "page",
                &listen,
                "without [page], [modbus], [mqtt] and [opcua] nothing would listen or be sent; `flankscope-plant example` prints a complete file",
            ),
            (
                (1..=MOST_STALE_S).contains(&stale),
                "stale_after_s",
                &stale,
                "must be 1 to 31536000 seconds (a year)",
            ),
            (
                certificate.is_some() == has_key,
                "page.certificate",
                &certificate,
                "a certificate needs its `key`, and a key its `certificate`: name both, or none of them behind a proxy",
            ),
            (
                certificate.is_none() || cfg!(feature = "tls"),
                "page.certificate",
                &certificate,
                "this program was built without TLS: cargo install --path host/plant --features tls, or a proxy before it (docs/plant.md)",
            ),
            (
                is_loopback || certificate.is_some(),
                "page.listen",
                &listen,
                "other machines reach this address, and tokens would cross the network in clear: name `certificate` and `key`, or listen \
                 on 127.0.0.1 and put a proxy with TLS before it (docs/plant.md)",
            ),
            (
                is_loopback || has_name,
                "page.listen",
                &listen,
                "other machines reach this address: state the certificate's name, by which browsers ask for the page, in `name`",
            ),
            (
                mqtt.is_none() || cfg!(feature = "mqtt"),
                "mqtt",
                &broker,
                "this program was built without MQTT: cargo install --path host/plant --features mqtt",
            ),
            (
                is_tls,
                "mqtt.broker",
                &broker,
                "it is not on this machine, so password and results would cross the network in clear: name the certificates of the \
                 authority that issued the broker's in `ca` (PEM)",
            ),
            (
                name.is_none_or(is_topic_word),
                "mqtt.name",
                &name,
                TOPIC_WORD,
            ),
            (
                group.is_none_or(is_topic_word),
                "mqtt.group",
                &group,
                TOPIC_WORD,
            ),
            (
                opcua.is_none() || cfg!(feature = "opcua"),
                "opcua",
                &opcua_listen,
                "this program was built without OPC UA: cargo install --path host/plant --features opcua",
            ),
            (
                is_reached,
                "opcua.listen",
                &opcua_listen,
                "it stands for all addresses of this machine: name the one by which clients reach it in `name`",
            ),
            (
                opcua_name.is_none_or(is_topic_word),
                "opcua.name",
                &opcua_name,
                TOPIC_WORD,
            ),
        ])
    }
}

/// What is one level of a topic and a client's name at any broker.
const TOPIC_WORD: &str = "must be 1 to 64 letters, digits, - . _";

fn is_topic_word(name: &str) -> bool {
    let is_letter = |c: u8| c.is_ascii_alphanumeric() || b"-._".contains(&c);
    (1..=64).contains(&name.len()) && name.bytes().all(is_letter)
}
