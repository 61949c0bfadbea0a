//! The `flankscope` command.
fn main() {}
