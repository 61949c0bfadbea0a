//! The `flankscope` command: parses arguments and returns the exit code, nothing else.
//!
//! Exit codes: 0 go or done · 1 no-go · 2 indeterminate · 3 could not run · 4 warn · 130 interrupted.

mod article;
mod article_settings;
#[cfg(feature = "bench")]
mod bench_link;
#[cfg(not(feature = "bench"))]
#[path = "no_bench.rs"]
mod bench_link;
mod calibrate;
mod calibrate_autofocus;
mod calibrate_board;
mod calibrate_drawing;
mod calibrate_focus;
mod camera_process;
mod clean;
mod compare;
mod decode;
mod deviation;
mod doctor;
mod gear;
mod geometry;
mod grid;
mod help;
mod history;
mod init;
mod init_patches;
mod inspect;
mod instrument;
mod interrupt;
mod live;
mod manual;
mod merge;
mod output;
mod patterns;
mod progress;
mod register;
mod replay;
mod sample;
mod scan;
mod scene;
mod site;
mod terminal;
mod trust;
mod view;
mod watch;
mod wear;

use std::process::ExitCode;

use clap::{Arg, ArgAction, CommandFactory, FromArgMatches, Parser, Subcommand};
use output::Outcome;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// A 3D measuring endoscope that tells, between two strokes, whether the die's gear teeth are still good.
#[derive(Parser)]
#[command(name = "flankscope", version = env!("FLANKSCOPE_VERSION"))]
#[command(after_help = format!(
    "{}\n\n{COMMON_OPTIONS}\n\nExit code: 0 go or done, 1 no-go, 2 indeterminate, 3 could not run, 4 warn, 130 interrupted",
    help::START
))]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Init(init::Args),
    Inspect(inspect::Args),
    Watch(watch::Args),
    View(view::Args),
    Scan(Box<scan::Args>),
    Article(Box<article::Args>),
    Calibrate(calibrate::Args),
    Decode(decode::Args),
    Sample(sample::Args),
    Register(register::Args),
    Deviation(deviation::Args),
    Merge(merge::Args),
    Clean(clean::Args),
    Wear(wear::Args),
    Gear(gear::Args),
    History(history::Args),
    Replay(replay::Args),
    Compare(compare::Args),
    Trust(trust::Args),
    Doctor(doctor::Args),
    Patterns(patterns::Args),
    Manual(manual::Args),
    /// Simulated bench: write its settings file or the demo's files, run its process
    #[cfg(feature = "bench")]
    #[command(subcommand)]
    Bench(bench_link::Command),
}

/// Options common to all commands: one line in each command's help, described by `flankscope --help`.
const COMMON_OPTIONS: &str = "Every command takes --json FILE, the result as JSON (- for standard output), --quiet or -q, no progress and no \
    table, and --help.";

/// The commands with their options. The common options are hidden in help; man pages and completions list them.
fn commands() -> clap::Command {
    let help = Arg::new("help").short('h').long("help");
    let help = help.help("Print help").action(ArgAction::Help).hide(true);
    Cli::command().mut_subcommands(|command| {
        if !command.get_arguments().any(|arg| arg.get_id() == "json") {
            return command;
        }
        let after = command.get_after_help().cloned().unwrap_or_default();
        command
            .mut_args(|arg| match arg.get_id().as_str() {
                "json" | "quiet" => arg.hide(true),
                _ => arg,
            })
            .disable_help_flag(true)
            .arg(help.clone())
            .after_help(format!("{after}\n\n{COMMON_OPTIONS}"))
    })
}

fn main() -> ExitCode {
    let given = commands().try_get_matches();
    let cli = match given.and_then(|given| Cli::from_arg_matches(&given)) {
        Ok(cli) => cli,
        Err(error) => {
            // clap exits with 2 on a usage error, which here means "indeterminate"; bad arguments are "could not run" (3).
            let _ = error.print();
            return if error.use_stderr() {
                Outcome::CouldNotRun.into()
            } else {
                ExitCode::SUCCESS
            };
        }
    };
    // Warnings by default: what the host worked around. FLANKSCOPE_LOG=debug shows every event.
    let wanted = std::env::var("FLANKSCOPE_LOG").ok();
    let filter: Targets = wanted
        .and_then(|wanted| wanted.parse().ok())
        .unwrap_or_else(|| Targets::new().with_default(LevelFilter::WARN));
    tracing_subscriber::fmt()
        .with_max_level(LevelFilter::TRACE)
        .with_writer(std::io::stderr)
        .without_time()
        // A full standard error must not end a check.
        .log_internal_errors(false)
        .finish()
        .with(filter)
        .init();
    let result = match cli.command {
        Command::Init(args) => init::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Watch(args) => watch::run(&args),
        Command::View(args) => view::run(&args),
        Command::Scan(args) => scan::run(&args),
        Command::Article(args) => article::run(&args),
        Command::Calibrate(args) => calibrate::run(&args),
        Command::Decode(args) => decode::run(&args),
        Command::Sample(args) => sample::run(&args),
        Command::Register(args) => register::run(&args),
        Command::Deviation(args) => deviation::run(&args),
        Command::Merge(args) => merge::run(&args),
        Command::Clean(args) => clean::run(&args),
        Command::Wear(args) => wear::run(&args),
        Command::Gear(args) => gear::run(&args),
        Command::History(args) => history::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Trust(args) => trust::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Patterns(args) => patterns::run(&args),
        Command::Manual(args) => manual::run(&args),
        #[cfg(feature = "bench")]
        Command::Bench(command) => bench_link::run(&command).map(|()| output::Outcome::Done),
    };
    match result {
        Err(error) if interrupt::is_requested() => {
            output::say(&output::in_words(&error));
            interrupt::EXIT_CODE.into()
        }
        Ok(_) if interrupt::is_requested() => interrupt::EXIT_CODE.into(),
        Ok(outcome) => outcome.into(),
        Err(error) => {
            output::say(&format!("error: {}", output::in_words(&error)));
            Outcome::CouldNotRun.into()
        }
    }
}

#[cfg(all(test, not(feature = "bench")))]
mod tests {
    use super::*;

    #[test]
    fn without_a_bench_help_offers_none() {
        let mut program = commands();
        let mut texts = vec![program.render_long_help().to_string()];
        for command in program.get_subcommands_mut() {
            texts.push(command.render_long_help().to_string());
        }
        assert!(texts.len() > 10);
        let words = ["bench", "simulat", "demo", "qemu", "sim|", "`sim`"];
        let offered: Vec<&str> = texts
            .iter()
            .flat_map(|text| text.lines())
            .filter(|line| words.iter().any(|word| line.contains(word)))
            .collect();
        assert!(offered.is_empty(), "a deployment offers {offered:#?}");
    }
}
