//! What tests of several crates need: other people's data, board images and an emulator, none of which are in the repository; and random
//! numbers.
//!
//! A test asks for data or a program and returns when that is not there: missed aloud, and a failure where everything must run
//! (`cargo xtask test --all`).

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Where [`stage_clients`] looks, from the repository.
pub const STAGE_CLIENTS: &str = "target/stage-clients/bin/python";

/// Where [`mqtt_peers`] looks, from the repository.
pub const MQTT_CLIENTS: &str = "target/mqtt-clients/bin/python";

/// Where [`opcua_clients`] looks, from the repository.
pub const OPCUA_CLIENTS: &str = "target/opcua-clients/bin/python";

/// Where [`lake_readers`] looks, from the repository.
pub const LAKE_READERS: &str = "target/lake-readers/bin/python";

/// Where [`ballista`] looks, from the repository, before the shell's own places.
pub const BALLISTA: &str = "target/ballista/bin";

/// Where [`dfq_reader`] looks, from the repository.
pub const DFQ_READER: &str = "target/dfq-reader/bin/python";

/// Where Debian's broker is, which is no program for users.
pub const MOSQUITTO: &str = "/usr/sbin/mosquitto";

/// A head file as drawn, without volume and sensor: the camera's 1920 x 1200 pixels behind a bundle, a DMD of 1024 x 768 mirrors.
pub const DRAWN_HEAD: &str = r#"
name = "drawn"
[camera]
width_px = 1920
height_px = 1200
focal_px = [2530.0, 2531.5]
principal_px = [959.5, 599.5]
[projector]
width_px = 1024
height_px = 768
focal_px = [2252.8, 2252.8]
principal_px = [511.5, 383.5]
[projector_from_camera]
rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
translation_mm = [11.0, 0.0, 0.0]
[image_circle]
centre_px = [959.5, 599.5]
radius_px = 575.0
"#;

/// Calls `each` for all numbers below `count`, on so many threads; the results in no particular order.
///
/// # Panics
/// A call panicked.
pub fn in_lanes<T: Send>(count: usize, lanes: usize, each: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let lane = || {
        let numbers = std::iter::repeat_with(|| next.fetch_add(1, Ordering::Relaxed));
        let numbers = numbers.take_while(|number| *number < count);
        numbers.map(&each).collect::<Vec<T>>()
    };
    std::thread::scope(|scope| {
        let running: Vec<_> = (0..lanes).map(|_| scope.spawn(lane)).collect();
        let joined = running.into_iter().map(|lane| lane.join().unwrap());
        joined.flatten().collect()
    })
}

/// Random numbers that do not come from the code under test: Knuth's linear congruential generator (MMIX), from this state.
pub struct Random(pub u64);

impl Random {
    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Nearly normal with a standard deviation of one: the sum of twelve uniform numbers less six.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Whether everything must run: nothing may be missed, and campaigns draw as many cases as they state.
#[must_use]
pub fn everything() -> bool {
    std::env::var_os("FLANKSCOPE_TEST_ALL").is_some()
}

/// All cases where everything must run, else the first so many.
///
/// # Panics
/// There are not so many.
#[must_use]
pub fn at_least<T>(first: usize, cases: &[T]) -> &[T] {
    if everything() { cases } else { &cases[..first] }
}

/// Whether a test of half a minute and more runs, of which others show a part: where everything must run. Says so.
#[must_use]
pub fn dear() -> bool {
    if !everything() {
        eprintln!("SKIPPED: cargo xtask test --all runs it");
    }
    everything()
}

/// The repository.
#[must_use]
pub fn workspace() -> &'static Path {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.ancestors().nth(2).unwrap_or(here)
}

/// Other people's data (a file or a folder), by its path in `shared` beside the repository.
///
/// # Panics
/// It is missing although everything must run.
#[must_use]
pub fn shared(path: &str) -> Option<PathBuf> {
    let found = workspace().join("../shared").join(path);
    found
        .canonicalize()
        .ok()
        .or_else(|| missed(&format!("{} (other people's data)", found.display())))
}

/// The image of a board, by its folder below `firmware`; STM32 boards are built in one folder.
///
/// # Panics
/// It is missing although everything must run.
#[must_use]
pub fn board_image(board: &str) -> Option<PathBuf> {
    let name = format!("flankscope-{board}");
    let built_in = match board {
        "mps2-an386" => board,
        _ => "stm32-board",
    };
    let folder = format!("firmware/{built_in}/target/thumbv7em-none-eabihf/release");
    let image = workspace().join(folder).join(&name);
    match image.is_file() {
        true => Some(image),
        false => missed(&format!("{name}, which cargo xtask firmware builds,")),
    }
}

/// A board image of `firmware/mps2-an386` by its file name, where the emulator that runs it is there, too.
///
/// # Panics
/// One of them is missing although everything must run.
#[must_use]
pub fn emulated_image(name: &str) -> Option<PathBuf> {
    let folder = "firmware/mps2-an386/target/thumbv7em-none-eabihf/release";
    let image = workspace().join(folder).join(name);
    match (image.is_file(), has_emulator()) {
        (true, true) => Some(image),
        (false, _) => missed(&format!("{name}, which cargo xtask firmware builds,")),
        (_, false) => missed("qemu-system-arm"),
    }
}

/// The image of a board that the emulator knows by itself, where the emulator is there, too.
///
/// # Panics
/// One of them is missing although everything must run.
#[must_use]
pub fn emulated_board(board: &str) -> Option<PathBuf> {
    match has_emulator() {
        true => board_image(board),
        false => missed("qemu-system-arm"),
    }
}

fn has_emulator() -> bool {
    on_path("qemu-system-arm").is_some()
}

/// A program where the shell looks for one.
#[must_use]
pub fn on_path(program: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let mut programs = std::env::split_paths(&path).map(|folder| folder.join(program));
    programs.find(|program| program.is_file())
}

/// A Python that has these modules: that of the folder in `FLANKSCOPE_PYTHON`, of `target/python` (`.ci/run` makes it), or the
/// system's.
///
/// # Panics
/// There is none although everything must run.
#[must_use]
pub fn python_with(modules: &[&str]) -> Option<PathBuf> {
    let own = workspace().join("target/python");
    let named = std::env::var_os("FLANKSCOPE_PYTHON").map(PathBuf::from);
    let folders = [named, Some(own)].into_iter().flatten();
    let candidates = folders.map(|folder| folder.join("bin/python"));
    let script = format!("import {}", modules.join(", "));
    let has = |python: &PathBuf| {
        let mut tried = std::process::Command::new(python);
        let tried = tried.args(["-c", &script]).output();
        tried.is_ok_and(|output| output.status.success())
    };
    let mut candidates = candidates.chain([PathBuf::from("python3")]);
    let found = candidates.find(has);
    found.or_else(|| missed(&format!("Python with {}", modules.join(", "))))
}

/// Name of another's metrics server, which scrapes the plant's.
pub const PROMETHEUS: &str = "prometheus";

/// Another's metrics server.
///
/// # Panics
/// It is missing although everything must run.
#[must_use]
pub fn prometheus() -> Option<PathBuf> {
    on_path(PROMETHEUS).or_else(|| missed(PROMETHEUS))
}

/// OpenSSL's program, which makes certificates and speaks TLS.
///
/// # Panics
/// It is missing although everything must run.
#[must_use]
pub fn openssl() -> Option<PathBuf> {
    on_path("openssl").or_else(|| missed("openssl"))
}

/// Names of the browser whose engine draws the pages in tests.
pub const BROWSERS: &[&str] = &["chromium", "chromium-browser", "google-chrome"];

/// A browser of the Chromium family, which draws and prints pages without a screen.
///
/// # Panics
/// There is none although everything must run.
#[must_use]
pub fn browser() -> Option<PathBuf> {
    let found = BROWSERS.iter().find_map(|name| on_path(name));
    found.or_else(|| missed("Chromium"))
}

/// Python with two clients of other people for the stage controller.
///
/// # Panics
/// It is missing although everything must run.
#[must_use]
pub fn stage_clients() -> Option<PathBuf> {
    environment(STAGE_CLIENTS)
}

/// Other people's MQTT broker, and Python with other people's clients.
///
/// # Panics
/// One of them is missing although everything must run.
#[must_use]
pub fn mqtt_peers() -> Option<(PathBuf, PathBuf)> {
    let broker = Path::new(MOSQUITTO);
    let broker = match broker.is_file() {
        true => broker.to_owned(),
        false => missed("mosquitto")?,
    };
    Some((broker, environment(MQTT_CLIENTS)?))
}

/// Python with other people's OPC UA client.
///
/// # Panics
/// It is missing although everything must run.
#[must_use]
pub fn opcua_clients() -> Option<PathBuf> {
    environment(OPCUA_CLIENTS)
}

/// Python with other people's readers of Parquet, and a server that speaks S3.
///
/// # Panics
/// It is missing although everything must run.
#[must_use]
pub fn lake_readers() -> Option<PathBuf> {
    environment(LAKE_READERS)
}

/// Ballista's scheduler and executor, as they are published.
///
/// # Panics
/// One of them is missing although everything must run.
#[must_use]
pub fn ballista() -> Option<[PathBuf; 2]> {
    let found = |name: &str| {
        let own = workspace().join(BALLISTA).join(name);
        let found = own.is_file().then_some(own).or_else(|| on_path(name));
        found.or_else(|| missed(&format!("{name} (tools/peers/README.md)")))
    };
    Some([found("ballista-scheduler")?, found("ballista-executor")?])
}

/// Python with another's reader of DFQ files.
///
/// # Panics
/// It is missing although everything must run.
#[must_use]
pub fn dfq_reader() -> Option<PathBuf> {
    environment(DFQ_READER)
}

/// The published schema of QIF 3.0, whose folder `FLANKSCOPE_QIF_XSD` names, and a validator. No package brings the schema, so a test may miss
/// it even where everything must run.
#[must_use]
pub fn qif_schema() -> Option<(PathBuf, PathBuf)> {
    let folder = std::env::var_os("FLANKSCOPE_QIF_XSD").map(PathBuf::from);
    let schema = folder.map(|folder| folder.join("QIFApplications/QIFDocument.xsd"));
    match (schema, on_path("xmllint")) {
        (Some(schema), Some(xmllint)) if schema.is_file() => Some((schema, xmllint)),
        (schema, xmllint) => {
            eprintln!(
                "SKIPPED: not validated by the published schema: FLANKSCOPE_QIF_XSD names {schema:?}, xmllint is {xmllint:?}"
            );
            None
        }
    }
}

/// Whether Aravis' library is there, which speaks GigE Vision and USB3 Vision.
#[must_use]
pub fn has_aravis() -> bool {
    let mut asked = std::process::Command::new("pkg-config");
    let asked = asked.args(["--exists", "--print-errors", ARAVIS]).output();
    asked.is_ok_and(|output| output.status.success())
}

/// As `pkg-config` knows the oldest library that is used.
const ARAVIS: &str = "aravis-0.8 >= 0.8.20";

/// Whether tests of GigE cameras can run.
///
/// # Panics
/// They cannot although everything must run.
#[must_use]
pub fn aravis() -> bool {
    has_aravis() || missed("Aravis (libaravis-dev and libusb-1.0-0-dev)").is_some()
}

/// The Python of an environment with other people's packages.
fn environment(python: &str) -> Option<PathBuf> {
    let there = workspace().join(python);
    match there.is_file() {
        true => Some(there),
        false => missed(&format!("{python} (tools/peers/README.md)")),
    }
}

fn missed(what: &str) -> Option<PathBuf> {
    assert!(!everything(), "{what} is missing");
    eprintln!("SKIPPED: {what} is missing");
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_workspace_is_where_the_members_are() {
        assert!(
            workspace()
                .join("tools/test-requisites/Cargo.toml")
                .is_file()
        );
    }
}
