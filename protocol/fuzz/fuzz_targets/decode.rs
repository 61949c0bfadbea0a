//! Any bytes into the decoder: `cargo install cargo-fuzz`, then in `protocol`: `cargo +nightly fuzz run decode`.
//!
//! What it finds belongs into `protocol/tests/corpus` in hexadecimal (`xxd -p`), where every test run replays it.
#![no_main]

#[path = "../../tests/common/feed.rs"]
mod feed;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    feed::feed(bytes);
});
