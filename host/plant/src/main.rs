//! `flankscope-plant`: what a plant sees of a station. It reads the station's history and serves a page, metrics and a fieldbus
//! word, and sends its checks to a broker; all that it asks of the instrument is a check at the next opening. Checks go on whether
//! this process runs, hangs or dies.
//!
//! | file | holds |
//! |---|---|
//! | `settings` | `plant.toml` |
//! | `access` | who may see the page: names and hashes of their tokens |
//! | `acknowledge` | clearing a no-go, with name and reason |
//! | `start_check` | starting a check before it is due |
//! | `history` | the history's file, kept open |
//! | `demo_line` | a simulated line to show |
//! | `follow` | follows it from a thread of its own |
//! | `statement` | what every outlet may say: the one type for it, with the age and origin of each verdict |
//! | `export` | files of a period for metrologists |
//! | `percent` | percent encoding |
//! | `live` | what a watch does now, from its socket |
//! | `listener` | connections of the page: how long their requests may take |
//! | `places` | how many connections a listener has, and which one is closed for a new one |
//! | `encryption` | TLS of the page, behind a feature |
//! | `page` | routes of the page |
//! | `metrics` | Prometheus' text |
//! | `modbus` | registers for a line controller |
//! | `mqtt` | messages to a broker, behind a feature |
//! | `opcua` | an OPC UA server, behind a feature |

mod access;
mod acknowledge;
mod demo_line;
mod encryption;
mod export;
mod follow;
#[cfg(test)]
mod freshness_model;
mod history;
mod listener;
mod live;
mod metrics;
mod modbus;
#[cfg(feature = "mqtt")]
mod mqtt;
#[cfg(feature = "opcua")]
mod opcua;
mod page;
mod percent;
mod places;
mod settings;
mod start_check;
mod statement;

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::Context;
use clap::{Parser, Subcommand};
use flankscope_record::seal::Seals;
use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use access::{Role, Users, UsersFile};
use demo_line::DemoLine;
use encryption::Encryption;
use page::Names;
use settings::Settings;

/// Show a plant what a station says: a page, metrics and Modbus registers, from the station's history.
///
/// Nothing listens, and nothing is sent, unless the settings file names an address for it. The page is for people with a token.
#[derive(Parser)]
#[command(version)]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Serve what this settings file asks for, until it is interrupted
    Serve {
        /// Settings: history, addresses, users
        #[arg(value_name = "PLANT.toml")]
        settings: PathBuf,
    },
    /// Show a simulated line: a press whose die wears, a watch over it, and the page; ends with Ctrl-C and leaves nothing
    DemoLine,
    /// Become a program that is interrupted when the process that started this one ends
    #[command(name = demo_line::UNTIL_PARENT_ENDS, hide = true)]
    UntilParentEnds {
        /// Id of the process that started this one
        parent: i32,
        /// Program and its arguments
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, required = true)]
        program: Vec<OsString>,
    },
    /// Write the checks of a period as files for metrologists' programs
    ///
    /// A history that was changed by others than the instrument is refused. A file that is there already is replaced by the same
    /// bytes. Lengths are millimetres in QIF and DFQ, micrometres in tables; times are UTC.
    #[command(
        after_help = "Example: flankscope-plant export press.db files --as qif,dfq,csv --since 2026-11-01 --until 2026-11-30"
    )]
    Export(export::Args),
    /// Write an example of the settings file to standard output
    Example,
    /// Give a person or a program a token for the page; it is printed once, the file keeps its hash
    Token {
        /// Name of the person or program
        name: String,
        /// What it is good for
        #[arg(long, value_enum, default_value_t = Role::View)]
        role: Role,
        /// File of users; created if missing
        #[arg(long, value_name = "USERS.toml")]
        users: PathBuf,
    },
}

fn main() -> ExitCode {
    // The OPC UA library tells of every connection.
    let levels = Targets::new()
        .with_default(LevelFilter::INFO)
        .with_target("opcua_", LevelFilter::WARN);
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_target(false)
        .finish()
        .with(levels)
        .init();
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            // As the instrument's commands: could not run.
            ExitCode::from(3)
        }
    }
}

fn run(args: &Args) -> anyhow::Result<()> {
    match &args.command {
        Command::Serve { settings } => serve(&Settings::load(settings)?),
        Command::DemoLine => {
            let (line, settings, token) = DemoLine::start()?;
            println!("token    {token}");
            println!("folder   {}", line.folder().display());
            serve(&settings)
        }
        Command::UntilParentEnds { parent, program } => {
            match demo_line::until_parent_ends(*parent, program)? {}
        }
        Command::Export(args) => {
            let seals = Seals::default_folder().and_then(|folder| Seals::open(&folder))?;
            export::run(args, &seals)
        }
        Command::Example => {
            print!("{}", settings::EXAMPLE);
            Ok(())
        }
        Command::Token { name, role, users } => {
            println!("{}", Users::add(users, name, *role)?);
            Ok(())
        }
    }
}

fn serve(settings: &Settings) -> anyhow::Result<()> {
    let seals = Seals::default_folder().and_then(|folder| Seals::open(&folder))?;
    let standing = follow::follow(settings, seals.clone())?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?;
    runtime.block_on(async {
        let mut terminate = signal(SignalKind::terminate())?;
        let mut tasks = tokio::task::JoinSet::new();
        if let Some(page) = &settings.page {
            let users = UsersFile::open(&page.users)?;
            let encryption = Encryption::for_page(page)?;
            let listener = TcpListener::bind(page.listen)
                .await
                .with_context(|| format!("[page] listen = \"{}\"", page.listen))?;
            let address = listener.local_addr()?;
            let scheme = encryption.scheme();
            let names = Names::new(address, page.name.as_deref(), encryption.is_on());
            let live = live::follow(&settings.history)?;
            let site = page::Site::new(
                settings,
                names,
                users,
                seals.clone(),
                (standing.clone(), live),
            );
            println!("page     {scheme}://{address}/");
            let routes = page::routes(Arc::new(site));
            tasks.spawn(listener::serve(listener, encryption, routes));
        }
        if let Some(modbus) = &settings.modbus {
            let listener = TcpListener::bind(modbus.listen)
                .await
                .with_context(|| format!("[modbus] listen = \"{}\"", modbus.listen))?;
            println!("modbus   {}", listener.local_addr()?);
            tasks.spawn(modbus::serve(listener, standing.clone()));
        }
        #[cfg(feature = "mqtt")]
        if let Some(mqtt) = &settings.mqtt {
            let sender = mqtt::Sender::new(settings, mqtt, seals.clone(), standing.clone())?;
            println!("mqtt     {}", mqtt.broker);
            tasks.spawn(sender.run());
        }
        #[cfg(feature = "opcua")]
        if let Some(opcua) = &settings.opcua {
            let server = opcua::OpcuaServer::new(settings, opcua, seals, standing)?;
            let listener = TcpListener::bind(opcua.listen)
                .await
                .with_context(|| format!("[opcua] listen = \"{}\"", opcua.listen))?;
            println!("opcua    opc.tcp://{}/", listener.local_addr()?);
            tasks.spawn(server.run(listener));
        }
        tokio::select! {
            ended = tasks.join_next() => match ended {
                Some(ended) => ended?,
                None => Ok(()),
            },
            stopped = tokio::signal::ctrl_c() => Ok(stopped?),
            _ = terminate.recv() => Ok(()),
        }
    })
}
