//! The iceoryx2 services of a capture, with every limit stated.

use iceoryx2::node::Node;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenOrCreateError;
use iceoryx2::service::port_factory::{event, publish_subscribe};

use crate::arm::Arm;
use crate::header::FrameHeader;
use crate::ready::Ready;
use crate::root::SharedRoot;

/// Frames that may wait for the host before the camera process must drop one: 16 exposures of 10 ms, 160 ms of host delay.
pub const BUFFERED_FRAMES: usize = 16;
/// Frames that the host may hold at once: one being decoded, one kept for the report, one to spare.
pub const BORROWED_FRAMES: usize = 3;
/// Frames that the camera process may be writing at once.
pub const LOANED_FRAMES: usize = 2;
/// Largest frame, px: 1920 x 1200. The segment is laid out for it once, nothing is allocated later.
pub const MAX_FRAME_PIXELS: usize = 1920 * 1200;

/// Bytes of shared memory that the frames of a capture take.
pub const SEGMENT_BYTES: usize =
    (BUFFERED_FRAMES + BORROWED_FRAMES + LOANED_FRAMES) * MAX_FRAME_PIXELS * size_of::<u16>();

/// Why a service cannot be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServiceError {
    /// The root's path or prefix cannot name services.
    #[error("{path} cannot hold services: the path is too long or has odd characters")]
    Path {
        /// The root.
        path: String,
    },
    /// iceoryx2 refused.
    #[error("cannot {action} in {path}: {reason}")]
    Refused {
        /// What was asked for.
        action: &'static str,
        /// The root.
        path: String,
        /// The library's own reason.
        reason: String,
    },
}

pub(super) type FrameService = publish_subscribe::PortFactory<ipc::Service, [u16], FrameHeader>;
pub(super) type ArmService = publish_subscribe::PortFactory<ipc::Service, Arm, ()>;
pub(super) type ReadyService = publish_subscribe::PortFactory<ipc::Service, Ready, ()>;
pub(super) type WakeService = event::PortFactory<ipc::Service>;

/// The four services of a capture and the node that holds them.
#[derive(Debug)]
pub(super) struct Services {
    pub frames: FrameService,
    pub arm: ArmService,
    pub ready: ReadyService,
    pub wake: WakeService,
    // Dropped last: ports, services, node.
    pub _node: Node<ipc::Service>,
}

/// Turns a library error into ours.
pub(super) fn refused<E: std::fmt::Debug>(
    action: &'static str,
    root: &SharedRoot,
) -> impl FnOnce(E) -> ServiceError {
    let path = root.path().display().to_string();
    move |error| ServiceError::Refused {
        action,
        path,
        reason: format!("{error:?}"),
    }
}

fn not_a_place(root: &SharedRoot) -> ServiceError {
    ServiceError::Path {
        path: root.path().display().to_string(),
    }
}

/// A node below `root`, with every service file in its folder and every segment under its prefix.
pub(super) fn make_node(root: &SharedRoot) -> Result<Node<ipc::Service>, ServiceError> {
    set_log_level(LogLevel::Fatal);
    let named = || not_a_place(root);
    let mut config = Config::default();
    config.global.set_root_path(
        &Path::new(root.path().as_os_str().as_encoded_bytes()).map_err(|_| named())?,
    );
    config.global.prefix = FileName::new(root.prefix().as_bytes()).map_err(|_| named())?;
    // A killed peer's half-made files can keep the library's own cleaning waiting for ever, and none is needed: the
    // root is this run's alone, and its owner removes it whole.
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = false;
    NodeBuilder::new()
        .config(&config)
        // Signals belong to the program, not to a library.
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>()
        .map_err(refused("create a node", root))
}

/// A service of one writer and one reader in which only the newest word counts.
fn newest<T: std::fmt::Debug + ZeroCopySend>(
    node: &Node<ipc::Service>,
    name: &ServiceName,
) -> Result<publish_subscribe::PortFactory<ipc::Service, T, ()>, PublishSubscribeOpenOrCreateError>
{
    node.service_builder(name)
        .publish_subscribe::<T>()
        .enable_safe_overflow(true)
        .history_size(1)
        .subscriber_max_buffer_size(1)
        .subscriber_max_borrowed_samples(1)
        .max_publishers(1)
        .max_subscribers(1)
        .max_nodes(4)
        .open_or_create()
}

impl Services {
    /// Opens the services below `root`, or makes them: the host does so before it starts the camera process.
    pub fn open(root: &SharedRoot) -> Result<Self, ServiceError> {
        let node = make_node(root)?;
        let named = || not_a_place(root);
        let name = |text: &str| ServiceName::new(text).map_err(|_| named());
        let frames = node
            .service_builder(&name("frames")?)
            .publish_subscribe::<[u16]>()
            .user_header::<FrameHeader>()
            .payload_alignment(Alignment::new(64).ok_or_else(named)?)
            // A frame that cannot be delivered must be an error that is seen, never an old frame silently replaced.
            .enable_safe_overflow(false)
            .history_size(0)
            .subscriber_max_buffer_size(BUFFERED_FRAMES)
            .subscriber_max_borrowed_samples(BORROWED_FRAMES)
            .max_publishers(1)
            .max_subscribers(1)
            .max_nodes(4)
            .open_or_create()
            .map_err(refused("open the frame service", root))?;
        let arm = newest(&node, &name("arm")?).map_err(refused("open the arming service", root))?;
        let ready =
            newest(&node, &name("ready")?).map_err(refused("open the camera's service", root))?;
        let wake = node
            .service_builder(&name("wake")?)
            .event()
            .max_notifiers(1)
            .max_listeners(1)
            .max_nodes(4)
            .open_or_create()
            .map_err(refused("open the frame-ready event", root))?;
        Ok(Self {
            frames,
            arm,
            ready,
            wake,
            _node: node,
        })
    }
}
