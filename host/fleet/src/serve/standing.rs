//! What the lake said last: the presses as soon as a file is new, lines and ring comparison at their own pace.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use jiff::Timestamp;
use serde::de::DeserializeOwned;
use tokio::runtime::Handle;
use tokio::sync::watch;
use tokio::time::sleep;

use super::answers::{Die, LastCheck, Unlike};
use crate::lake::Lake;
use crate::query::{QueryError, ScalarValue, Snapshot};

/// How often the lake is listed.
const LOOK: Duration = Duration::from_secs(5);
/// Questions over all rows rest at least so long, and at least so many times as long as they took.
const REST: Duration = Duration::from_secs(60);
const REST_RATIO: u32 = 4;

/// The presses as the lake told them last.
#[derive(Debug, Default)]
pub struct Standing {
    /// The files that were asked.
    pub snapshot: Option<Arc<Snapshot>>,
    /// When the lake last answered.
    pub answered_at: Option<Timestamp>,
    /// Why it did not answer since.
    pub fault: Option<String>,
    pub presses: Arc<Vec<LastCheck>>,
}

/// Answers over all rows.
#[derive(Debug)]
pub struct Lines {
    pub asked_at: Timestamp,
    pub dies: Result<Vec<Die>, String>,
    pub unlike: Result<Vec<Unlike>, String>,
}

/// Asks on the engine's threads, so that connections are not held up.
pub async fn asked<T: DeserializeOwned + Send + 'static>(
    engine: &Handle,
    snapshot: Arc<Snapshot>,
    question: impl Into<String>,
    values: Vec<ScalarValue>,
) -> Result<Vec<T>, String> {
    let question = question.into();
    let asking = engine.spawn(async move { snapshot.ask(&question, values).await?.rows() });
    let answer = asking.await.map_err(|error| error.to_string())?;
    answer.map_err(|error: QueryError| error.to_string())
}

/// Follows the lake until nobody listens.
pub async fn follow(lake: Lake, engine: Handle, told: watch::Sender<Arc<Standing>>) {
    while !told.is_closed() {
        let last = Arc::clone(&told.borrow());
        let now = match look(&lake, &engine, &last).await {
            Ok((snapshot, presses)) => Standing {
                snapshot: Some(snapshot),
                answered_at: Some(Timestamp::now()),
                fault: None,
                presses,
            },
            Err(fault) => Standing {
                snapshot: last.snapshot.clone(),
                answered_at: last.answered_at,
                presses: Arc::clone(&last.presses),
                fault: Some(fault),
            },
        };
        told.send_replace(Arc::new(now));
        sleep(LOOK).await;
    }
}

async fn look(
    lake: &Lake,
    engine: &Handle,
    last: &Standing,
) -> Result<(Arc<Snapshot>, Arc<Vec<LastCheck>>), String> {
    let lake = lake.clone();
    let listed = engine.spawn(async move { Snapshot::of(&lake).await });
    let listed = listed.await.map_err(|error| error.to_string())?;
    let snapshot = listed.map_err(|error| error.to_string())?;
    if let Some(known) = &last.snapshot
        && last.fault.is_none()
        && known.names().eq(snapshot.names())
    {
        return Ok((Arc::clone(known), Arc::clone(&last.presses)));
    }
    let snapshot = Arc::new(snapshot);
    let mut presses: Vec<LastCheck> =
        asked(engine, Arc::clone(&snapshot), "presses", Vec::new()).await?;
    // A folder whose disk is not mounted is empty, too: a press that was there once does not vanish without a word.
    let present: BTreeSet<&String> = presses.iter().map(|press| &press.station).collect();
    let gone = last.presses.iter();
    let gone = gone.filter(|known| !present.contains(&known.station));
    let gone = gone.map(|known| LastCheck {
        is_gone: true,
        ..known.clone()
    });
    let gone: Vec<LastCheck> = gone.collect();
    presses.extend(gone);
    Ok((snapshot, Arc::new(presses)))
}

/// Asks for lines and ring comparison whenever files are new, at its own pace, until nobody listens.
pub async fn follow_lines(
    mut standing: watch::Receiver<Arc<Standing>>,
    engine: Handle,
    told: watch::Sender<Option<Arc<Lines>>>,
) {
    let mut known: Option<Arc<Snapshot>> = None;
    while standing.changed().await.is_ok() {
        let snapshot = standing.borrow_and_update().snapshot.clone();
        let Some(snapshot) = snapshot else { continue };
        if known.as_ref().is_some_and(|k| Arc::ptr_eq(k, &snapshot)) {
            continue;
        }
        let begun = Instant::now();
        let files = || Arc::clone(&snapshot);
        let dies = asked(&engine, files(), "dies-by-strokes-left", Vec::new()).await;
        let unlike = asked(&engine, files(), "stations-unlike-the-others", Vec::new()).await;
        told.send_replace(Some(Arc::new(Lines {
            asked_at: Timestamp::now(),
            dies,
            unlike,
        })));
        known = Some(snapshot);
        sleep(REST.max(REST_RATIO * begun.elapsed())).await;
    }
}
