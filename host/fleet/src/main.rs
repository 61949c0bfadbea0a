//! `flankscope-fleet`: ships histories into a lake of Parquet files, verifies and compacts it, and asks it.

#[cfg(feature = "serve")]
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::{Args, Parser, Subcommand};
use flankscope_fleet::compact::{Compaction, compact};
use flankscope_fleet::lake::{Lake, LakeError};
#[cfg(feature = "cluster")]
use flankscope_fleet::query::Cluster;
#[cfg(feature = "query")]
use flankscope_fleet::query::{Form, ask, questions};
#[cfg(feature = "serve")]
use flankscope_fleet::serve::{Hall, Settings, serve};
use flankscope_fleet::ship::{ShipError, Shipped, Shipper};
use flankscope_fleet::verify::Verifier;
use flankscope_record::history::History;
use flankscope_record::seal::Seals;
#[cfg(feature = "serve")]
use jiff::SignedDuration;
use jiff::Timestamp;
use signal_hook::consts::{SIGINT, SIGTERM};
#[cfg(feature = "query")]
use tokio::runtime::Handle;

/// How often a followed history is looked at.
const POLL: Duration = Duration::from_secs(2);
/// How long a store that fails is left alone.
const AFTER_FAILURE: Duration = Duration::from_secs(30);
/// Exit codes: something is wrong with the lake; the command could not run.
const FOUND: u8 = 1;
const COULD_NOT_RUN: u8 = 3;

/// Every press in one place: stations ship their histories into a lake of Parquet files, which any reader of Parquet can query.
#[derive(Debug, Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Copy the checks of a history into the lake, each once, from where the lake ends.
    Ship(Ship),
    /// Look at every file of the lake: what is missing, edited, cut short, of another station or there twice.
    Verify(Verify),
    /// Join the small files of past days, and give up old days.
    Compact(Compact),
    /// List the files that count, one a line: together they have every check once.
    Files(Files),
    /// Ask the files that count a question in SQL, or one that has a name; nothing is written but the answer.
    #[cfg(feature = "query")]
    Query(Query),
    /// Show all presses in a browser: who is worn, who is silent, whose die ends first. Only reads the lake.
    #[cfg(feature = "serve")]
    Serve(Serve),
}

#[derive(Debug, Args)]
struct InLake {
    /// The lake: a folder, or s3://BUCKET/PREFIX in a build with S3.
    #[arg(long, value_name = "FOLDER-OR-URL")]
    lake: String,
}

#[derive(Debug, Args)]
struct Ship {
    /// History of the station; it is only read.
    #[arg(long, value_name = "FILE")]
    history: PathBuf,
    #[command(flatten)]
    lake: InLake,
    /// Go on with what is stored from now on, until interrupted.
    #[arg(long)]
    follow: bool,
}

#[derive(Debug, Args)]
struct Verify {
    #[command(flatten)]
    lake: InLake,
    /// Folder of a station's key; repeat it for several. Its files are then verified by their seals, and compared with what the
    /// station remembers of its histories there.
    #[arg(long = "key", value_name = "FOLDER")]
    keys: Vec<PathBuf>,
    /// Compare every row with this history, which needs its station's key (`FLANKSCOPE_STATE`).
    #[arg(long, value_name = "FILE")]
    history: Option<PathBuf>,
}

#[derive(Debug, Args)]
struct Compact {
    #[command(flatten)]
    lake: InLake,
    /// Join files of days that lie so many days back or more; 1: all but today's.
    #[arg(long, value_name = "DAYS", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    older_than: u32,
    /// Give up days that lie so many days back or more.
    #[arg(long, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..))]
    retire_older_than: Option<u32>,
    /// How long joined files stand beside what they were made of, for readers that have listed these.
    #[arg(long, value_name = "MINUTES", default_value_t = 60)]
    grace_minutes: u32,
}

#[derive(Debug, Args)]
struct Files {
    #[command(flatten)]
    lake: InLake,
}

#[cfg(feature = "query")]
#[derive(Debug, Args)]
struct Query {
    /// The lake: a folder, or s3://BUCKET/PREFIX in a build with S3.
    #[arg(long, value_name = "FOLDER-OR-URL", required_unless_present = "list")]
    lake: Option<String>,
    /// One SELECT, EXPLAIN, SHOW or DESCRIBE over the table `checks`, or the name of a question.
    #[arg(value_name = "SQL-OR-NAME", required_unless_present = "list")]
    question: Option<String>,
    /// List the questions that have a name, and what each answers.
    #[arg(long)]
    list: bool,
    /// Form of the answer, on the standard output.
    #[arg(long = "as", value_enum, default_value_t = Form::Table)]
    form: Form,
    /// Scheduler of a Ballista cluster that answers instead of this process; its executors read the lake at the same address.
    #[cfg(feature = "cluster")]
    #[arg(long, value_name = "df://HOST:PORT")]
    cluster: Option<String>,
}

#[cfg(feature = "serve")]
#[derive(Debug, Args)]
struct Serve {
    #[command(flatten)]
    lake: InLake,
    /// Address on this machine, where browsers or a proxy find the page; 0 as port: any that is free.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8090", value_parser = of_this_machine)]
    listen: SocketAddr,
    /// Map of the hall: a table (CSV) with the stations' names where their presses stand.
    #[arg(long, value_name = "FILE")]
    hall: Option<PathBuf>,
    /// How long a verdict stands; older ones are never shown as good.
    #[arg(long, value_name = "MINUTES", default_value_t = 60, value_parser = clap::value_parser!(u16).range(1..))]
    stale_after: u16,
}

/// The page has no users of its own, so nobody else's machine reaches it.
#[cfg(feature = "serve")]
fn of_this_machine(text: &str) -> Result<SocketAddr, String> {
    let address: SocketAddr = text
        .parse()
        .map_err(|_| "no address such as 127.0.0.1:8090")?;
    match address.ip().is_loopback() {
        true => Ok(address),
        false => Err("only addresses of this machine (127.0.0.1, [::1]): let a proxy that knows users pass others on".into()),
    }
}

fn main() -> ExitCode {
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_target(false)
        .init();
    let cli = Cli::parse();
    let run = || -> anyhow::Result<ExitCode> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        // Questions have threads of their own, one for every core.
        #[cfg(feature = "query")]
        let engine = tokio::runtime::Builder::new_multi_thread()
            .thread_name("engine")
            .enable_all()
            .build()?;
        runtime.block_on(async {
            match cli.command {
                Command::Ship(ship) => ship.run().await,
                Command::Verify(verify) => verify.run().await,
                #[cfg(feature = "query")]
                Command::Compact(compact) => engine.spawn(compact.run()).await?,
                #[cfg(not(feature = "query"))]
                Command::Compact(compact) => compact.run().await,
                Command::Files(files) => files.run().await,
                #[cfg(feature = "query")]
                Command::Query(query) => query.run(engine.handle().clone()).await,
                #[cfg(feature = "serve")]
                Command::Serve(serve) => serve.run(engine.handle().clone()).await,
            }
        })
    };
    match run() {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            // As the instrument's commands: could not run.
            ExitCode::from(COULD_NOT_RUN)
        }
    }
}

impl InLake {
    fn open(&self) -> Result<Lake, LakeError> {
        Lake::open(&self.lake)
    }
}

fn today() -> String {
    Timestamp::now().strftime("%Y-%m-%d").to_string()
}

/// The station's key; a history that this station has written is read with it.
fn own_key() -> anyhow::Result<Seals> {
    Ok(Seals::existing(&Seals::default_folder()?)?)
}

impl Ship {
    async fn run(&self) -> anyhow::Result<ExitCode> {
        let lake = self.lake.open()?;
        let seals = own_key()?;
        let stop = Arc::new(AtomicBool::new(false));
        if self.follow {
            for signal in [SIGINT, SIGTERM] {
                signal_hook::flag::register(signal, Arc::clone(&stop))?;
            }
        }
        while !stop.load(Ordering::Relaxed) {
            let shipped = self.ship(&lake, &seals, &stop).await;
            match shipped {
                Ok(()) if !self.follow => break,
                // A person has accepted the history as it is: it is opened anew.
                Ok(()) => {}
                Err(ShipError::Lake(error @ LakeError::Store(_))) if self.follow => {
                    tracing::warn!(%error, "nothing is shipped; tried again in {} s", AFTER_FAILURE.as_secs());
                    wait(AFTER_FAILURE, &stop);
                }
                Err(error) => return Err(error.into()),
            }
        }
        Ok(ExitCode::SUCCESS)
    }

    async fn ship(&self, lake: &Lake, seals: &Seals, stop: &AtomicBool) -> Result<(), ShipError> {
        let history = History::read(&self.history, seals)?;
        let mut shipper = Shipper::new(history, seals, lake).await?;
        loop {
            let begun = Instant::now();
            let shipped = shipper.pass(&today()).await?;
            if shipped != Shipped::default() || !self.follow {
                say(&shipped, begun.elapsed());
            }
            if !self.follow {
                return Ok(());
            }
            wait(POLL, stop);
            if stop.load(Ordering::Relaxed) || !shipper.is_same_epoch()? {
                return Ok(());
            }
        }
    }
}

fn say(shipped: &Shipped, took: Duration) {
    let Shipped {
        files,
        checks,
        bytes,
        there_already,
    } = shipped;
    let seconds = took.as_secs_f64();
    let rate = *checks as f64 / seconds.max(1e-3);
    println!(
        "shipped {checks} checks in {files} files of {bytes} bytes in {seconds:.2} s ({rate:.0} checks/s); {there_already} files were there"
    );
}

/// Sleeps, but not on when the process is to end.
fn wait(time: Duration, stop: &AtomicBool) {
    let until = Instant::now() + time;
    while !stop.load(Ordering::Relaxed) && Instant::now() < until {
        std::thread::sleep(Duration::from_millis(50));
    }
}

impl Verify {
    async fn run(&self) -> anyhow::Result<ExitCode> {
        let lake = self.lake.open()?;
        let key = |folder: &PathBuf| Seals::existing(folder);
        let keys: Vec<Seals> = self.keys.iter().map(key).collect::<Result<_, _>>()?;
        let history = self.history.as_deref().map(opened).transpose()?;
        let report = Verifier::new(&lake, &keys).run(history.as_ref()).await?;
        println!(
            "{} files that count, {} redundant; {} checks, {} flanks; {} checks sealed by a given key; {} checks given up on purpose; \
             {} links of the stations not in the lake",
            report.current,
            report.redundant,
            report.checks,
            report.flanks,
            report.sealed,
            report.retired,
            report.links_behind
        );
        for finding in &report.findings {
            println!("{finding}");
        }
        Ok(match report.findings.is_empty() {
            true => ExitCode::SUCCESS,
            false => ExitCode::from(FOUND),
        })
    }
}

fn opened(path: &Path) -> anyhow::Result<History> {
    let history = History::read(path, &own_key()?);
    history.with_context(|| format!("history {}", path.display()))
}

impl Compact {
    async fn run(self) -> anyhow::Result<ExitCode> {
        let lake = self.lake.open()?;
        let grace = Duration::from_secs(60 * u64::from(self.grace_minutes));
        let what = Compaction::of_days(
            self.older_than,
            self.retire_older_than,
            grace,
            Timestamp::now(),
        );
        let done = compact(&lake, &what).await?;
        println!(
            "joined {} files into {}; removed {} whose checks are in joined ones, {} of days given up; \
             sums of {} days made, of {} removed",
            done.joined, done.into, done.removed, done.retired, done.summed, done.sums_removed
        );
        for (name, why) in &done.left {
            println!("left alone: {name}: {why}");
        }
        Ok(match done.left.is_empty() {
            true => ExitCode::SUCCESS,
            false => ExitCode::from(FOUND),
        })
    }
}

#[cfg(feature = "serve")]
impl Serve {
    async fn run(self, engine: Handle) -> anyhow::Result<ExitCode> {
        let settings = Settings {
            lake: self.lake.open()?,
            hall: self.hall.as_deref().map(Hall::load).transpose()?,
            stale_after: SignedDuration::from_mins(self.stale_after.into()),
        };
        let listener = tokio::net::TcpListener::bind(self.listen).await;
        let listener = listener.with_context(|| format!("cannot listen on {}", self.listen))?;
        println!("http://{}", listener.local_addr()?);
        serve(listener, settings, engine).await?;
        Ok(ExitCode::SUCCESS)
    }
}

#[cfg(feature = "query")]
impl Query {
    async fn run(self, engine: Handle) -> anyhow::Result<ExitCode> {
        if let (Some(lake), Some(question)) = (self.lake, self.question) {
            let lake = Lake::open(&lake)?;
            #[cfg(feature = "cluster")]
            let cluster = self.cluster.as_deref().map(Cluster::new).transpose()?;
            let answer = engine.spawn(async move {
                #[cfg(feature = "cluster")]
                if let Some(cluster) = cluster {
                    return cluster.ask(&lake, &question).await;
                }
                ask(&lake, &question).await
            });
            let answer = answer.await??;
            answer.write(self.form, std::io::BufWriter::new(std::io::stdout()))?;
        }
        if self.list {
            for question in questions() {
                println!("{}: {}", question.name, question.sentence);
            }
        }
        Ok(ExitCode::SUCCESS)
    }
}

impl Files {
    async fn run(&self) -> anyhow::Result<ExitCode> {
        let lake = self.lake.open()?;
        let listing = lake.list(None).await?;
        let found = listing.cover();
        for name in &found.current {
            println!("{}/{name}", self.lake.lake.trim_end_matches('/'));
        }
        if let Some((one, other)) = found.doubled.first() {
            eprintln!("error: {one} and {other} have the same checks; `verify` says more");
            return Ok(ExitCode::from(FOUND));
        }
        Ok(ExitCode::SUCCESS)
    }
}
