//! Follows what stands: shows it, and says once of every check that it was stored.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use flankscope_record::history::HistoryError;
use flankscope_record::origin::OriginKind;
use flankscope_record::seal::Seals;
use opcua::nodes::Event;
use opcua::server::ServerHandle;
use opcua::types::{NodeId, StatusCode};
use tokio::sync::watch;
use tokio::time::timeout;

use super::events::CheckEvent;
use super::nodes::{Manager, Shown, show};
use super::space::{self, Node};
use super::types::Types;
use crate::history::{HistoryFile, check_id};
use crate::statement::{DieStatement, Moment, Standing, StationStatement};

/// How often it looks whether a verdict grew too old.
const EVERY: Duration = Duration::from_millis(500);
/// Checks of which it says at a time that they were stored.
const EVENTS_AT_A_TIME: usize = 50;
/// How good the server's data is, as OPC UA's redundancy counts it: all is there, or none.
const SERVICE: u8 = 255;
const NO_SERVICE: u8 = 1;

/// Number of a check, and what identifies it in all histories.
type Identified = (i64, String);

/// Shows what stands.
pub struct Publisher {
    manager: Arc<Manager>,
    handle: ServerHandle,
    history: HistoryFile,
    shown: Shown,
    /// Nodes of the tools as they were shown last.
    tools: Vec<Node>,
    /// What stood when the history was read last, with the identifiers of its tools' last checks by their numbers; none if they could not
    /// be read.
    read: Option<(Arc<Standing>, Vec<Identified>)>,
    /// Number and identifier of the last check of which an event told, or that was there before this server.
    told: Option<Identified>,
    /// Whether there may be checks of which no event told yet.
    is_behind: bool,
    service: u8,
}

impl Publisher {
    /// Shows nothing yet.
    pub fn new(
        manager: Arc<Manager>,
        handle: ServerHandle,
        (history, seals): (&PathBuf, &Seals),
    ) -> Self {
        Self {
            manager,
            handle,
            history: HistoryFile::new(history, seals.clone()),
            shown: Shown::new(),
            tools: Vec::new(),
            read: None,
            told: None,
            is_behind: true,
            service: SERVICE,
        }
    }

    /// Shows what stands until the process ends.
    pub async fn run(mut self, mut standing: watch::Receiver<Arc<Standing>>) -> anyhow::Result<()> {
        loop {
            let now = Arc::clone(&standing.borrow_and_update());
            // It reads the history's file.
            self = tokio::task::spawn_blocking(move || self.published(&now)).await??;
            // A verdict also grows too old without a change.
            if let Ok(changed) = timeout(EVERY, standing.changed()).await {
                changed?;
            }
        }
    }

    fn published(mut self, standing: &Arc<Standing>) -> Result<Self, StatusError> {
        let names = self.manager.inner().names;
        let station = standing.statement(&Moment::now());
        let mut nodes = space::own(names, &station);
        if station.fault.is_none() {
            self.read_ids(standing, &station);
            let id_of = |tool: &DieStatement| {
                let (_, ids) = self.read.as_ref()?;
                let found = ids.iter().find(|(number, _)| *number == tool.last.id);
                found.map(|(_, id)| id.clone())
            };
            self.tools = space::nodes(names, &station, &id_of);
        } else {
            self.tools = self.tools.iter().map(Node::unknown).collect();
        }
        nodes.extend(self.tools.iter().cloned());
        let subscriptions = Arc::clone(self.handle.subscriptions());
        show(&self.manager, &subscriptions, &mut self.shown, nodes).map_err(StatusError)?;
        let service = match station.fault {
            Some(_) => NO_SERVICE,
            None => SERVICE,
        };
        if service != self.service {
            self.service = service;
            self.handle.set_service_level(service);
        }
        if station.fault.is_none() && self.is_behind {
            self.is_behind = self.tell().unwrap_or_else(|error| {
                tracing::warn!("opcua: {error}");
                self.history.close();
                true
            });
        }
        Ok(self)
    }

    /// Reads the identifiers of the tools' last checks, unless they were read of what stands now. A check that is stored changes
    /// what stands, so there may be news then.
    fn read_ids(&mut self, standing: &Arc<Standing>, station: &StationStatement) {
        let of_now = |(before, _): &(Arc<Standing>, _)| Arc::ptr_eq(before, standing);
        if self.read.as_ref().is_some_and(of_now) {
            return;
        }
        self.is_behind = true;
        let read = |file: &mut HistoryFile| -> Result<Vec<Identified>, HistoryError> {
            let (history, _) = file.verified()?;
            let mut ids = Vec::new();
            for tool in &station.dies {
                let number = tool.last.id;
                ids.push((number, check_id(&tool.last, &history.document(number)?)));
            }
            Ok(ids)
        };
        self.read = match read(&mut self.history) {
            Ok(ids) => Some((Arc::clone(standing), ids)),
            Err(error) => {
                tracing::warn!("opcua: {error}");
                self.history.close();
                None
            }
        };
    }

    /// Tells subscribers of the checks that were stored since the last time, and returns whether there may be more.
    fn tell(&mut self) -> Result<bool, HistoryError> {
        let (history, _) = self.history.verified()?;
        let id = |number: i64| -> Result<String, HistoryError> {
            Ok(check_id(
                &history.check(number)?,
                &history.document(number)?,
            ))
        };
        let newest = || -> Result<Identified, HistoryError> {
            match history.listed(None, None, None, 1)?.pop() {
                Some(check) => Ok((check.id, id(check.id)?)),
                None => Ok((0, String::new())),
            }
        };
        let Some((told, told_id)) = &self.told else {
            self.told = Some(newest()?);
            return Ok(false);
        };
        let is_same = match *told {
            0 => true,
            number => match id(number) {
                Ok(id) => id == *told_id,
                Err(HistoryError::NoSuchCheck { .. }) => false,
                Err(error) => return Err(error),
            },
        };
        if !is_same {
            tracing::warn!("opcua: another history stands in its place; its checks are no news");
            self.told = Some(newest()?);
            return Ok(false);
        }
        let mut number = *told;
        for _ in 0..EVENTS_AT_A_TIME {
            let Some(next) = history.next_after(number)? else {
                return Ok(false);
            };
            let check = history.check(next)?;
            let id = id(next)?;
            let names = self.manager.inner().names;
            let tool = space::tool_id(names, &check.tool);
            let types = Types {
                namespace: names.own,
            };
            let event = CheckEvent::new(types, &check, &id, &tool);
            // A recording is not an event at the press. Told of a tool, the server tells it itself, too.
            if check.origin.kind() != OriginKind::Recording {
                let told: [(&dyn Event, &NodeId); 1] = [(&event, &tool)];
                self.handle.subscriptions().notify_events(told.into_iter());
            }
            number = next;
            self.told = Some((next, id));
        }
        Ok(true)
    }
}

/// The server refused a node.
#[derive(Debug, thiserror::Error)]
#[error("a value cannot be shown: {0}")]
struct StatusError(StatusCode);
