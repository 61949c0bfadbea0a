//! `flankscope watch`: check every N press cycles, as a service.

use std::collections::BTreeMap;
use std::io::BufRead;
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use flankscope_foundation::date;
use flankscope_foundation::display::plain;
use flankscope_jobs::watch::{Checked, WatchEvent, WatchSettings};
use flankscope_metrology::verdict::{Shown, Word};
use flankscope_record::document::{Inspection, live_socket};
use flankscope_record::sink::LinesFile;
use flankscope_report::{Pages, ReportFolder, figure};
use serde_json::{Value, json};

use crate::bench_link::{DieArgs, WearRateArgs, setup_with_press};
use crate::help;
use crate::inspect::SIMULATED;
use crate::instrument::{Instrument, Source};
use crate::interrupt::{self, DeferredExit};
use crate::live::LiveWatch;
use crate::output::{Common, Complaints, Outcome, say, try_report};
use crate::terminal::Terminal;

/// Check every N press cycles: hold the press, check, release it, show the verdict.
///
/// A no-go stands until it is acknowledged by a line on standard input, for example your name; with a history, also after this
/// program was stopped and started again. Every verdict is sent to the press, which assumes no-go when this program stops.
#[derive(clap::Args)]
#[command(
    after_help = format!(
        "{}\n\n\
        Exit code: that of the last verdict shown: 0 go, 1 no-go, 2 indeterminate or none, 3 could not run, 4 warn",
        help::WATCH_EXAMPLE
    )
)]
pub struct Args {
    #[command(flatten)]
    source: Source,
    /// Press cycles between checks
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// End after this many press cycles [default: never]
    #[arg(long)]
    cycles: Option<u32>,
    /// Write the last check's report.html, a page per check (reports/), an index, and a line per check (checks.jsonl) into this
    /// folder
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    die: DieArgs,
    #[command(flatten)]
    press: WearRateArgs,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    interrupt::on_signals()?;
    let _summary_is_written = DeferredExit::until_dropped();
    let site = args.source.site()?.with_own_stages("a watch")?;
    let bench = setup_with_press(&args.die, &args.press)?;
    // Before anything moves: a watch whose results cannot be written should not begin.
    args.common.try_json()?;
    let mut papers = Papers::default();
    if let Some(folder) = args
        .report
        .as_ref()
        .or(site.settings.report.folder.as_ref())
    {
        papers = Papers::open(folder)?;
    }
    let setting = &site.setting;
    let quiet = args.common.quiet;
    let (mut instrument, mut writer) =
        Instrument::open(&args.source, &site, &bench, Some(args.every), quiet)?;
    let settings = WatchSettings {
        every: args.every,
        cycles: args.cycles,
        hold_limit: Duration::from_secs_f64(site.settings.press.hold_limit_s),
    };
    let acknowledged = acknowledgements();
    let mut log = Log::new(args, papers);
    let mut live = args.source.store(&site)?.and_then(|history| {
        let opened = LiveWatch::open(history, setting, &instrument.job, &settings);
        opened
            .inspect_err(|error| {
                log.say(&format!(
                    "nobody can look on ({}): {error}",
                    live_socket(history).display()
                ));
            })
            .ok()
    });
    if setting.link.is_simulated() {
        log.say(SIMULATED);
    }
    let shown = instrument.job.watch(
        &instrument.port,
        instrument.settings.clone(),
        &settings,
        writer.as_mut(),
        &acknowledged,
        |told| {
            if let Some(live) = &mut live {
                live.take(&told);
            }
            log.take(told)
        },
    )?;
    drop(live);
    if interrupt::is_requested() {
        say(&format!(
            "interrupted after {} checks; verdicts are no longer sent, which the press treats as no-go",
            log.checks_made()
        ));
    }
    log.say(&log.summary(shown));
    let mut complaints = Complaints::default();
    let truth = complaints.hear(instrument.close(quiet)).flatten();
    complaints.hear(args.common.write_json(&json!({
        "link": setting.link.to_string(),
        "simulated": setting.link.is_simulated(),
        "station": setting.station,
        "operator": setting.operator,
        "date": date::now(),
        "shown": shown.word(),
        "checks": log.checks,
        "truth": truth,
    })));
    // A cycle that was not checked is indeterminate.
    let sentence = format!("{}: this is what the press was shown last", shown.word());
    Ok(complaints.end(shown.verdict(), &sentence, quiet))
}

/// Files that are written for every check.
#[derive(Default)]
struct Papers {
    lines: Option<LinesFile>,
    page: Option<Pages>,
}

impl Papers {
    /// Before anything moves: a watch whose results cannot be written should not begin.
    fn open(folder: &Path) -> anyhow::Result<Self> {
        try_report(folder, ReportFolder::OF_WATCH)?;
        Ok(Self {
            lines: Some(LinesFile::open(&folder.join("checks.jsonl"))?),
            page: Some(Pages(ReportFolder::new(folder))),
        })
    }
}

/// A message for every line on standard input: a name, or empty.
fn acknowledgements() -> mpsc::Receiver<String> {
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            if sender.send(plain(line.trim()).into_owned()).is_err() {
                return;
            }
        }
    });
    receiver
}

/// Output of the watch's checks.
struct Log<'a> {
    args: &'a Args,
    start: Instant,
    /// Number of checks by verdict.
    verdicts: BTreeMap<Word, u64>,
    /// Openings at which a due check was not made, by the press's reason.
    missed: BTreeMap<String, u64>,
    /// Press cycles seen.
    cycles: u64,
    /// All of them for `--json`, whose document ends with the watch; empty without it, because a watch may last for months.
    checks: Vec<Value>,
    papers: Papers,
}

impl<'a> Log<'a> {
    fn new(args: &'a Args, papers: Papers) -> Self {
        Self {
            args,
            start: Instant::now(),
            verdicts: BTreeMap::new(),
            missed: BTreeMap::new(),
            cycles: 0,
            checks: Vec::new(),
            papers,
        }
    }

    /// Handles one event; false stops the watch.
    fn take(&mut self, told: WatchEvent) -> bool {
        match told {
            WatchEvent::Cycle(_) => self.cycles += 1,
            WatchEvent::Checking(cycle) => {
                self.say(&format!("cycle {cycle}: press held, checking"))
            }
            WatchEvent::Step(_) | WatchEvent::Repeated(_) => {}
            WatchEvent::Expired(shown) => self.say(&format!(
                "no check for twice the interval: the press is shown {}",
                shown.word()
            )),
            WatchEvent::Missed(cycle, fault) => {
                *self.missed.entry(fault.to_string()).or_default() += 1;
                self.say(&format!(
                    "cycle {cycle}: no check, the press did not admit the head ({fault}); next try at the next opening"
                ));
            }
            WatchEvent::Resumed(shown) => self.say(&format!(
                "{} of an earlier check stays until it is acknowledged (press Enter)",
                shown.word()
            )),
            WatchEvent::NotAcknowledged(error) => self.say(&format!("NOT acknowledged: {error}")),
            WatchEvent::Requested(who) => {
                self.say(&format!(
                    "{who} wants a check: it is made at the next opening"
                ));
            }
            WatchEvent::Acknowledged => self.say("acknowledged: the next check decides anew"),
            WatchEvent::Checked(mut checked) => self.keep(&mut checked),
        }
        true
    }

    fn keep(&mut self, checked: &mut Checked) {
        let Checked {
            cycle,
            inspection,
            shown,
            needs_maintenance,
        } = checked;
        let worst = inspection.features.iter().max_by(|a, b| {
            a.wear_um
                .unwrap_or(f64::NEG_INFINITY)
                .total_cmp(&b.wear_um.unwrap_or(f64::NEG_INFINITY))
        });
        let worst = worst.map_or_else(String::new, |f| {
            format!(", most worn: {} {} um", f.id, figure(f.wear_um))
        });
        let held_s = inspection.timing_ms.total / 1000.0;
        let on = Terminal::of_stderr();
        let verdict = inspection.verdict;
        let word = on.in_colour(verdict, &verdict.as_str().to_uppercase());
        let rest = format!(
            "(shown: {}){worst}, press held {held_s:.2} s: {}",
            shown.word(),
            inspection.reason
        );
        self.say(&format!("cycle {cycle}: {word} {}", on.text(&rest)));
        if *needs_maintenance {
            self.say(
                "MAINTENANCE: several checks in a row gave no result; is the head soiled or moved?",
            );
        }
        if *shown == Shown::NoGo && inspection.verdict == Word::NoGo {
            self.say("ALARM: no-go stays until it is acknowledged (press Enter)");
        }
        // The watch continues even if reports cannot be written.
        let mut complaints = Complaints::default();
        complaints.hear_of(self.papers.lines.as_mut(), checked);
        complaints.hear_of(self.papers.page.as_mut(), &mut checked.inspection);
        *self.verdicts.entry(checked.inspection.verdict).or_default() += 1;
        if self.args.common.json.is_some() {
            let document = serde_json::to_value(&*checked).map_err(Into::into);
            self.checks.extend(complaints.hear(document));
        }
        let Inspection { verdict, .. } = checked.inspection;
        let quiet = self.args.common.quiet;
        let _ = complaints.end(verdict, &checked.inspection.sentence(), quiet);
    }

    fn checks_made(&self) -> u64 {
        self.verdicts.values().sum()
    }

    /// What the watch did, and which exit code follows.
    fn summary(&self, shown: Shown) -> String {
        let checks = self.checks_made();
        let of_verdicts = self.verdicts.iter();
        let of_verdicts: Vec<String> = of_verdicts.map(|(word, n)| format!("{n} {word}")).collect();
        let made = match checks {
            0 => "nothing was checked".to_owned(),
            _ => format!("{checks} checks made: {}", of_verdicts.join(", ")),
        };
        let reasons = self.missed.iter();
        let reasons: Vec<String> = reasons.map(|(why, n)| format!("{why}: {n}")).collect();
        let missed = match (self.missed.values().sum::<u64>(), checks) {
            (0, 0) => ", because no opening came at which a check was due".to_owned(),
            (0, _) => String::new(),
            (openings, _) => format!(
                ", {openings} openings missed because the press did not admit the head ({})",
                reasons.join(", ")
            ),
        };
        format!(
            "end of the watch after {} press cycles: {made}{missed}; the verdict that stands is {}, exit code {}",
            self.cycles,
            shown.word(),
            shown.verdict().exit_code()
        )
    }

    fn say(&self, text: &str) {
        if !self.args.common.quiet {
            say(&format!(
                "{:7.1} s  {text}",
                self.start.elapsed().as_secs_f64()
            ));
        }
    }
}
