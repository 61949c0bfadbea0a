//! Empty stand-in for `bindgen`.
//!
//! `iceoryx2-pal-posix` and `iceoryx2-pal-os-api` 0.10 list `bindgen` as a build dependency on every system. Their build scripts run
//! it on QNX alone. Without this stand-in, each cold build compiles bindgen and its nine dependencies and runs none of them.
