//! OPC UA: what stands for every tool, its last check with all flanks, an event for every check, and methods that acknowledge and start a check. All
//! of it is signed and encrypted, for clients whose certificates are trusted and users with a token.
//!
//! | file | holds |
//! |---|---|
//! | `gate` | connections: how many, and what passes before they are encrypted |
//! | `certificates` | own certificate, trusted and refused ones |
//! | `users` | who comes in |
//! | `types` | structures, evaluations and the event's type, as clients decode them |
//! | `space` | what is shown, as a list of nodes |
//! | `nodes` | the nodes as the server holds them, and the method |
//! | `events` | a check as an event |
//! | `publisher` | follows what stands |

mod certificates;
mod events;
mod gate;
mod nodes;
mod publisher;
mod space;
mod types;
mod users;

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::{Context, anyhow};
use flankscope_record::seal::Seals;
use opcua::crypto::SecurityPolicy;
use opcua::server::address_space::AddressSpace;
use opcua::server::node_manager::ServerContext;
use opcua::server::node_manager::memory::InMemoryNodeManagerBuilder;
use opcua::server::{Server, ServerBuilder, ServerEndpoint, ServerHandle};
use opcua::types::{BuildInfo, DateTime, MessageSecurityMode};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::sleep;

use crate::access::UsersFile;
use crate::acknowledge::Acknowledging;
use crate::settings::{OpcuaSettings, Settings};
use crate::statement::Standing;
use certificates::Certificates;
use nodes::{Manager, PlantNodes};
use publisher::Publisher;
use users::Authenticator;

/// Sessions at a time, and how long one may be silent, ms.
const MOST_SESSIONS: usize = 32;
const SESSION_TIME_MS: u64 = 60_000;
/// Largest message, bytes and chunks.
const MOST_MESSAGE: usize = 4 << 20;
const MOST_CHUNKS: usize = 64;
/// Items of a subscription: all variables of a tool of 84 teeth.
const MOST_ITEMS: usize = 4_000;
/// Values or events that wait for a client, per item.
const MOST_QUEUED: usize = 100;
/// Time for the server to begin.
const BEGIN_TIME: Duration = Duration::from_secs(20);
/// Pause after something broke.
const PAUSE: Duration = Duration::from_secs(1);
/// How often refused certificates are counted.
const PRUNE_EVERY: Duration = Duration::from_secs(2);

/// The server, before it listens.
pub struct OpcuaServer {
    host: String,
    users: Authenticator,
    certificates: Certificates,
    acknowledging: Acknowledging,
    standing: watch::Receiver<Arc<Standing>>,
}

impl OpcuaServer {
    /// Reads what the settings name, and makes what is missing of the certificates.
    ///
    /// # Errors
    /// A file cannot be read or written, lets others read a secret, or is not what it should be.
    pub fn new(
        settings: &Settings,
        opcua: &OpcuaSettings,
        seals: Seals,
        standing: watch::Receiver<Arc<Standing>>,
    ) -> anyhow::Result<Self> {
        let ip = opcua.listen.ip();
        let host = opcua.name.clone().unwrap_or_else(|| ip.to_string());
        let certificates = Certificates::prepare(&opcua.certificates, &host, ip.is_loopback())?;
        tracing::info!("opcua: own certificate {}", certificates.thumbprint()?);
        Ok(Self {
            host,
            users: Authenticator(Arc::new(UsersFile::open(&opcua.users)?)),
            certificates,
            acknowledging: Acknowledging {
                history: settings.history.clone(),
                seals,
            },
            standing,
        })
    }

    /// Serves until the process ends. What breaks here, breaks nothing else: everybody is disconnected, and it begins anew.
    pub async fn run(self, listener: TcpListener) -> anyhow::Result<()> {
        let (server, listener) = (Arc::new(self), Arc::new(listener));
        loop {
            let (this, gate) = (Arc::clone(&server), Arc::clone(&listener));
            // A task of its own: not even a panic on what a client sends reaches the others.
            let ended = tokio::spawn(async move { this.serve(&gate).await }).await;
            let why = match ended {
                Ok(Ok(())) => "the server ended".to_owned(),
                Ok(Err(error)) => format!("{error:#}"),
                Err(panicked) => panicked.to_string(),
            };
            tracing::warn!("opcua: {why}; again in {} s", PAUSE.as_secs());
            sleep(PAUSE).await;
        }
    }

    /// Serves until something breaks.
    async fn serve(self: Arc<Self>, listener: &Arc<TcpListener>) -> anyhow::Result<()> {
        // Behind the gate.
        let inner = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await?;
        let inner_address = inner.local_addr()?;
        let address = listener.local_addr()?;
        let (server, handle) = self.build(address)?;
        let _cancelled = Cancel(handle.clone());
        let mut tasks = JoinSet::new();
        tasks.spawn(async move { server.run_with(inner).await.map_err(|error| anyhow!(error)) });
        // It writes the port behind the gate where clients read how they reach it.
        let port = &handle.info().port;
        let begun = async {
            while port.load(Ordering::Relaxed) == 0 {
                sleep(Duration::from_millis(10)).await;
            }
        };
        tokio::time::timeout(BEGIN_TIME, begun).await?;
        port.store(address.port(), Ordering::Relaxed);
        let manager = handle.node_managers().get_of_type::<Manager>();
        let manager = manager.context("the server has lost its nodes")?;
        let history = (&self.acknowledging.history, &self.acknowledging.seals);
        let publisher = Publisher::new(manager, handle.clone(), history);
        tasks.spawn(publisher.run(self.standing.clone()));
        let gate = Arc::clone(listener);
        tasks.spawn(async move { gate::serve(&gate, inner_address).await });
        let certificates = self.certificates.clone();
        tasks.spawn(async move { prune(certificates).await });
        match tasks.join_next().await {
            Some(ended) => ended?,
            None => Ok(()),
        }
    }

    fn build(&self, address: SocketAddr) -> anyhow::Result<(Server, ServerHandle)> {
        let (users, acknowledging) = (self.users.clone(), self.acknowledging.clone());
        let nodes = move |context: ServerContext, space: &mut AddressSpace| {
            PlantNodes::new(&context, space, users, acknowledging)
        };
        let host = match self.host.parse() {
            Ok(IpAddr::V6(ip)) => format!("[{ip}]"),
            _ => self.host.clone(),
        };
        let uri = &self.certificates.application_uri;
        let version = env!("CARGO_PKG_VERSION");
        let mut builder = ServerBuilder::new()
            .application_name("flankscope-plant")
            .application_uri(uri)
            .product_uri("urn:flankscope:plant")
            .build_info(BuildInfo {
                product_uri: "urn:flankscope:plant".into(),
                manufacturer_name: "flankscope".into(),
                product_name: "flankscope-plant".into(),
                software_version: version.into(),
                build_number: version.into(),
                build_date: DateTime::null(),
            })
            .create_sample_keypair(false)
            .pki_dir(&self.certificates.folder)
            .certificate_path(certificates::OWN)
            .private_key_path(certificates::KEY)
            .trust_client_certs(false)
            .check_cert_time(true)
            .host(&host)
            .port(address.port())
            .discovery_urls(vec!["/".into()])
            .hello_timeout(5)
            .max_sessions(MOST_SESSIONS)
            .max_session_timeout_ms(SESSION_TIME_MS)
            .max_message_size(MOST_MESSAGE)
            .max_chunk_count(MOST_CHUNKS)
            .receive_buffer_size(gate::MOST_CHUNK)
            .send_buffer_size(gate::MOST_CHUNK)
            .diagnostics_enabled(false)
            .with_authenticator(Arc::new(self.users.clone()))
            .with_node_manager(InMemoryNodeManagerBuilder::new(nodes));
        for (name, policy) in [
            ("basic256sha256", SecurityPolicy::Basic256Sha256),
            ("aes256sha256rsapss", SecurityPolicy::Aes256Sha256RsaPss),
        ] {
            let mode = MessageSecurityMode::SignAndEncrypt;
            builder = builder.add_endpoint(name, ServerEndpoint::new("/", policy, mode, &[]));
        }
        let subscriptions = &mut builder.limits_mut().subscriptions;
        subscriptions.max_monitored_items_per_sub = MOST_ITEMS;
        subscriptions.max_monitored_item_queue_size = MOST_QUEUED;
        builder.build().map_err(|error| anyhow!(error))
    }
}

/// Ends a server when it is dropped: its connections are tasks of their own.
struct Cancel(ServerHandle);

impl Drop for Cancel {
    fn drop(&mut self) {
        self.0.cancel();
    }
}

async fn prune(certificates: Certificates) -> anyhow::Result<()> {
    loop {
        sleep(PRUNE_EVERY).await;
        let certificates = certificates.clone();
        if let Err(error) = tokio::task::spawn_blocking(move || certificates.prune()).await? {
            tracing::warn!("opcua: refused certificates: {error}");
        }
    }
}

/// Whether the nodes say that a die is good.
#[cfg(test)]
pub fn says_good(die: &crate::statement::DieStatement) -> bool {
    space::says_good(die)
}
