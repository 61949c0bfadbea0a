//! Follows the history from a thread of its own: looks every second whether something was committed, and publishes what stands.

use std::sync::Arc;
use std::thread;
use std::time::Duration;

use flankscope_record::history::{History, HistoryError};
use flankscope_record::seal::Seals;
use tokio::sync::watch;

use crate::history::HistoryFile;
use crate::settings::Settings;
use crate::standing::{Standing, ToolStanding};

/// How often it looks.
const EVERY: Duration = Duration::from_secs(1);

/// Begins to follow the history. One that cannot be read is a fault that is shown, and it is tried again.
///
/// # Errors
/// No thread can be started.
pub fn follow(
    settings: &Settings,
    seals: Seals,
) -> std::io::Result<watch::Receiver<Arc<Standing>>> {
    let stale_after_s = settings.stale_after_s;
    let mut file = HistoryFile::new(&settings.history, seals);
    let (publish, standing) = watch::channel(Arc::new(Standing {
        fault: Some("the history has not been read yet".into()),
        stale_after_s,
        ..Standing::default()
    }));
    thread::Builder::new()
        .name("follow".into())
        .spawn(move || {
            while !publish.is_closed() {
                let seen = look(&mut file).unwrap_or_else(|error| {
                    file.close();
                    Some(Standing {
                        fault: Some(error.to_string().into()),
                        ..Standing::default()
                    })
                });
                if let Some(mut seen) = seen {
                    seen.stale_after_s = stale_after_s;
                    publish.send_if_modified(|before| {
                        let is_new = seen.fault.is_none() || seen.fault != before.fault;
                        if is_new {
                            if let Some(fault) = &seen.fault {
                                tracing::warn!("{fault}");
                            }
                            *before = Arc::new(seen);
                        }
                        is_new
                    });
                }
                thread::sleep(EVERY);
            }
        })?;
    Ok(standing)
}

/// What stands, if it may have changed since the last look.
fn look(file: &mut HistoryFile) -> Result<Option<Standing>, HistoryError> {
    let (history, is_changed) = file.verified()?;
    is_changed.then(|| standing(history)).transpose()
}

fn standing(history: &History) -> Result<Standing, HistoryError> {
    // The newest first.
    let no_gos = history.standing_no_gos()?;
    let mut tools = Vec::new();
    for tool in history.tools()? {
        let counts = history.verdict_counts(&tool)?;
        if let Some(last) = history.listed(Some(&tool), None, None, 1)?.pop() {
            tools.push(ToolStanding {
                latched: no_gos.iter().find(|no_go| no_go.die.tool == tool).cloned(),
                last: Arc::new(last),
                counts,
            });
        }
    }
    Ok(Standing {
        tools,
        ..Standing::default()
    })
}
