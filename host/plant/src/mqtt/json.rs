//! Plain JSON: every check once, what stands for every tool, and whether this station is there. The messages' schema is
//! docs/formats/plant-mqtt.schema.json.

use std::collections::BTreeMap;
use std::time::Duration;

use flankscope_metrology::verdict::Word;
use flankscope_record::history::{Check, FlankRow};
use serde::Serialize;

use super::packets::Message;
use super::topic_word;
use crate::statement::{DieStatement, Doubt, StationStatement, Worth};

/// End of the topics under which the broker retains what stands for a tool.
const STATE: &str = "/state";

/// The messages of one connection.
#[derive(Debug)]
pub struct Json {
    station: String,
    /// States of an earlier connection that this one has not replaced.
    earlier: BTreeMap<String, Vec<u8>>,
    /// Last payload of every topic.
    published: BTreeMap<String, Vec<u8>>,
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
    /// Measured object of the check: press, bench or recording.
    origin: &'static str,
    stale_after_s: u64,
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
    /// Measured object of the last check: press, bench or recording.
    origin: &'static str,
    /// When its last exposure ended.
    exposed_at: Option<String>,
    /// Why its age is not proven, if it is not.
    doubt: Option<&'static str>,
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
    /// Messages of one connection. `retained` are the messages that the broker still has from an earlier connection, by topic.
    pub fn new(station: &str, retained: BTreeMap<String, String>) -> Self {
        let retained = retained.into_iter();
        Self {
            station: topic_word(station),
            earlier: retained
                .map(|(topic, state)| (topic, state.into_bytes()))
                .collect(),
            published: BTreeMap::new(),
        }
    }

    /// Messages that the broker retains once these changes are sent: the states of all tools, by topic.
    pub fn retained(&self) -> BTreeMap<String, String> {
        let published = self.earlier.iter().chain(&self.published);
        let states = published.filter(|(topic, _)| topic.ends_with(STATE));
        let text = |payload: &Vec<u8>| String::from_utf8_lossy(payload).into_owned();
        states
            .map(|(topic, payload)| (topic.clone(), text(payload)))
            .collect()
    }

    /// What the broker says when this connection breaks.
    pub fn will(&self) -> Message {
        self.retained_message("status".into(), status(false, None))
    }

    /// A check, sent once and not kept by the broker.
    pub fn check(&self, check: &Check, id: &str, stale_after: Duration) -> Message {
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
            origin: check.origin.kind().word(),
            stale_after_s: stale_after.as_secs(),
            flanks: &check.flanks,
        };
        Message {
            retained: false,
            ..self.retained_message(format!("{}/check", topic_word(&check.tool)), text(&payload))
        }
    }

    /// Messages about what stands now, as far as it differs from what was said before. States come before the status, so that nothing old is
    /// retained once it says online: a tool that is no longer in the history is cleared by an empty message, and while the history
    /// cannot be read, every state but a no-go is withdrawn.
    pub fn changes(&mut self, station: &StationStatement) -> Vec<Message> {
        let mut current: BTreeMap<String, Vec<u8>> = BTreeMap::new();
        for die in &station.dies {
            let topic = format!("{}{STATE}", topic_word(&die.last.tool));
            current.insert(topic, text(&state(die)));
        }
        self.published.append(&mut self.earlier);
        let states = self
            .published
            .iter()
            .filter(|(topic, _)| topic.ends_with(STATE));
        for (topic, before) in states {
            let now = || match station.fault {
                Some(_) => withdrawn(before),
                None => Vec::new(),
            };
            current.entry(topic.clone()).or_insert_with(now);
        }
        let mut changes = Vec::new();
        let status = status(true, station.fault.as_deref());
        for (topic, payload) in current.into_iter().chain([("status".to_owned(), status)]) {
            if self.published.get(&topic) == Some(&payload) {
                continue;
            }
            if payload.is_empty() {
                self.published.remove(&topic);
            } else {
                self.published.insert(topic.clone(), payload.clone());
            }
            changes.push(self.retained_message(topic, payload));
        }
        changes
    }

    fn retained_message(&self, topic: String, payload: Vec<u8>) -> Message {
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

fn state(die: &DieStatement) -> StateMessage<'_> {
    let last = &die.last;
    StateMessage {
        tool: &last.tool,
        verdict: die.verdict,
        worth: match die.worth {
            Worth::Counts => "counts",
            Worth::Stale => "stale",
            Worth::Unknown(_) => "unknown",
        },
        latched: die.latched.as_ref().map(|no_go| no_go.check),
        number: last.id,
        at: &last.at,
        simulated: last.origin.simulated,
        origin: die.origin.word(),
        exposed_at: die.exposed_at.map(|at| at.to_string()),
        doubt: die.worth.doubt().map(Doubt::word),
        counts_until: die.counts_until.map(|until| until.to_string()),
    }
}

/// Whether a state says that a die is good.
#[cfg(test)]
pub fn says_good(die: &DieStatement) -> bool {
    matches!(state(die).verdict, Some(Word::Go | Word::Warn))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::freshness_model::{Scene, check, moment, no_go};
    use crate::statement::Standing;

    /// Topics below the station's with their payloads, in order.
    fn sent(json: &mut Json, standing: &Standing, now_s: i64) -> Vec<(String, serde_json::Value)> {
        let changes = json.changes(&standing.statement(&moment(now_s)));
        let parts = changes.into_iter().map(|message| {
            let topic = message.topic.replace("flankscope/press7/", "");
            (
                topic,
                serde_json::from_slice(&message.payload).unwrap_or_default(),
            )
        });
        parts.collect()
    }

    #[test]
    fn states_of_what_is_no_longer_served_are_cleared_before_the_station_is_online() {
        let mut scene = Scene::new(60);
        scene.facts.tools = vec![(check(1, "die", Word::Go, &moment(100)), Vec::new())];
        let mut json = Json::new("press7", BTreeMap::new());
        let first = sent(&mut json, &scene.look(&moment(100)), 100);
        assert_eq!(first[0].0, "die/state");
        assert_eq!(
            (&first[0].1["verdict"], &first[0].1["origin"]),
            (&"go".into(), &"press".into())
        );
        assert_eq!(
            (&*first[1].0, &first[1].1["online"]),
            ("status", &true.into())
        );
        assert!(sent(&mut json, &scene.look(&moment(101)), 101).is_empty());
        // The process starts anew with another history.
        let mut other = Scene::new(60);
        other.facts.tools = vec![(check(1, "other", Word::Go, &moment(100)), Vec::new())];
        let mut json = Json::new("press7", json.retained());
        let second = sent(&mut json, &other.look(&moment(110)), 110);
        let topics: Vec<&str> = second.iter().map(|(topic, _)| &**topic).collect();
        assert_eq!(topics, ["die/state", "other/state", "status"]);
        assert!(
            second[0].1.is_null(),
            "an empty message clears what is retained"
        );
        assert_eq!(json.retained().keys().collect::<Vec<_>>(), ["other/state"]);
    }

    #[test]
    fn states_of_an_earlier_process_are_withdrawn_while_the_history_is_gone() {
        let mut scene = Scene::new(60);
        scene.facts.tools = vec![
            (check(1, "die", Word::Go, &moment(100)), Vec::new()),
            (check(2, "worn", Word::NoGo, &moment(100)), Vec::new()),
        ];
        scene.facts.open_no_gos = vec![no_go("worn", 2)];
        let mut json = Json::new("press7", BTreeMap::new());
        sent(&mut json, &scene.look(&moment(100)), 100);
        let mut json = Json::new("press7", json.retained());
        let gone = Standing::unread(Duration::from_secs(60)).with_fault("gone", &[]);
        let messages = sent(&mut json, &gone, 110);
        assert_eq!(messages.len(), 3);
        assert_eq!(
            (&*messages[0].0, &messages[0].1["verdict"]),
            ("die/state", &serde_json::Value::Null)
        );
        assert_eq!(messages[0].1["worth"], "unknown");
        assert_eq!(
            (&*messages[1].0, &messages[1].1["verdict"]),
            ("worn/state", &"no-go".into())
        );
        assert_eq!(
            (&*messages[2].0, &messages[2].1["fault"]),
            ("status", &"gone".into())
        );
        // It comes back as it was.
        let messages = sent(&mut json, &scene.look(&moment(120)), 120);
        assert_eq!(
            (&*messages[0].0, &messages[0].1["verdict"]),
            ("die/state", &"go".into())
        );
    }
}
