//! What the server shows, as a list of nodes with their values: it follows from what stands alone, so that it can be compared with
//! what was shown before.

use flankscope_metrology::verdict::Word;
use flankscope_record::history::FlankRow;
use jiff::Timestamp;
use opcua::types::{
    DataTypeId, DataValue, DateTime, EUInformation, ExtensionObject, LocalizedText, NodeId,
    ObjectId, ObjectTypeId, ReferenceTypeId, StatusCode, VariableTypeId, Variant,
};

use super::types::{self, CheckResult, Types, UNDEFINED, evaluation, finite};
use crate::percent::escaped;
use crate::statement::{DieStatement, Doubt, StationStatement, Worth};

/// Namespaces whose terms are used for what a machine is and where it stands.
pub const MACHINERY: &str = "http://opcfoundation.org/UA/Machinery/";
pub const DEVICES: &str = "http://opcfoundation.org/UA/DI/";
/// The folder in which OPC 40001-1 has all machines of a server.
const MACHINES: u32 = 1001;

/// Longest part of a node's identifier that is spelled out, bytes.
const MOST_PART: usize = 120;

/// Indices of the namespaces.
#[derive(Clone, Copy, Debug)]
pub struct Names {
    pub own: u16,
    pub machinery: u16,
    pub devices: u16,
}

/// A node.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    pub id: NodeId,
    pub parent: NodeId,
    /// How the parent refers to it.
    pub reference: ReferenceTypeId,
    pub namespace: u16,
    pub name: String,
    pub kind: Kind,
}

/// What a node is.
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    Object {
        type_definition: ObjectTypeId,
        /// Clients can subscribe to its events.
        has_events: bool,
    },
    Variable {
        type_definition: VariableTypeId,
        data_type: NodeId,
        value: Variant,
        status: StatusCode,
        source_time: Option<DateTime>,
        /// Value while nothing is known: a controller that looks at no status must not go on with the last one.
        safe: Option<Variant>,
    },
    /// A method of this tool.
    Method { tool: String, method: Method },
}

/// What a client can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Clear a no-go.
    Acknowledge,
    /// Have a check made at the next opening.
    StartCheck,
}

impl Method {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Acknowledge => "Acknowledge",
            Self::StartCheck => "StartCheck",
        }
    }
}

impl Node {
    /// Whether another node differs in more than its value.
    pub fn is_same_place(&self, other: &Self) -> bool {
        let kind = match (&self.kind, &other.kind) {
            (
                Kind::Variable {
                    type_definition: a,
                    data_type: b,
                    ..
                },
                Kind::Variable {
                    type_definition: c,
                    data_type: d,
                    ..
                },
            ) => a == c && b == d,
            (one, other) => one == other,
        };
        kind && self.parent == other.parent && self.name == other.name
    }

    /// The same node while nothing is known of its value.
    pub fn unknown(&self) -> Self {
        let mut node = self.clone();
        if let Kind::Variable {
            value,
            status,
            source_time,
            safe,
            ..
        } = &mut node.kind
        {
            *value = safe.clone().unwrap_or_default();
            *status = StatusCode::BadNoCommunication;
            *source_time = None;
        }
        node
    }

    /// Its value, if it is a variable.
    pub fn data_value(&self) -> Option<DataValue> {
        let Kind::Variable {
            value,
            status,
            source_time,
            ..
        } = &self.kind
        else {
            return None;
        };
        let now = DateTime::now();
        Some(DataValue {
            // Without a value, not even an empty one, the server would leave out the status, which then reads as good.
            value: Some(value.clone()),
            status: Some(*status),
            source_timestamp: Some(source_time.unwrap_or(now)),
            source_picoseconds: None,
            server_timestamp: Some(now),
            server_picoseconds: None,
        })
    }
}

/// The folder of machines.
pub fn machines(names: Names) -> NodeId {
    NodeId::new(names.machinery, MACHINES)
}

/// The node of a tool.
pub fn tool_id(names: Names, tool: &str) -> NodeId {
    NodeId::new(names.own, format!("Tools/{}", part(tool)))
}

/// The node of a station.
pub fn station_id(names: Names, station: &str) -> NodeId {
    NodeId::new(names.own, format!("Stations/{}", part(station)))
}

/// A name as one part of an identifier: without what separates parts or cannot be typed, and no longer than an identifier may be.
fn part(name: &str) -> String {
    let part = escaped(name, |c| matches!(c, '/' | ';') || c.is_control());
    if part.len() > MOST_PART {
        let hash = blake3::hash(name.as_bytes()).to_hex();
        return format!("%%{}", &hash[..32]);
    }
    part
}

/// A name as a person reads it.
fn readable(name: &str) -> String {
    let clean = |c: char| if c.is_control() { '_' } else { c };
    name.chars().map(clean).take(200).collect()
}

/// What stands, as nodes: parents before what is in them. `id_of` has the identifiers of the tools' last checks.
pub fn nodes(
    names: Names,
    station: &StationStatement,
    id_of: &dyn Fn(&DieStatement) -> Option<String>,
) -> Vec<Node> {
    let mut nodes = Nodes {
        names,
        nodes: Vec::new(),
        source_time: None,
    };
    let mut stations: Vec<&str> = Vec::new();
    for tool in &station.dies {
        let name = tool.last.origin.station.as_str();
        if !stations.contains(&name) {
            stations.push(name);
            nodes.station(name);
        }
        nodes.tool(tool, id_of(tool));
    }
    nodes.nodes
}

/// Nodes under construction.
struct Nodes {
    names: Names,
    nodes: Vec<Node>,
    /// When the values were found.
    source_time: Option<DateTime>,
}

/// A variable's value and what it is worth.
struct Value {
    data_type: NodeId,
    value: Variant,
    status: StatusCode,
    safe: Option<Variant>,
}

impl Value {
    fn new(data_type: DataTypeId, value: impl Into<Variant>, status: StatusCode) -> Self {
        Self {
            data_type: data_type.into(),
            value: value.into(),
            status,
            safe: None,
        }
    }

    fn good(data_type: DataTypeId, value: impl Into<Variant>) -> Self {
        Self::new(data_type, value, StatusCode::Good)
    }

    /// A number in µm, which may not have been measured.
    fn micrometres(number: Option<f64>, status: StatusCode) -> Self {
        match finite(number) {
            Some(number) => Self::new(DataTypeId::Double, number, status),
            None => Self::new(DataTypeId::Double, Variant::Empty, StatusCode::BadNoData),
        }
    }

    fn safe(self, safe: impl Into<Variant>) -> Self {
        Self {
            safe: Some(safe.into()),
            ..self
        }
    }
}

impl Nodes {
    fn child(&self, parent: &NodeId, name: &str) -> NodeId {
        let parent_name = match &parent.identifier {
            opcua::types::Identifier::String(parent_name) => parent_name.as_ref(),
            _ => "",
        };
        NodeId::new(self.names.own, format!("{parent_name}/{}", part(name)))
    }

    fn object(
        &mut self,
        id: &NodeId,
        (parent, reference): (&NodeId, ReferenceTypeId),
        (namespace, name): (u16, &str),
        type_definition: ObjectTypeId,
        has_events: bool,
    ) {
        self.nodes.push(Node {
            id: id.clone(),
            parent: parent.clone(),
            reference,
            namespace,
            name: readable(name),
            kind: Kind::Object {
                type_definition,
                has_events,
            },
        });
    }

    /// An object or folder in another one.
    fn part(&mut self, parent: &NodeId, name: &str, type_definition: ObjectTypeId) -> NodeId {
        let id = self.child(parent, name);
        let place = (parent, ReferenceTypeId::HasComponent);
        self.object(&id, place, (self.names.own, name), type_definition, false);
        id
    }

    fn variable(&mut self, parent: &NodeId, name: &str, value: Value) -> NodeId {
        let (place, definition) = (
            ReferenceTypeId::HasComponent,
            VariableTypeId::BaseDataVariableType,
        );
        self.any_variable(parent, place, (self.names.own, name), definition, value)
    }

    fn property(&mut self, parent: &NodeId, (namespace, name): (u16, &str), value: Value) {
        let (place, definition) = (ReferenceTypeId::HasProperty, VariableTypeId::PropertyType);
        self.any_variable(parent, place, (namespace, name), definition, value);
    }

    fn any_variable(
        &mut self,
        parent: &NodeId,
        reference: ReferenceTypeId,
        (namespace, name): (u16, &str),
        type_definition: VariableTypeId,
        value: Value,
    ) -> NodeId {
        let id = self.child(parent, name);
        self.nodes.push(Node {
            id: id.clone(),
            parent: parent.clone(),
            reference,
            namespace,
            name: name.into(),
            kind: Kind::Variable {
                type_definition,
                data_type: value.data_type,
                value: value.value,
                status: value.status,
                source_time: self.source_time,
                safe: value.safe,
            },
        });
        id
    }

    fn station(&mut self, station: &str) {
        let id = station_id(self.names, station);
        let machines = machines(self.names);
        let place = (&machines, ReferenceTypeId::Organizes);
        let base = ObjectTypeId::BaseObjectType;
        self.object(&id, place, (self.names.own, station), base, false);
        let identification = self.child(&id, "Identification");
        let place = (&id, ReferenceTypeId::HasAddIn);
        let name = (self.names.devices, "Identification");
        self.object(&identification, place, name, base, false);
        let text = |text: &str| Value::good(DataTypeId::LocalizedText, LocalizedText::from(text));
        let string = |text: &str| Value::good(DataTypeId::String, text);
        for (name, value) in [
            ("Manufacturer", text("flankscope")),
            ("Model", text("in-press die inspection")),
            ("SoftwareRevision", string(env!("CARGO_PKG_VERSION"))),
            ("ComponentName", text(station)),
        ] {
            self.property(&identification, (self.names.devices, name), value);
        }
        let tools = self.child(&id, "Tools");
        let place = (&id, ReferenceTypeId::HasComponent);
        let name = (self.names.own, "Tools");
        self.object(&tools, place, name, ObjectTypeId::FolderType, false);
    }

    fn tool(&mut self, tool: &DieStatement, result_id: Option<String>) {
        let last = &tool.last;
        let id = tool_id(self.names, &last.tool);
        let tools = self.child(&station_id(self.names, &last.origin.station), "Tools");
        let place = (&tools, ReferenceTypeId::Organizes);
        let base = ObjectTypeId::BaseObjectType;
        self.object(&id, place, (self.names.own, &last.tool), base, true);
        let status = match tool.worth {
            Worth::Counts => StatusCode::Good,
            Worth::Stale => StatusCode::UncertainLastUsableValue,
            // Nothing of the press was looked at.
            Worth::Unknown(Doubt::Recording) => StatusCode::UncertainLastUsableValue,
            Worth::Unknown(_) => StatusCode::BadInvalidTimestamp,
        };
        self.source_time = Some(types::time(last));
        let serial = Value::good(DataTypeId::String, last.serial.clone().unwrap_or_default());
        self.property(&id, (self.names.devices, "SerialNumber"), serial);
        let cycles = Value::new(DataTypeId::UInt64, types::cycles(last), status);
        self.variable(&id, "CycleCount", cycles);

        self.standing(&id, tool, status);
        for method in [Method::Acknowledge, Method::StartCheck] {
            let name = method.name();
            self.nodes.push(Node {
                id: self.child(&id, name),
                parent: id.clone(),
                reference: ReferenceTypeId::HasComponent,
                namespace: self.names.own,
                name: name.into(),
                kind: Kind::Method {
                    tool: last.tool.clone(),
                    method,
                },
            });
        }

        let results = self.part(&id, "Results", ObjectTypeId::FolderType);
        let latest = self.part(&results, "Latest", base);
        self.latest(&latest, tool, result_id, status);
    }

    /// What stands for a tool now.
    fn standing(&mut self, id: &NodeId, tool: &DieStatement, status: StatusCode) {
        let types = self.types();
        let stands = tool.verdict;
        // A no-go stands however old it is.
        let standing_status = stands.map_or(status, |_| StatusCode::Good);
        let word = stands.map_or("", Word::as_str);
        let verdict = Value::new(DataTypeId::String, word, standing_status).safe("");
        self.variable(id, "Verdict", verdict);
        let number = stands.map_or(UNDEFINED, evaluation);
        let value = Value {
            data_type: types.evaluation(),
            ..Value::new(DataTypeId::Int32, number, standing_status).safe(UNDEFINED)
        };
        self.variable(id, "Evaluation", value);
        let counts = tool.worth == Worth::Counts;
        let counts = Value::good(DataTypeId::Boolean, counts).safe(false);
        self.variable(id, "Counts", counts);
        let time = |at: Option<Timestamp>| {
            let time = at.and_then(|at| DateTime::parse_from_rfc3339(&at.to_string()).ok());
            time.unwrap_or_else(DateTime::null)
        };
        let until = time(tool.counts_until);
        let until = Value::good(DataTypeId::UtcTime, until);
        self.variable(id, "CountsUntil", until);
        let exposed = Value::good(DataTypeId::UtcTime, time(tool.exposed_at));
        self.variable(id, "ExposedAt", exposed);
        let origin = Value::good(DataTypeId::String, tool.origin.word());
        self.variable(id, "Origin", origin);
        let doubt = tool.worth.doubt().map_or("", Doubt::word);
        self.variable(id, "Doubt", Value::good(DataTypeId::String, doubt));
        let latched = tool.latched.as_ref().map(|no_go| no_go.check);
        // While nothing is known it may well be latched.
        let is_latched = Value::good(DataTypeId::Boolean, latched.is_some()).safe(true);
        self.variable(id, "Latched", is_latched);
        let number = Value::good(DataTypeId::Int64, latched.unwrap_or_default());
        self.variable(id, "LatchedNumber", number);
    }

    /// The last check of a tool.
    fn latest(
        &mut self,
        latest: &NodeId,
        tool: &DieStatement,
        result_id: Option<String>,
        status: StatusCode,
    ) {
        let types = self.types();
        let last = &tool.last;
        let id_text = result_id.clone().unwrap_or_default();
        let structure = match result_id {
            Some(id) => CheckResult::new(last, &id).variant(),
            None => Variant::Empty,
        };
        let result_status = match structure {
            Variant::Empty => StatusCode::BadNoData,
            _ => status,
        };
        let result = Value {
            data_type: types.result(),
            ..Value::new(DataTypeId::Structure, structure, result_status)
        };
        self.variable(latest, "Result", result);
        let with_status = |data_type, value: Variant| Value::new(data_type, value, status);
        let details = LocalizedText::new("en", &last.reason);
        for (name, value) in [
            (
                "ResultId",
                Value::new(DataTypeId::String, id_text, result_status),
            ),
            ("Number", with_status(DataTypeId::Int64, last.id.into())),
            (
                "CreationTime",
                with_status(DataTypeId::UtcTime, types::time(last).into()),
            ),
            (
                "ResultEvaluation",
                Value {
                    data_type: types.evaluation(),
                    ..with_status(DataTypeId::Int32, evaluation(last.verdict).into())
                        .safe(UNDEFINED)
                },
            ),
            (
                "ResultEvaluationDetails",
                with_status(DataTypeId::LocalizedText, details.into()),
            ),
            (
                "Verdict",
                with_status(DataTypeId::String, last.verdict.as_str().into()).safe(""),
            ),
            (
                "IsSimulated",
                with_status(DataTypeId::Boolean, last.origin.simulated.into()),
            ),
        ] {
            self.variable(latest, name, value);
        }
        let characteristics = self.part(latest, "Characteristics", ObjectTypeId::FolderType);
        for flank in &last.flanks {
            self.characteristic(&characteristics, flank, status);
        }
    }

    fn characteristic(&mut self, folder: &NodeId, flank: &FlankRow, status: StatusCode) {
        let name = flank.id.to_string();
        let characteristic = self.part(folder, &name, ObjectTypeId::BaseObjectType);
        for (name, number) in [
            ("ResultValue", flank.wear_um),
            ("ExpandedUncertainty", flank.u95_um),
            ("WarningLimit", Some(flank.warn_um)),
            ("UpperLimit", Some(flank.limit_um)),
        ] {
            let value = Value::micrometres(number, status);
            let (place, definition) = (
                ReferenceTypeId::HasComponent,
                VariableTypeId::AnalogUnitType,
            );
            let variable = self.any_variable(
                &characteristic,
                place,
                (self.names.own, name),
                definition,
                value,
            );
            let unit = Value::good(
                DataTypeId::EUInformation,
                ExtensionObject::from_message(micrometre()),
            );
            self.property(&variable, (0, "EngineeringUnits"), unit);
        }
        let value = Value {
            data_type: self.types().evaluation(),
            ..Value::new(DataTypeId::Int32, evaluation(flank.verdict), status).safe(UNDEFINED)
        };
        self.variable(&characteristic, "ResultEvaluation", value);
    }

    fn types(&self) -> Types {
        Types {
            namespace: self.names.own,
        }
    }
}

/// Whether the nodes of a tool say that it is good.
#[cfg(test)]
pub fn says_good(die: &DieStatement) -> bool {
    let mut nodes = Nodes {
        names: Names {
            own: 2,
            machinery: 3,
            devices: 4,
        },
        nodes: Vec::new(),
        source_time: None,
    };
    nodes.tool(die, None);
    let value = |name: &str| {
        let parent = tool_id(nodes.names, &die.last.tool);
        let mut found = nodes.nodes.iter().filter(|node| node.parent == parent);
        found
            .find(|node| node.name == name)
            .and_then(|node| match &node.kind {
                Kind::Variable { value, .. } => Some(value.clone()),
                _ => None,
            })
    };
    let good = [Word::Go, Word::Warn].map(|word| Some(Variant::from(word.as_str())));
    let is_good = good.contains(&value("Verdict"));
    assert_eq!(
        value("Evaluation") == Some(Variant::from(1_i32)),
        is_good,
        "{die:?}"
    );
    is_good
}

/// Micrometre by its code of UN/CEFACT, "4H", whose bytes are its number.
fn micrometre() -> EUInformation {
    EUInformation {
        namespace_uri: "http://www.opcfoundation.org/UA/units/un/cefact".into(),
        unit_id: i32::from_be_bytes([0, 0, b'4', b'H']),
        display_name: "µm".into(),
        description: "micrometre".into(),
    }
}

/// Where this process says how it stands itself, and its nodes.
pub fn own(names: Names, station: &StationStatement) -> Vec<Node> {
    let mut nodes = Nodes {
        names,
        nodes: Vec::new(),
        source_time: None,
    };
    let id = NodeId::new(names.own, "Plant");
    let objects = NodeId::from(ObjectId::ObjectsFolder);
    let base = ObjectTypeId::BaseObjectType;
    let place = (&objects, ReferenceTypeId::Organizes);
    nodes.object(&id, place, (names.own, "Plant"), base, false);
    let machines_name = (names.machinery, "Machines");
    let folder = ObjectTypeId::FolderType;
    nodes.object(&machines(names), place, machines_name, folder, false);
    let fault = station.fault.as_deref().unwrap_or_default();
    nodes.variable(&id, "HistoryFault", Value::good(DataTypeId::String, fault));
    let age_ms = 1000.0 * station.stale_after.as_secs_f64();
    nodes.variable(&id, "StaleAfter", Value::good(DataTypeId::Duration, age_ms));
    nodes.nodes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_makes_an_identifier_of_another_one() {
        let long = "ü".repeat(300);
        let names = ["a/b", "a", "a%2Fb", "b", "a;b", "a\0b", "a\nb", "", &long];
        let parts: std::collections::BTreeSet<String> =
            names.iter().map(|name| part(name)).collect();
        assert_eq!(parts.len(), names.len());
        for part in parts {
            assert!(
                part.len() <= MOST_PART && !part.contains(['/', ';', '\0']),
                "{part}"
            );
        }
        assert_ne!(part(&long), part(&format!("{long}ü")));
    }

    #[test]
    fn the_unit_is_micrometre() {
        // Part 8 of OPC UA gives the number of a code of two characters as 256 times the first one and the second one.
        assert_eq!(micrometre().unit_id, 0x34 * 256 + 0x48);
    }
}
