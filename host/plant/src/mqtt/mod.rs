//! MQTT: every check of the history to a broker, and what stands now. The history is the queue: what the broker has is kept as a
//! number in a small file, and whatever follows is sent from there, in order, one message at a time.
//!
//! | file | holds |
//! |---|---|
//! | `broker` | a connection, with TLS |
//! | `packets` | packets of MQTT 5 and 3.1.1 |
//! | `delivered` | how far the broker has the history |
//! | `json` | messages in plain JSON |
//! | `sparkplug` | messages of Sparkplug B |

mod broker;
mod delivered;
mod json;
mod packets;
mod sparkplug;

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::Context;
use flankscope_foundation::textfile;
use flankscope_record::history::{Check, HistoryError};
use flankscope_record::seal::Seals;
use jiff::Timestamp;
use tokio::sync::watch;

use crate::access::require_private;
use crate::history::{HistoryFile, check_id};
use crate::percent::escaped;
use crate::settings::{MqttSettings, Settings};
use crate::statement::{Moment, Standing, StationStatement};
use broker::{Broker, Dial, Login};
use delivered::Delivered;
use json::Json;
use packets::Message;
use sparkplug::Node;

/// How often it looks whether a verdict grew too old.
const EVERY: Duration = Duration::from_secs(1);
/// Pause after the first broken connection; it doubles up to the longest while nothing is delivered.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
const LONGEST_PAUSE: Duration = Duration::from_secs(30);
/// Checks that are sent before it looks again at what stands.
const CHECKS_AT_A_TIME: usize = 50;
/// Largest file with user and password, bytes.
const MOST_LOGIN_BYTES: u64 = 4 << 10;

/// Sends to a broker until the process ends.
pub struct Sender {
    dial: Dial,
    /// Group of Sparkplug B; plain JSON without one.
    group: Option<String>,
    delivered: PathBuf,
    history: Mutex<HistoryFile>,
    standing: watch::Receiver<Arc<Standing>>,
    /// Whether the broker has acknowledged something since the last pause.
    is_heard: AtomicBool,
}

impl Sender {
    /// Reads what the settings name; connects to nothing yet.
    ///
    /// # Errors
    /// A file cannot be read or written, or lets others read the password.
    pub fn new(
        settings: &Settings,
        mqtt: &MqttSettings,
        seals: Seals,
        standing: watch::Receiver<Arc<Standing>>,
    ) -> anyhow::Result<Arc<Self>> {
        let login = mqtt.login.as_deref().map(|path| -> anyhow::Result<Login> {
            require_private(path)?;
            Ok(textfile::load_toml(path, MOST_LOGIN_BYTES, |_| Ok(()))?.0)
        });
        let sender = Self {
            dial: Dial {
                address: mqtt.broker.clone(),
                tls: mqtt.ca.as_deref().map(broker::tls).transpose()?,
                version: mqtt.version,
                client: mqtt.name.clone(),
                login: login.transpose()?,
            },
            group: mqtt.group.clone(),
            delivered: mqtt.delivered.clone(),
            history: Mutex::new(HistoryFile::new(&settings.history, seals)),
            standing,
            is_heard: AtomicBool::new(false),
        };
        // Fails now rather than after the first check.
        Delivered::load(&sender.delivered)
            .map_err(anyhow::Error::from)
            .and_then(|delivered| delivered.store(&sender.delivered))
            .context("[mqtt] delivered; without that file every check is sent again")?;
        Ok(Arc::new(sender))
    }

    /// Connects again and again. Neither a broker that is away nor one that misbehaves ends this.
    pub async fn run(self: Arc<Self>) -> anyhow::Result<()> {
        let mut pause = FIRST_PAUSE;
        loop {
            // A task of its own: not even a panic on what a broker sends reaches the others.
            let sender = Arc::clone(&self);
            let ended = tokio::spawn(async move { sender.connection().await }).await;
            let why = match ended {
                Ok(Err(error)) => format!("{error:#}"),
                Err(panicked) => panicked.to_string(),
            };
            if self.is_heard.swap(false, Ordering::Relaxed) {
                pause = FIRST_PAUSE;
            }
            tracing::warn!("mqtt: {why}; again in {} ms", pause.as_millis());
            tokio::time::sleep(pause).await;
            pause = LONGEST_PAUSE.min(2 * pause);
        }
    }

    /// One connection, until it breaks.
    async fn connection(self: Arc<Self>) -> anyhow::Result<Infallible> {
        let mut delivered = Delivered::load(&self.delivered)?;
        delivered.connection = delivered.connection.wrapping_add(1);
        delivered.store(&self.delivered)?;
        let mut words = match &self.group {
            Some(group) => {
                let node = Node::new(group, &self.dial.client, delivered.connection);
                Words::Sparkplug(node)
            }
            None => {
                let retained = delivered.retained.clone();
                Words::Json(Json::new(&self.dial.client, retained))
            }
        };
        let mut broker = Broker::connect(&self.dial, words.will()).await?;
        let address = &self.dial.address;
        tracing::info!(
            "mqtt: connected to {address}; it has check {}",
            delivered.number
        );
        if let Words::Sparkplug(node) = &mut words {
            broker.subscribe(&node.commands()).await?;
            broker.publish(&node.birth(Timestamp::now())).await?;
        }
        let mut standing = self.standing.clone();
        loop {
            self.obey(&mut broker, &mut words).await?;
            let now = standing.borrow_and_update().statement(&Moment::now());
            let changes = words.changes(&now);
            // First with all that may be retained if this process ends meanwhile, then with what is.
            let retained = words.retained();
            let mut possible = delivered.retained.clone();
            possible.extend(retained.clone());
            self.note_retained(possible, &mut delivered).await?;
            for message in changes {
                broker.publish(&message).await?;
            }
            self.note_retained(retained, &mut delivered).await?;
            if now.fault.is_none()
                && self
                    .forward(&mut broker, &mut words, &mut delivered, &now)
                    .await?
            {
                // There may be more.
                continue;
            }
            tokio::select! {
                changed = standing.changed() => changed?,
                arrived = broker.arrival() => arrived?,
                () = tokio::time::sleep(EVERY) => {}
            }
            broker.attend().await?;
        }
    }

    /// Sends the checks that follow, a limited number of them; whether it reached that number.
    async fn forward(
        self: &Arc<Self>,
        broker: &mut Broker,
        words: &mut Words,
        delivered: &mut Delivered,
        station: &StationStatement,
    ) -> anyhow::Result<bool> {
        for _ in 0..CHECKS_AT_A_TIME {
            let Some((check, id)) = self.next(delivered.clone()).await? else {
                return Ok(false);
            };
            for message in words.check(&check, &id, station) {
                broker.publish(&message).await?;
            }
            if let Words::Sparkplug(_) = words {
                // Sparkplug's messages are not acknowledged one by one.
                broker.confirm().await?;
            }
            (delivered.number, delivered.id) = (check.id, id);
            self.store(delivered).await?;
            self.is_heard.store(true, Ordering::Relaxed);
            self.obey(broker, words).await?;
        }
        Ok(true)
    }

    async fn store(&self, delivered: &Delivered) -> anyhow::Result<()> {
        let (delivered, path) = (delivered.clone(), self.delivered.clone());
        tokio::task::spawn_blocking(move || delivered.store(&path)).await?
    }

    /// Notes on the disk what the broker retains, so that a process that starts anew can take it back.
    async fn note_retained(
        &self,
        retained: BTreeMap<String, String>,
        delivered: &mut Delivered,
    ) -> anyhow::Result<()> {
        if retained != delivered.retained {
            delivered.retained = retained;
            self.store(delivered).await?;
        }
        Ok(())
    }

    /// Carries out what a host commanded: a birth.
    async fn obey(&self, broker: &mut Broker, words: &mut Words) -> anyhow::Result<()> {
        let commands = broker.commands();
        if let Words::Sparkplug(node) = words
            && commands.iter().any(|command| Node::asks_for_birth(command))
        {
            broker.publish(&node.birth(Timestamp::now())).await?;
            let station = self.standing.borrow().statement(&Moment::now());
            for message in words.changes(&station) {
                broker.publish(&message).await?;
            }
        }
        Ok(())
    }

    /// The first check that the broker does not have, and its id.
    async fn next(
        self: &Arc<Self>,
        delivered: Delivered,
    ) -> anyhow::Result<Option<(Check, String)>> {
        let sender = Arc::clone(self);
        let read = move || {
            let mut file = sender
                .history
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            next_in(&mut file, &delivered).unwrap_or_else(|error| {
                // The connection stays: over it everybody hears, within a second, that the history cannot be read.
                tracing::warn!("mqtt: {error}");
                file.close();
                None
            })
        };
        Ok(tokio::task::spawn_blocking(read).await?)
    }
}

fn next_in(
    file: &mut HistoryFile,
    delivered: &Delivered,
) -> Result<Option<(Check, String)>, HistoryError> {
    let (history, _) = file.verified()?;
    let read = |number| -> Result<(Check, String), HistoryError> {
        let check = history.check(number)?;
        let id = check_id(&check, &history.document(number)?);
        Ok((check, id))
    };
    // Another history stands here, or an older copy of this one: all of it is sent, and receivers know what they have.
    let is_same = match delivered.number {
        0 => true,
        number => match read(number) {
            Ok((_, id)) => id == delivered.id,
            Err(HistoryError::NoSuchCheck { .. }) => false,
            // A disk that fails says nothing about whose history it is.
            Err(error) => return Err(error),
        },
    };
    if !is_same {
        tracing::warn!(
            "mqtt: check {} is not the one that was delivered; this history is sent from its first check",
            delivered.number
        );
    }
    let from = if is_same { delivered.number } else { 0 };
    history.next_after(from)?.map(read).transpose()
}

/// The language of the messages.
enum Words {
    Json(Json),
    Sparkplug(Node),
}

impl Words {
    fn will(&self) -> Message {
        match self {
            Self::Json(json) => json.will(),
            Self::Sparkplug(node) => node.will(),
        }
    }

    /// Messages that the broker retains once the last changes are sent: none of Sparkplug B.
    fn retained(&self) -> BTreeMap<String, String> {
        match self {
            Self::Json(json) => json.retained(),
            Self::Sparkplug(_) => BTreeMap::new(),
        }
    }

    fn changes(&mut self, station: &StationStatement) -> Vec<Message> {
        match self {
            Self::Json(json) => json.changes(station),
            Self::Sparkplug(node) => node.changes(station, Timestamp::now()),
        }
    }

    fn check(&mut self, check: &Check, id: &str, station: &StationStatement) -> Vec<Message> {
        match self {
            Self::Json(json) => vec![json.check(check, id, station.stale_after)],
            Self::Sparkplug(node) => node.check(check, id, station, Timestamp::now()),
        }
    }
}

/// A name as one level of a topic: what separates or matches levels becomes its code, as in a URL.
fn topic_word(name: &str) -> String {
    let name = name.replace(char::is_control, "_");
    escaped(&name, |c| matches!(c, '/' | '+' | '#'))
}

/// Whether a message says that a die is good: of JSON and of Sparkplug B, which agree.
#[cfg(test)]
pub fn says_good(die: &crate::statement::DieStatement) -> bool {
    let is_good = json::says_good(die);
    assert_eq!(sparkplug::says_good(die), is_good, "{die:?}");
    is_good
}
