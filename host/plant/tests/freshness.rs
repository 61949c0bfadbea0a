//! Stale is never good: what the outlets of a running process say when the last check is a recording, a no-go is open, the history is
//! damaged or gone, the watch is silent, or clients without a token take up all connections.

#[allow(dead_code)]
mod press;
#[allow(dead_code)]
mod station;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::fs::FileExt;
use std::os::unix::net::UnixListener;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::time::{Duration, Instant};

use flankscope_foundation::clock::BootTime;
use flankscope_metrology::verdict::Word;
use flankscope_record::document::{HeadDates, Inspection, LastExposure, LiveLine, LiveState};
use flankscope_record::origin::Origin;
use flankscope_tests::{flankscope, run};
use press::{Press, inspection};
use rustix::process::{Pid, Signal, kill_process};
use station::{Plant, Station};

const GO: u16 = 1;
const NO_GO: u16 = 1 << 2;
const LATCHED: u16 = 1 << 4;
const STALE: u16 = 1 << 6;
const FAULT: u16 = 1 << 7;

/// Registers, once the first one is this.
fn registers_with(plant: &Plant, wanted: impl Fn(u16) -> bool) -> Vec<u16> {
    let end = Instant::now() + Duration::from_secs(60);
    loop {
        let registers = plant.registers();
        if wanted(registers[0]) {
            return registers;
        }
        assert!(Instant::now() < end, "{registers:?}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

fn recording(tool: &str, verdict: Word) -> Inspection {
    let check = inspection(tool, 40, verdict, 1);
    Inspection {
        origin: Origin {
            link: "recorded frames".into(),
            ..check.origin.clone()
        },
        ..check
    }
}

#[test]
fn a_recording_is_shown_and_never_stands() {
    let station = Station::new(3600);
    let mut press = Press::new(&station.history());
    press.store(recording("die", Word::Go));
    let plant = station.serve();
    let board = plant.board_with("RECORDING");
    assert!(!board.contains("verdict go"), "{board}");
    let registers = plant.registers();
    assert_eq!((registers[0], registers[3]), (0, 0), "{registers:?}");
    let metrics = plant.with_token("/metrics").text;
    for line in [
        "flankscope_verdict_counts{tool=\"die\",station=\"press 7\"} 0.0",
        "flankscope_verdict_stands{tool=\"die\",station=\"press 7\",verdict=\"go\"} 0.0",
        "reason=\"recording\"} 1.0",
    ] {
        assert!(metrics.contains(line), "no {line} in {metrics}");
    }
    // The no-go of a recording is shown, latches nothing, and cannot be acknowledged.
    press.store(recording("die", Word::NoGo));
    let board = plant.board_with("last NO-GO");
    assert!(!board.contains("verdict no-go"), "{board}");
    assert!(!board.contains("not acknowledged"), "{board}");
    let registers = plant.registers();
    assert_eq!((registers[0], registers[3]), (0, 0), "{registers:?}");
    let metrics = plant.with_token("/metrics").text;
    for line in [
        "flankscope_no_gos_open 0.0",
        "flankscope_no_go_latched{tool=\"die\",station=\"press 7\"} 0.0",
    ] {
        assert!(metrics.contains(line), "no {line} in {metrics}");
    }
    let bearer = format!("Authorization: Bearer {}\r\n", plant.token);
    let answer = plant.post("/acknowledge", &bearer, "check=2&reason=looked");
    assert_eq!(answer.status, 409, "{}", answer.text);
    // The no-go of one die, then a recording with go of another and of the same one: the registers keep the no-go.
    press.check_now("die", 40, Word::NoGo);
    registers_with(&plant, |bits| bits & LATCHED != 0);
    press.store(recording("other", Word::Go));
    press.store(recording("die", Word::Go));
    plant.board_with("which does not stand at the press");
    let registers = plant.registers();
    assert_eq!(registers[0] & (GO | NO_GO | LATCHED), NO_GO | LATCHED);
    assert_eq!((registers[3], registers[5]), (3, 3), "{registers:?}");
    // A fresh go of another die does not clear it either.
    press.check_now("third", 40, Word::Go);
    plant.board_with("verdict go");
    let registers = plant.registers();
    assert_eq!(registers[0] & (GO | NO_GO | LATCHED), NO_GO | LATCHED);
    assert!(plant.with_token("/checks/1").text.contains("RECORDING"));
}

#[test]
fn the_age_of_a_check_is_that_of_its_last_exposure() {
    let station = Station::new(60);
    let mut press = Press::new(&station.history());
    let old = Inspection {
        last_exposure: Some(LastExposure::before_now(Duration::from_secs(50))),
        ..inspection("die", 40, Word::Go, 1)
    };
    press.store(old.clone());
    let plant = station.serve();
    let registers = registers_with(&plant, |bits| bits & GO != 0);
    assert!((50..60).contains(&registers[2]), "{registers:?}");
    // Stored just now, exposed long ago: a watch was stopped between the two.
    press.store(Inspection {
        last_exposure: Some(LastExposure::before_now(Duration::from_secs(61))),
        ..old.clone()
    });
    let registers = registers_with(&plant, |bits| bits & STALE != 0);
    assert_eq!((registers[0] & GO, registers[3]), (0, 0), "{registers:?}");
    // Before another start of this computer.
    let mut exposure = LastExposure::before_now(Duration::ZERO);
    exposure.boot.boot = "another start".into();
    press.store(Inspection {
        last_exposure: Some(exposure),
        ..old.clone()
    });
    registers_with(&plant, |bits| bits & (GO | STALE | FAULT) == FAULT);
    plant.board_with("before this computer was started");
    // The wall clock went back since then.
    let mut exposure = LastExposure::before_now(Duration::from_secs(30));
    exposure.at = LastExposure::before_now(Duration::ZERO).at;
    press.store(Inspection {
        last_exposure: Some(exposure),
        ..old
    });
    plant.board_with("the clock was set back");
    assert_eq!(plant.registers()[0] & (GO | FAULT), FAULT);
}

#[test]
fn a_no_go_is_acknowledged_only_by_the_number_of_the_newest_one() {
    let station = Station::new(3600);
    let mut press = Press::new(&station.history());
    press.check_now("die", 40, Word::NoGo);
    let plant = station.serve();
    plant.board_with("name=\"check\" value=\"1\"");
    // The page still shows the first no-go when the second one is stored.
    press.check_now("die", 40, Word::NoGo);
    let bearer = format!("Authorization: Bearer {}\r\n", plant.token);
    let form = |check: u32| format!("check={check}&reason=insert+changed");
    let status = |check| plant.post("/acknowledge", &bearer, &form(check)).status;
    assert_eq!(status(1), 409);
    assert_eq!(status(2), 303);
    assert_eq!(status(2), 409);
    registers_with(&plant, |bits| bits & LATCHED == 0);
}

#[test]
fn acknowledgements_that_race_with_new_no_gos_clear_none_unseen() {
    let station = Station::new(3600);
    let mut press = Press::new(&station.history());
    press.check_now("die", 40, Word::NoGo);
    let plant = station.serve();
    plant.board_with("name=\"check\" value=\"1\"");
    let bearer = format!("Authorization: Bearer {}\r\n", plant.token);
    let newest = AtomicI64::new(1);
    let is_over = AtomicBool::new(false);
    let (mut accepted, mut refused) = (Vec::new(), 0);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !is_over.load(Ordering::Relaxed) {
                press.check_now("die", 40, Word::NoGo);
                newest.store(press.made, Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(10));
            }
        });
        for _ in 0..200 {
            let check = newest.load(Ordering::Relaxed);
            let form = format!("check={check}&reason=insert+changed");
            match plant.post("/acknowledge", &bearer, &form).status {
                303 => accepted.push(check),
                409 => refused += 1,
                status => panic!("{status}"),
            }
        }
        is_over.store(true, Ordering::Relaxed);
    });
    println!("{} accepted, {refused} refused", accepted.len());
    assert!(!accepted.is_empty() && refused > 0);
    // The stored acknowledgements are those that were accepted, and a no-go above the last one is open.
    let history = run(flankscope()
        .arg("history")
        .arg(station.history())
        .args(["--json", "-"]));
    let stored = history.json["acknowledgements"].as_array().unwrap();
    let stored: Vec<i64> = stored
        .iter()
        .filter_map(|row| row["inspection"].as_i64())
        .collect();
    assert_eq!(stored, accepted, "{history:?}");
    if accepted.last() < Some(&press.made) {
        registers_with(&plant, |bits| bits & (NO_GO | LATCHED) == NO_GO | LATCHED);
    }
}

#[test]
fn bytes_that_no_commit_announced_are_noticed_at_the_next_look() {
    let station = Station::new(3600);
    let mut press = Press::new(&station.history());
    press.check_now("die", 40, Word::NoGo);
    press.check_now("other", 40, Word::Go);
    // The last connection that closes writes the journal into the file.
    drop(press);
    let plant = station.serve();
    plant.board_with("verdict go");
    let mut options = std::fs::File::options();
    let file = options
        .write(true)
        .read(true)
        .open(station.history())
        .unwrap();
    let mut bytes = Vec::new();
    (&file).read_to_end(&mut bytes).unwrap();
    let places = bytes.windows(9).enumerate();
    let reasons = places.filter(|(_, window)| *window == b"as stated");
    let reasons: Vec<u64> = reasons.map(|(at, _)| at as u64).collect();
    assert!(!reasons.is_empty());
    for at in reasons {
        file.write_all_at(b"AS", at).unwrap();
    }
    let begin = Instant::now();
    let registers = registers_with(&plant, |bits| bits & FAULT != 0);
    assert!(begin.elapsed() < Duration::from_secs(10));
    // What is latched stays.
    assert_eq!(registers[0] & (GO | NO_GO | LATCHED), NO_GO | LATCHED);
    let board = plant.board_with("cannot be read");
    assert!(!board.contains("class=\"verdict") && board.contains("A no-go is not acknowledged"));
}

#[test]
fn a_latched_no_go_stays_while_the_history_is_gone() {
    let station = Station::new(3600);
    let mut press = Press::new(&station.history());
    press.check_now("die", 40, Word::NoGo);
    drop(press);
    let plant = station.serve();
    plant.board_with("verdict no-go");
    std::fs::rename(station.history(), station.folder.path().join("away.db")).unwrap();
    let gone = registers_with(&plant, |bits| bits & FAULT != 0);
    assert_eq!(gone[0] & (GO | NO_GO | LATCHED), NO_GO | LATCHED);
    let metrics = plant.with_token("/metrics").text;
    assert!(metrics.contains("flankscope_no_gos_open 1.0"), "{metrics}");
    // A process that starts now has it from the station's memory.
    drop(plant);
    let plant = station.serve();
    let gone = registers_with(&plant, |bits| bits & LATCHED != 0);
    assert_eq!(gone[0] & (GO | NO_GO | FAULT), NO_GO | FAULT);
}

#[test]
fn what_a_silent_watch_said_is_not_shown_as_the_present() {
    let station = Station::new(3600);
    let mut press = Press::new(&station.history());
    press.check_now("die", 40, Word::Go);
    let mut socket = station.history().into_os_string();
    socket.push(".live");
    let listener = UnixListener::bind(socket).unwrap();
    let plant = station.serve();
    let (mut watch, _) = listener.accept().unwrap();
    let mut say = |sequence: u64, age: Duration, shown: &str| {
        let mut state = LiveState::new("press 7".into(), "die".into(), true, HeadDates::default());
        shown.clone_into(&mut state.shown);
        state.sequence = sequence;
        state.said_at = Some(BootTime::now().before(age));
        state.holds_ms = 30_000;
        let line = serde_json::to_string(&LiveLine::State(state)).unwrap() + "\n";
        watch.write_all(line.as_bytes()).unwrap();
    };
    // Said long ago, delivered now: the watch was stopped.
    say(1, Duration::from_secs(45), "go");
    let now = plant.page_with("/now", "The watch is silent");
    assert!(!now.contains("shown <strong>"), "{now}");
    assert!(
        !plant
            .with_token("/metrics")
            .text
            .contains("watch_frames_triggered_total{")
    );
    say(2, Duration::ZERO, "go");
    let now = plant.page_with("/now/state", "the press is shown <strong>go<");
    let valid = now.split("data-valid-ms=\"").nth(1).unwrap();
    let valid_ms: u64 = valid.split('"').next().unwrap().parse().unwrap();
    assert!((1..=30_000).contains(&valid_ms), "{now}");
    // An older statement does not replace a newer one.
    say(1, Duration::ZERO, "no-go");
    say(3, Duration::from_secs(40), "warn");
    plant.page_with("/now", "The watch is silent");
}

/// Sends a request and returns its connection, whose answer is waited for at most a second.
fn asked(address: SocketAddr, request: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(address).unwrap();
    let wait = Some(Duration::from_secs(1));
    stream.set_read_timeout(wait).unwrap();
    stream.write_all(request).unwrap();
    stream
}

#[test]
fn a_stopped_process_answers_nothing_and_later_nothing_that_was_true_before() {
    const STALE_AFTER: Duration = Duration::from_secs(6);
    let station = Station::new(STALE_AFTER.as_secs() as u32);
    let mut press = Press::new(&station.history());
    let mut plant = station.serve();
    registers_with(&plant, |bits| bits & FAULT == 0);
    press.store(Inspection {
        last_exposure: Some(LastExposure::before_now(Duration::ZERO)),
        ..inspection("die", 40, Word::Go, 1)
    });
    registers_with(&plant, |bits| bits & GO != 0);
    let (page, token) = (plant.page, &plant.token);
    let get = |path: &str| {
        format!(
            "GET {path} HTTP/1.1\r\nHost: {page}\r\nConnection: close\r\nAuthorization: Bearer {token}\r\n\r\n"
        )
    };
    let pid = Pid::from_child(&plant.process.0);
    kill_process(pid, Signal::STOP).unwrap();
    let status = format!("/proc/{}/status", plant.process.0.id());
    while !std::fs::read_to_string(&status)
        .unwrap()
        .contains("State:\tT")
    {
        std::thread::sleep(Duration::from_millis(5));
    }
    let read_registers = [0x12, 0x34, 0, 0, 0, 6, 1, 4, 0, 0, 0, 10];
    let mut registers = asked(plant.modbus, &read_registers);
    let mut metrics = asked(page, get("/metrics").as_bytes());
    let mut board = asked(page, get("/board").as_bytes());
    for stream in [&mut registers, &mut metrics, &mut board] {
        let silent = stream.read(&mut [0]).unwrap_err();
        assert_eq!(silent.kind(), std::io::ErrorKind::WouldBlock);
    }
    std::thread::sleep(STALE_AFTER);
    kill_process(pid, Signal::CONT).unwrap();
    // The answers to what was asked while it stood still.
    let mut answer = [0; 29];
    let wait = Some(Duration::from_secs(20));
    registers.set_read_timeout(wait).unwrap();
    registers.read_exact(&mut answer).unwrap();
    let bits = u16::from_be_bytes([answer[9], answer[10]]);
    assert_eq!(bits & (GO | STALE), STALE, "{answer:?}");
    for (mut stream, wanted) in [
        (metrics, "verdict=\"go\"} 0.0"),
        (board, "<span class=\"verdict old\">TOO OLD"),
    ] {
        stream.set_read_timeout(wait).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.contains(wanted), "{answer}");
        assert!(!answer.contains("verdict go"), "{answer}");
        let stands = "verdict_stands{tool=\"die\",station=\"press 7\",verdict=\"go\"} 1.0";
        assert!(!answer.contains(stands), "{answer}");
    }
    // Without the process, or without a network to it, there is no answer at all.
    plant.process.0.kill().unwrap();
    plant.process.0.wait().unwrap();
    for address in [plant.modbus, plant.page] {
        assert!(TcpStream::connect(address).is_err());
    }
}

/// A request whose body never comes.
fn unfinished_login(plant: &Plant) -> TcpStream {
    let mut stream = TcpStream::connect(plant.page).unwrap();
    let host = plant.page;
    let head = format!(
        "POST /login HTTP/1.1\r\nHost: {host}\r\nContent-Type: application/x-www-form-urlencoded\r\nContent-Length: 100\r\n\r\n"
    );
    stream.write_all(head.as_bytes()).unwrap();
    stream
}

#[test]
fn clients_without_a_token_do_not_keep_the_metrics_from_one_with_a_token() {
    let station = Station::new(3600);
    let mut press = Press::new(&station.history());
    press.check_now("die", 40, Word::Go);
    let plant = station.serve();
    plant.board_with("verdict go");
    // A page that is open all the time, from the same address.
    let mut open = TcpStream::connect(plant.page).unwrap();
    open.set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    let (host, token) = (plant.page, &plant.token);
    let request =
        format!("GET /events HTTP/1.1\r\nHost: {host}\r\nAuthorization: Bearer {token}\r\n\r\n");
    open.write_all(request.as_bytes()).unwrap();
    assert!(open.read(&mut [0; 1024]).unwrap() > 0);
    let mut slow = Vec::new();
    for _ in 0..12 {
        slow.extend((0..100).map(|_| unfinished_login(&plant)));
        let begin = Instant::now();
        assert_eq!(plant.with_token("/metrics").status, 200);
        assert!(
            begin.elapsed() < Duration::from_secs(10),
            "{:?}",
            begin.elapsed()
        );
    }
    // It still gets its events.
    let mut heard = [0; 1024];
    assert!(open.read(&mut heard).unwrap() > 0);
    // A request that does not end is answered and closed.
    let mut last = slow.pop().unwrap();
    last.set_read_timeout(Some(Duration::from_secs(60)))
        .unwrap();
    let mut answer = String::new();
    last.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 408"), "{answer}");
}

#[test]
fn silent_line_controllers_make_room_for_one_that_asks() {
    let station = Station::new(3600);
    let plant = station.serve();
    let mut polling = TcpStream::connect(plant.modbus).unwrap();
    polling
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    let mut poll = || {
        let request = [0x12, 0x34, 0, 0, 0, 6, 1, 4, 0, 0, 0, 10];
        polling.write_all(&request).unwrap();
        let mut answer = [0; 29];
        polling.read_exact(&mut answer).unwrap();
    };
    poll();
    let silent: Vec<_> = (0..40)
        .map(|_| TcpStream::connect(plant.modbus).unwrap())
        .collect();
    assert_eq!(plant.registers().len(), 10);
    // The one that asked before keeps its place.
    poll();
    drop(silent);
    // A count of none, by the protocol's specification an illegal value.
    assert_eq!(plant.ask_registers([4, 0, 0, 0, 0]), [0x84, 3]);
    assert_eq!(plant.ask_registers([3, 0, 10, 0, 0]), [0x83, 3]);
}

#[test]
fn a_change_for_a_doubled_or_strange_origin_is_refused() {
    let station = Station::new(3600);
    let plant = station.serve();
    let own = format!("Origin: http://{}\r\n", plant.page);
    assert_eq!(plant.post("/logout", &own, "").status, 303);
    let doubled = format!("{own}Origin: https://evil.example\r\n");
    assert_eq!(plant.post("/logout", &doubled, "").status, 403);
    let strange = "Origin: https://evil.example/\u{fc}\r\n";
    assert_eq!(plant.post("/logout", strange, "").status, 403);
}
