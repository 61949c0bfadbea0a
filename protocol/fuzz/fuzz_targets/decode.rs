//! Any bytes into the decoder: `cargo install cargo-fuzz`, then in `protocol`: `cargo +nightly fuzz run decode`.
//!
//! It begins with `fuzz/corpus/decode` and adds to it; `protocol/tests/corpus.rs` replays that folder in every test run.
//! Before committing what it added: `cargo +nightly fuzz cmin decode`.
#![no_main]

#[path = "../../tests/common/feed.rs"]
mod feed;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    feed::feed(bytes);
});
