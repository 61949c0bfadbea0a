//! `cargo xtask firmware` builds the board images and judges them by their budgets; `cargo xtask qemu` runs one.
//!
//! `core` is compiled with the images, by any toolchain that has its source: only so can the board's hardware library trap where it
//! would panic, without the text of its panics (20 KB).

use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::process::Command;

use flankscope_test_requisites::on_path;
use serde_json::Value;

use crate::elf::{Image, Symbol};

const TARGET: &str = "thumbv7em-none-eabihf";
/// Above this an image is warned of, not refused: the part has 2 MB. What grows beyond it has gained something big.
const FLASH_BUDGET: u32 = 80 * 1024;
const STATIC_RAM_BUDGET: u32 = 24 * 1024;
/// Static data and stack together: what `memory.x` gives the emulated image.
const RAM_BYTES: u32 = 40 * 1024;
const RAM_START: u32 = 0x2000_0000;
/// The image that the emulator runs, below the repository.
pub const EMULATED_IMAGE: &str =
    "firmware/mps2-an386/target/thumbv7em-none-eabihf/release/flankscope-mps2-an386";
/// Beside it, the one that the bench can make go wrong.
const FAULT_INJECTION_IMAGE: &str = "flankscope-mps2-an386-fault-injection";
/// The board's program on a chip that the emulator knows.
const EMULATED_STM32: &str = "netduinoplus2-f405";
pub const EMULATED_STM32_IMAGE: &str =
    "firmware/stm32-board/target/thumbv7em-none-eabihf/release/flankscope-netduinoplus2-f405";
const PACKAGES: &str = "rustc-web cargo-web rust-web-src lld";
/// `rust-version` of the images.
const LEAST_MINOR: u32 = 95;

/// An image: its folder below `firmware`, which is also its name behind `flankscope-`.
struct Board {
    folder: &'static str,
    /// The folder below `firmware` whose `target` holds the image: boards of one family share it, as their `.cargo/config.toml` says.
    built_in: &'static str,
    /// Its other image.
    also: Option<Variant>,
    /// Its hardware library has panicking paths of its own: they become traps.
    traps: bool,
}

/// An image with a feature, kept under a name of its own.
struct Variant {
    feature: &'static str,
    name: &'static str,
    /// It goes onto boards; else it is made to go wrong.
    flashed: bool,
}

static BOARDS: [Board; 3] = [
    Board {
        folder: "mps2-an386",
        built_in: "mps2-an386",
        also: Some(Variant {
            feature: "fault-injection",
            name: FAULT_INJECTION_IMAGE,
            flashed: false,
        }),
        traps: false,
    },
    Board {
        folder: "nucleo-h743zi",
        built_in: "stm32-board",
        also: Some(Variant {
            feature: "dlp5500",
            name: "flankscope-nucleo-h743zi-dlp5500",
            flashed: true,
        }),
        traps: true,
    },
    Board {
        folder: EMULATED_STM32,
        built_in: "stm32-board",
        also: None,
        traps: true,
    },
];

/// An image that was built.
struct BuiltImage {
    name: &'static str,
    path: PathBuf,
    flashed: bool,
}

struct Toolchain {
    cargo: PathBuf,
    rustc: PathBuf,
    /// Named where the toolchain brings none.
    linker: Option<&'static str>,
    /// How it becomes newer.
    update: &'static str,
}

/// Builds every image and fails if one breaks a budget. Boards are built side by side: an image is linked by one thread.
pub fn build(root: &Path) -> Result<(), String> {
    let toolchain = &toolchain()?;
    let built: Vec<Result<Vec<BuiltImage>, String>> = std::thread::scope(|scope| {
        let builds = BOARDS.each_ref();
        let builds = builds.map(|board| scope.spawn(|| board.build(root, toolchain)));
        let ended = builds.map(|build| build.join().unwrap_or_else(|panic| resume_unwind(panic)));
        ended.into()
    });
    let mut broken = Vec::new();
    for images in built {
        for BuiltImage {
            name,
            path,
            flashed,
        } in images?
        {
            broken.extend(judge(name, &path, flashed)?);
        }
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
    if on_path("qemu-system-arm").is_none() {
        return Err("qemu-system-arm is missing; get it: apt-get install qemu-system-arm".into());
    }
    let program = crate::test_programs()?.join("flankscope");
    let inspect = |arguments: &[&str]| inspect(root, Command::new(&program), arguments);
    let sim = inspect(&["--link", "sim", "--speed", "max"])?;
    let emulated = inspect(&["--link", "qemu"])?;
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

/// What a check by that program says, as JSON; fails unless it said go.
pub fn inspect(root: &Path, mut command: Command, arguments: &[&str]) -> Result<Value, String> {
    command
        .args(["inspect", "--quiet", "--json", "-"])
        .args(arguments)
        .current_dir(root);
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

/// What can build here: any toolchain with the source of `core`, rustup's before Debian's.
fn toolchain() -> Result<Toolchain, String> {
    let rustup = Toolchain {
        cargo: std::env::var_os("CARGO").map_or_else(|| "cargo".into(), PathBuf::from),
        rustc: "rustc".into(),
        linker: None,
        update: "rustup update",
    };
    let debian = Toolchain {
        cargo: "/usr/bin/cargo".into(),
        rustc: "/usr/bin/rustc".into(),
        linker: Some("ld.lld"),
        update: "apt-get update && apt-get install rustc-web cargo-web rust-web-src",
    };
    let mut wrong = Vec::new();
    for toolchain in [rustup, debian] {
        match toolchain.check() {
            Ok(()) => return Ok(toolchain),
            Err(why) => wrong.push(format!("{}: {why}", toolchain.rustc.display())),
        }
    }
    Err(format!(
        "nothing here builds for {TARGET}. Either: rustup component add rust-src\n       \
         or, on Debian: apt-get update && apt-get install {PACKAGES}\n       ({})",
        wrong.join("; ")
    ))
}

impl Board {
    /// Builds its images, its other one first.
    fn build(&self, root: &Path, toolchain: &Toolchain) -> Result<Vec<BuiltImage>, String> {
        let mut built = Vec::new();
        if let Some(Variant {
            feature,
            name,
            flashed,
        }) = self.also
        {
            let path = compile(root, self, toolchain, &["--features", feature])?;
            let kept = path.with_file_name(name);
            std::fs::copy(&path, &kept).map_err(|error| format!("{}: {error}", kept.display()))?;
            built.push(BuiltImage {
                name,
                path: kept,
                flashed,
            });
        }
        built.push(BuiltImage {
            name: self.folder,
            path: compile(root, self, toolchain, &[])?,
            flashed: true,
        });
        Ok(built)
    }
}

impl Toolchain {
    /// Whether it can build the images: new enough, with the source of `core` and a linker.
    fn check(&self) -> Result<(), String> {
        let version = self.asked("--version")?;
        new_enough(&version, self.update)?;
        let sysroot = self.asked("--print=sysroot")?;
        let core = Path::new(&sysroot).join("lib/rustlib/src/rust/library/core/Cargo.toml");
        if !core.exists() {
            return Err("the source of core is not installed".into());
        }
        match self.linker {
            Some(linker) if on_path(linker).is_none() => Err(format!("{linker} is missing")),
            _ => Ok(()),
        }
    }

    fn asked(&self, question: &str) -> Result<String, String> {
        let output = Command::new(&self.rustc).arg(question).output();
        let output = output.map_err(|error| error.to_string())?;
        Ok(String::from_utf8_lossy(&output.stdout).trim().to_string())
    }
}

/// Refuses a compiler older than the images need, by what it says of itself.
fn new_enough(said: &str, update: &str) -> Result<(), String> {
    let number = said.split_whitespace().nth(1);
    let minor = number.and_then(|number| number.strip_prefix("1.")?.split('.').next());
    let minor: Option<u32> = minor.and_then(|minor| minor.parse().ok());
    match minor {
        None => Err(format!("says {said:?} for its version")),
        Some(minor) if minor < LEAST_MINOR => Err(format!(
            "is 1.{minor}, 1.{LEAST_MINOR} or newer is needed: {update}"
        )),
        Some(_) => Ok(()),
    }
}

fn image_path(root: &Path, board: &Board) -> PathBuf {
    let target = root.join("firmware").join(board.built_in).join("target");
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
    let mut cargo = Command::new(&toolchain.cargo);
    cargo.args(["build", "--release", "--locked", "--target", TARGET]);
    cargo.args(["-Z", "build-std=core"]);
    cargo.args(features);
    cargo.current_dir(root.join("firmware").join(board.folder));
    // The image's own folder says where and how, not what this build was called with.
    for name in [
        "CARGO_TARGET_DIR",
        "CARGO_BUILD_TARGET_DIR",
        "RUSTFLAGS",
        "CARGO_ENCODED_RUSTFLAGS",
        "RUSTC_WRAPPER",
        "RUSTC_WORKSPACE_WRAPPER",
        "RUSTC",
        "RUSTDOC",
    ] {
        cargo.env_remove(name);
    }
    // build-std is unstable; a compiler of a fixed version allows it when told to.
    cargo.env("RUSTC_BOOTSTRAP", "1");
    if let Some(linker) = toolchain.linker {
        for name in ["RUSTUP_TOOLCHAIN", "CARGO"] {
            cargo.env_remove(name);
        }
        cargo.env("RUSTC", &toolchain.rustc);
        cargo.env("RUSTDOC", toolchain.rustc.with_file_name("rustdoc"));
        cargo.env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", linker);
    }
    if board.traps {
        cargo.env(
            "CARGO_TARGET_THUMBV7EM_NONE_EABIHF_RUSTFLAGS",
            "-Zunstable-options -Cpanic=immediate-abort",
        );
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

/// Prints an image's figures and returns what is wrong with it. One that goes onto boards must not panic.
fn judge(name: &str, path: &Path, flashed: bool) -> Result<Vec<String>, String> {
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
    for (what, bytes, budget) in [
        ("flash", flash, FLASH_BUDGET),
        ("static RAM", ram, STATIC_RAM_BUDGET),
    ] {
        if bytes > budget {
            println!(
                "  warning: {what} is {} bytes over its budget",
                bytes - budget
            );
        }
    }
    let panicking = panicking(&image);
    if flashed && !panicking.is_empty() {
        return Ok(vec![format!(
            "{name}: panicking paths: {}",
            panicking.join(", ")
        )]);
    }
    if panicking.is_empty() {
        println!("  no panicking path, no formatting machinery");
    }
    Ok(Vec::new())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_compiler_that_is_too_old_is_told_how_to_become_newer() {
        let of = |said: &str| new_enough(said, "apt-get update");
        assert_eq!(of("rustc 1.96.0 (ac68faa20 2026-05-25)"), Ok(()));
        let old = of("rustc 1.85.1 (Debian)").unwrap_err();
        for word in ["1.85", "1.95", "apt-get update"] {
            assert!(old.contains(word), "{old}");
        }
        assert!(of("error: no default toolchain").is_err());
    }
}
