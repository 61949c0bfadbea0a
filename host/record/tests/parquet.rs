//! A history as a Parquet file, read back by the format's own reader.

mod inspections;

use flankscope_metrology::verdict::{Code, Word};
use flankscope_record::history::{History, parquet};
use inspections::inspection;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::{Field, Row};

#[test]
fn every_figure_is_there_and_what_is_missing_is_null() {
    let folder = tempfile::tempdir().unwrap();
    let mut history =
        History::open(&folder.path().join("press.db"), &inspections::seals()).unwrap();
    let mut first = inspection(8, Word::Go, "");
    first.origin.operator = Some("Ada".into());
    history.record(&first, None).unwrap();
    let mut lost = inspection(16, Word::Indeterminate, "");
    lost.features[0].wear_um = None;
    lost.features[0].u95_um = None;
    lost.features[0].code = Some(Code::FramesMissing);
    history.record(&lost, None).unwrap();
    let checks = history.checks("die").unwrap();

    let path = folder.path().join("history.parquet");
    std::fs::write(&path, parquet(&checks).unwrap()).unwrap();
    let reader = SerializedFileReader::new(std::fs::File::open(path).unwrap()).unwrap();
    let rows: Vec<Row> = reader
        .get_row_iter(None)
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap();
    let field = |row: &Row, name: &str| {
        let mut columns = row.get_column_iter();
        columns.find(|(of, _)| *of == name).unwrap().1.clone()
    };
    let expected: Vec<_> = checks
        .iter()
        .flat_map(|check| check.flanks.iter().map(move |flank| (check, flank)))
        .collect();
    assert_eq!(rows.len(), expected.len());
    for (row, (check, flank)) in rows.iter().zip(expected) {
        let text = |text: &str| Field::Str(text.to_owned());
        let of = |word: &Option<String>| word.as_deref().map_or(Field::Null, text);
        let origin = &check.origin;
        let number = |value: Option<f64>| value.map_or(Field::Null, Field::Double);
        for (name, value) in [
            ("check", Field::Long(check.id)),
            ("at", text(&check.at)),
            ("tool", text("die")),
            ("tool_cycles", Field::Long(check.tool_cycles)),
            ("press_cycles", Field::Long(check.press_cycles)),
            ("baseline", Field::Null),
            ("check_verdict", text(check.verdict.as_str())),
            ("tooth", Field::Int(flank.id.tooth as i32)),
            ("flank", text(flank.id.flank.word())),
            ("wear_um", number(flank.wear_um)),
            ("u95_um", number(flank.u95_um)),
            ("warn_um", Field::Double(30.0)),
            ("limit_um", Field::Double(50.0)),
            ("verdict", text(flank.verdict.as_str())),
            (
                "code",
                flank.code.map_or(Field::Null, |code| text(code.word())),
            ),
            ("link", text("sim")),
            ("simulated", Field::Bool(true)),
            ("head", text("demo, 20 mm")),
            ("head_blake3", text(&origin.head.blake3)),
            ("station", text("press 7")),
            ("operator", of(&origin.operator)),
            ("patch", Field::Null),
        ] {
            assert_eq!(field(row, name), value, "{name} of {flank:?}");
        }
    }
    assert_eq!(field(&rows[6], "wear_um"), Field::Null);
    assert_eq!(field(&rows[0], "operator"), Field::Str("Ada".into()));
    assert_eq!(field(&rows[6], "operator"), Field::Null);
    assert!(!parquet(&[]).unwrap().is_empty());
}
