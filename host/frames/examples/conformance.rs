//! Checks a camera process: `conformance PROGRAM [ARGUMENT]...`, whose last argument will be the root's folder.

use std::error::Error;

use flankscope_frames::conformance::{CommandRig, Settings, run};

fn main() -> Result<(), Box<dyn Error>> {
    let mut words = std::env::args_os().skip(1);
    let program = words
        .next()
        .ok_or("usage: conformance PROGRAM [ARGUMENT]...")?;
    let mut rig = CommandRig::new(program, words);
    run(
        &mut rig,
        &flankscope_frames::default_base()?,
        &Settings::default(),
        |check| println!("passed: {check}"),
    )?;
    Ok(())
}
