//! A private network namespace for the bench, so that its camera does not disturb others, nor two benches each other.

use std::ffi::c_short;
use std::fs::write;

use anyhow::Context;
use rustix::ioctl::{Opcode, Setter, ioctl};
use rustix::net::{AddressFamily, SocketType, socket};
use rustix::process::{DumpableBehavior, getgid, getuid, set_dumpable_behavior};
use rustix::thread::{UnshareFlags, unshare_unsafe};

/// `struct ifreq` with interface flags.
#[repr(C)]
struct InterfaceFlags {
    name: [u8; 16],
    flags: c_short,
    rest: [u8; 22],
}

const SIOCSIFFLAGS: Opcode = 0x8914;
const IFF_UP: c_short = 1;

/// Moves this process, which must have one thread only, into its own network namespace with a loopback interface only. If the
/// system does not allow that, it stays in the host's. Returns whether it has its own.
///
/// # Errors
/// It has its own, but its loopback interface cannot be used.
pub fn enter() -> anyhow::Result<bool> {
    let (uid, gid) = (getuid().as_raw(), getgid().as_raw());
    // SAFETY: no memory, files or threads are unshared.
    let unshared = unsafe { unshare_unsafe(UnshareFlags::NEWUSER | UnshareFlags::NEWNET) };
    if unshared.is_err() {
        // SAFETY: as above. Who may not have users of his own may be root.
        if unsafe { unshare_unsafe(UnshareFlags::NEWNET) }.is_err() {
            return Ok(false);
        }
    } else {
        // The user and group ids stay the same inside.
        write("/proc/self/setgroups", "deny").context("setgroups")?;
        write("/proc/self/uid_map", format!("{uid} {uid} 1")).context("uid_map")?;
        write("/proc/self/gid_map", format!("{gid} {gid} 1")).context("gid_map")?;
        // The camera process joins through our entry in /proc.
        set_dumpable_behavior(DumpableBehavior::Dumpable)?;
    }
    let mut name = [0; 16];
    name[..2].copy_from_slice(b"lo");
    let request = InterfaceFlags {
        name,
        flags: IFF_UP,
        rest: [0; 22],
    };
    let any = socket(AddressFamily::INET, SocketType::DGRAM, None)?;
    // SAFETY: the request has the size and layout that SIOCSIFFLAGS reads (netdevice(7)).
    unsafe { ioctl(&any, Setter::<SIOCSIFFLAGS, InterfaceFlags>::new(request)) }
        .context("the loopback of the bench's own network")?;
    Ok(true)
}
