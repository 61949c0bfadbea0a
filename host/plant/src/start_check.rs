//! Starting a check before it is due: who may. The page and OPC UA do it the same way; the watch makes it at the next opening, under the
//! same conditions as any other.

use std::path::Path;

use flankscope_record::check_request::{RequestError, request_check};

use crate::access::User;

/// Why no check was started.
#[derive(Debug, thiserror::Error)]
pub enum NotStarted {
    #[error("the role of {0} is to view, not to start checks")]
    NotAllowed(String),
    #[error(transparent)]
    Request(#[from] RequestError),
}

/// Asks the watch of a history for a check, of this tool if one is named. It waits for the watch's word and the disk.
///
/// # Errors
/// The user may not, no watch runs or it is of another tool, or the request cannot be stored.
pub fn start_check(history: &Path, user: &User, tool: Option<&str>) -> Result<(), NotStarted> {
    if !user.role.acknowledges() {
        return Err(NotStarted::NotAllowed(user.name.clone()));
    }
    request_check(history, tool, &user.name)?;
    tracing::info!("{} wants a check", user.name);
    Ok(())
}
