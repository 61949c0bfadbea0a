//! The plant's OPC UA server to other people's client: who comes in, what it shows, what it tells, and that it says nothing good of
//! what it does not know.

mod press;
mod process;

use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use flankscope_metrology::verdict::Word;
use flankscope_record::history::History;
use flankscope_record::seal::Seals;
use flankscope_test_requisites::{opcua_clients, workspace};
use flankscope_tests::{Killed, state};
use press::Press;
use process::{AT_MOST, Plant, free_port, lines_of, wait_for};
use serde_json::{Value, json};

const SECURE: &str = "Basic256Sha256";
const STATION: &str = "Machines|press 7";

/// A folder with settings and users, and other people's client.
struct Station {
    folder: tempfile::TempDir,
    port: u16,
    page: u16,
    modbus: u16,
    python: PathBuf,
    /// Tokens of who may view and of who may acknowledge.
    screen: String,
    anna: String,
}

impl Station {
    /// None where the client is missing.
    fn new() -> Option<Self> {
        let python = opcua_clients()?;
        let folder = tempfile::tempdir().unwrap();
        let users = folder.path().join("users.toml");
        let token = |name: &str, role: &str| {
            let mut command = Command::new(env!("CARGO_BIN_EXE_flankscope-plant"));
            command.args(["token", name, "--role", role, "--users"]);
            let output = command.arg(&users).output().unwrap();
            assert!(output.status.success(), "{output:?}");
            String::from_utf8(output.stdout).unwrap().trim().to_owned()
        };
        Some(Self {
            screen: token("screen", "view"),
            anna: token("Anna", "acknowledge"),
            port: free_port(),
            page: free_port(),
            modbus: free_port(),
            folder,
            python,
        })
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn history(&self) -> PathBuf {
        self.file("press.db")
    }

    fn plant(&self, stale_after_s: u32) -> Plant {
        let Self {
            port, page, modbus, ..
        } = self;
        let settings = format!(
            "history = \"press.db\"\nstale_after_s = {stale_after_s}\n\
             [page]\nlisten = \"127.0.0.1:{page}\"\nusers = \"users.toml\"\n\
             [modbus]\nlisten = \"127.0.0.1:{modbus}\"\n\
             [opcua]\nlisten = \"127.0.0.1:{port}\"\nusers = \"users.toml\"\ncertificates = \"certificates\"\n"
        );
        let file = self.file("plant.toml");
        std::fs::write(&file, settings).unwrap();
        let mut plant = Plant::start(&file);
        // Making a key takes seconds, and the server behind the gate begins a little later.
        plant.says("own certificate");
        plant
    }

    fn url(&self) -> String {
        format!("opc.tcp://127.0.0.1:{}/", self.port)
    }

    /// A client with a certificate of its own.
    fn client(&self, name: &str) -> Client {
        let child = Command::new(&self.python)
            .arg(workspace().join("tools/peers/opcua_clients.py"))
            .arg(self.folder.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn();
        let mut child = child.unwrap();
        let mut client = Client {
            lines: lines_of(child.stdout.take().unwrap()),
            commands: child.stdin.take().unwrap(),
            heard: Vec::new(),
            name: name.to_owned(),
            url: self.url(),
            _process: Killed(child),
        };
        client.must(json!({"do": "certificate", "name": name}));
        client
    }

    /// The certificate of this client in a folder of the server.
    fn certificate(&self, folder: &str, client: &str) -> Option<PathBuf> {
        let files = std::fs::read_dir(self.file("certificates").join(folder));
        let files = files.into_iter().flatten().flatten();
        let named = |file: &PathBuf| {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with(&format!("CN=urn:client:{client} ["))
        };
        files.map(|file| file.path()).find(named)
    }

    /// What a person does for a client: lets it be refused once, and moves its certificate to the trusted ones.
    fn trust(&self, client: &mut Client) {
        // The server may still be starting.
        wait_for(|| {
            let _refused = client.connect(&self.screen, "screen", SECURE);
            self.certificate("rejected", &client.name)
        });
        let refused = self.certificate("rejected", &client.name).unwrap();
        let trusted = self
            .file("certificates/trusted")
            .join(refused.file_name().unwrap());
        std::fs::rename(refused, trusted).unwrap();
    }

    /// A client that is trusted and has come in to look.
    fn viewer(&self, name: &str) -> Client {
        let mut client = self.client(name);
        self.trust(&mut client);
        client.connect(&self.screen, "screen", SECURE).unwrap();
        client
    }
}

/// Other people's client.
struct Client {
    lines: Receiver<String>,
    commands: std::process::ChildStdin,
    /// What a subscription brought and nobody has looked at.
    heard: Vec<Value>,
    name: String,
    url: String,
    _process: Killed,
}

impl Client {
    fn line(&mut self, end: Instant) -> Option<Value> {
        let remaining = end.saturating_duration_since(Instant::now());
        let line = self.lines.recv_timeout(remaining).ok()?;
        Some(serde_json::from_str(&line).unwrap())
    }

    /// The answer to a command, or the name of the status with which it was refused.
    fn ask(&mut self, command: Value) -> Result<Value, String> {
        writeln!(self.commands, "{command}").unwrap();
        let end = Instant::now() + 2 * AT_MOST;
        loop {
            let line = self
                .line(end)
                .unwrap_or_else(|| panic!("no answer to {command}"));
            if let Some(refused) = line["refused"].as_str() {
                return Err(format!("{refused}: {}", line["why"]));
            }
            match line.get("answer") {
                Some(answer) => return Ok(answer.clone()),
                None => self.heard.push(line),
            }
        }
    }

    fn must(&mut self, command: Value) -> Value {
        self.ask(command.clone())
            .unwrap_or_else(|refused| panic!("{command}: {refused}"))
    }

    fn connect(&mut self, password: &str, user: &str, policy: &str) -> Result<Value, String> {
        let how = self.how(password, user, policy);
        self.ask(how)
    }

    fn how(&self, password: &str, user: &str, policy: &str) -> Value {
        json!({
            "do": "connect", "url": self.url, "user": user, "password": password, "certificate": self.name, "policy": policy,
        })
    }

    fn browse(&mut self) -> Value {
        self.must(json!({"do": "browse"}))
    }

    /// All that can be browsed, once there is this path.
    fn browse_until(&mut self, path: &str) -> Value {
        let end = Instant::now() + AT_MOST;
        loop {
            let all = self.browse();
            if !all[path].is_null() {
                return all;
            }
            assert!(Instant::now() < end, "no {path} in {all:#}");
        }
    }

    fn read(&mut self, path: &str) -> Value {
        self.must(json!({"do": "read", "path": path}))
    }

    /// What is read of a path, once it is like this.
    fn read_until(&mut self, path: &str, like: impl Fn(&Value) -> bool) -> Value {
        let end = Instant::now() + AT_MOST;
        loop {
            let value = self.read(path);
            if like(&value) {
                return value;
            }
            assert!(Instant::now() < end, "{path} is {value}");
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// The first thing that a subscription brings, or has brought, that is like this.
    fn until(&mut self, like: impl Fn(&Value) -> bool) -> Value {
        let end = Instant::now() + AT_MOST;
        loop {
            if let Some(at) = self.heard.iter().position(&like) {
                return self.heard.remove(at);
            }
            match self.line(end) {
                Some(line) => self.heard.push(line),
                None => panic!("not heard: {:#?}", self.heard),
            }
        }
    }
}

fn tool(name: &str, path: &str) -> String {
    format!("{STATION}|Tools|{name}|{path}")
}

#[test]
fn nobody_comes_in_whose_certificate_or_token_is_unknown() {
    let Some(station) = Station::new() else {
        return;
    };
    Press::new(&station.history()).check("die", 40, Word::Go);
    let _plant = station.plant(3600);
    let key = station.file("certificates/own/flankscope-plant.key.pem");
    let mode = std::fs::metadata(&key).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    let mut client = station.client("plc");
    let endpoints = json!({"do": "endpoints", "url": station.url()});
    let end = Instant::now() + AT_MOST;
    let found = loop {
        match client.ask(endpoints.clone()) {
            Ok(found) => break found,
            Err(refused) => assert!(Instant::now() < end, "{refused}"),
        }
    };
    let found = found.as_array().unwrap().clone();
    let policies: Vec<_> = found
        .iter()
        .map(|endpoint| endpoint["policy"].as_str().unwrap())
        .collect();
    assert_eq!(policies.len(), 2);
    for endpoint in &found {
        assert_eq!(endpoint["mode"], "SignAndEncrypt", "{endpoint}");
        assert_eq!(endpoint["tokens"], json!(["UserName"]), "{endpoint}");
        assert_eq!(endpoint["url"], station.url(), "{endpoint}");
    }
    // Without security, discovery is all.
    let clear = json!({"do": "connect", "url": station.url(), "user": "screen", "password": station.screen});
    let refused = client.ask(clear).unwrap_err();
    assert!(!refused.is_empty());
    // An unknown certificate, also with a token that is right.
    let refused = client.connect(&station.anna, "Anna", SECURE).unwrap_err();
    assert!(refused.contains("BadCertificateUntrusted"), "{refused}");
    assert!(station.certificate("rejected", "plc").is_some());
    // To copy it is not enough while it is among the refused.
    let refused = station.certificate("rejected", "plc").unwrap();
    let trusted = station
        .file("certificates/trusted")
        .join(refused.file_name().unwrap());
    std::fs::copy(&refused, &trusted).unwrap();
    assert!(client.connect(&station.anna, "Anna", SECURE).is_err());
    std::fs::remove_file(&refused).unwrap();
    for policy in ["Basic256Sha256", "Aes256_Sha256_RsaPss"] {
        assert!(policies.contains(&policy));
        for (user, token) in [
            ("Anna", "0000"),
            ("Anna", ""),
            ("Anna", &station.screen),
            ("nobody", &station.anna),
        ] {
            let refused = client.connect(token, user, policy).unwrap_err();
            assert!(
                refused.contains("BadIdentityTokenRejected"),
                "{user}: {refused}"
            );
        }
        let mut anonymous = client.how("", "", policy);
        anonymous["user"] = Value::Null;
        assert!(client.ask(anonymous).is_err());
        let mut signed = client.how(&station.anna, "Anna", policy);
        signed["mode"] = json!("Sign");
        assert!(client.ask(signed).is_err());
        client.connect(&station.anna, "Anna", policy).unwrap();
        client.browse_until(&tool("die", "Verdict"));
        client.must(json!({"do": "disconnect"}));
    }
    // Another client's certificate with this name is another one.
    let mut other = station.client("plc");
    assert!(other.connect(&station.anna, "Anna", SECURE).is_err());
}

#[test]
fn everything_is_browsed_read_and_decoded() {
    let Some(station) = Station::new() else {
        return;
    };
    let mut press = Press::new(&station.history());
    let strange = "Gesenk 9/a;#1 %2F ü";
    let long = "long ".repeat(60);
    for name in ["die", strange, &long, "a|b"] {
        press.check(name, 40, Word::Warn);
    }
    press.check("die", 41, Word::Indeterminate);
    let _plant = station.plant(3600);
    let mut client = station.viewer("browser");
    let all = client.browse_until(&tool(strange, "Verdict"));
    let at = |path: &str| {
        let node = &all[path];
        assert!(!node.is_null(), "{path} is not in {all:#}");
        node
    };
    let value = |path: &str| {
        let node = at(path);
        assert_eq!(node["status"], "Good", "{path}: {node}");
        &node["value"]
    };
    assert_eq!(value("Plant|HistoryFault"), "");
    assert_eq!(value("Plant|StaleAfter"), 3_600_000.0);
    assert_eq!(
        value(&format!("{STATION}|Identification|Manufacturer")),
        "flankscope"
    );
    assert_eq!(
        value(&format!("{STATION}|Identification|ComponentName")),
        "press 7"
    );
    assert_eq!(at("Machines")["class"], "Object");
    assert_eq!(value(&tool("die", "Verdict")), "indeterminate");
    assert_eq!(value(&tool("die", "Evaluation")), 3);
    assert_eq!(value(&tool(strange, "Verdict")), "warn");
    assert_eq!(value(&tool(strange, "Evaluation")), 1);
    assert_eq!(value(&tool("die", "Counts")), true);
    assert_eq!(value(&tool("die", "Latched")), false);
    assert_eq!(at(&tool("die", "Acknowledge"))["class"], "Method");
    let latest = |path: &str| tool("die", &format!("Results|Latest|{path}"));
    assert_eq!(value(&latest("Number")), 5);
    assert_eq!(value(&latest("ResultEvaluation")), 3);
    assert_eq!(value(&latest("ResultEvaluationDetails")), "as stated");
    assert_eq!(value(&latest("IsSimulated")), true);
    let id = value(&latest("ResultId")).as_str().unwrap().to_owned();
    assert_eq!(id.len(), 64);
    let flank = |path: &str| latest(&format!("Characteristics|tooth 41 left|{path}"));
    for (name, um) in [
        ("ResultValue", 25.5),
        ("ExpandedUncertainty", 4.0),
        ("WarningLimit", 30.0),
        ("UpperLimit", 50.0),
    ] {
        assert_eq!(value(&flank(name)), um, "{name}");
        let unit = value(&flank(&format!("{name}|EngineeringUnits")));
        assert_eq!(
            (&unit["UnitId"], &unit["DisplayName"]),
            (&json!(13_384), &json!("µm"))
        );
    }
    // Names stay apart, and identifiers short.
    let ids: std::collections::BTreeSet<&str> = all
        .as_object()
        .unwrap()
        .values()
        .map(|node| node["id"].as_str().unwrap())
        .collect();
    assert_eq!(ids.len(), all.as_object().unwrap().len());
    assert!(ids.iter().all(|id| id.len() < 400));
    // As one structure, by the types that the server describes.
    let types = client.must(json!({"do": "types"}));
    for name in [
        "CharacteristicDataType",
        "ResultDataType",
        "ResultEvaluationEnum",
        "ResultMetaDataType",
    ] {
        assert!(types.as_array().unwrap().contains(&json!(name)), "{types}");
    }
    let result = client.read(&latest("Result"));
    assert_eq!(result["status"], "Good");
    let meta = &result["value"]["ResultMetaData"];
    assert_eq!(meta["ResultId"], id);
    assert_eq!(
        (&meta["Number"], &meta["ResultEvaluation"], &meta["Verdict"]),
        (&json!(5), &json!("NotDecidable"), &json!("indeterminate"))
    );
    assert_eq!(
        (&meta["IsSimulated"], &meta["Tool"]),
        (&json!(true), &json!("die"))
    );
    let flanks = &result["value"]["ResultContent"];
    assert_eq!(
        flanks,
        &json!([{
            "Name": "tooth 41 left", "ResultEvaluation": "NotDecidable", "WarningLimit": 30.0, "UpperLimit": 50.0,
            "ResultValue": 25.5, "ExpandedUncertainty": 4.0,
        }])
    );
    // Nothing can be written.
    for path in [
        tool("die", "Verdict"),
        latest("Number"),
        "Plant|HistoryFault".into(),
    ] {
        let write = json!({"do": "write", "path": path, "value": "go"});
        assert!(client.ask(write).is_err(), "{path}");
    }
}

#[test]
fn a_check_is_a_change_and_one_event_and_what_is_not_known_is_not_good() {
    let Some(station) = Station::new() else {
        return;
    };
    let mut press = Press::new(&station.history());
    press.check("die", 40, Word::Go);
    press.check("die", 40, Word::Go);
    let plant = station.plant(8);
    let mut client = station.viewer("line");
    client.browse_until(&tool("die", "Verdict"));
    let paths =
        ["Verdict", "Evaluation", "Counts", "Results|Latest|Number"].map(|path| tool("die", path));
    client.must(json!({"do": "subscribe", "paths": paths, "events": "Server"}));
    // Its value stays the same when it grows too old.
    let paths = [tool("die", "Results|Latest|ResultEvaluation")];
    client.must(json!({"do": "subscribe", "paths": paths, "of_status": true}));
    let mut of_tool = station.viewer("of tool");
    of_tool.browse_until(&tool("die", "Verdict"));
    let source = format!("{STATION}|Tools|die");
    of_tool.must(json!({"do": "subscribe", "paths": [], "events": source}));
    let number = tool("die", "Results|Latest|Number");
    let changed = |path: &str, value: Value, status: &'static str| {
        let path = path.to_owned();
        move |line: &Value| {
            line["change"] == path.as_str() && line["value"] == value && line["status"] == status
        }
    };
    // What was there before is no news; several at once are one each.
    press.check("die", 40, Word::Warn);
    press.check("other die", 41, Word::Go);
    press.check("die", 40, Word::NoGo);
    client.until(changed(&number, json!(5), "Good"));
    client.until(changed(&tool("die", "Verdict"), json!("no-go"), "Good"));
    let event = |number: i64| move |line: &Value| line["event"]["Number"] == number;
    let events: Vec<Value> = (3..=5).map(|number| client.until(event(number))).collect();
    let told = &events[2]["event"];
    assert_eq!(
        (
            &told["Verdict"],
            &told["ResultEvaluation"],
            &told["Tool"],
            &told["Severity"]
        ),
        (&json!("no-go"), &json!(2), &json!("die"), &json!(900))
    );
    assert_eq!(
        told["Result"]["ResultMetaData"]["Number"],
        Value::Null,
        "not decoded before types are loaded"
    );
    assert_eq!(
        (
            &told["WorstCharacteristic"],
            &told["WorstValue"],
            &told["WorstUncertainty"]
        ),
        (&json!("tooth 40 left"), &json!(25.5), &json!(4.0))
    );
    for (name, value) in [
        ("CharacteristicNames", json!(["tooth 40 left"])),
        ("CharacteristicValues", json!([25.5])),
        ("CharacteristicUncertainties", json!([4.0])),
        ("CharacteristicUpperLimits", json!([50.0])),
        ("CharacteristicEvaluations", json!([2])),
    ] {
        assert_eq!(told[name], value, "{name}");
    }
    for number in [3, 5] {
        of_tool.until(event(number));
    }
    // Too old: the check's evaluation is uncertain, and the no-go stands nevertheless.
    client.until(|line| {
        line["change"] == tool("die", "Results|Latest|ResultEvaluation").as_str()
            && (&line["value"], &line["status"]) == (&json!(2), &json!("UncertainLastUsableValue"))
    });
    assert_eq!(
        client.read(&tool("die", "Verdict")),
        json!({"value": "no-go", "status": "Good"})
    );
    let stale = client.browse();
    let other = |path: &str| stale[&tool("other die", path)].clone();
    assert_eq!(other("Verdict")["status"], "UncertainLastUsableValue");
    assert_eq!(
        (&other("Verdict")["value"], &other("Evaluation")["value"]),
        (&json!(""), &json!(0))
    );
    assert_eq!(other("Counts")["value"], false);
    for path in stale
        .as_object()
        .unwrap()
        .keys()
        .filter(|path| path.contains("|Latest|"))
    {
        let node = &stale[path];
        let is_value = node["class"] == "Variable" && !path.ends_with("EngineeringUnits");
        assert!(!is_value || node["status"] != "Good", "{path}: {node}");
    }
    // No event came twice.
    let again: Vec<&Value> = client
        .heard
        .iter()
        .filter(|line| !line["event"].is_null())
        .collect();
    assert!(again.is_empty(), "{again:?}");
    // Nothing is known while the history cannot be read.
    let hidden = station.file("hidden.db");
    std::fs::rename(station.history(), &hidden).unwrap();
    client.until(|line| {
        line["change"] == tool("die", "Verdict").as_str() && line["status"] == "BadNoCommunication"
    });
    let unknown = client.browse();
    for (path, node) in unknown.as_object().unwrap() {
        let is_own = path.starts_with("Plant|") || path.ends_with("InputArguments");
        if node["class"] == "Variable" && !is_own {
            assert_eq!(node["status"], "BadNoCommunication", "{path}: {node}");
        }
    }
    assert_ne!(unknown["Plant|HistoryFault"]["value"], "");
    // It comes back as it was, and is no news.
    std::fs::rename(&hidden, station.history()).unwrap();
    client.until(changed(&tool("die", "Verdict"), json!("no-go"), "Good"));
    press.check("die", 40, Word::Go);
    client.until(event(6));
    assert!(
        client.heard.iter().all(|line| line["event"].is_null()),
        "{:?}",
        client.heard
    );
    drop(plant);
}

#[test]
fn a_history_that_was_edited_is_not_shown() {
    let Some(station) = Station::new() else {
        return;
    };
    Press::new(&station.history()).check("die", 40, Word::Warn);
    let _plant = station.plant(3600);
    let mut client = station.viewer("line");
    client.browse_until(&tool("die", "Verdict"));
    client.read_until(&tool("die", "Verdict"), |it| {
        *it == json!({"value": "warn", "status": "Good"})
    });
    // The reason, in a copy that takes its place.
    let mut bytes = std::fs::read(station.history()).unwrap();
    let mut edited = 0;
    for at in 0..bytes.len() - 9 {
        if &bytes[at..at + 9] == b"as stated" {
            bytes[at..at + 9].copy_from_slice(b"as edited");
            edited += 1;
        }
    }
    assert!(edited > 0);
    std::fs::write(station.file("edited.db"), bytes).unwrap();
    std::fs::rename(station.file("edited.db"), station.history()).unwrap();
    client.read_until(&tool("die", "Verdict"), |it| {
        it["status"] == "BadNoCommunication"
    });
    let all = client.browse();
    assert!(!all.to_string().contains("as edited"));
    assert_eq!(
        all[&tool("die", "Evaluation")]["status"],
        "BadNoCommunication"
    );
}

#[test]
fn who_may_acknowledges_with_name_and_reason() {
    let Some(station) = Station::new() else {
        return;
    };
    let mut press = Press::new(&station.history());
    press.check("die", 40, Word::NoGo);
    press.check("other", 40, Word::NoGo);
    let _plant = station.plant(3600);
    let mut viewer = station.viewer("screen");
    viewer.browse_until(&tool("other", "Acknowledge"));
    let call = |name: &str, number: i64, reason: &str| json!({"do": "call", "path": tool(name, "Acknowledge"), "arguments": [number, reason]});
    let refused = viewer.ask(call("die", 1, "looked")).unwrap_err();
    assert!(refused.contains("BadUserAccessDenied"), "{refused}");
    let start = json!({"do": "call", "path": tool("die", "StartCheck"), "arguments": []});
    let refused = viewer.ask(start.clone()).unwrap_err();
    assert!(refused.contains("BadUserAccessDenied"), "{refused}");
    let mut anna = station.client("Annas tablet");
    station.trust(&mut anna);
    anna.connect(&station.anna, "Anna", SECURE).unwrap();
    anna.browse_until(&tool("other", "Acknowledge"));
    // Nothing would make the check: no watch runs here.
    let refused = anna.ask(start).unwrap_err();
    assert!(refused.contains("BadInvalidState"), "{refused}");
    let [long, endless] = [201, 100_000].map(|length| "x".repeat(length));
    for (name, number, reason, why) in [
        ("die", 1, "", "BadInvalidArgument"),
        ("die", 1, "   ", "BadInvalidArgument"),
        ("die", 1, "two\nlines", "BadInvalidArgument"),
        ("die", 1, long.as_str(), "BadInvalidArgument"),
        // Longer than the server takes any text.
        ("die", 1, endless.as_str(), "BadDecodingError"),
        // Of another tool, of another check, of none.
        ("die", 2, "looked", "BadNotFound"),
        ("other", 1, "looked", "BadNotFound"),
        ("die", i64::MIN, "looked", "BadNotFound"),
    ] {
        let refused = anna.ask(call(name, number, reason)).unwrap_err();
        assert!(
            refused.contains(why),
            "{name} {number} {}: {refused}",
            reason.len()
        );
    }
    let seals = Seals::open(&state()).unwrap();
    let acknowledged = || {
        let history = History::read(&station.history(), &seals).unwrap();
        let all = history.acknowledgements("die").unwrap();
        all.into_iter().map(|one| one.who).collect::<Vec<_>>()
    };
    assert!(acknowledged().is_empty());
    assert_eq!(anna.read(&tool("die", "LatchedNumber"))["value"], 1);
    anna.must(call("die", 1, "tooth 40 was dressed"));
    assert_eq!(acknowledged(), ["Anna: tooth 40 was dressed"]);
    viewer.read_until(&tool("die", "Latched"), |it| it["value"] == false);
    assert_eq!(viewer.read(&tool("other", "Latched"))["value"], true);
    let refused = anna.ask(call("die", 1, "again")).unwrap_err();
    assert!(refused.contains("BadNotFound"), "{refused}");
    // A token that was revoked acknowledges nothing, not even in a session that stands.
    let users = station.file("users.toml");
    let text = std::fs::read_to_string(&users).unwrap();
    let (others, _) = text.split_once("[[user]]\nname = \"Anna\"").unwrap();
    std::fs::write(&users, others).unwrap();
    let refused = anna.ask(call("other", 2, "looked")).unwrap_err();
    assert!(refused.contains("BadUserAccessDenied"), "{refused}");
}

/// The status line of the page without a login.
fn page_answers(page: u16) -> bool {
    let answer = || -> std::io::Result<String> {
        let mut stream = TcpStream::connect(("127.0.0.1", page))?;
        stream.set_read_timeout(Some(Duration::from_secs(5)))?;
        write!(
            stream,
            "GET /healthz HTTP/1.1\r\nHost: 127.0.0.1:{page}\r\nConnection: close\r\n\r\n"
        )?;
        let mut text = String::new();
        stream.read_to_string(&mut text)?;
        Ok(text)
    };
    answer().is_ok_and(|text| text.starts_with("HTTP/1.1 200"))
}

/// The registers' first word by Modbus TCP, read as the protocol's specification has it.
fn registers_answer(modbus: u16) -> bool {
    let answer = || -> std::io::Result<[u8; 11]> {
        let mut stream = TcpStream::connect(("127.0.0.1", modbus))?;
        stream.set_read_timeout(Some(Duration::from_secs(5)))?;
        stream.write_all(&[0, 1, 0, 0, 0, 6, 1, 4, 0, 0, 0, 1])?;
        let mut answer = [0; 11];
        stream.read_exact(&mut answer)?;
        Ok(answer)
    };
    answer().is_ok_and(|answer| answer[7] == 4)
}

#[test]
fn a_flood_is_bounded_and_holds_up_nobody_else() {
    let Some(station) = Station::new() else {
        return;
    };
    Press::new(&station.history()).check("die", 40, Word::Go);
    let mut plant = station.plant(3600);
    let mut client = station.viewer("line");
    client.browse_until(&tool("die", "Verdict"));
    // Connections that say nothing, nonsense, or that they will send more than any memory should hold.
    let flood: Vec<TcpStream> = (0..300)
        .filter_map(|number| {
            let mut stream = TcpStream::connect(("127.0.0.1", station.port)).ok()?;
            let words: [&[u8]; 3] = [b"", b"GET / HTTP/1.1\r\n\r\n", b"HELF\xff\xff\xff\x7f"];
            let _may_be_closed = stream.write_all(words[number % 3]);
            Some(stream)
        })
        .collect();
    assert!(page_answers(station.page) && registers_answer(station.modbus));
    // Who is in stays in.
    assert_eq!(client.read(&tool("die", "Verdict"))["value"], "go");
    drop(flood);
    let mut crowd = client.how(&station.screen, "screen", SECURE);
    crowd["do"] = json!("crowd");
    crowd["most"] = json!(40);
    let end = Instant::now() + AT_MOST;
    let sessions = loop {
        // The flood's connections end within seconds.
        let answer = client.must(crowd.clone());
        client.must(json!({"do": "leave"}));
        if answer["sessions"].as_i64() > Some(4) {
            break answer;
        }
        assert!(Instant::now() < end, "{answer}");
    };
    assert!(!sessions["refused"].is_null(), "{sessions}");
    assert!(page_answers(station.page) && registers_answer(station.modbus));
    assert_eq!(client.read(&tool("die", "Verdict"))["value"], "go");
    assert!(plant.lives());
}

fn refused(folder: &Path, opcua: &str) -> String {
    let file = folder.join("plant.toml");
    let text = format!("history = \"press.db\"\nstale_after_s = 60\n[opcua]\n{opcua}\n");
    std::fs::write(&file, text).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_flankscope-plant"));
    command.env("FLANKSCOPE_STATE", state());
    let output = command.arg("serve").arg(&file).output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{output:?}");
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn settings_without_users_or_with_secrets_in_the_open_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let keys = "users = \"users.toml\"\ncertificates = \"certificates\"";
    let local = format!("listen = \"127.0.0.1:0\"\n{keys}");
    for (opcua, why) in [
        (format!("listen = \"0.0.0.0:0\"\n{keys}"), "opcua.listen"),
        (format!("{local}\nname = \"a/b\""), "opcua.name"),
        (format!("{local}\nanonymous = true"), "unknown field"),
        (
            "listen = \"127.0.0.1:0\"\nusers = \"users.toml\"".into(),
            "certificates",
        ),
        // The certificate is made first.
        (local.clone(), "users.toml"),
    ] {
        let message = refused(path, &opcua);
        assert!(message.contains(why), "{opcua}: {message}");
    }
    let key = path.join("certificates/own/flankscope-plant.key.pem");
    let mode =
        |mode: u32| std::fs::set_permissions(&key, std::fs::Permissions::from_mode(mode)).unwrap();
    mode(0o644);
    assert!(refused(path, &local).contains("chmod 600"));
    mode(0o600);
    // A name that its certificate does not have.
    let message = refused(path, &format!("{local}\nname = \"press8\""));
    assert!(message.contains("another name"), "{message}");
    std::fs::remove_file(&key).unwrap();
    assert!(refused(path, &local).contains("is missing"));
    // The folder cannot be made.
    let message = refused(path, &local.replace("\"certificates\"", "\"plant.toml\""));
    assert!(message.contains("[opcua] certificates"), "{message}");
}
