//! `cargo xtask firmware` builds the board images and judges them by their budgets; `cargo xtask qemu` runs one.
//!
//! With rustup's target installed, the usual cargo builds them. Without it, Debian's packaged toolchain does, with `core`
//! compiled from its source.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::elf::{Image, Symbol};

const TARGET: &str = "thumbv7em-none-eabihf";
const FLASH_BUDGET: u32 = 80 * 1024;
const STATIC_RAM_BUDGET: u32 = 24 * 1024;
/// Static data and stack together: what `memory.x` of both images gives them.
const RAM_BYTES: u32 = 40 * 1024;
const RAM_START: u32 = 0x2000_0000;
/// The image that the emulator runs, below the repository.
pub const EMULATED_IMAGE: &str =
    "firmware/mps2-an386/target/thumbv7em-none-eabihf/release/flankscope-mps2-an386";
/// Beside it, the one that the bench can make go wrong.
const FAULT_INJECTION_IMAGE: &str = "flankscope-mps2-an386-fault-injection";
const PACKAGES: &str = "rustc-web cargo-web rust-web-src lld";

/// An image: its folder below `firmware`, which is also its name behind `flankscope-`.
struct Board {
    folder: &'static str,
    /// Its other image.
    also: Variant,
    /// Its hardware library has panicking paths of its own: where `core` is compiled anyway, they become traps.
    traps: bool,
}

/// An image with a feature, kept under a name of its own.
struct Variant {
    feature: &'static str,
    name: &'static str,
    /// It goes onto boards; else it is made to go wrong.
    flashed: bool,
}

/// Who may panic in an image.
#[derive(Clone, Copy)]
enum Panics {
    Nobody,
    /// Its hardware library: Debian's toolchain turns that into traps.
    Library,
    /// Whoever is told to.
    Ordered,
}

const BOARDS: [Board; 2] = [
    Board {
        folder: "mps2-an386",
        also: Variant {
            feature: "fault-injection",
            name: FAULT_INJECTION_IMAGE,
            flashed: false,
        },
        traps: false,
    },
    Board {
        folder: "nucleo-h743zi",
        also: Variant {
            feature: "dlp5500",
            name: "flankscope-nucleo-h743zi-dlp5500",
            flashed: true,
        },
        traps: true,
    },
];

enum Toolchain {
    /// rustup's, with the target installed.
    Rustup,
    /// Debian's, compiling `core` itself.
    Debian,
}

/// Builds both images and fails if one breaks a budget.
pub fn build(root: &Path) -> Result<(), String> {
    let toolchain = toolchain()?;
    let mut broken = Vec::new();
    for board in &BOARDS {
        let panics = match board.traps && !matches!(toolchain, Toolchain::Debian) {
            true => Panics::Library,
            false => Panics::Nobody,
        };
        let Variant {
            feature,
            name,
            flashed,
        } = board.also;
        let path = compile(root, board, &toolchain, &["--features", feature])?;
        let kept = path.with_file_name(name);
        std::fs::copy(&path, &kept).map_err(|error| format!("{}: {error}", kept.display()))?;
        let ordered = if flashed { panics } else { Panics::Ordered };
        broken.extend(judge(name, &kept, ordered)?);
        let path = compile(root, board, &toolchain, &[])?;
        broken.extend(judge(board.folder, &path, panics)?);
    }
    if broken.is_empty() {
        Ok(())
    } else {
        Err(broken.join("\n       "))
    }
}

/// Runs the in-situ check in-process and through the emulated image, compares them and prints the image's timing.
pub fn qemu(root: &Path) -> Result<(), String> {
    build(root)?;
    if !is_on_path("qemu-system-arm") {
        return Err("qemu-system-arm is missing; get it: apt-get install qemu-system-arm".into());
    }
    let sim = inspect(root, &["--link", "sim", "--speed", "max"])?;
    let emulated = inspect(root, &["--link", "qemu"])?;
    let figures = &emulated["truth"]["controller"];
    let number = |value: &Value| value.as_u64().map_or_else(|| "?".into(), |n| n.to_string());
    let spread = |key: &str| {
        let spread = &figures[key];
        format!(
            "{}..{} us ({} times)",
            number(&spread["min_us"]),
            number(&spread["max_us"]),
            number(&spread["count"])
        )
    };
    println!(
        "mps2-an386 in QEMU, 1000 million instructions per second (-icount shift=0), by its own clock:"
    );
    println!(
        "  stack high-water mark            {} bytes",
        number(&figures["stack_bytes"])
    );
    println!(
        "  alarm to interrupt, worst        {} us",
        number(&figures["timer_interrupt_us"])
    );
    println!("  input interrupt to output        {}", spread("reaction"));
    println!(
        "  exposure beyond the commanded    {}",
        spread("pulse_excess")
    );
    println!(
        "  DMD ready to camera trigger      {}: the plan's settle, and lateness",
        spread("ready_to_camera")
    );
    println!(
        "  DMD trigger to camera trigger    {}, the bench's answers in real time included",
        spread("dmd_to_camera")
    );
    println!(
        "  trigger period jitter, worst     {} us where the readout sets the pace, else {} us, likewise",
        number(&figures["held_period_jitter_us"]),
        number(&figures["period_jitter_us"])
    );
    let path = image_path(root, &BOARDS[0]);
    let image = read(&path)?;
    let stack = figures["stack_bytes"]
        .as_u64()
        .ok_or("the image did not tell its stack")?;
    let used = u64::from(static_ram(&image)) + stack;
    println!("  static RAM and stack             {used} of {RAM_BYTES} bytes");
    if used > u64::from(RAM_BYTES) {
        return Err(format!("RAM: {used} bytes are used, {RAM_BYTES} are there"));
    }
    for key in ["verdict", "features", "registration"] {
        let (one, other) = (untimed(&sim[key]), untimed(&emulated[key]));
        if one != other {
            return Err(format!(
                "{key} differs between --link sim and --link qemu:\n{one}\n{other}"
            ));
        }
    }
    println!("  verdict, features and registration are those of --link sim, to the last bit");
    Ok(())
}

/// Without the times that a computation took.
fn untimed(value: &Value) -> Value {
    match value {
        Value::Array(items) => items.iter().map(untimed).collect(),
        Value::Object(fields) => fields
            .iter()
            .filter(|(key, _)| *key != "elapsed_ms")
            .map(|(key, value)| (key.clone(), untimed(value)))
            .collect(),
        other => other.clone(),
    }
}

/// What a check says, as JSON; fails unless it said go.
pub fn inspect(root: &Path, arguments: &[&str]) -> Result<Value, String> {
    let mut command = crate::cargo(&[
        "run",
        "--release",
        "--quiet",
        "--",
        "inspect",
        "--quiet",
        "--json",
        "-",
    ]);
    command.args(arguments).current_dir(root);
    eprintln!("$ {command:?}");
    let output = command
        .output()
        .map_err(|error| format!("{command:?}: {error}"))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let document: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        return Err(format!(
            "{command:?} ended with {}: {}\n{said}",
            output.status, document["reason"]
        ));
    }
    serde_json::from_slice(&output.stdout).map_err(|error| format!("{command:?}: {error}"))
}

/// What can build here.
fn toolchain() -> Result<Toolchain, String> {
    let installed = Command::new("rustup")
        .args(["target", "list", "--installed"])
        .output();
    if installed.is_ok_and(|output| {
        String::from_utf8_lossy(&output.stdout)
            .lines()
            .any(|line| line == TARGET)
    }) {
        return Ok(Toolchain::Rustup);
    }
    let sysroot = Command::new("/usr/bin/rustc")
        .args(["--print", "sysroot"])
        .output();
    let sysroot = sysroot
        .map(|output| String::from_utf8_lossy(&output.stdout).trim().to_string())
        .unwrap_or_default();
    let core = Path::new(&sysroot).join("lib/rustlib/src/rust/library/core/Cargo.toml");
    let mut missing = Vec::new();
    for (what, there) in [
        ("/usr/bin/rustc", Path::new("/usr/bin/rustc").exists()),
        ("/usr/bin/cargo", Path::new("/usr/bin/cargo").exists()),
        ("the source of core", !sysroot.is_empty() && core.exists()),
        ("ld.lld", is_on_path("ld.lld")),
    ] {
        if !there {
            missing.push(what);
        }
    }
    if missing.is_empty() {
        return Ok(Toolchain::Debian);
    }
    Err(format!(
        "nothing here builds for {TARGET}. Either: rustup target add {TARGET}\n       \
         or, on Debian: apt-get install {PACKAGES} (missing of it: {})",
        missing.join(", ")
    ))
}

pub fn is_on_path(program: &str) -> bool {
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path).any(|folder| folder.join(program).is_file())
}

fn image_path(root: &Path, board: &Board) -> PathBuf {
    let target = root.join("firmware").join(board.folder).join("target");
    target
        .join(TARGET)
        .join("release")
        .join(format!("flankscope-{}", board.folder))
}

fn compile(
    root: &Path,
    board: &Board,
    toolchain: &Toolchain,
    features: &[&str],
) -> Result<PathBuf, String> {
    let mut cargo = match toolchain {
        Toolchain::Rustup => crate::cargo(&[]),
        Toolchain::Debian => Command::new("/usr/bin/cargo"),
    };
    cargo.args(["build", "--release", "--locked", "--target", TARGET]);
    cargo.args(features);
    cargo.current_dir(root.join("firmware").join(board.folder));
    // The image's own folder says where and how, not what this build was called with.
    for name in [
        "CARGO_TARGET_DIR",
        "CARGO_BUILD_TARGET_DIR",
        "RUSTFLAGS",
        "CARGO_ENCODED_RUSTFLAGS",
    ] {
        cargo.env_remove(name);
    }
    if let Toolchain::Debian = toolchain {
        for name in [
            "RUSTUP_TOOLCHAIN",
            "CARGO",
            "RUSTC_WRAPPER",
            "RUSTC_WORKSPACE_WRAPPER",
        ] {
            cargo.env_remove(name);
        }
        cargo.args(["-Z", "build-std=core"]);
        // build-std is unstable; a packaged compiler of a fixed version allows it when told to.
        cargo
            .env("RUSTC_BOOTSTRAP", "1")
            .env("RUSTC", "/usr/bin/rustc");
        cargo.env("RUSTDOC", "/usr/bin/rustdoc");
        cargo.env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", "ld.lld");
        if board.traps {
            cargo.env(
                "CARGO_TARGET_THUMBV7EM_NONE_EABIHF_RUSTFLAGS",
                "-Zunstable-options -Cpanic=immediate-abort",
            );
        }
    }
    crate::run(cargo)?;
    Ok(image_path(root, board))
}

fn read(path: &Path) -> Result<Image, String> {
    let bytes = std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
    Image::read(bytes).ok_or_else(|| format!("{} is no 32-bit ELF file", path.display()))
}

fn static_ram(image: &Image) -> u32 {
    image
        .sections
        .iter()
        .filter(|section| section.address >= RAM_START)
        .map(|section| section.size)
        .sum()
}

/// Prints an image's figures and returns the budgets that it breaks.
fn judge(name: &str, path: &Path, panics: Panics) -> Result<Vec<String>, String> {
    let image = read(path)?;
    let flash: u32 = image
        .sections
        .iter()
        .filter(|section| section.stored)
        .map(|section| section.size)
        .sum();
    let ram = static_ram(&image);
    println!("{name}:");
    println!("  flash        {flash:>6} of {FLASH_BUDGET} bytes");
    println!(
        "  static RAM   {ram:>6} of {STATIC_RAM_BUDGET} bytes (stack: cargo xtask qemu measures it)"
    );
    let mut broken = Vec::new();
    if flash > FLASH_BUDGET {
        broken.push(format!(
            "{name}: {flash} bytes of flash, {FLASH_BUDGET} allowed"
        ));
    }
    if ram > STATIC_RAM_BUDGET {
        broken.push(format!(
            "{name}: {ram} bytes of static RAM, {STATIC_RAM_BUDGET} allowed"
        ));
    }
    let panicking = panicking(&image);
    match (panicking.is_empty(), panics) {
        (_, Panics::Ordered) => {}
        (true, _) => println!("  no panicking path, no formatting machinery"),
        (false, Panics::Nobody) => {
            broken.push(format!("{name}: panicking paths: {}", panicking.join(", ")))
        }
        (false, Panics::Library) => println!(
            "  {} panicking paths of its hardware library; Debian's toolchain turns them into traps",
            panicking.len()
        ),
    }
    Ok(broken)
}

/// Everything in the image that panics or formats.
///
/// One kind of check is left out: the compiler's own guard against an `async` function that is polled after its end,
/// which no `await` does. It is allowed to call the panic entry; nobody else is.
fn panicking(image: &Image) -> Vec<String> {
    const MARKS: [&str; 6] = [
        "9panicking",
        "4core3fmt",
        "unwrap_failed",
        "expect_failed",
        "slice_index_fail",
        "panic_already",
    ];
    let guard = |symbol: &Symbol| symbol.name.contains("panic_const_async_fn_resumed");
    let entry = |symbol: &Symbol| symbol.name.contains("9panicking9panic_fmt");
    let mut found = Vec::new();
    for symbol in image
        .symbols
        .iter()
        .filter(|symbol| MARKS.iter().any(|mark| symbol.name.contains(mark)))
    {
        if entry(symbol) {
            let callers = image.callers(symbol);
            if callers.is_empty() {
                found.push(format!(
                    "{} (called by nobody that this tool can see)",
                    symbol.name
                ));
            }
            found.extend(
                callers
                    .iter()
                    .filter(|caller| !guard(caller))
                    .map(|caller| caller.name.clone()),
            );
        } else if !guard(symbol) {
            found.push(symbol.name.clone());
        }
    }
    found.sort();
    found.dedup();
    found
}
