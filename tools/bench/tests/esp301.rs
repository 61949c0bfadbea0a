//! The stage controller alone, behind a pseudo-terminal, driven as other people's ESP301 clients do.

use flankscope_bench::devices::esp301;
use std::io::{Read, Write};
use std::time::Duration;

struct Client(Box<dyn serialport::SerialPort>);

impl Client {
    fn open(stages: &esp301::Stages) -> Self {
        let path = stages.port().to_string_lossy().into_owned();
        let port = serialport::new(path, 921_600)
            .timeout(Duration::from_secs(20))
            .open()
            .expect("the port opens");
        Self(port)
    }

    fn say(&mut self, line: &str) {
        self.0
            .write_all(format!("{line}\r").as_bytes())
            .expect("written");
    }

    /// One line of answer, without its carriage return and line feed.
    fn ask(&mut self, line: &str) -> String {
        self.say(line);
        self.answer()
    }

    fn answer(&mut self) -> String {
        let mut text = Vec::new();
        while !text.ends_with(b"\r\n") {
            let mut byte = [0];
            self.0.read_exact(&mut byte).expect("an answer");
            text.push(byte[0]);
        }
        text.truncate(text.len() - 2);
        String::from_utf8(text).expect("text")
    }
}

#[test]
fn the_questions_that_clients_ask_when_they_connect_have_answers() {
    let stages = esp301::run(1.0, 1).expect("a pseudo-terminal");
    let mut client = Client::open(&stages);
    assert!(client.ask("VE?").starts_with("ESP301 Version"));
    for (axis, name, unit, low, high) in [
        (1, "URS150BCC", "7", "-361.0", "361.0"),
        (2, "IMS300V", "2", "-150.0", "150.0"),
    ] {
        assert!(client.ask(&format!("{axis}ID?")).starts_with(name));
        assert_eq!(client.ask(&format!("{axis}SN?")), unit);
        assert_eq!(client.ask(&format!("{axis}SL?")), low);
        assert_eq!(client.ask(&format!("{axis}SR?")), high);
        assert_eq!(client.ask(&format!("{axis}MO?")), "0");
        client.say(&format!("{axis}MO"));
        assert_eq!(client.ask(&format!("{axis}MO?")), "1");
        client.say(&format!("{axis}MF"));
        assert_eq!(client.ask(&format!("{axis}MO?")), "0");
    }
    assert_eq!(client.ask("TE?"), "0");
    assert_eq!(client.ask("TE"), "0");
    assert!(client.ask("TB?").starts_with("0, "));
}

#[test]
fn a_client_moves_waits_reads_and_sets_its_own_zero() {
    let stages = esp301::run(20.0, 1).expect("a pseudo-terminal");
    let mut client = Client::open(&stages);
    client.say("1MO");
    client.say("1VA40");
    client.say("1PA10");
    // Accepted is not done.
    assert_eq!(client.ask("1MD?"), "0");
    // Wait for stop: the answer behind it comes when the axis stands.
    assert_eq!(client.ask("1WS100;1MD?"), "1");
    assert_eq!(client.ask("1TP?"), "10.000000");
    // What can only be read is answered without a question mark too.
    assert_eq!(client.ask("1TP"), "10.000000");
    assert_eq!(client.ask("1MD"), "1");
    client.say("1DH");
    assert_eq!(client.ask("1TP?"), "0.000000");
    client.say("1PR-2.5");
    assert_eq!(client.ask("1WS;1TP?"), "-2.500000");
    client.say("1OR;1WS");
    assert_eq!(client.ask("1TP?"), "0.000000");
    assert_eq!(client.ask("TE?"), "0");
}

#[test]
fn errors_have_their_numbers_and_move_nothing() {
    let stages = esp301::run(20.0, 1).expect("a pseudo-terminal");
    let mut client = Client::open(&stages);
    for (line, code) in [
        ("1PA5", "113"),
        ("2MO;2PA999", "206"),
        ("2PA-999", "207"),
        ("1XY3", "6"),
        ("7PA1", "9"),
        ("1MO;1VA500", "110"),
        ("1PA", "38"),
    ] {
        client.say(line);
        assert_eq!(client.ask("TE?"), code, "{line}");
    }
    assert_eq!(client.ask("1TP?"), "0.000000");
    assert_eq!(client.ask("2TP?"), "100.000000");
}

/// A carriage return ends a line; a line feed means nothing, wherever it stands.
#[test]
fn lines_end_with_a_carriage_return() {
    let stages = esp301::run(20.0, 1).expect("a pseudo-terminal");
    let mut client = Client::open(&stages);
    for text in ["1SN?\r", "1SN?\r\n", "1SN?\n\r", "\n1S\nN?\r", " 1 sn ? \r"] {
        client.0.write_all(text.as_bytes()).expect("written");
        assert_eq!(client.answer(), "7", "{text:?}");
    }
    // Nothing is carried out, or answered, before there is one.
    client.0.write_all(b"1MO\n1MO?\n").expect("written");
    assert_eq!(client.ask(";2SN?"), "2");
    assert_eq!(client.ask("TE?"), "6");
}

#[test]
fn what_waits_holds_back_what_comes_after_it() {
    let stages = esp301::run(20.0, 1).expect("a pseudo-terminal");
    let mut client = Client::open(&stages);
    client.say("1MO;1PA20;1WP10");
    let passed: f64 = client.ask("1TP?").parse().expect("a position");
    assert!((10.0..20.0).contains(&passed), "{passed}");
    assert_eq!(client.ask("1WS;1WP5;TE?"), "101");
    client.say("3XX;3EP;1PA4;1WS;QP");
    assert_eq!(client.ask("1TP?"), "20.000000");
    assert_eq!(client.ask("3EX;1TP?"), "4.000000");
    assert_eq!(client.ask("4EX;TE?"), "35");
    assert_eq!(client.ask("WT70000;TE?"), "7");
}

/// PyMeasure's and InstrumentKit's whole interfaces: every public method and attribute of either is used.
#[test]
fn clients_of_other_people_find_everything_they_ask_for() {
    let Some(python) = flankscope_test_requisites::stage_clients() else {
        return;
    };
    let stages = esp301::run(20.0, 1).expect("a pseudo-terminal");
    let script = flankscope_test_requisites::workspace().join("tools/peers/stage_clients.py");
    let output = std::process::Command::new(python)
        .arg(script)
        .arg(stages.port())
        .output()
        .expect("Python starts");
    let said = String::from_utf8_lossy(&output.stdout);
    let complaints = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}\n{complaints}");
    println!("{said}");
}
