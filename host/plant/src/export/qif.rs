//! A check as a document of QIF 3.0 (ANSI/DMSC; ISO 23952): per flank a characteristic's definition, nominal, item and measurement.
//!
//! Elements stand in the order of the published schema; the name of its type is stated where one begins. Wear has no characteristic of
//! its own there (it is neither a profile nor a thickness), so it is a user-defined linear one.

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_metrology::verdict::{Code, Word};
use flankscope_record::history::FlankRow;

use super::xml::Xml;
use super::{
    DECIMALS, ExportedCheck, SIMULATED, characteristic, designation, measured, millimetres,
    one_line,
};

const NAMESPACE: &str = "http://qifstandards.org/xsd/qif3";

/// Ids within a document; they are unique in it.
const STANDARD: usize = 1;
const COMPONENT: usize = 2;
const RESULTS: usize = 3;

/// The ids of a flank's four elements.
#[derive(Clone, Copy)]
enum Aspect {
    Definition,
    Nominal,
    Item,
    Measurement,
}

impl Aspect {
    fn id(self, flank: usize) -> usize {
        RESULTS + 1 + 4 * flank + self as usize
    }
}

/// The document's text.
pub fn document(exported: &ExportedCheck) -> String {
    let flanks = exported.check.flanks.len();
    let id_max = (RESULTS + 4 * flanks).to_string();
    let root = [
        ("xmlns", NAMESPACE),
        ("versionQIF", "3.0.0"),
        ("idMax", id_max.as_str()),
    ];
    let mut xml = Xml::new();
    // QIFDocumentType
    xml.around("QIFDocument", &root, |xml| {
        xml.text("QPId", uuid("document", &exported.id));
        header(xml, exported);
        standards(xml);
        units(xml);
        // Lists of the schema are not empty.
        if flanks > 0 {
            characteristics(xml, &exported.check.flanks);
        }
        results(xml, exported);
    });
    xml.finish()
}

/// QIFDocumentHeaderType
fn header(xml: &mut Xml, exported: &ExportedCheck) {
    let check = &exported.check;
    let simulated = match check.origin.simulated {
        true => format!("{SIMULATED}. "),
        false => String::new(),
    };
    let description = format!(
        "{simulated}Check {} of {} at {}, {}; id {}. Wear is the largest mean loss over any disc of the stated area in a zone, \
         relative to its nominal 0; the upper limit is the stop limit.",
        check.id,
        one_line(&check.tool),
        one_line(&check.origin.station),
        check.at,
        exported.id
    );
    xml.around("Header", &[], |xml| {
        xml.text("Description", description);
        xml.text("Scope", "Results");
    });
}

/// StandardsDefinitionsType: by what the characteristics are judged.
fn standards(xml: &mut Xml) {
    xml.around("StandardsDefinitions", &[("n", "1")], |xml| {
        xml.around("Standard", &[("id", &STANDARD.to_string())], |xml| {
            xml.around("Organization", &[], |xml| {
                xml.text("StandardsOrganizationEnum", "ISO");
            });
            xml.text("Designator", "14253-1");
            xml.text("Year", "2017");
        });
    });
}

/// FileUnitsType
fn units(xml: &mut Xml) {
    xml.around("FileUnits", &[], |xml| {
        xml.around("PrimaryUnits", &[], |xml| {
            // LinearUnitType
            xml.around("LinearUnit", &[], |xml| {
                xml.text("SIUnitName", "meter");
                xml.text("UnitName", "mm");
                xml.around("UnitConversion", &[], |xml| xml.text("Factor", "0.001"));
            });
        });
    });
}

/// CharacteristicAspectsListsType
fn characteristics(xml: &mut Xml, flanks: &[FlankRow]) {
    let n = flanks.len().to_string();
    let n = [("n", n.as_str())];
    let all = || flanks.iter().enumerate();
    let id = |aspect: Aspect, flank| aspect.id(flank).to_string();
    xml.around("Characteristics", &[], |xml| {
        xml.text("FormalStandardId", STANDARD);
        xml.around("CharacteristicDefinitions", &n, |xml| {
            for (i, flank) in all() {
                let own = [("id", &*id(Aspect::Definition, i))];
                // UserDefinedLinearCharacteristicDefinitionType
                xml.around("UserDefinedLinearCharacteristicDefinition", &own, |xml| {
                    xml.text("Name", one_line(&characteristic(flank)));
                    // LinearToleranceType
                    xml.around("Tolerance", &[], |xml| {
                        let places = DECIMALS.to_string();
                        let places = [("decimalPlaces", places.as_str())];
                        xml.text_with("MaxValue", &places, millimetres(flank.limit_um));
                        xml.text("DefinedAsLimit", true);
                    });
                    xml.text("WhatToMeasure", one_line(&characteristic(flank)));
                });
            }
        });
        xml.around("CharacteristicNominals", &n, |xml| {
            for (i, _) in all() {
                let own = [("id", &*id(Aspect::Nominal, i))];
                // UserDefinedLinearCharacteristicNominalType
                xml.around("UserDefinedLinearCharacteristicNominal", &own, |xml| {
                    xml.text("CharacteristicDefinitionId", Aspect::Definition.id(i));
                    xml.text("TargetValue", 0);
                });
            }
        });
        xml.around("CharacteristicItems", &n, |xml| {
            for (i, flank) in all() {
                let own = [("id", &*id(Aspect::Item, i))];
                // UserDefinedLinearCharacteristicItemType
                xml.around("UserDefinedLinearCharacteristicItem", &own, |xml| {
                    xml.text("Name", one_line(&characteristic(flank)));
                    xml.around("CharacteristicDesignator", &[], |xml| {
                        xml.text("Designator", one_line(&designation(flank)));
                    });
                    xml.text("CharacteristicNominalId", Aspect::Nominal.id(i));
                });
            }
        });
    });
}

/// ResultsType
fn results(xml: &mut Xml, exported: &ExportedCheck) {
    let check = &exported.check;
    let status = |xml: &mut Xml, name: &str| {
        xml.around(name, &[], |xml| {
            xml.text("InspectionStatusEnum", inspection_status(check.verdict));
        });
    };
    xml.around("Results", &[], |xml| {
        xml.around("MeasurementResultsSet", &[("n", "1")], |xml| {
            let own = [("id", &*RESULTS.to_string())];
            // MeasurementResultsType
            xml.around("MeasurementResults", &own, |xml| {
                traceability(xml, exported);
                xml.text("ThisResultsInstanceQPId", uuid("results", &exported.id));
                if !check.flanks.is_empty() {
                    xml.around("MeasuredCharacteristics", &[], |xml| {
                        let n = check.flanks.len().to_string();
                        xml.around("CharacteristicMeasurements", &[("n", &*n)], |xml| {
                            for (i, flank) in check.flanks.iter().enumerate() {
                                measurement(xml, i, flank, &check.at);
                            }
                        });
                    });
                }
                status(xml, "InspectionStatus");
            });
        });
        // The die itself.
        xml.around("ActualComponentSets", &[("n", "1")], |xml| {
            xml.around("ActualComponentSet", &[("n", "1")], |xml| {
                let own = [("id", &*COMPONENT.to_string())];
                // ActualComponentType
                xml.around("ActualComponent", &own, |xml| {
                    if let Some(serial) = &check.serial {
                        xml.text("SerialNumber", one_line(serial));
                    }
                    status(xml, "Status");
                });
            });
        });
    });
}

/// An attribute of AttributesType: its element, name and value.
type Attribute = (&'static str, &'static str, String);

fn attributes(xml: &mut Xml, all: &[Attribute]) {
    xml.around("Attributes", &[("n", &all.len().to_string())], |xml| {
        for (element, name, value) in all {
            xml.empty(element, &[("name", name), ("value", value)]);
        }
    });
}

/// InspectionTraceabilityType: what QIF has no element for, or only one that wants more than is known, is an attribute.
fn traceability(xml: &mut Xml, exported: &ExportedCheck) {
    let check = &exported.check;
    let origin = &check.origin;
    let text = |name, value: &str| ("AttributeStr", name, one_line(value));
    let number = |name, value: i64| ("AttributeI1", name, value.to_string());
    let mut all = vec![
        text("CheckId", &exported.id),
        ("AttributeBool", "Simulated", origin.simulated.to_string()),
        text("Tool", &check.tool),
        number("ToolCycles", check.tool_cycles),
        number("PressCycles", check.press_cycles),
        text("Station", &origin.station),
        text("Head", &origin.head.name),
        text("HeadBlake3", &origin.head.blake3),
        text("HeadSeal", &origin.head.seal),
        text("Link", &origin.link),
        text("Verdict", check.verdict.as_str()),
        text("Reason", &check.reason),
    ];
    let optional = [
        ("Operator", &origin.operator),
        ("BaselineBlake3", &check.baseline),
    ];
    for (name, value) in optional {
        all.extend(value.as_deref().map(|value| text(name, value)));
    }
    xml.around("InspectionTraceability", &[], |xml| {
        xml.text("ReportNumber", check.id);
        xml.text("InspectionEnd", &check.at);
        attributes(xml, &all);
    });
}

/// UserDefinedLinearCharacteristicMeasurementType
fn measurement(xml: &mut Xml, i: usize, flank: &FlankRow, at: &str) {
    let own = [("id", &*Aspect::Measurement.id(i).to_string())];
    let value = measured(flank);
    // An uncertainty belongs to a value.
    let u95_um = flank
        .u95_um
        .filter(|u95_um| value.is_some() && *u95_um >= 0.0);
    let length = |name, um| ("AttributeD1", name, millimetres(um));
    let mut all = vec![
        ("AttributeStr", "Verdict", flank.verdict.to_string()),
        length("WarnLimit", flank.warn_um),
    ];
    if let Some(u95_um) = u95_um {
        all.push(length("U95", u95_um));
        all.push(("AttributeD1", "CoverageFactor", COVERAGE_95.to_string()));
    }
    all.extend(
        flank
            .code
            .map(|code| ("AttributeStr", "Code", Code::word(code).to_owned())),
    );
    xml.around("UserDefinedLinearCharacteristicMeasurement", &own, |xml| {
        attributes(xml, &all);
        xml.around("Status", &[], |xml| {
            xml.text(
                "CharacteristicStatusEnum",
                characteristic_status(flank.verdict),
            );
        });
        xml.text("CharacteristicItemId", Aspect::Item.id(i));
        xml.text("TimeStamp", at);
        xml.text("ActualComponentId", COMPONENT);
        // MeasuredLinearValueType: combined standard uncertainty and mean error come together; what is known of a systematic
        // deviation is corrected.
        if let Some(wear_um) = value {
            let places = DECIMALS.to_string();
            let combined = u95_um.map(|u95_um| millimetres(u95_um / COVERAGE_95));
            let mut with = vec![("decimalPlaces", places.as_str())];
            if let Some(combined) = &combined {
                with.extend([
                    ("combinedUncertainty", combined.as_str()),
                    ("meanError", "0"),
                ]);
            }
            xml.text_with("Value", &with, millimetres(wear_um));
        }
    });
}

/// CharacteristicStatusEnumType. A warning lies within the limit.
fn characteristic_status(verdict: Word) -> &'static str {
    match verdict {
        Word::Go | Word::Warn => "PASS",
        Word::NoGo => "FAIL",
        Word::Indeterminate => "INDETERMINATE",
    }
}

/// InspectionStatusEnumType
fn inspection_status(verdict: Word) -> &'static str {
    match verdict {
        Word::Go | Word::Warn => "PASS",
        Word::NoGo => "FAIL",
        Word::Indeterminate => "UNKNOWN",
    }
}

/// QPIdType: the same one every time for the same thing of the same check (RFC 9562, version 8).
fn uuid(thing: &str, id: &str) -> String {
    let hash = blake3::hash(format!("flankscope QIF {thing} {id}").as_bytes());
    let mut bytes = [0; 16];
    bytes.copy_from_slice(&hash.as_bytes()[..16]);
    bytes[6] = bytes[6] & 0x0f | 0x80;
    bytes[8] = bytes[8] & 0x3f | 0x80;
    let hex = |bytes: &[u8]| -> String { bytes.iter().map(|b| format!("{b:02x}")).collect() };
    let parts = [0..4, 4..6, 6..8, 8..10, 10..16].map(|part| hex(&bytes[part]));
    parts.join("-")
}
