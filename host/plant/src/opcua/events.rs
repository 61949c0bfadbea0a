//! The event that a check was stored, with its characteristics.

use flankscope_metrology::verdict::Word;
use flankscope_record::history::Check;
use opcua::nodes::{BaseEventType, Event};
use opcua::server::EventField;
use opcua::types::{
    AttributeId, ByteString, DateTime, LocalizedText, NodeId, NumericRange, QualifiedName,
    UAString, Variant,
};

use super::types::{self, CheckResult, Types, evaluation, event_fields, finite};
use crate::statement::most_worn;

/// A check was stored.
#[derive(Debug)]
pub struct CheckEvent {
    base: BaseEventType,
    types: Types,
    /// In the order of [`event_fields`].
    values: Vec<Variant>,
}

impl CheckEvent {
    /// `source` is the node of its tool.
    pub fn new(types: Types, check: &Check, id: &str, source: &NodeId) -> Self {
        let time = types::time(check);
        let base = BaseEventType {
            event_id: ByteString::from(id.as_bytes()),
            event_type: types.event(),
            source_node: source.clone(),
            source_name: check.tool.as_str().into(),
            time,
            receive_time: DateTime::now(),
            message: LocalizedText::new(
                "en",
                &format!(
                    "{}: {}, {}",
                    check.tool,
                    check.verdict.as_str(),
                    check.reason
                ),
            ),
            severity: severity(check.verdict),
            ..BaseEventType::default()
        };
        let worst = most_worn(check);
        // What was not measured is no number.
        let number = |number: Option<f64>| finite(number).unwrap_or(f64::NAN);
        let doubles = |value: fn(&flankscope_record::history::FlankRow) -> Option<f64>| {
            let values: Vec<f64> = check
                .flanks
                .iter()
                .map(|flank| number(value(flank)))
                .collect();
            Variant::from(values)
        };
        let names = check.flanks.iter().map(|flank| flank.id.to_string().into());
        let names: Vec<UAString> = names.collect();
        let evaluations = check.flanks.iter().map(|flank| evaluation(flank.verdict));
        let evaluations: Vec<i32> = evaluations.collect();
        let values = vec![
            CheckResult::new(check, id).variant(),
            id.into(),
            check.id.into(),
            evaluation(check.verdict).into(),
            check.verdict.as_str().into(),
            check.origin.simulated.into(),
            check.tool.as_str().into(),
            worst
                .map_or_else(String::new, |flank| flank.id.to_string())
                .into(),
            number(worst.and_then(|flank| flank.wear_um)).into(),
            number(worst.and_then(|flank| flank.u95_um)).into(),
            names.into(),
            doubles(|flank| flank.wear_um),
            doubles(|flank| flank.u95_um),
            doubles(|flank| Some(flank.limit_um)),
            evaluations.into(),
        ];
        Self {
            base,
            types,
            values,
        }
    }
}

/// How urgent it is, as OPC UA counts from 1 to 1000.
fn severity(verdict: Word) -> u16 {
    match verdict {
        Word::Go => 100,
        Word::Warn => 400,
        Word::Indeterminate => 600,
        Word::NoGo => 900,
    }
}

impl Event for CheckEvent {
    fn get_field(
        &self,
        _type_definition_id: &NodeId,
        attribute_id: AttributeId,
        index_range: &NumericRange,
        browse_path: &[QualifiedName],
    ) -> Variant {
        self.get_value(attribute_id, index_range, browse_path)
    }

    fn time(&self) -> &DateTime {
        &self.base.time
    }

    fn event_type_id(&self) -> &NodeId {
        &self.base.event_type
    }
}

impl EventField for CheckEvent {
    fn get_value(
        &self,
        attribute_id: AttributeId,
        index_range: &NumericRange,
        remaining_path: &[QualifiedName],
    ) -> Variant {
        let [name] = remaining_path else {
            return Variant::Empty;
        };
        if name.namespace_index == 0 {
            return self
                .base
                .get_value(attribute_id, index_range, remaining_path);
        }
        if name.namespace_index != self.types.namespace || attribute_id != AttributeId::Value {
            return Variant::Empty;
        }
        let fields = event_fields(self.types);
        let mut named = fields.iter().zip(&self.values);
        let found = named.find(|((field, ..), _)| *field == name.name.as_ref());
        let value = found.map(|(_, value)| value);
        value
            .and_then(|value| value.range_of(index_range).ok())
            .unwrap_or_default()
    }
}
