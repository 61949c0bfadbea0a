//! `plant.toml`: what is read, and where it is shown.

use std::net::SocketAddr;
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
}

/// The page, and the metrics beside it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PageSettings {
    pub listen: SocketAddr,
    /// Names and hashes of tokens, written by `flankscope-plant token`.
    pub users: PathBuf,
    /// Name by which a browser reaches the page, if a proxy with TLS stands before it.
    pub name: Option<String>,
}

/// Registers for a line controller.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModbusSettings {
    pub listen: SocketAddr,
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
        }
        Ok(settings)
    }

    fn check(&self) -> Result<(), BadValue> {
        let listen = self.page.as_ref().map(|page| page.listen);
        let is_private = listen.is_none_or(|listen| listen.ip().is_loopback());
        let listens = self.page.is_some() || self.modbus.is_some();
        let stale = self.stale_after_s;
        textfile::require(&[
            (
                listens,
                "page",
                &listen,
                "without [page] and [modbus] nothing would listen; `flankscope-plant example` prints a complete file",
            ),
            (
                (1..=MOST_STALE_S).contains(&stale),
                "stale_after_s",
                &stale,
                "must be 1 to 31536000 seconds (a year)",
            ),
            (
                is_private,
                "page.listen",
                &listen,
                "other machines reach this address, and tokens would cross the network in clear: listen on 127.0.0.1 and put a proxy \
                 with TLS before it (docs/plant.md)",
            ),
        ])
    }
}
