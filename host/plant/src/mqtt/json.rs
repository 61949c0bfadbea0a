//! Plain JSON: every check once, what stands for every tool, and whether this station is there. The messages' schema is
//! docs/formats/plant-mqtt.schema.json.

use std::collections::BTreeMap;

use flankscope_metrology::verdict::Word;
use flankscope_record::history::{Check, FlankRow};
use jiff::{SignedDuration, Timestamp};
use serde::Serialize;

use super::packets::Message;
use super::topic_word;
use crate::standing::{Standing, ToolStanding, Worth};

/// The messages of one connection.
#[derive(Debug)]
pub struct Json {
    station: String,
    /// What was last said under every topic.
    said: BTreeMap<String, Vec<u8>>,
}

/// A stored check.
#[derive(Serialize)]
struct CheckMessage<'a> {
    id: &'a str,
    number: i64,
    at: &'a str,
    station: &'a str,
    tool: &'a str,
    serial: Option<&'a str>,
    tool_cycles: i64,
    verdict: Word,
    reason: &'a str,
    simulated: bool,
    stale_after_s: u32,
    flanks: &'a [FlankRow],
}

/// What stands for a tool.
#[derive(Serialize)]
struct StateMessage<'a> {
    tool: &'a str,
    /// The verdict that counts; null if none does.
    verdict: Option<Word>,
    worth: &'static str,
    /// Number of the no-go that is not acknowledged.
    latched: Option<i64>,
    /// The last check.
    number: i64,
    at: &'a str,
    simulated: bool,
    /// From then on the verdict no longer counts, unless it is a no-go.
    counts_until: Option<String>,
}

#[derive(Serialize)]
struct StatusMessage<'a> {
    online: bool,
    /// Why the history cannot be read.
    fault: Option<&'a str>,
}

impl Json {
    pub fn new(station: &str) -> Self {
        Self {
            station: topic_word(station),
            said: BTreeMap::new(),
        }
    }

    /// What the broker says when this connection breaks.
    pub fn will(&self) -> Message {
        self.retained("status".into(), status(false, None))
    }

    /// A check, sent once and not kept by the broker.
    pub fn check(&self, check: &Check, id: &str, standing: &Standing) -> Message {
        let payload = CheckMessage {
            id,
            number: check.id,
            at: &check.at,
            station: &check.origin.station,
            tool: &check.tool,
            serial: check.serial.as_deref(),
            tool_cycles: check.tool_cycles,
            verdict: check.verdict,
            reason: &check.reason,
            simulated: check.origin.simulated,
            stale_after_s: standing.stale_after_s,
            flanks: &check.flanks,
        };
        Message {
            retained: false,
            ..self.retained(format!("{}/check", topic_word(&check.tool)), text(&payload))
        }
    }

    /// What stands now, as far as it differs from what was said before.
    pub fn changes(&mut self, standing: &Standing, now: Timestamp) -> Vec<Message> {
        let status = status(true, standing.fault.as_deref());
        let mut current = vec![("status".to_owned(), status)];
        current.extend(standing.tools.iter().map(|tool| {
            let topic = format!("{}/state", topic_word(&tool.last.tool));
            (topic, text(&state(standing, tool, now)))
        }));
        if standing.fault.is_some() {
            let states = self
                .said
                .iter()
                .filter(|(topic, _)| topic.ends_with("/state"));
            current.extend(states.map(|(topic, state)| (topic.clone(), withdrawn(state))));
        }
        let mut changes = Vec::new();
        for (topic, payload) in current {
            if self.said.get(&topic) != Some(&payload) {
                self.said.insert(topic.clone(), payload.clone());
                changes.push(self.retained(topic, payload));
            }
        }
        changes
    }

    fn retained(&self, topic: String, payload: Vec<u8>) -> Message {
        Message {
            topic: format!("flankscope/{}/{topic}", self.station),
            payload,
            acknowledged: true,
            retained: true,
        }
    }
}

fn status(online: bool, fault: Option<&str>) -> Vec<u8> {
    text(&StatusMessage { online, fault })
}

fn state<'a>(standing: &Standing, tool: &'a ToolStanding, now: Timestamp) -> StateMessage<'a> {
    let last = &tool.last;
    let at = last.at.parse::<Timestamp>().ok();
    let age = SignedDuration::from_secs(i64::from(standing.stale_after_s));
    StateMessage {
        tool: &last.tool,
        verdict: standing.verdict(tool, now),
        worth: match standing.worth(tool, now) {
            Worth::Counts => "counts",
            Worth::Stale => "stale",
            Worth::Unknown => "unknown",
        },
        latched: tool.latched.as_ref().map(|no_go| no_go.check),
        number: last.id,
        at: &last.at,
        simulated: last.origin.simulated,
        counts_until: at
            .and_then(|at| at.checked_add(age).ok())
            .map(|until| until.to_string()),
    }
}

/// A state of which nothing is known any more: a no-go stands nevertheless.
fn withdrawn(state: &[u8]) -> Vec<u8> {
    let mut state: serde_json::Value = serde_json::from_slice(state).unwrap_or_default();
    state["worth"] = "unknown".into();
    if state["verdict"] != Word::NoGo.as_str() {
        state["verdict"] = serde_json::Value::Null;
    }
    text(&state)
}

fn text(message: &impl Serialize) -> Vec<u8> {
    // Numbers that are not finite become null; nothing else can fail in memory.
    serde_json::to_vec(message).unwrap_or_default()
}
