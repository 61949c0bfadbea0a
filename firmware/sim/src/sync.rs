//! Locks and thread identities, by which a simulation speaks with other threads.
//!
//! With the feature `shuttle` they are those of a scheduler that tries one interleaving of the threads after another; nothing
//! but `tests/interleavings.rs` runs under it.

#[cfg(feature = "shuttle")]
pub(crate) use shuttle::{
    sync::{Condvar, Mutex, MutexGuard},
    thread::{ThreadId, current},
};
#[cfg(not(feature = "shuttle"))]
pub(crate) use std::{
    sync::{Condvar, Mutex, MutexGuard},
    thread::{ThreadId, current},
};
