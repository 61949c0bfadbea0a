//! Encryption of the page by itself, where no proxy stands before it: TLS 1.2 or 1.3 with the certificate and key of `[page]`.
//!
//! | file | holds |
//! |---|---|
//! | `validity` | from when until when a certificate is valid |

#[cfg(feature = "tls")]
mod validity;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;

use crate::settings::PageSettings;

/// Whether and how connections are encrypted.
#[derive(Clone)]
pub enum Encryption {
    /// Not here: a proxy on the same machine does it.
    Plain,
    #[cfg(feature = "tls")]
    Tls(tokio_rustls::TlsAcceptor),
}

/// A connection, encrypted or not.
pub trait Stream: AsyncRead + AsyncWrite + Unpin + Send {}
impl<T: AsyncRead + AsyncWrite + Unpin + Send> Stream for T {}

impl Encryption {
    /// As the settings ask for it.
    ///
    /// # Errors
    /// Certificate or key cannot be read, do not belong together, or others can read the key.
    #[cfg(feature = "tls")]
    pub fn for_page(page: &PageSettings) -> anyhow::Result<Self> {
        match (&page.certificate, &page.key) {
            (Some(certificate), Some(key)) => Ok(Self::Tls(acceptor(certificate, key)?)),
            _ => Ok(Self::Plain),
        }
    }

    /// Settings that ask for it were refused.
    #[cfg(not(feature = "tls"))]
    #[expect(clippy::unnecessary_wraps, reason = "as with the feature")]
    pub fn for_page(_: &PageSettings) -> anyhow::Result<Self> {
        Ok(Self::Plain)
    }

    pub fn is_on(&self) -> bool {
        !matches!(self, Self::Plain)
    }

    pub fn scheme(&self) -> &'static str {
        match self.is_on() {
            true => "https",
            false => "http",
        }
    }

    /// The connection, once a key is agreed on; none if that fails or takes too long.
    pub async fn agree(&self, stream: TcpStream) -> Option<Box<dyn Stream>> {
        match self {
            Self::Plain => Some(Box::new(stream)),
            #[cfg(feature = "tls")]
            Self::Tls(acceptor) => {
                let agreed = tokio::time::timeout(AGREED_WITHIN, acceptor.accept(stream)).await;
                Some(Box::new(agreed.ok()?.ok()?))
            }
        }
    }
}

/// Longest time until a key is agreed on.
#[cfg(feature = "tls")]
const AGREED_WITHIN: std::time::Duration = std::time::Duration::from_secs(10);

#[cfg(feature = "tls")]
fn acceptor(
    certificate: &std::path::Path,
    key: &std::path::Path,
) -> anyhow::Result<tokio_rustls::TlsAcceptor> {
    use anyhow::Context;
    use flankscope_foundation::textfile;
    use tokio_rustls::rustls::ServerConfig;
    use tokio_rustls::rustls::pki_types::pem::PemObject;
    use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

    crate::access::require_private(key)?;
    let name = certificate.display();
    let text = textfile::read(certificate)?;
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(text.as_bytes()).collect();
    let chain = chain
        .map_err(|error| anyhow::anyhow!("{error}"))
        .with_context(|| format!("{name}: no certificates"))?;
    let first = chain.first();
    let first = first.with_context(|| {
        format!(
            "{name}: no certificate in it; a PEM file with the page's certificate first is expected"
        )
    })?;
    if let Some(why) = validity::objection(first, jiff::Timestamp::now()) {
        tracing::warn!("[page] {name}: {why}; browsers will refuse the page");
    }
    let text = textfile::read(key)?;
    let private = PrivateKeyDer::from_pem_slice(text.as_bytes())
        .map_err(|error| anyhow::anyhow!("{error}"))
        .with_context(|| format!("{}: no private key (PEM)", key.display()))?;
    let config = ServerConfig::builder()
        .with_no_client_auth()
        .with_single_cert(chain, private)
        .with_context(|| format!("{name} and {} do not belong together", key.display()))?;
    Ok(std::sync::Arc::new(config).into())
}
