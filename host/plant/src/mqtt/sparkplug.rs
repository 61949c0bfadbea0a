//! Sparkplug B 3.0: this process is an edge node, every tool a device. Field numbers and data types are those of the
//! specification's chapter 6.

use std::collections::{BTreeMap, BTreeSet};

use flankscope_metrology::verdict::Word;
use flankscope_record::history::Check;
use flankscope_record::origin::OriginKind;
use jiff::Timestamp;
use prost::Message as _;

use super::packets::Message;
use super::topic_word;
use crate::statement::{DieStatement, StationStatement, Worth};

/// Metric by which a host asks for all births.
const REBIRTH: &str = "Node Control/Rebirth";

const INT32: u32 = 3;
const INT64: u32 = 4;
const DOUBLE: u32 = 10;
const BOOLEAN: u32 = 11;
const STRING: u32 = 12;

/// Values of the property `Quality`.
const BAD: u32 = 0;
const GOOD: u32 = 192;
const STALE: u32 = 500;

/// Content of a message.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Payload {
    #[prost(uint64, optional, tag = "1")]
    pub timestamp: Option<u64>,
    #[prost(message, repeated, tag = "2")]
    pub metrics: Vec<Metric>,
    #[prost(uint64, optional, tag = "3")]
    pub seq: Option<u64>,
}

/// A named value.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Metric {
    #[prost(string, optional, tag = "1")]
    pub name: Option<String>,
    #[prost(uint64, optional, tag = "3")]
    pub timestamp: Option<u64>,
    #[prost(uint32, optional, tag = "4")]
    pub datatype: Option<u32>,
    #[prost(bool, optional, tag = "5")]
    pub is_historical: Option<bool>,
    #[prost(bool, optional, tag = "7")]
    pub is_null: Option<bool>,
    #[prost(message, optional, tag = "9")]
    pub properties: Option<PropertySet>,
    #[prost(oneof = "Value", tags = "11, 13, 14, 15")]
    pub value: Option<Value>,
}

/// A metric's value.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum Value {
    #[prost(uint64, tag = "11")]
    Long(u64),
    #[prost(double, tag = "13")]
    Double(f64),
    #[prost(bool, tag = "14")]
    Boolean(bool),
    #[prost(string, tag = "15")]
    Text(String),
}

/// Properties of a metric: key and value at the same place.
#[derive(Clone, PartialEq, prost::Message)]
pub struct PropertySet {
    #[prost(string, repeated, tag = "1")]
    pub keys: Vec<String>,
    #[prost(message, repeated, tag = "2")]
    pub values: Vec<PropertyValue>,
}

/// A property's value.
#[derive(Clone, PartialEq, prost::Message)]
pub struct PropertyValue {
    #[prost(uint32, optional, tag = "1")]
    pub datatype: Option<u32>,
    #[prost(oneof = "Property", tags = "3, 8")]
    pub value: Option<Property>,
}

/// What a property can be here.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum Property {
    #[prost(uint32, tag = "3")]
    Number(u32),
    #[prost(string, tag = "8")]
    Text(String),
}

/// State of a tool, as it is published.
#[derive(Debug, PartialEq)]
struct PublishedState {
    verdict: Option<Word>,
    worth: Worth,
    latched: Option<i64>,
}

/// A device that was born.
#[derive(Debug)]
struct Device {
    /// Metrics of flanks that its birth named.
    flanks: BTreeSet<String>,
    published: Option<PublishedState>,
}

/// The messages of one connection.
#[derive(Debug)]
pub struct Node {
    group: String,
    node: String,
    connection: u8,
    seq: u8,
    born: BTreeMap<String, Device>,
}

impl Node {
    /// A connection with this number (0 to 255, one more every time).
    pub fn new(group: &str, node: &str, connection: u8) -> Self {
        Self {
            group: group.into(),
            node: node.into(),
            connection,
            seq: 0,
            born: BTreeMap::new(),
        }
    }

    /// What the broker says when this connection breaks: the node's death.
    pub fn will(&self) -> Message {
        let payload = Payload {
            timestamp: Some(ms(Timestamp::now())),
            metrics: vec![self.birth_death()],
            seq: None,
        };
        Message {
            acknowledged: true,
            ..self.message("NDEATH", None, &payload)
        }
    }

    /// Where a host's commands to the node arrive.
    pub fn commands(&self) -> String {
        format!("spBv1.0/{}/NCMD/{}", self.group, self.node)
    }

    /// The node's birth; its devices' follow with the next [`Self::changes`].
    pub fn birth(&mut self, now: Timestamp) -> Message {
        self.born.clear();
        self.seq = 0;
        let payload = Payload {
            timestamp: Some(ms(now)),
            metrics: vec![
                self.birth_death(),
                metric(REBIRTH, BOOLEAN, Some(Value::Boolean(false)), now),
            ],
            seq: Some(0),
        };
        self.message("NBIRTH", None, &payload)
    }

    /// A check. It is historical unless it is its tool's last one.
    pub fn check(
        &mut self,
        check: &Check,
        id: &str,
        station: &StationStatement,
        now: Timestamp,
    ) -> Vec<Message> {
        let die = station.dies.iter().find(|die| die.last.tool == check.tool);
        let mut metrics = of_check(check, id);
        let mut messages = Vec::new();
        let is_new =
            |device: &Device| flank_names(check).any(|name| !device.flanks.contains(&name));
        if self.born.get(&check.tool).is_none_or(is_new) {
            let last = die.map_or(check, |die| &die.last);
            messages.push(self.device_birth(last, die, check, now));
        }
        // A recording was exposed before it was stored, and is not the tool's last check either.
        let is_historical = die.is_some_and(|die| check.id != die.last.id)
            || check.origin.kind() == OriginKind::Recording;
        for metric in metrics.iter_mut().filter(|_| is_historical) {
            metric.is_historical = Some(true);
        }
        if let Some(die) = die.filter(|_| !is_historical) {
            qualify(&mut metrics, die.worth);
        }
        messages.push(self.data("DDATA", Some(&check.tool), metrics, now));
        messages
    }

    /// Messages about what stands now, as far as it differs from what was said before: births of new tools, and deaths of those that are no
    /// longer served: of all while the history cannot be read.
    pub fn changes(&mut self, station: &StationStatement, now: Timestamp) -> Vec<Message> {
        let is_served = |tool: &str| station.dies.iter().any(|die| die.last.tool == tool);
        let born = std::mem::take(&mut self.born).into_iter();
        let (served, gone): (BTreeMap<_, _>, BTreeMap<_, _>) =
            born.partition(|(tool, _)| is_served(tool));
        self.born = served;
        let deaths = gone
            .keys()
            .map(|tool| self.data("DDEATH", Some(tool), Vec::new(), now));
        let mut messages: Vec<Message> = deaths.collect();
        for die in &station.dies {
            let current = Some(published_state(die));
            match self.born.get_mut(&die.last.tool) {
                Some(device) if device.published == current => {}
                Some(device) => {
                    device.published = current;
                    let mut metrics = live(die, now);
                    // What was measured is as old as the verdict on it.
                    let mut check = of_check(&die.last, "");
                    check.retain(|metric| metric.name.as_deref() == Some("Check/Verdict"));
                    metrics.append(&mut check);
                    qualify(&mut metrics, die.worth);
                    messages.push(self.data("DDATA", Some(&die.last.tool), metrics, now));
                }
                None => messages.push(self.device_birth(&die.last, Some(die), &die.last, now)),
            }
        }
        messages
    }

    /// Whether a command asks for all births.
    pub fn asks_for_birth(command: &[u8]) -> bool {
        let asks = |metric: &Metric| {
            metric.name.as_deref() == Some(REBIRTH) && metric.value == Some(Value::Boolean(true))
        };
        Payload::decode(command).is_ok_and(|payload| payload.metrics.iter().any(asks))
    }

    /// A device's birth: its last check, what stands, and every flank that it or the check which follows has.
    fn device_birth(
        &mut self,
        last: &Check,
        die: Option<&DieStatement>,
        follows: &Check,
        now: Timestamp,
    ) -> Message {
        let mut metrics = match die {
            Some(die) => live(die, now),
            None => nothing_stands(now),
        };
        metrics.extend(of_check(last, ""));
        if let Some(die) = die {
            qualify(&mut metrics, die.worth);
        }
        let before = self.born.remove(&last.tool);
        let mut flanks: BTreeSet<String> = before.map(|device| device.flanks).unwrap_or_default();
        flanks.extend(flank_names(follows));
        let has: BTreeSet<String> = flank_names(last).collect();
        metrics.extend(
            flanks
                .difference(&has)
                .map(|name| micrometres(name, None, now)),
        );
        flanks.extend(has);
        let device = Device {
            flanks,
            published: die.map(published_state),
        };
        self.born.insert(last.tool.clone(), device);
        self.data("DBIRTH", Some(&last.tool), metrics, now)
    }

    fn data(
        &mut self,
        kind: &str,
        tool: Option<&str>,
        metrics: Vec<Metric>,
        now: Timestamp,
    ) -> Message {
        self.seq = self.seq.wrapping_add(1);
        let payload = Payload {
            timestamp: Some(ms(now)),
            metrics,
            seq: Some(self.seq.into()),
        };
        self.message(kind, tool, &payload)
    }

    fn message(&self, kind: &str, tool: Option<&str>, payload: &Payload) -> Message {
        let Self { group, node, .. } = self;
        let device = tool.map_or(String::new(), |tool| format!("/{}", topic_word(tool)));
        Message {
            topic: format!("spBv1.0/{group}/{kind}/{node}{device}"),
            payload: payload.encode_to_vec(),
            // The specification wants QoS 0 of all but the death.
            acknowledged: false,
            retained: false,
        }
    }

    /// The number by which a host knows to which birth a death belongs.
    fn birth_death(&self) -> Metric {
        let number = Value::Long(self.connection.into());
        metric("bdSeq", INT64, Some(number), Timestamp::now())
    }
}

fn published_state(die: &DieStatement) -> PublishedState {
    PublishedState {
        verdict: die.verdict,
        worth: die.worth,
        latched: die.latched.as_ref().map(|no_go| no_go.check),
    }
}

/// What stands for a tool: null where no verdict counts.
fn live(die: &DieStatement, now: Timestamp) -> Vec<Metric> {
    let verdict = die.verdict;
    let latched = Value::Boolean(die.latched.is_some());
    let mut stands = metric("Verdict", STRING, verdict.map(word), now);
    // A no-go stands however old it is.
    stands.properties = Some(quality(match verdict {
        Some(_) => GOOD,
        None => quality_of(die.worth),
    }));
    vec![stands, metric("Latched", BOOLEAN, Some(latched), now)]
}

/// Whether the metrics say that a die is good.
#[cfg(test)]
pub fn says_good(die: &DieStatement) -> bool {
    let good = [Word::Go, Word::Warn].map(|verdict| Some(word(verdict)));
    good.contains(&live(die, Timestamp::UNIX_EPOCH)[0].value)
}

/// The same of a tool of which nothing is known yet.
fn nothing_stands(now: Timestamp) -> Vec<Metric> {
    let mut stands = metric("Verdict", STRING, None, now);
    stands.properties = Some(quality(BAD));
    vec![stands, metric("Latched", BOOLEAN, None, now)]
}

/// A check's own values, of the time when it was stored; `id` is left out where it is empty.
fn of_check(check: &Check, id: &str) -> Vec<Metric> {
    let at = check.at.parse().unwrap_or(Timestamp::UNIX_EPOCH);
    let text = |text: &str| Some(Value::Text(text.into()));
    let number = |number: i64| Some(Value::Long(number.cast_unsigned()));
    let id = (!id.is_empty()).then(|| Value::Text(id.into()));
    let mut metrics = vec![
        metric("Check/Verdict", STRING, Some(word(check.verdict)), at),
        metric("Check/Number", INT64, number(check.id), at),
        metric("Check/Id", STRING, id, at),
        metric("Check/Reason", STRING, text(&check.reason), at),
        metric("Check/Tool cycles", INT64, number(check.tool_cycles), at),
        metric(
            "Check/Simulated",
            BOOLEAN,
            Some(Value::Boolean(check.origin.simulated)),
            at,
        ),
    ];
    for flank in &check.flanks {
        let values = [flank.wear_um, flank.u95_um, Some(flank.limit_um)];
        for (name, um) in flank_metrics(&flank.id.to_string()).iter().zip(values) {
            metrics.push(micrometres(name, um, at));
        }
    }
    metrics
}

fn flank_names(check: &Check) -> impl Iterator<Item = String> {
    check
        .flanks
        .iter()
        .flat_map(|flank| flank_metrics(&flank.id.to_string()))
}

fn flank_metrics(flank: &str) -> [String; 3] {
    ["Wear", "U95", "Limit"].map(|what| format!("Flanks/{flank}/{what}"))
}

/// Says of a check's verdict how far it can be relied on now.
fn qualify(metrics: &mut [Metric], worth: Worth) {
    for metric in metrics {
        if metric.name.as_deref() == Some("Check/Verdict") {
            metric.properties = Some(quality(quality_of(worth)));
        }
    }
}

fn quality_of(worth: Worth) -> u32 {
    match worth {
        Worth::Counts => GOOD,
        Worth::Stale => STALE,
        Worth::Unknown(_) => BAD,
    }
}

fn quality(code: u32) -> PropertySet {
    property("Quality", INT32, Property::Number(code))
}

fn property(key: &str, datatype: u32, value: Property) -> PropertySet {
    PropertySet {
        keys: vec![key.into()],
        values: vec![PropertyValue {
            datatype: Some(datatype),
            value: Some(value),
        }],
    }
}

fn micrometres(name: &str, um: Option<f64>, at: Timestamp) -> Metric {
    let value = um.filter(|um| um.is_finite()).map(Value::Double);
    Metric {
        properties: Some(property("engUnit", STRING, Property::Text("µm".into()))),
        ..metric(name, DOUBLE, value, at)
    }
}

fn metric(name: &str, datatype: u32, value: Option<Value>, at: Timestamp) -> Metric {
    Metric {
        name: Some(name.into()),
        timestamp: Some(ms(at)),
        datatype: Some(datatype),
        is_historical: None,
        is_null: value.is_none().then_some(true),
        properties: None,
        value,
    }
}

fn word(word: Word) -> Value {
    Value::Text(word.as_str().into())
}

fn ms(at: Timestamp) -> u64 {
    u64::try_from(at.as_millisecond()).unwrap_or(0)
}
