//! Another process's network, where a test's cameras are apart from everybody else's.

use std::fs::{File, read_link};
use std::os::fd::AsFd;

use anyhow::Context;
use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};

/// Moves this process, which has one thread yet, into the network of another one, and into its users' namespace if that is
/// another.
///
/// # Errors
/// There is no such process, or it is not ours.
pub(crate) fn join(pid: u32) -> anyhow::Result<()> {
    for (name, kind) in [
        ("user", LinkNameSpaceType::User),
        ("net", LinkNameSpaceType::Network),
    ] {
        let (own, other) = (
            format!("/proc/self/ns/{name}"),
            format!("/proc/{pid}/ns/{name}"),
        );
        let there = read_link(&other).with_context(|| other.clone())?;
        if read_link(&own).with_context(|| own)? == there {
            continue;
        }
        let file = File::open(&other).with_context(|| other.clone())?;
        move_into_link_name_space(file.as_fd(), Some(kind))
            .with_context(|| format!("cannot enter {other}"))?;
    }
    Ok(())
}
