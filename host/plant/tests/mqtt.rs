//! The plant's messages through another's broker to other people's clients: what they say, and that none is lost or doubled
//! whatever breaks.

mod broker;
mod press;
mod process;

use std::io::{Read, Write};
use std::net::TcpListener;
use std::process::Command;
use std::time::Duration;

use broker::{Cable, Station};
use flankscope_metrology::verdict::Word;
use flankscope_test_requisites::dear;
use press::Press;
use process::wait_for;
use serde_json::{Value, json};

const TOOL: &str = "demo die";
const OPEN: &str = "allow_anonymous true\npersistence false";

/// The messages of a topic's kind, each as its schema wants it.
fn payloads<'a>(heard: &'a [Value], kind: &str) -> Vec<&'a Value> {
    let of_kind = heard.iter().filter(|message| {
        assert_eq!(message["invalid"], json!([]), "{message}");
        let topic = message["topic"].as_str().unwrap();
        topic.ends_with(&format!("/{kind}"))
    });
    of_kind.map(|message| &message["payload"]).collect()
}

fn is_state(message: &Value, verdict: Value, number: i64) -> bool {
    let payload = &message["payload"];
    let is_state = message["topic"] == "flankscope/press7/demo die/state";
    is_state && payload["verdict"] == verdict && payload["number"] == number
}

#[test]
fn checks_and_what_stands_are_said_in_json_as_the_schema_has_it() {
    for version in ["5", "3.1.1"] {
        let Some(station) = Station::new(OPEN) else {
            return;
        };
        let mut heard = station.hear("json");
        let more = format!("version = \"{version}\"");
        let plant = station.plant(station.port, 3600, &more);
        // The history is not there yet.
        let first = heard.until(|message| message["payload"]["online"] == true);
        let status = payloads(&first, "status");
        assert!(status[0]["fault"].is_string(), "{status:?}");
        let mut press = Press::new(&station.history());
        press.check(TOOL, 40, Word::Go);
        let mut all = heard.until(|message| is_state(message, json!("go"), 1));
        all.extend(heard.until(|message| message["topic"].as_str().unwrap().ends_with("/check")));
        assert_eq!(
            payloads(&all, "status").last().unwrap()["fault"],
            Value::Null
        );
        let checks = payloads(&all, "check");
        assert_eq!(
            (
                &checks[0]["tool"],
                &checks[0]["verdict"],
                &checks[0]["simulated"]
            ),
            (&json!(TOOL), &json!("go"), &json!(true))
        );
        assert_eq!(checks[0]["flanks"][0]["wear_um"], 25.5);
        wait_for(|| (station.delivered() == 1).then_some(()));
        drop(plant);
        all = heard.until(|message| message["payload"]["online"] == false);
        assert_eq!(payloads(&all, "check").len(), 0);

        // Another start: nothing is sent again, and a verdict that grows too old is withdrawn.
        let plant = station.plant(station.port, 1, &more);
        heard.until(|message| {
            is_state(message, Value::Null, 1) && message["payload"]["worth"] == "stale"
        });
        // Nothing is known of it while the history cannot be read.
        let hidden = station.file("hidden.db");
        std::fs::rename(station.history(), &hidden).unwrap();
        all = heard.until(|message| message["payload"]["worth"] == "unknown");
        assert!(
            payloads(&all, "state").last().unwrap()["verdict"].is_null(),
            "{all:?}"
        );
        // The status names the fault, before or after the state.
        let names_fault = |message: &Value| message["payload"]["fault"].is_string();
        if !all.iter().any(names_fault) {
            heard.until(names_fault);
        }
        std::fs::rename(&hidden, station.history()).unwrap();
        all = heard.until(|message| is_state(message, Value::Null, 1));
        // A no-go stands, however old.
        press.check(TOOL, 40, Word::NoGo);
        all.extend(heard.until(|message| {
            is_state(message, json!("no-go"), 2) && message["payload"]["worth"] == "stale"
        }));
        let latched = payloads(&all, "state").last().unwrap()["latched"].clone();
        assert_eq!(latched, 2);
        wait_for(|| (station.delivered() == 2).then_some(()));
        drop(plant);
        all.extend(heard.until(|message| message["payload"]["online"] == false));
        let numbers: Vec<_> = payloads(&all, "check")
            .iter()
            .map(|check| check["number"].clone())
            .collect();
        assert_eq!(numbers, [json!(2)]);
        // Who comes later is told what stands, and that nobody is there.
        let mut late = station.hear("json");
        let mut retained = late.until(|message| message["retained"] == true);
        retained.extend(late.until(|message| message["retained"] == true));
        assert_eq!(payloads(&retained, "status")[0]["online"], false);
        assert_eq!(payloads(&retained, "state")[0]["verdict"], "no-go");
    }
}

/// Cuts the cable so often while checks are added, and kills the plant now and then; what a client heard, in order.
fn through_cuts(
    station: &Station,
    cuts: usize,
    seed: u64,
    language: &str,
    more: &str,
) -> (Vec<Value>, i64) {
    let mut heard = station.hear(language);
    let mut press = Press::new(&station.history());
    let cable = Cable::to(station.port, seed, 4000);
    let mut plant = Some(station.plant(cable.port, 3600, more));
    let mut kills = 0;
    while cable.cuts() < cuts {
        press.check("die", 40, Word::Go);
        std::thread::sleep(Duration::from_millis(40));
        if cable.cuts() / 10 > kills {
            kills += 1;
            // First it is gone, then another one starts.
            drop(plant.take());
            plant = Some(station.plant(cable.port, 3600, more));
        }
        assert!(press.made < 3000, "{} cuts only", cable.cuts());
    }
    cable.mend();
    let last = press.made;
    let all = heard.until(|message| {
        let metric = &message["metrics"]["Check/Number"]["value"];
        let is_data = message["kind"] == "DDATA" && metric == last;
        is_data || message["payload"]["number"] == last && message["payload"]["id"].is_string()
    });
    wait_for(|| (station.delivered() == last).then_some(()));
    eprintln!(
        "{last} checks through {} cuts and {kills} kills",
        cable.cuts()
    );
    (all, last)
}

/// Every check once and in order, after those that came twice were dropped by their ids, as a receiver does it. Some do come twice:
/// acknowledgements were lost.
fn assert_each_once(ids_and_numbers: Vec<(String, i64)>, last: i64, breaks: usize) {
    let mut seen = std::collections::HashSet::new();
    let total = ids_and_numbers.len();
    let kept = ids_and_numbers
        .into_iter()
        .filter(|(id, _)| seen.insert(id.clone()));
    let numbers: Vec<i64> = kept.map(|(_, number)| number).collect();
    assert_eq!(numbers, (1..=last).collect::<Vec<_>>());
    // One message at a time is under way when something breaks.
    let doubled = total - numbers.len();
    eprintln!("{doubled} came twice");
    assert!((1..=breaks).contains(&doubled), "{doubled} in {breaks}");
}

#[test]
fn nothing_is_lost_or_doubled_in_a_hundred_cuts() {
    let Some(station) = Station::new(OPEN) else {
        return;
    };
    let (heard, last) = through_cuts(&station, 100, 1, "json", "");
    let checks = payloads(&heard, "check");
    let id_and_number = |check: &&Value| {
        let id = check["id"].as_str().unwrap().to_owned();
        (id, check["number"].as_i64().unwrap())
    };
    // A kill, too, may come between an acknowledgement and its note.
    assert_each_once(checks.iter().map(id_and_number).collect(), last, 110);
}

#[test]
fn sparkplug_loses_nothing_on_its_way_to_the_broker() {
    let Some(station) = Station::new(OPEN) else {
        return;
    };
    let (heard, last) = through_cuts(&station, 30, 2, "sparkplug", "group = \"forming\"");
    let data = heard.iter().filter(|message| message["kind"] == "DDATA");
    let checks = data.filter_map(|message| {
        let id = message["metrics"]["Check/Id"]["value"].as_str()?;
        let number = message["metrics"]["Check/Number"]["value"].as_i64()?;
        Some((id.to_owned(), number))
    });
    assert_each_once(checks.collect(), last, 33);
    // What a host relies on: order within a connection, and a birth before it.
    let mut next = None;
    for message in &heard {
        let Some(seq) = message["seq"].as_u64() else {
            continue;
        };
        if message["kind"] == "NBIRTH" {
            next = Some(0);
        }
        assert_eq!(Some(seq), next, "{message}");
        next = Some((seq + 1) % 256);
    }
}

#[test]
fn sparkplug_births_and_deaths_enclose_the_data_and_old_data_say_so() {
    let Some(station) = Station::new(OPEN) else {
        return;
    };
    let mut heard = station.hear("sparkplug");
    let mut press = Press::new(&station.history());
    // A topic cannot hold that name as it is.
    let tool = "die #1/a";
    press.check(tool, 40, Word::Go);
    press.check(tool, 41, Word::Warn);
    let plant = station.plant(station.port, 5, "group = \"forming\"");
    let is_last = |message: &Value| {
        message["kind"] == "DDATA" && message["metrics"]["Check/Number"]["value"] == 2
    };
    let all = heard.until(is_last);
    let kinds: Vec<_> = all
        .iter()
        .map(|message| message["kind"].as_str().unwrap())
        .collect();
    let births = |kinds: &[&str]| kinds.iter().filter(|kind| kind.ends_with("BIRTH")).count();
    assert!(
        kinds[0] == "NBIRTH" && kinds[1..].contains(&"DBIRTH"),
        "{kinds:?}"
    );
    assert_eq!(all[0]["metrics"]["Node Control/Rebirth"]["value"], false);
    let bd_seq = all[0]["metrics"]["bdSeq"]["value"].clone();
    let of_device = all.iter().filter(|message| message["kind"] != "NBIRTH");
    assert!(
        of_device
            .clone()
            .all(|message| message["device"] == "die %231%2Fa")
    );
    assert!(all.iter().all(|message| message["retained"] == false));
    let old: Vec<_> = of_device
        .filter(|message| message["metrics"]["Check/Number"]["historical"] == true)
        .collect();
    assert_eq!(old.len(), 1);
    assert_eq!(old[0]["metrics"]["Check/Number"]["value"], 1);
    let wear = &old[0]["metrics"]["Flanks/tooth 40 left/Wear"];
    assert_eq!(
        (
            &wear["value"],
            &wear["engUnit"],
            &wear["type"],
            &wear["historical"]
        ),
        (&json!(25.5), &json!("µm"), &json!("DOUBLE"), &json!(true))
    );
    // Every metric of data was in the birth before it.
    let mut born = Vec::new();
    for message in &all[1..] {
        let names = message["metrics"].as_object().unwrap().keys();
        match message["kind"].as_str().unwrap() {
            "DBIRTH" => born = names.cloned().collect(),
            _ => assert!(names.clone().all(|name| born.contains(name)), "{message}"),
        }
    }
    let last = all.last().unwrap();
    assert_eq!(last["metrics"]["Check/Verdict"]["Quality"], 192);
    assert_eq!(last["metrics"]["Check/Verdict"]["historical"], false);

    // Too old: the verdict is withdrawn, and the check's own is marked.
    let stale = heard.until(|message| message["metrics"]["Verdict"]["null"] == true);
    let metrics = &stale.last().unwrap()["metrics"];
    assert_eq!(
        (
            &metrics["Verdict"]["Quality"],
            &metrics["Check/Verdict"]["Quality"]
        ),
        (&json!(500), &json!(500))
    );
    // All births again, when a host asks for them.
    heard.command("forming press7");
    let again = heard.until(|message| message["kind"] == "DBIRTH");
    let kinds: Vec<_> = again
        .iter()
        .map(|message| message["kind"].as_str().unwrap())
        .collect();
    assert_eq!((kinds.len(), births(&kinds)), (2, 2), "{kinds:?}");
    assert_eq!(again[0]["seq"], 0);
    assert_eq!(again[0]["metrics"]["bdSeq"]["value"], bd_seq);
    let withdrawn = &again[1]["metrics"]["Verdict"];
    assert_eq!(
        (&withdrawn["null"], &withdrawn["Quality"]),
        (&json!(true), &json!(500))
    );
    // While the history cannot be read, no device lives.
    let hidden = station.file("hidden.db");
    std::fs::rename(station.history(), &hidden).unwrap();
    heard.until(|message| message["kind"] == "DDEATH" && message["device"] == "die %231%2Fa");
    std::fs::rename(&hidden, station.history()).unwrap();
    heard.until(|message| message["kind"] == "DBIRTH");
    // The broker itself says that the node is gone, and of which birth.
    drop(plant);
    let death = heard.until(|message| message["kind"] == "NDEATH");
    assert_eq!(death.last().unwrap()["metrics"]["bdSeq"]["value"], bd_seq);
    let plant = station.plant(station.port, 5, "group = \"forming\"");
    let birth = heard.until(|message| message["kind"] == "NBIRTH");
    let next = birth.last().unwrap()["metrics"]["bdSeq"]["value"].as_i64();
    assert_eq!(next, Some((bd_seq.as_i64().unwrap() + 1) % 256));
    drop(plant);
}

/// The keep-alive interval is 30 s, and a broker waits for one and a half of them.
fn stopped_process_is_declared_offline(language: &str, more: &str, is_offline: fn(&Value) -> bool) {
    if !dear() {
        return;
    }
    let Some(station) = Station::new(OPEN) else {
        return;
    };
    let mut heard = station.hear(language);
    let mut press = Press::new(&station.history());
    press.check_now(TOOL, 40, Word::Go);
    let plant = station.plant(station.port, 3600, more);
    wait_for(|| (station.delivered() == 1).then_some(()));
    plant.stop();
    std::thread::sleep(Duration::from_secs(25));
    heard.until(is_offline);
}

#[test]
fn a_stopped_process_is_declared_offline_by_the_broker() {
    stopped_process_is_declared_offline("json", "", |message| {
        message["payload"]["online"] == false
    });
}

#[test]
fn a_stopped_node_is_declared_dead_by_the_broker() {
    stopped_process_is_declared_offline("sparkplug", "group = \"forming\"", |message| {
        message["kind"] == "NDEATH"
    });
}

#[test]
fn another_history_is_sent_from_its_first_check() {
    let Some(station) = Station::new(OPEN) else {
        return;
    };
    let mut heard = station.hear("json");
    let mut press = Press::new(&station.history());
    for _ in 0..3 {
        press.check("die", 40, Word::Go);
    }
    let plant = station.plant(station.port, 3600, "");
    wait_for(|| (station.delivered() == 3).then_some(()));
    drop(plant);
    drop(press);
    std::fs::rename(station.history(), station.file("old.db")).unwrap();
    let mut press = Press::new(&station.history());
    for _ in 0..4 {
        press.check("die", 40, Word::Go);
    }
    let mut plant = station.plant(station.port, 3600, "");
    plant.says("is not the one that was delivered");
    wait_for(|| (station.delivered() == 4).then_some(()));
    let is_fourth =
        |message: &Value| message["payload"]["number"] == 4 && message["payload"]["id"].is_string();
    let all = heard.until(is_fourth);
    let checks = payloads(&all, "check");
    let numbers: Vec<_> = checks
        .iter()
        .map(|check| check["number"].as_i64().unwrap())
        .collect();
    assert_eq!(numbers, [1, 2, 3, 1, 2, 3, 4]);
    let ids: std::collections::HashSet<_> =
        checks.iter().map(|check| check["id"].as_str()).collect();
    assert_eq!(ids.len(), 7);
}

fn openssl(folder: &std::path::Path, arguments: &str) {
    let mut command = Command::new("openssl");
    command.args(arguments.split(' ')).current_dir(folder);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{output:?}");
}

#[test]
fn what_goes_over_a_network_is_encrypted_and_goes_to_the_right_broker_alone() {
    let Some((mosquitto, _)) = flankscope_test_requisites::mqtt_peers() else {
        return;
    };
    let keys = tempfile::tempdir().unwrap();
    let new = "-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2";
    for name in ["plant", "other"] {
        openssl(
            keys.path(),
            &format!("req -x509 {new} -keyout {name}.key -out {name}.pem -subj /CN={name}"),
        );
    }
    openssl(
        keys.path(),
        &format!("req {new} -keyout broker.key -out broker.csr -subj /CN=localhost"),
    );
    std::fs::write(keys.path().join("names"), "subjectAltName=DNS:localhost\n").unwrap();
    openssl(
        keys.path(),
        "x509 -req -in broker.csr -CA plant.pem -CAkey plant.key -CAcreateserial -out broker.pem -days 2 -extfile names",
    );
    let password = Command::new("mosquitto_passwd")
        .args(["-b", "-c", "passwords", "press7", "secret word"])
        .current_dir(keys.path())
        .status();
    assert!(password.unwrap().success(), "{}", mosquitto.display());
    let folder = keys.path().to_str().unwrap();
    // The stranger's client comes in through a port of its own.
    let settings = format!(
        "per_listener_settings true\nallow_anonymous true\nlistener {{TLS}} 127.0.0.1\ncertfile {folder}/broker.pem\n\
         keyfile {folder}/broker.key\npassword_file {folder}/passwords\nallow_anonymous false"
    );
    let tls = process::free_port();
    let Some(station) = Station::new(&settings.replace("{TLS}", &tls.to_string())) else {
        return;
    };
    let mut heard = station.hear("json");
    Press::new(&station.history()).check("die", 40, Word::Go);
    let login = station.file("login.toml");
    let write = |password: &str, mode: &str| {
        std::fs::write(
            &login,
            format!("user = \"press7\"\npassword = \"{password}\"\n"),
        )
        .unwrap();
        let chmod = Command::new("chmod").arg(mode).arg(&login).status();
        assert!(chmod.unwrap().success());
    };
    let ca = |name: &str| format!("login = \"login.toml\"\nca = \"{folder}/{name}.pem\"");
    write("secret word", "644");
    let message = station.plant(tls, 3600, &ca("plant")).says("chmod 600");
    assert!(!message.contains("secret"), "{message}");
    write("secret word", "600");
    let mut wrong = station.plant(tls, 3600, &ca("other"));
    wrong.says("agree on TLS with the broker");
    drop(wrong);
    write("guess", "600");
    let mut wrong = station.plant(tls, 3600, &ca("plant"));
    let message = wrong.says("the broker refuses the connection");
    assert!(
        message.contains("NotAuthorized") && !message.contains("guess"),
        "{message}"
    );
    drop(wrong);
    assert_eq!(station.delivered(), 0);
    write("secret word", "600");
    for version in ["5", "3.1.1"] {
        let more = format!("{}\nversion = \"{version}\"", ca("plant"));
        let plant = station.plant(tls, 3600, &more);
        let online = heard.until(|message| message["payload"]["online"] == true);
        assert!(online.iter().all(|message| message["invalid"] == json!([])));
        wait_for(|| (station.delivered() == 1).then_some(()));
        drop(plant);
        heard.until(|message| message["payload"]["online"] == false);
    }
}

#[test]
fn what_a_broker_refuses_is_not_taken_for_delivered() {
    let Some(station) = Station::new("allow_anonymous true\nacl_file FOLDER/rights") else {
        return;
    };
    std::fs::write(
        station.file("rights"),
        "topic readwrite flankscope/press7/status\ntopic readwrite flankscope/press7/die/state\n",
    )
    .unwrap();
    Press::new(&station.history()).check("die", 40, Word::Go);
    wait_for(|| std::net::TcpStream::connect(("127.0.0.1", station.port)).ok());
    let mut plant = station.plant(station.port, 3600, "");
    let message = plant.says("refuses");
    assert!(message.contains("die/check: NotAuthorized"), "{message}");
    assert_eq!(station.delivered(), 0);
}

#[test]
fn a_broker_that_talks_nonsense_ends_nothing() {
    let Some(station) = Station::new(OPEN) else {
        return;
    };
    Press::new(&station.history()).check("die", 40, Word::Go);
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let mut plant = station.plant(port, 3600, "");
    // No packet; one that is none before the connection stands; one larger than any memory should hold; lengths that lie; a
    // connection that stands, and then an acknowledgement of what was never sent and half of a packet.
    let connected = [0x20, 3, 0, 0, 0];
    let nonsense: [&[u8]; 6] = [
        &[0; 64],
        &[0x30, 5, 0, 200, 1, 2, 3],
        &[0x30, 0xff, 0xff, 0xff, 0x7f, 0],
        &[0x20, 3, 0, 0, 250],
        &[&connected[..], &[0x40, 2, 99, 99, 0x30, 9, 0]].concat(),
        &[&connected[..], &[0x40, 1, 0]].concat(),
    ];
    for bytes in nonsense {
        let (mut stream, _) = listener.accept().unwrap();
        let mut greeting = [0; 16];
        stream.read_exact(&mut greeting).unwrap();
        stream.write_all(bytes).unwrap();
        drop(stream);
        plant.says("again in");
    }
    assert!(plant.lives());
    assert_eq!(station.delivered(), 0);
}

#[test]
fn settings_that_would_send_in_clear_or_to_nowhere_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("plant.toml");
    let refused = |mqtt: &str| {
        let text = format!(
            "history = \"press.db\"\nstale_after_s = 60\n[mqtt]\nname = \"press7\"\ndelivered = \"delivered.toml\"\n{mqtt}\n"
        );
        std::fs::write(&file, text).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_flankscope-plant"));
        command.env("FLANKSCOPE_STATE", flankscope_tests::state());
        let output = command.arg("serve").arg(&file).output().unwrap();
        assert_eq!(output.status.code(), Some(3), "{output:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    let here = "broker = \"localhost:1883\"";
    for (mqtt, why) in [
        ("broker = \"192.0.2.1:1883\"", "in clear"),
        ("broker = \"localhost.example.org:1883\"", "in clear"),
        ("broker = \"localhost\"", "no HOST:PORT"),
        ("broker = \"mqtt://localhost:1883\"", "no HOST:PORT"),
        (&format!("{here}\ngroup = \"a/b\""), "mqtt.group"),
        (&format!("{here}\nversion = \"3.1\""), "3.1.1"),
        (&format!("{here}\nca = \"none.pem\""), "none.pem"),
        (&format!("{here}\nca = \"plant.toml\""), "PEM"),
        (&format!("{here}\nlogin = \"none.toml\""), "none.toml"),
        (&format!("{here}\npassword = \"a\""), "unknown field"),
    ] {
        let message = refused(mqtt);
        assert!(message.contains(why), "{mqtt}: {message}");
    }
    let delivered = folder.path().join("delivered.toml");
    std::fs::write(&delivered, "number = 3\n").unwrap();
    let message = refused(here);
    assert!(
        message.contains("delivered.toml:1") && message.contains("sent again"),
        "{message}"
    );
    std::fs::remove_file(&delivered).unwrap();
    std::fs::create_dir(&delivered).unwrap();
    assert!(refused(here).contains("delivered.toml"));
}
