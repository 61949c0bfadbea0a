//! A node of iceoryx2 in a private place.

use std::path::Path;

use iceoryx2::node::Node;
use iceoryx2::prelude::{
    Config, FileName, LogLevel, NodeBuilder, SemanticString, SignalHandlingMode, ipc, set_log_level,
};

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

/// Turns a library error into ours.
pub(super) fn refused<E: std::fmt::Debug>(
    action: &'static str,
    folder: &Path,
) -> impl FnOnce(E) -> ServiceError {
    let path = folder.display().to_string();
    move |error| ServiceError::Refused {
        action,
        path,
        reason: format!("{error:?}"),
    }
}

pub(super) fn not_a_place(folder: &Path) -> ServiceError {
    ServiceError::Path {
        path: folder.display().to_string(),
    }
}

/// A node with every service file in `folder` and every segment under `prefix`.
pub(super) fn make(folder: &Path, prefix: &str) -> Result<Node<ipc::Service>, ServiceError> {
    set_log_level(LogLevel::Fatal);
    let named = || not_a_place(folder);
    let mut config = Config::default();
    config.global.set_root_path(
        &iceoryx2::prelude::Path::new(folder.as_os_str().as_encoded_bytes())
            .map_err(|_| named())?,
    );
    config.global.prefix = FileName::new(prefix.as_bytes()).map_err(|_| named())?;
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
        .map_err(refused("create a node", folder))
}
