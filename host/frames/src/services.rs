//! The iceoryx2 services of a capture, with every limit stated.

use iceoryx2::node::Node;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenOrCreateError;
use iceoryx2::service::port_factory::{event, publish_subscribe};

use crate::arm::Arm;
use crate::header::FrameHeader;
use crate::node::{self, ServiceError, not_a_place, refused};
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
        let path = root.path();
        let node = node::make(path, root.prefix())?;
        let named = || not_a_place(path);
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
            .map_err(refused("open the frame service", path))?;
        let arm = newest(&node, &name("arm")?).map_err(refused("open the arming service", path))?;
        let ready =
            newest(&node, &name("ready")?).map_err(refused("open the camera's service", path))?;
        let wake = node
            .service_builder(&name("wake")?)
            .event()
            .max_notifiers(1)
            .max_listeners(1)
            .max_nodes(4)
            .open_or_create()
            .map_err(refused("open the frame-ready event", path))?;
        Ok(Self {
            frames,
            arm,
            ready,
            wake,
            _node: node,
        })
    }
}
