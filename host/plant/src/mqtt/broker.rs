//! A connection to a broker: one question at a time, each answered within a time or not at all.
//!
//! It takes packets from a library and no more: clients of libraries queue and reconnect by themselves, while here the history is
//! the queue and the acknowledgement of every single check counts.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use mqtt_proto::Pid;
use serde::Deserialize;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::{Instant, timeout};
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::{InvalidDnsNameError, ServerName};

use super::packets::{self, BrokerAnswer, Message, PacketError};
use crate::settings::{Address, MqttVersion};

/// Longest time for a connection or an answer.
const ANSWER_WITHIN: Duration = Duration::from_secs(10);
/// Silence after which the broker takes this client for dead, s.
const KEEP_ALIVE_S: u16 = 30;
/// Silence after which this client asks for a sign of life.
const PING_AFTER: Duration = Duration::from_secs(10);
/// Commands that are kept until they are looked at; one more is dropped, since each asks for the same.
const MOST_COMMANDS: usize = 4;

/// User and password of the broker. Never shown: it has no `Debug`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Login {
    pub user: String,
    pub password: String,
}

/// Where a broker is and how it is spoken to.
pub struct Dial {
    pub address: Address,
    pub tls: Option<TlsConnector>,
    pub version: MqttVersion,
    pub client: String,
    pub login: Option<Login>,
}

/// Why a connection ended.
#[derive(Debug, thiserror::Error)]
pub enum BrokerError {
    #[error("{doing}: {source}")]
    Io {
        doing: &'static str,
        source: io::Error,
    },
    #[error("{doing}: no answer within {} s", ANSWER_WITHIN.as_secs())]
    Silent { doing: &'static str },
    #[error("the broker refuses {what}: {why}")]
    Refused { what: String, why: String },
    #[error("the broker closed the connection: {why}")]
    Closed { why: String },
    #[error(transparent)]
    Packet(#[from] PacketError),
    #[error("{host} is no name that a certificate can have: {source}")]
    Name {
        host: String,
        source: InvalidDnsNameError,
    },
}

trait Stream: AsyncRead + AsyncWrite + Unpin + Send {}
impl<T: AsyncRead + AsyncWrite + Unpin + Send> Stream for T {}

/// A connection that the broker took.
pub struct Broker {
    stream: Box<dyn Stream>,
    version: MqttVersion,
    arrived: Vec<u8>,
    last_pid: Pid,
    sent: Instant,
    /// When a question was sent that is not answered yet.
    pinged: Option<Instant>,
    commands: Vec<Vec<u8>>,
}

impl Broker {
    /// Connects; `will` is published by the broker when the connection breaks.
    pub async fn connect(dial: &Dial, will: Message) -> Result<Self, BrokerError> {
        let stream = within("connect to the broker", open(dial)).await?;
        let mut broker = Self {
            stream,
            version: dial.version,
            arrived: Vec::new(),
            last_pid: Pid::default(),
            sent: Instant::now(),
            pinged: None,
            commands: Vec::new(),
        };
        let login = dial.login.as_ref();
        let packet = packets::connect(dial.version, &dial.client, login, will, KEEP_ALIVE_S)?;
        within("introduce this station to the broker", async {
            broker.send(&packet).await?;
            loop {
                if let BrokerAnswer::Connected(answer) = broker.hear().await? {
                    return refused("the connection", answer);
                }
            }
        })
        .await?;
        Ok(broker)
    }

    /// Publishes a message, and returns once the broker has it if it is one that is acknowledged.
    pub async fn publish(&mut self, message: &Message) -> Result<(), BrokerError> {
        self.last_pid += 1;
        let pid = self.last_pid;
        let packet = packets::publish(self.version, message, pid)?;
        within("publish", async {
            self.send(&packet).await?;
            if !message.acknowledged {
                return Ok(());
            }
            loop {
                match self.hear().await? {
                    BrokerAnswer::Published(acknowledged, answer)
                        if acknowledged == pid.value() =>
                    {
                        return refused(&message.topic, answer);
                    }
                    _ => {}
                }
            }
        })
        .await
    }

    /// Returns once the broker has everything that was published before: it answers in order.
    pub async fn confirm(&mut self) -> Result<(), BrokerError> {
        within("ask the broker for a sign of life", async {
            self.send(&packets::ping()?).await?;
            // One that is due already is not the answer to this one.
            let mut due = 1 + usize::from(self.pinged.take().is_some());
            while due > 0 {
                if matches!(self.hear().await?, BrokerAnswer::Pong) {
                    due -= 1;
                }
            }
            Ok(())
        })
        .await
    }

    /// Asks for commands.
    pub async fn subscribe(&mut self, filter: &str) -> Result<(), BrokerError> {
        self.last_pid += 1;
        let packet = packets::subscribe(self.version, filter, self.last_pid)?;
        within("subscribe", async {
            self.send(&packet).await?;
            loop {
                if let BrokerAnswer::Subscribed(answer) = self.hear().await? {
                    return refused(filter, answer);
                }
            }
        })
        .await
    }

    /// Commands that have arrived.
    pub fn commands(&mut self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.commands)
    }

    /// Waits until something has arrived. May be abandoned at any time: nothing is lost by that.
    pub async fn arrival(&mut self) -> Result<(), BrokerError> {
        let got = self.stream.read_buf(&mut self.arrived).await;
        match got.map_err(io_error("hear the broker"))? {
            0 => Err(BrokerError::Closed {
                why: "without a word".into(),
            }),
            _ => Ok(()),
        }
    }

    /// Takes what has arrived, of which only commands are expected, and asks for a sign of life after a long silence.
    ///
    /// # Errors
    /// The last question was not answered in time.
    pub async fn attend(&mut self) -> Result<(), BrokerError> {
        let doing = "wait for a sign of life";
        within(doing, async {
            while let Some(answer) = packets::take(self.version, &mut self.arrived)? {
                self.note(answer).await?;
            }
            match self.pinged {
                Some(at) if at.elapsed() > ANSWER_WITHIN => Err(BrokerError::Silent { doing }),
                None if self.sent.elapsed() > PING_AFTER => {
                    self.pinged = Some(Instant::now());
                    self.send(&packets::ping()?).await
                }
                _ => Ok(()),
            }
        })
        .await
    }

    /// What the broker says next.
    async fn hear(&mut self) -> Result<BrokerAnswer, BrokerError> {
        loop {
            if let Some(answer) = packets::take(self.version, &mut self.arrived)? {
                return self.note(answer).await;
            }
            self.arrival().await?;
        }
    }

    async fn note(&mut self, answer: BrokerAnswer) -> Result<BrokerAnswer, BrokerError> {
        match answer {
            BrokerAnswer::Command(payload, pid) => {
                if self.commands.len() < MOST_COMMANDS {
                    self.commands.push(payload);
                }
                if let Some(pid) = pid {
                    let packet = packets::acknowledge(self.version, pid)?;
                    self.send(&packet).await?;
                }
                Ok(BrokerAnswer::Other)
            }
            BrokerAnswer::Closed(why) => Err(BrokerError::Closed { why }),
            answer => {
                if matches!(answer, BrokerAnswer::Pong) {
                    self.pinged = None;
                }
                Ok(answer)
            }
        }
    }

    async fn send(&mut self, packet: &[u8]) -> Result<(), BrokerError> {
        self.sent = Instant::now();
        let sent = async {
            self.stream.write_all(packet).await?;
            self.stream.flush().await
        };
        sent.await.map_err(io_error("send to the broker"))
    }
}

async fn open(dial: &Dial) -> Result<Box<dyn Stream>, BrokerError> {
    let Address { host, port } = &dial.address;
    let failed = io_error("connect to the broker");
    let plain = TcpStream::connect((host.as_str(), *port))
        .await
        .map_err(&failed)?;
    plain.set_nodelay(true).map_err(&failed)?;
    let Some(tls) = &dial.tls else {
        return Ok(Box::new(plain));
    };
    let name = ServerName::try_from(host.clone()).map_err(|source| BrokerError::Name {
        host: host.clone(),
        source,
    })?;
    let shaken = tls.connect(name, plain).await;
    Ok(Box::new(
        shaken.map_err(io_error("agree on TLS with the broker"))?,
    ))
}

async fn within<T>(
    doing: &'static str,
    done: impl Future<Output = Result<T, BrokerError>>,
) -> Result<T, BrokerError> {
    let ended = timeout(ANSWER_WITHIN, done).await;
    ended.unwrap_or(Err(BrokerError::Silent { doing }))
}

fn refused(what: &str, answer: Result<(), String>) -> Result<(), BrokerError> {
    let what = what.to_owned();
    answer.map_err(|why| BrokerError::Refused { what, why })
}

fn io_error(doing: &'static str) -> impl Fn(io::Error) -> BrokerError {
    move |source| BrokerError::Io { doing, source }
}

/// TLS to a broker whose certificate was issued by one of these authorities.
pub fn tls(ca: &std::path::Path) -> anyhow::Result<TlsConnector> {
    use anyhow::Context;
    use tokio_rustls::rustls::pki_types::CertificateDer;
    use tokio_rustls::rustls::pki_types::pem::PemObject;
    use tokio_rustls::rustls::{ClientConfig, RootCertStore};

    let text = flankscope_foundation::textfile::read(ca)?;
    let mut roots = RootCertStore::empty();
    for certificate in CertificateDer::pem_slice_iter(text.as_bytes()) {
        let certificate = certificate.map_err(|error| anyhow::anyhow!("{error}"));
        let added = certificate.and_then(|certificate| Ok(roots.add(certificate)?));
        added.with_context(|| format!("{}: no certificate", ca.display()))?;
    }
    anyhow::ensure!(
        !roots.is_empty(),
        "{}: no certificate in it; a PEM file of the authority that issued the broker's certificate is expected",
        ca.display()
    );
    let config = ClientConfig::builder()
        .with_root_certificates(roots)
        .with_no_client_auth();
    Ok(TlsConnector::from(Arc::new(config)))
}
