//! Files of a period for metrologists: that their structure is what the formats demand, that another's reader finds in them what the history
//! has, and that nothing is exported that cannot be believed.

mod press;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use flankscope_metrology::gear::Flank;
use flankscope_metrology::verdict::Word;
use flankscope_record::document::Inspection;
use flankscope_test_requisites::{dfq_reader, qif_schema, workspace};
use flankscope_tests::state;
use press::{Press, inspection};
use roxmltree::{Document, Node};
use serde_json::Value;

/// A name that has to be escaped everywhere.
const TOOL: &str = "Gesenk <7> & \"Ö\"";

fn export(history: &Path, folder: &Path, more: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_flankscope-plant"));
    command.env("FLANKSCOPE_STATE", state());
    command.arg("export").arg(history).arg(folder).args(more);
    command.output().unwrap()
}

fn exported(history: &Path, folder: &Path, more: &[&str]) -> BTreeMap<String, Vec<u8>> {
    let output = export(history, folder, more);
    assert!(output.status.success(), "{output:?}");
    files(folder)
}

/// Contents of the files in a folder, by name.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap().map(Result::unwrap);
    entries
        .map(|entry| {
            let name = entry.file_name().into_string().unwrap();
            (name, std::fs::read(entry.path()).unwrap())
        })
        .collect()
}

fn with_extension<'a>(files: &'a BTreeMap<String, Vec<u8>>, extension: &str) -> Vec<&'a str> {
    let found = files.iter().filter(|(name, _)| name.ends_with(extension));
    found
        .map(|(_, content)| std::str::from_utf8(content).unwrap())
        .collect()
}

/// A no-go of two flanks and a patch, one of which was not measured.
fn mixed() -> Inspection {
    let mut check = inspection(TOOL, 40, Word::NoGo, 7000);
    check.die.serial = Some("S/N 4711".into());
    check.origin.operator = Some("Änne <tester>".into());
    check.reason = "tooth 40 left is beyond the stop limit\nby far".into();
    check.features[0].wear_um = Some(62.25);
    check.features[0].u95_um = Some(3.92);
    check.features[0].verdict = Word::NoGo;
    let mut unseen = check.features[0].clone();
    unseen.id.tooth = 41;
    (unseen.wear_um, unseen.u95_um) = (None, None);
    unseen.verdict = Word::Indeterminate;
    let mut patch = check.features[0].clone();
    (patch.id.tooth, patch.id.flank) = (1, Flank::Face);
    patch.id.patch = Some("land & \"corner\"".into());
    patch.wear_um = Some(-0.75);
    patch.verdict = Word::Go;
    check.features.extend([unseen, patch]);
    check
}

/// A history with a mixed no-go, a check of another tool, and one without a flank.
fn history(folder: &Path) -> PathBuf {
    let path = folder.join("press.db");
    let mut press = Press::new(&path);
    press.store(mixed());
    press.check("other", 40, Word::Go);
    let mut blind = inspection("other", 40, Word::Indeterminate, 8000);
    blind.features.clear();
    press.store(blind);
    path
}

/// Children of the types that occur, in the order of the schema's sequences (QIFDocument.xsd, QIFResults.xsd, Characteristics.xsd,
/// Traceability.xsd, IntermediatesPMI.xsd, Units.xsd of QIF 3.0). `!`: required.
const SEQUENCES: &[(&str, &[&str])] = &[
    // QIFDocumentType
    (
        "QIFDocument",
        &[
            "!QPId",
            "Header",
            "StandardsDefinitions",
            "FileUnits",
            "Characteristics",
            "Results",
        ],
    ),
    // QIFDocumentHeaderType
    (
        "Header",
        &[
            "Application",
            "Author",
            "ApplicationSource",
            "Description",
            "Scope",
        ],
    ),
    // StandardsDefinitionsType, StandardType
    ("StandardsDefinitions", &["!Standard"]),
    ("Standard", &["!Organization", "!Designator", "Year"]),
    ("Organization", &["!StandardsOrganizationEnum"]),
    // FileUnitsType, PrimaryUnitsType, LinearUnitType, UnitConversionType
    (
        "FileUnits",
        &["!PrimaryUnits", "OtherUnits", "UserDefinedUnits"],
    ),
    ("PrimaryUnits", &["AngularUnit", "LinearUnit"]),
    ("LinearUnit", &["SIUnitName", "!UnitName", "UnitConversion"]),
    ("UnitConversion", &["!Factor", "Offset"]),
    // CharacteristicAspectsListsType
    (
        "Characteristics",
        &[
            "!FormalStandardId",
            "!CharacteristicDefinitions",
            "!CharacteristicNominals",
            "CharacteristicItems",
        ],
    ),
    (
        "CharacteristicDefinitions",
        &["!UserDefinedLinearCharacteristicDefinition"],
    ),
    // CharacteristicBaseType, CharacteristicDefinitionBaseType, DimensionalCharacteristicDefinitionBaseType,
    // LinearCharacteristicDefinitionBaseType, UserDefinedLinearCharacteristicDefinitionType
    (
        "UserDefinedLinearCharacteristicDefinition",
        &[
            "Attributes",
            "Description",
            "Name",
            "CharacteristicDesignator",
            "!Tolerance",
            "!WhatToMeasure",
        ],
    ),
    // LinearToleranceType
    (
        "Tolerance",
        &["!MaxValue", "MinValue", "!DefinedAsLimit", "Attributes"],
    ),
    (
        "CharacteristicNominals",
        &["!UserDefinedLinearCharacteristicNominal"],
    ),
    // CharacteristicNominalBaseType, LinearCharacteristicNominalBaseType
    (
        "UserDefinedLinearCharacteristicNominal",
        &[
            "Attributes",
            "Description",
            "!CharacteristicDefinitionId",
            "Name",
            "CharacteristicDesignator",
            "TargetValue",
        ],
    ),
    (
        "CharacteristicItems",
        &["!UserDefinedLinearCharacteristicItem"],
    ),
    // CharacteristicItemBaseType
    (
        "UserDefinedLinearCharacteristicItem",
        &[
            "Attributes",
            "Description",
            "Name",
            "CharacteristicDesignator",
            "!CharacteristicNominalId",
        ],
    ),
    ("CharacteristicDesignator", &["!Designator", "UUID"]),
    // ResultsType, MeasurementResultsSetType, MeasurementResultsType
    (
        "Results",
        &[
            "Version",
            "!MeasurementResultsSet",
            "ActualComponentSets",
            "InspectionTraceability",
        ],
    ),
    ("MeasurementResultsSet", &["!MeasurementResults"]),
    (
        "MeasurementResults",
        &[
            "Attributes",
            "InspectionTraceability",
            "ThisResultsInstanceQPId",
            "MeasuredFeatures",
            "MeasuredCharacteristics",
            "!InspectionStatus",
            "ActualComponentIds",
        ],
    ),
    // InspectionTraceabilityType
    (
        "InspectionTraceability",
        &[
            "OrderNumber",
            "ReportNumber",
            "InspectionStart",
            "InspectionEnd",
            "InspectionOperator",
            "Attributes",
        ],
    ),
    ("MeasuredCharacteristics", &["!CharacteristicMeasurements"]),
    (
        "CharacteristicMeasurements",
        &["!UserDefinedLinearCharacteristicMeasurement"],
    ),
    // CharacteristicMeasurementBaseType, LinearCharacteristicMeasurementBaseType
    (
        "UserDefinedLinearCharacteristicMeasurement",
        &[
            "Attributes",
            "Description",
            "!Status",
            "!CharacteristicItemId",
            "TimeStamp",
            "ActualComponentId",
            "Value",
        ],
    ),
    // ActualComponentSetsType, ActualComponentSetType, ActualComponentType
    ("ActualComponentSets", &["!ActualComponentSet"]),
    ("ActualComponentSet", &["!ActualComponent"]),
    (
        "ActualComponent",
        &["Attributes", "SerialNumber", "!Status"],
    ),
    // CharacteristicStatusType or InspectionStatusType
    (
        "Status",
        &["CharacteristicStatusEnum", "InspectionStatusEnum"],
    ),
    ("InspectionStatus", &["!InspectionStatusEnum"]),
    // AttributesType: in any order.
    ("Attributes", &[]),
];

/// Types of lists: they state their length.
const LISTS: [&str; 9] = [
    "StandardsDefinitions",
    "CharacteristicDefinitions",
    "CharacteristicNominals",
    "CharacteristicItems",
    "MeasurementResultsSet",
    "CharacteristicMeasurements",
    "ActualComponentSets",
    "ActualComponentSet",
    "Attributes",
];

fn children<'a>(parent: Node<'a, 'a>) -> Vec<Node<'a, 'a>> {
    parent.children().filter(Node::is_element).collect()
}

fn name<'a>(node: &Node<'a, 'a>) -> &'a str {
    node.tag_name().name()
}

/// Descendants of that name.
fn all<'a>(document: &'a Document<'a>, wanted: &str) -> Vec<Node<'a, 'a>> {
    let found = document.descendants();
    found.filter(|node| name(node) == wanted).collect()
}

/// The text of a child.
fn text<'a>(parent: Node<'a, 'a>, child: &str) -> Option<&'a str> {
    let found = children(parent)
        .into_iter()
        .find(|node| name(node) == child);
    found.map(|node| node.text().unwrap())
}

fn attribute<'a>(parent: Node<'a, 'a>, wanted: &str) -> Option<&'a str> {
    let lists = children(parent)
        .into_iter()
        .filter(|node| name(node) == "Attributes");
    let mut found = lists.flat_map(children);
    let found = found.find(|node| node.attribute("name") == Some(wanted));
    found.and_then(|node| node.attribute("value"))
}

fn check_structure(document: &Document<'_>) {
    let sequences: BTreeMap<_, _> = SEQUENCES.iter().copied().collect();
    let mut ids = BTreeMap::new();
    for node in document.descendants().filter(Node::is_element) {
        assert_eq!(
            node.tag_name().namespace(),
            Some("http://qifstandards.org/xsd/qif3")
        );
        if let Some(id) = node.attribute("id") {
            let is_new = ids
                .insert(id.parse::<u32>().unwrap(), name(&node))
                .is_none();
            assert!(is_new, "id {id} twice");
        }
        let inside = children(node);
        if LISTS.contains(&name(&node)) {
            let n: usize = node.attribute("n").unwrap().parse().unwrap();
            assert!(n > 0 && n == inside.len(), "{}: n = {n}", name(&node));
        }
        let names: Vec<_> = inside.iter().map(name).collect();
        let Some(sequence) = sequences.get(name(&node)) else {
            assert!(names.is_empty(), "{} has children: {names:?}", name(&node));
            continue;
        };
        if sequence.is_empty() {
            continue;
        }
        let order: Vec<_> = sequence
            .iter()
            .map(|child| child.trim_start_matches('!'))
            .collect();
        let places: Vec<_> = names
            .iter()
            .map(|child| {
                order
                    .iter()
                    .position(|allowed| allowed == child)
                    .unwrap_or_else(|| panic!("{child} in {}", name(&node)))
            })
            .collect();
        assert!(places.is_sorted(), "{}: {names:?}", name(&node));
        for required in sequence.iter().filter_map(|child| child.strip_prefix('!')) {
            assert!(names.contains(&required), "{}: no {required}", name(&node));
        }
        let may_repeat = LISTS.contains(&name(&node));
        let distinct: BTreeSet<_> = names.iter().collect();
        assert!(may_repeat || distinct.len() == names.len(), "{names:?}");
    }
    let root = document.root_element();
    assert_eq!(root.attribute("versionQIF"), Some("3.0.0"));
    let id_max: u32 = root.attribute("idMax").unwrap().parse().unwrap();
    assert_eq!(ids.last_key_value().map(|(id, _)| *id), Some(id_max));
    // Keys and their references.
    for (reference, kind) in [
        ("FormalStandardId", "Standard"),
        (
            "CharacteristicDefinitionId",
            "UserDefinedLinearCharacteristicDefinition",
        ),
        (
            "CharacteristicNominalId",
            "UserDefinedLinearCharacteristicNominal",
        ),
        (
            "CharacteristicItemId",
            "UserDefinedLinearCharacteristicItem",
        ),
        ("ActualComponentId", "ActualComponent"),
    ] {
        for node in all(document, reference) {
            let id = node.text().unwrap().parse().unwrap();
            assert_eq!(ids.get(&id), Some(&kind), "{reference} {id}");
        }
    }
    // QPIdType
    for qpid in ["QPId", "ThisResultsInstanceQPId"] {
        let [node] = all(document, qpid)[..] else {
            panic!("one {qpid}");
        };
        let parts: Vec<_> = node.text().unwrap().split('-').collect();
        let is_hex = |part: &&str| part.bytes().all(|b| b.is_ascii_hexdigit());
        assert!(parts.iter().all(is_hex), "{parts:?}");
        assert_eq!(
            parts.iter().map(|part| part.len()).collect::<Vec<_>>(),
            [8, 4, 4, 4, 12]
        );
    }
}

#[test]
fn qif_documents_have_the_schemas_structure_and_the_historys_figures() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("files");
    let history = history(folder.path());
    let files = exported(&history, &out, &["--as", "qif"]);
    assert_eq!(files.len(), 3);
    let mut measurements = 0;
    for (file, content) in &files {
        let content = std::str::from_utf8(content).unwrap();
        let document = Document::parse(content).unwrap();
        check_structure(&document);
        let [traceability] = all(&document, "InspectionTraceability")[..] else {
            panic!("one traceability");
        };
        let id = attribute(traceability, "CheckId").unwrap();
        assert_eq!(*file, format!("{id}.qif"));
        assert_eq!(attribute(traceability, "Simulated"), Some("true"));
        assert!(
            text(all(&document, "Header")[0], "Description")
                .unwrap()
                .starts_with("SIMULATED")
        );
        measurements += all(&document, "UserDefinedLinearCharacteristicMeasurement").len();
        if attribute(traceability, "Tool") != Some(TOOL) {
            continue;
        }
        assert_eq!(attribute(traceability, "Operator"), Some("Änne <tester>"));
        assert_eq!(text(traceability, "ReportNumber"), Some("1"));
        assert_eq!(
            text(all(&document, "ActualComponent")[0], "SerialNumber"),
            Some("S/N 4711")
        );
        let status = all(&document, "InspectionStatusEnum");
        assert!(status.len() == 2 && status.iter().all(|node| node.text() == Some("FAIL")));
        assert_eq!(all(&document, "Factor")[0].text(), Some("0.001"));
        let limits: Vec<_> = all(&document, "MaxValue")
            .iter()
            .map(|node| node.text().unwrap())
            .collect();
        assert_eq!(limits, ["0.050000"; 3]);
        let measurements = all(&document, "UserDefinedLinearCharacteristicMeasurement");
        // By tooth: the patch is the first of its tool's file.
        let found: Vec<_> = measurements
            .iter()
            .map(|measurement| {
                let item = text(*measurement, "CharacteristicItemId").unwrap();
                let items = all(&document, "UserDefinedLinearCharacteristicItem");
                let item = items
                    .into_iter()
                    .find(|node| node.attribute("id") == Some(item))
                    .unwrap();
                let [designator] = children(children(item)[1])[..] else {
                    panic!("one designator");
                };
                (
                    designator.text().unwrap(),
                    text(children(*measurement)[1], "CharacteristicStatusEnum").unwrap(),
                    text(*measurement, "Value"),
                    attribute(*measurement, "U95"),
                )
            })
            .collect();
        assert_eq!(
            found,
            [
                (
                    "land & \"corner\"",
                    "PASS",
                    Some("-0.000750"),
                    Some("0.003920")
                ),
                ("40 left", "FAIL", Some("0.062250"), Some("0.003920")),
                ("41 left", "INDETERMINATE", None, None),
            ]
        );
        let value = all(&document, "Value")[1];
        // U95 is 1.96 standard uncertainties.
        assert_eq!(value.attribute("combinedUncertainty"), Some("0.002000"));
        assert_eq!(value.attribute("meanError"), Some("0"));
    }
    assert_eq!(measurements, 4);
    if let Some((schema, xmllint)) = qif_schema() {
        let mut validate = Command::new(xmllint);
        validate
            .args(["--noout", "--nonet", "--schema"])
            .arg(schema);
        validate.args(files.keys().map(|name| out.join(name)));
        let output = validate.output().unwrap();
        assert!(output.status.success(), "{output:?}");
    }
}

#[test]
fn dfq_files_state_every_field_and_a_flank_without_a_figure_has_no_value() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("files");
    let history = history(folder.path());
    let files = exported(&history, &out, &["--as", "dfq", "--tool", TOOL]);
    let [content] = with_extension(&files, ".dfq")[..] else {
        panic!("one file");
    };
    let path = out.join(files.keys().next().unwrap());
    let id = path.file_stem().unwrap().to_str().unwrap();
    // Not ASCII: it says that it is UTF-8.
    let content = content.strip_prefix('\u{feff}').unwrap();
    assert!(content.ends_with("\r\n") && content.lines().all(|line| line.starts_with('K')));
    assert_eq!(
        content.matches('\n').count(),
        content.matches("\r\n").count()
    );
    let fields: BTreeMap<_, _> = content
        .lines()
        .map(|line| line.split_once(' ').unwrap())
        .collect();
    assert_eq!(fields.len(), content.lines().count(), "a field twice");
    for (field, value) in [
        ("K0100", "3"),
        ("K1001", TOOL),
        ("K1002", TOOL),
        ("K1014", "S/N 4711"),
        ("K1203", "simulated check of wear"),
        ("K1206", "press 7"),
        ("K1222", "Änne <tester>"),
        ("K1802", id),
        ("K1812", "1"),
        ("K1832", "no-go"),
        ("K1842", "true"),
        (
            "K1900",
            "SIMULATED BENCH: no real die was looked at. tooth 40 left is beyond the stop limit by far",
        ),
        ("K2001/2", "40 left"),
        ("K2002/2", "wear of tooth 40, left flank"),
        ("K2004/2", "0"),
        ("K2022/2", "6"),
        ("K2101/2", "0.000000"),
        ("K2111/2", "0.050000"),
        ("K2120/2", "0"),
        ("K2121/2", "1"),
        ("K2142/2", "mm"),
        ("K2402/2", "demo, 20 mm"),
        ("K2802/2", "0.003920"),
        ("K2812/2", "0.030000"),
        ("K2822/2", "no-go"),
        ("K2822/3", "indeterminate"),
        ("K0001/1", "-0.000750"),
        ("K0001/2", "0.062250"),
        ("K0002/2", "0"),
        ("K0014/2", "S/N 4711"),
    ] {
        assert_eq!(fields.get(field), Some(&value), "{field}");
    }
    assert!(fields["K0009/2"].contains(id) && fields["K0009/2"].ends_with("simulated"));
    let time = fields["K0004/2"].as_bytes();
    assert!(
        time.len() == 19 && time[2] == b'.' && time[10] == b'/',
        "{time:?}"
    );
    for absent in ["K0001/3", "K0002/3", "K0004/3", "K2802/3", "K2110/2"] {
        assert!(!fields.contains_key(absent), "{absent}");
    }

    let Some(python) = dfq_reader() else {
        return;
    };
    let script = workspace().join("tools/peers/dfq_reader.py");
    let output = Command::new(python)
        .arg(script)
        .arg(&path)
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    let read: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(read["part"]["K1001"], TOOL);
    assert_eq!(read["part"]["K1802"], id);
    let characteristics = read["characteristics"].as_array().unwrap();
    let found: Vec<_> = characteristics
        .iter()
        .map(|characteristic| {
            let values = characteristic["values"].as_array().unwrap();
            let value = values.first().map(|value| {
                (
                    value["value"].as_str().unwrap(),
                    value["attribute"].as_i64(),
                )
            });
            (
                characteristic["fields"]["K2001"].as_str().unwrap(),
                characteristic["fields"]["K2111"].as_str().unwrap(),
                values.len(),
                value,
            )
        })
        .collect();
    assert_eq!(
        found,
        [
            (
                "land & \"corner\"",
                "0.050000",
                1,
                Some(("-0.000750", Some(0)))
            ),
            ("40 left", "0.050000", 1, Some(("0.062250", Some(0)))),
            ("41 left", "0.050000", 0, None),
        ]
    );
}

#[test]
fn a_period_and_a_tool_choose_and_twice_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("files");
    let history = history(folder.path());
    let once = exported(&history, &out, &["--as", "qif,dfq,csv"]);
    // A check without a flank is in no DFQ file.
    assert_eq!(
        (
            with_extension(&once, ".qif").len(),
            with_extension(&once, ".dfq").len()
        ),
        (3, 2)
    );
    let [csv] = with_extension(&once, ".csv")[..] else {
        panic!("one table");
    };
    assert!(
        csv.starts_with("check,at,") && csv.lines().count() == 1 + 4,
        "{csv}"
    );
    let twice = exported(&history, &out, &["--as", "qif,dfq,csv"]);
    assert_eq!(once, twice);
    // Inside the period or not at all: everything was stored just now.
    let long_ago = ["--as", "csv", "--until", "2020-12-31"];
    let elsewhere = folder.path().join("elsewhere");
    let refused = |more: &[&str], word: &str| {
        let output = export(&history, &elsewhere, more);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            output.status.code() == Some(3) && message.contains(word),
            "{output:?}"
        );
        assert!(!elsewhere.exists(), "nothing is made");
    };
    refused(&long_ago, "no check was stored in this period");
    refused(
        &[
            "--as",
            "csv",
            "--since",
            "2021-01-01",
            "--until",
            "2020-12-31",
        ],
        "is after",
    );
    refused(
        &["--as", "csv", "--tool", "unknown"],
        "--tool unknown: the history has checks of other",
    );
    if cfg!(not(feature = "parquet")) {
        refused(&["--as", "csv,parquet"], "--features parquet");
    }
    let chosen = exported(
        &history,
        &elsewhere,
        &["--as", "csv", "--tool", "other", "--since", "2021-01-01"],
    );
    let [table] = with_extension(&chosen, ".csv")[..] else {
        panic!("one table");
    };
    assert!(
        table.lines().count() == 2 && !table.contains("Gesenk"),
        "{table}"
    );
    assert!(
        chosen.keys().all(|name| name.starts_with("checks-other-")),
        "{chosen:?}"
    );
}

#[cfg(feature = "parquet")]
#[test]
fn a_period_is_a_parquet_file_too() {
    let folder = tempfile::tempdir().unwrap();
    let files = exported(
        &history(folder.path()),
        &folder.path().join("files"),
        &["--as", "parquet"],
    );
    let (name, bytes) = files.first_key_value().unwrap();
    assert!(files.len() == 1 && name.ends_with(".parquet"), "{name}");
    assert!(bytes.starts_with(b"PAR1") && bytes.ends_with(b"PAR1"));
}

#[test]
fn nothing_is_exported_of_a_history_that_was_edited() {
    let folder = tempfile::tempdir().unwrap();
    let history = history(folder.path());
    let mut bytes = std::fs::read(&history).unwrap();
    let word = b"beyond the stop limit";
    let places: Vec<_> = (0..bytes.len() - word.len())
        .filter(|&at| &bytes[at..at + word.len()] == word)
        .collect();
    assert!(!places.is_empty());
    for at in places {
        bytes[at] = b'B';
    }
    std::fs::write(&history, bytes).unwrap();
    let out = folder.path().join("files");
    let output = export(&history, &out, &["--as", "qif,dfq,csv"]);
    assert_eq!(output.status.code(), Some(3), "{output:?}");
    assert!(!out.exists());
}
