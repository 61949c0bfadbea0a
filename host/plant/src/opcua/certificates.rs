//! The folder of certificates: this server's own one with its key, made at the first start; those of clients that are trusted; and
//! those that were refused, from which somebody may move one to the trusted.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::{Context, anyhow, bail};
use opcua::crypto::{CertificateStore, X509, X509Data};
use opcua::types::DateTime;

use crate::access::require_private;

/// Certificate and key, from the folder.
pub const OWN: &str = "own/flankscope-plant.der";
pub const KEY: &str = "own/flankscope-plant.key.pem";
const TRUSTED: &str = "trusted";
const REJECTED: &str = "rejected";

/// Length of the key, bits: what is advised for use beyond 2030.
const KEY_BITS: u32 = 3072;
/// How long the certificate is valid: ten years. A new one has to be trusted by hand at every client.
const VALID_DAYS: u32 = 3652;
/// Refused certificates that are kept; anybody can send one.
const MOST_REJECTED: usize = 100;

/// The folder of certificates.
#[derive(Clone, Debug)]
pub struct Certificates {
    pub folder: PathBuf,
    /// Name of this server in its certificate, as a URI.
    pub application_uri: String,
}

impl Certificates {
    /// Makes the folder, and certificate and key if there are none.
    ///
    /// # Errors
    /// The folder cannot be written, or certificate and key are not usable.
    pub fn prepare(folder: &Path, host: &str, is_loopback: bool) -> anyhow::Result<Self> {
        let certificates = Self {
            folder: folder.into(),
            application_uri: format!("urn:{host}:flankscope:plant"),
        };
        let context = || format!("[opcua] certificates = \"{}\"", folder.display());
        for name in [TRUSTED, REJECTED, "own"] {
            fs::create_dir_all(folder.join(name)).with_context(context)?;
        }
        certificates
            .prepare_own(host, is_loopback)
            .with_context(context)?;
        Ok(certificates)
    }

    fn prepare_own(&self, host: &str, is_loopback: bool) -> anyhow::Result<()> {
        let [own, key] = [OWN, KEY].map(|name| self.folder.join(name));
        match (own.exists(), key.exists()) {
            (true, true) => {}
            (false, false) => self.make_own(host, is_loopback, (&own, &key))?,
            (true, false) => bail!("{} is missing beside {OWN}", key.display()),
            (false, true) => bail!("{} is missing beside {KEY}", own.display()),
        }
        require_private(&key)?;
        let certificate = CertificateStore::read_cert(&own).map_err(|error| anyhow!(error))?;
        if certificate
            .is_application_uri_valid(&self.application_uri)
            .is_err()
        {
            bail!(
                "{} was made for another name than {}: set [opcua] name to that one, or remove certificate and key to have new ones \
                 made, which every client must then trust",
                own.display(),
                self.application_uri
            );
        }
        if certificate
            .is_time_valid(&DateTime::now().as_chrono())
            .is_err()
        {
            tracing::warn!(
                "{} is not valid today, and clients will refuse it: remove certificate and key to have new ones made",
                own.display()
            );
        }
        Ok(())
    }

    /// Makes certificate and key in a folder that nobody else can enter, and moves them from there.
    fn make_own(
        &self,
        host: &str,
        is_loopback: bool,
        (own, key): (&Path, &Path),
    ) -> anyhow::Result<()> {
        let uri = &self.application_uri;
        let names =
            X509Data::alt_host_names(uri, Some(vec![host.into()]), is_loopback, true, false);
        let data = X509Data {
            key_size: KEY_BITS,
            common_name: "flankscope-plant".into(),
            organization: "flankscope".into(),
            organizational_unit: host.into(),
            country: String::new(),
            state: String::new(),
            alt_host_names: names,
            certificate_duration_days: VALID_DAYS,
        };
        let private = tempfile::tempdir_in(&self.folder)?;
        let made = [OWN, KEY].map(|name| private.path().join(name));
        CertificateStore::create_certificate_and_key(&data, false, &made[0], &made[1])
            .map_err(|error| anyhow!(error))?;
        fs::set_permissions(&made[1], fs::Permissions::from_mode(0o600))?;
        // The key first: a certificate alone would look complete.
        fs::rename(&made[1], key)?;
        fs::rename(&made[0], own)?;
        tracing::info!("opcua: made {} and its key", own.display());
        Ok(())
    }

    /// Removes the oldest refused certificates beyond the most that are kept.
    pub fn prune(&self) -> std::io::Result<()> {
        let mut refused = Vec::new();
        for entry in fs::read_dir(self.folder.join(REJECTED))? {
            let entry = entry?;
            let since = entry.metadata().and_then(|meta| meta.modified());
            refused.push((since.unwrap_or(SystemTime::UNIX_EPOCH), entry.path()));
        }
        refused.sort();
        let surplus = refused.len().saturating_sub(MOST_REJECTED);
        for (_, path) in &refused[..surplus] {
            fs::remove_file(path)?;
        }
        Ok(())
    }

    /// Certificate in its own words, for the log: thumbprint by which a client shows it.
    pub fn thumbprint(&self) -> anyhow::Result<String> {
        let own: X509 =
            CertificateStore::read_cert(&self.folder.join(OWN)).map_err(|error| anyhow!(error))?;
        Ok(own.thumbprint().as_hex_string())
    }
}
