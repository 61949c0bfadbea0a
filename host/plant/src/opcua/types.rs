//! Types of this server's own namespace, with the terms of OPC 40001-101 (result, its meta data and evaluation) and OPC 40210
//! (characteristic). They are described to clients by data type definitions, and encoded by the structures here: the fields of
//! both stand in the same order.

use flankscope_metrology::verdict::Word;
use flankscope_record::history::{Check, FlankRow};
use opcua::nodes::{DataTypeBuilder, ObjectBuilder, ObjectTypeBuilder, VariableBuilder};
use opcua::server::address_space::AddressSpace;
use opcua::types::{
    BinaryEncodable, DataTypeDefinition, DataTypeId, DateTime, EnumDefinition, EnumField,
    ExpandedMessageInfo, ExpandedNodeId, ExtensionObject, LocalizedText, NodeId, ObjectTypeId,
    QualifiedName, ReferenceTypeId, StructureDefinition, StructureField, StructureType, UAString,
    VariableTypeId, Variant,
};

/// Namespace of this server's nodes and types.
pub const NAMESPACE: &str = "urn:flankscope:plant";

/// The evaluations of a result, as OPC 40001-101 numbers them.
const EVALUATIONS: [(&str, &str); 4] = [
    ("Undefined", "no result stands"),
    ("OK", "go or warn"),
    ("NotOK", "no-go"),
    ("NotDecidable", "indeterminate"),
];
/// No result stands.
pub const UNDEFINED: i32 = 0;

const CHARACTERISTIC: u32 = 3001;
const META_DATA: u32 = 3002;
const RESULT: u32 = 3003;
const EVALUATION: u32 = 3004;
const EVALUATION_STRINGS: u32 = 3005;
/// A structure's binary encoding has its number and this.
const ENCODING: u32 = 2000;
const EVENT: u32 = 1001;
/// The fields of the event have their position and this.
const EVENT_FIELDS: u32 = 6001;

/// The evaluation of a verdict.
pub fn evaluation(verdict: Word) -> i32 {
    match verdict {
        Word::Go | Word::Warn => 1,
        Word::NoGo => 2,
        Word::Indeterminate => 3,
    }
}

/// A number that a client can compute with.
pub fn finite(number: Option<f64>) -> Option<f64> {
    number.filter(|number| number.is_finite())
}

/// Nodes of the types.
#[derive(Clone, Copy, Debug)]
pub struct Types {
    /// Index of the namespace.
    pub namespace: u16,
}

impl Types {
    pub fn evaluation(self) -> NodeId {
        NodeId::new(self.namespace, EVALUATION)
    }

    pub fn result(self) -> NodeId {
        NodeId::new(self.namespace, RESULT)
    }

    pub fn event(self) -> NodeId {
        NodeId::new(self.namespace, EVENT)
    }
}

/// A flank or patch.
#[derive(Clone, Debug, PartialEq, BinaryEncodable)]
pub struct Characteristic {
    pub name: UAString,
    pub evaluation: i32,
    pub warning_limit: f64,
    pub upper_limit: f64,
    #[opcua(optional)]
    pub value: Option<f64>,
    #[opcua(optional)]
    pub uncertainty: Option<f64>,
}

/// What is said of a result as a whole.
#[derive(Clone, Debug, PartialEq, BinaryEncodable)]
pub struct MetaData {
    pub result_id: UAString,
    pub number: i64,
    pub creation_time: DateTime,
    pub evaluation: i32,
    pub details: LocalizedText,
    pub verdict: UAString,
    pub is_simulated: bool,
    pub station: UAString,
    pub tool: UAString,
    pub serial_number: UAString,
    pub cycle_count: u64,
}

/// A check.
#[derive(Clone, Debug, PartialEq, BinaryEncodable)]
pub struct CheckResult {
    pub meta_data: MetaData,
    pub content: Option<Vec<Characteristic>>,
}

impl ExpandedMessageInfo for CheckResult {
    fn full_type_id(&self) -> ExpandedNodeId {
        in_namespace(RESULT + ENCODING)
    }

    fn full_json_type_id(&self) -> ExpandedNodeId {
        self.full_data_type_id()
    }

    fn full_xml_type_id(&self) -> ExpandedNodeId {
        self.full_data_type_id()
    }

    fn full_data_type_id(&self) -> ExpandedNodeId {
        in_namespace(RESULT)
    }
}

/// A node of this namespace, whatever its index is.
fn in_namespace(number: u32) -> ExpandedNodeId {
    ExpandedNodeId {
        node_id: NodeId::new(0, number),
        namespace_uri: NAMESPACE.into(),
        server_index: 0,
    }
}

/// When a check was stored.
pub fn time(check: &Check) -> DateTime {
    DateTime::parse_from_rfc3339(&check.at).unwrap_or_else(|_| DateTime::null())
}

/// Cycles done with the tool.
pub fn cycles(check: &Check) -> u64 {
    u64::try_from(check.tool_cycles).unwrap_or_default()
}

impl Characteristic {
    fn new(flank: &FlankRow) -> Self {
        Self {
            name: flank.id.to_string().into(),
            evaluation: evaluation(flank.verdict),
            // Limits are numbers of the tool's file, which must be finite there.
            warning_limit: finite(Some(flank.warn_um)).unwrap_or_default(),
            upper_limit: finite(Some(flank.limit_um)).unwrap_or_default(),
            value: finite(flank.wear_um),
            uncertainty: finite(flank.u95_um),
        }
    }
}

impl CheckResult {
    pub fn new(check: &Check, id: &str) -> Self {
        Self {
            meta_data: MetaData {
                result_id: id.into(),
                number: check.id,
                creation_time: time(check),
                evaluation: evaluation(check.verdict),
                details: LocalizedText::new("en", &check.reason),
                verdict: check.verdict.as_str().into(),
                is_simulated: check.origin.simulated,
                station: check.origin.station.as_str().into(),
                tool: check.tool.as_str().into(),
                serial_number: check.serial.as_deref().unwrap_or_default().into(),
                cycle_count: cycles(check),
            },
            content: Some(check.flanks.iter().map(Characteristic::new).collect()),
        }
    }

    pub fn variant(self) -> Variant {
        Variant::from(ExtensionObject::new(self))
    }
}

/// Name, type, whether it is an array, and whether it may be missing.
type Field = (&'static str, NodeId, bool, bool);

/// A field with one value.
fn single(name: &'static str, data_type: impl Into<NodeId>) -> Field {
    (name, data_type.into(), false, false)
}

/// A field with a value or none.
fn optional(name: &'static str, data_type: impl Into<NodeId>) -> Field {
    (name, data_type.into(), false, true)
}

/// A field with any number of values.
fn array(name: &'static str, data_type: impl Into<NodeId>) -> Field {
    (name, data_type.into(), true, false)
}

/// The fields of an event beside those that every event has, in the order of [`super::events`].
pub fn event_fields(types: Types) -> [Field; 15] {
    [
        single("Result", types.result()),
        single("ResultId", DataTypeId::String),
        single("Number", DataTypeId::Int64),
        single("ResultEvaluation", types.evaluation()),
        single("Verdict", DataTypeId::String),
        single("IsSimulated", DataTypeId::Boolean),
        single("Tool", DataTypeId::String),
        single("WorstCharacteristic", DataTypeId::String),
        single("WorstValue", DataTypeId::Double),
        single("WorstUncertainty", DataTypeId::Double),
        array("CharacteristicNames", DataTypeId::String),
        array("CharacteristicValues", DataTypeId::Double),
        array("CharacteristicUncertainties", DataTypeId::Double),
        array("CharacteristicUpperLimits", DataTypeId::Double),
        array("CharacteristicEvaluations", types.evaluation()),
    ]
}

/// Adds the types.
pub fn insert(types: Types, space: &mut AddressSpace) {
    let evaluation = single("ResultEvaluation", types.evaluation());
    insert_evaluation(types, space);
    let mut add = |number, name, fields: &[Field]| {
        insert_structure(types, space, (number, name), fields);
    };
    add(
        CHARACTERISTIC,
        "CharacteristicDataType",
        &[
            single("Name", DataTypeId::String),
            evaluation.clone(),
            single("WarningLimit", DataTypeId::Double),
            single("UpperLimit", DataTypeId::Double),
            optional("ResultValue", DataTypeId::Double),
            optional("ExpandedUncertainty", DataTypeId::Double),
        ],
    );
    add(
        META_DATA,
        "ResultMetaDataType",
        &[
            single("ResultId", DataTypeId::String),
            single("Number", DataTypeId::Int64),
            single("CreationTime", DataTypeId::UtcTime),
            evaluation,
            single("ResultEvaluationDetails", DataTypeId::LocalizedText),
            single("Verdict", DataTypeId::String),
            single("IsSimulated", DataTypeId::Boolean),
            single("Station", DataTypeId::String),
            single("Tool", DataTypeId::String),
            single("SerialNumber", DataTypeId::String),
            single("CycleCount", DataTypeId::UInt64),
        ],
    );
    let own = |number| NodeId::new(types.namespace, number);
    add(
        RESULT,
        "ResultDataType",
        &[
            single("ResultMetaData", own(META_DATA)),
            array("ResultContent", own(CHARACTERISTIC)),
        ],
    );
    insert_event(types, space);
}

fn insert_evaluation(types: Types, space: &mut AddressSpace) {
    let id = types.evaluation();
    let field = |(value, (name, description)): (usize, &(&str, &str))| EnumField {
        value: value as i64,
        display_name: (*name).into(),
        description: (*description).into(),
        name: (*name).into(),
    };
    let fields = EVALUATIONS.iter().enumerate().map(field).collect();
    let name = "ResultEvaluationEnum";
    DataTypeBuilder::new(&id, QualifiedName::new(types.namespace, name), name)
        .subtype_of(NodeId::from(DataTypeId::Enumeration))
        .data_type_definition(DataTypeDefinition::Enum(EnumDefinition {
            fields: Some(fields),
        }))
        .insert(space);
    let names: Vec<LocalizedText> = EVALUATIONS.iter().map(|(name, _)| (*name).into()).collect();
    VariableBuilder::new(
        &NodeId::new(types.namespace, EVALUATION_STRINGS),
        QualifiedName::from("EnumStrings"),
        "EnumStrings",
    )
    .data_type(DataTypeId::LocalizedText)
    .value_rank(1)
    .value(names)
    .has_type_definition(VariableTypeId::PropertyType)
    .property_of(id)
    .insert(space);
}

fn insert_structure(
    types: Types,
    space: &mut AddressSpace,
    (number, name): (u32, &'static str),
    fields: &[Field],
) {
    let [id, encoding] = [number, number + ENCODING].map(|it| NodeId::new(types.namespace, it));
    let has_optional = fields.iter().any(|(.., is_optional)| *is_optional);
    let field = |(name, data_type, is_array, is_optional): &Field| StructureField {
        name: (*name).into(),
        description: LocalizedText::null(),
        data_type: data_type.clone(),
        value_rank: if *is_array { 1 } else { -1 },
        array_dimensions: None,
        max_string_length: 0,
        is_optional: *is_optional,
    };
    let definition = StructureDefinition {
        default_encoding_id: encoding.clone(),
        base_data_type: DataTypeId::Structure.into(),
        structure_type: match has_optional {
            true => StructureType::StructureWithOptionalFields,
            false => StructureType::Structure,
        },
        fields: Some(fields.iter().map(field).collect()),
    };
    DataTypeBuilder::new(&id, QualifiedName::new(types.namespace, name), name)
        .subtype_of(NodeId::from(DataTypeId::Structure))
        .data_type_definition(DataTypeDefinition::Structure(definition))
        .insert(space);
    ObjectBuilder::new(
        &encoding,
        QualifiedName::from("Default Binary"),
        "Default Binary",
    )
    .has_type_definition(ObjectTypeId::DataTypeEncodingType)
    .insert(space);
    space.insert_reference(&id, &encoding, ReferenceTypeId::HasEncoding);
}

fn insert_event(types: Types, space: &mut AddressSpace) {
    let id = types.event();
    let name = "ResultReadyEventType";
    ObjectTypeBuilder::new(&id, QualifiedName::new(types.namespace, name), name)
        .subtype_of(NodeId::from(ObjectTypeId::BaseEventType))
        .insert(space);
    for (number, (name, data_type, is_array, _)) in (EVENT_FIELDS..).zip(event_fields(types)) {
        VariableBuilder::new(
            &NodeId::new(types.namespace, number),
            QualifiedName::new(types.namespace, name),
            name,
        )
        .data_type(data_type)
        .value_rank(if is_array { 1 } else { -1 })
        .has_type_definition(VariableTypeId::PropertyType)
        .has_modelling_rule(opcua::types::ObjectId::ModellingRule_Mandatory)
        .property_of(id.clone())
        .insert(space);
    }
}
