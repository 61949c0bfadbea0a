//! cargo xtask: every check and chore of the repository.
fn main() {}
