//! The board's program on an emulated STM32 (QEMU's machine `netduinoplus2`): embassy-stm32's UARTs, EXTI inputs and pins, the way
//! down when the supply sinks, and every start.
//!
//! ```text
//! this test ── Hello, Status ──────────────► USART3 ┐
//!           ◄─ "ST" to the stages ────────── USART2 │ flankscope-netduinoplus2-f405
//!           ── levels in RAM, edges ───────► EXTI   │
//!           ── interrupt of the supply's detector, RAM overwritten ► │
//!           ◄─ log of every register that the machine has no model of: the outputs, the watchdog ┘
//! ```
//! `firmware/README.md` says what of a board this shows and what it does not.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command as Process, Stdio};
use std::time::{Duration, Instant};

use flankscope_protocol::message::Boot;
use flankscope_protocol::stage::STAGE_CONFIG_VERSION;
use flankscope_protocol::{
    Command, Decoder, Event, Header, Identity, Kind, MAX_FRAME_BYTES, PROTOCOL_VERSION, Refusal,
    Reply, SCHEMA_HASH, StageConfig, StageName, State, Status, encode,
};
use flankscope_test_requisites::emulated_board;

/// For everything that the machine does at once; the machine that runs it may be busy.
const PATIENCE: Duration = Duration::from_secs(20);
/// For a reply.
const ASK_AGAIN: Duration = Duration::from_secs(1);
/// For what must not come.
const SILENCE: Duration = Duration::from_millis(300);

/// Where the image reads the contacts' levels: bit n is PFn (`stm32-board/src/f405/missing_registers.rs`).
const CONTACTS: u32 = 0x2001_FC00;
const PRESS_OPEN_A: u32 = 0;
const CYCLE: u32 = 7;
/// Where the image's data begins; it has 22 KB of them.
const RAM: u32 = 0x2000_0000;
/// Times that the stages are told to stop after a start: at every speed that their line may have.
const STOPS: usize = 7;
/// Number of the interrupt of the supply's detector (RM0090, table 62).
const PVD: u32 = 1;

/// Set and reset register of a GPIO port, and what it takes to set pins low.
const BSRR: &str = "write (size 4, offset 0x018, value 0x";
/// LED, DMD trigger, camera trigger; second LED and DMD trigger; head clear.
const OUTPUTS_E: u32 = 1 << 2 | 1 << 6 | 1 << 7 | 1 << 9 | 1 << 12 | 1 << 14 | 1 << 15;
/// Those that drop when something fails: both LEDs, camera trigger, head clear.
const DARK_E: u32 = 1 << 2 | 1 << 7 | 1 << 12 | 1 << 14 | 1 << 15;
/// Go, no-go, verdict beat.
const OUTPUTS_G: u32 = 0b111;
/// The watchdog's key that starts it: the first that `run` does with the board, before any task.
const WATCHDOG_STARTED: &str = "value 0x0000cccc)";

/// The emulator with its sockets; ended when dropped.
struct Machine {
    child: Child,
    folder: tempfile::TempDir,
    host: UnixStream,
    stage: UnixStream,
    bench: UnixStream,
    monitor: UnixStream,
    decoder: Decoder,
    sequence: u16,
    session: u32,
    events: Vec<Event>,
}

impl Machine {
    fn start(image: &Path) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let listen = |name: &str| UnixListener::bind(folder.path().join(name)).unwrap();
        let listeners = ["host", "stage", "bench", "monitor"].map(listen);
        let path = |name: &str| folder.path().join(name).display().to_string();
        let mut process = Process::new("qemu-system-arm");
        process.args(["-no-user-config", "-machine", "netduinoplus2"]);
        // A processor that is awake has the time of its instructions (32 ns each), not of the machine that runs it.
        process.args(["-icount", "shift=5"]);
        process.args(["-display", "none", "-monitor", "none", "-serial", "null"]);
        process.args(["-serial", &format!("unix:{}", path("stage"))]);
        process.args(["-serial", &format!("unix:{}", path("host"))]);
        process.args(["-qtest", &format!("unix:{}", path("bench"))]);
        process.args(["-qtest-log", "none"]);
        process.args(["-qmp", &format!("unix:{}", path("monitor"))]);
        process.args(["-d", "unimp", "-D", &path("log")]);
        process.arg("-kernel").arg(image).stdin(Stdio::null());
        let child = process.spawn().unwrap();
        let [host, stage, bench, monitor] = listeners.map(|listener| accept(&listener));
        // Asked and answered; the other ends speak when they want to.
        bench.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut machine = Self {
            child,
            folder,
            host,
            stage,
            bench,
            monitor,
            decoder: Decoder::new(),
            sequence: 0,
            session: 0,
            events: Vec::new(),
        };
        machine.order("{\"execute\":\"qmp_capabilities\"}");
        machine
    }

    /// To the emulator's monitor.
    fn order(&mut self, order: &str) {
        writeln!(self.monitor, "{order}").unwrap();
    }

    /// To what stands in for the world around the chip.
    fn act(&mut self, action: &str) {
        writeln!(self.bench, "{action}").unwrap();
        let mut answer = [0; 64];
        let count = self.bench.read(&mut answer).unwrap();
        assert_eq!(
            String::from_utf8_lossy(&answer[..count]),
            "OK\n",
            "{action}"
        );
    }

    /// Sets the contacts' levels; nobody is told.
    fn set_contacts(&mut self, levels: u32) {
        self.act(&format!("writel {CONTACTS:#x} {levels:#x}"));
    }

    /// A contact's edge at its EXTI line.
    fn edge(&mut self, pin: u32, level: u32) {
        self.act(&format!("set_irq_in exti unnamed-gpio-in {pin} {level}"));
    }

    /// What the emulator has logged so far.
    fn log(&self) -> String {
        let log = std::fs::read(self.folder.path().join("log")).unwrap();
        String::from_utf8_lossy(&log).into_owned()
    }

    /// What the stages are told, until it ends in `last`.
    fn stages_told(&mut self, last: &str) -> String {
        let (start, mut heard) = (Instant::now(), String::new());
        while start.elapsed() < PATIENCE && !heard.ends_with(last) {
            let mut buffer = [0; 256];
            let count = read(&mut self.stage, &mut buffer);
            heard.push_str(&String::from_utf8_lossy(&buffer[..count]));
        }
        heard
    }

    /// Waits until the stages have been told to stop, and nothing else, as after a start.
    fn stages_stopped(&mut self) {
        let stops = "ST\r".repeat(STOPS);
        assert_eq!(self.stages_told(&stops), stops);
    }

    /// Sends a command until its reply comes, as the host does: the model's receiver loses a byte now and then.
    fn ask(&mut self, command: &Command) -> Reply {
        self.sequence += 1;
        let header = Header {
            session: self.session,
            sequence: self.sequence,
            ack: 0,
        };
        let mut wire = [0; MAX_FRAME_BYTES];
        let length = encode(header, command, &mut wire).unwrap();
        for _ in 0..20 {
            self.host.write_all(&wire[..length]).unwrap();
            if let Some(reply) = self.listen(ASK_AGAIN, |_| false) {
                return reply;
            }
        }
        panic!("no reply to {command:?}");
    }

    /// The reply to the last command, if one came; events are kept.
    fn listen(&mut self, patience: Duration, done: impl Fn(&Self) -> bool) -> Option<Reply> {
        let start = Instant::now();
        while start.elapsed() < patience && !done(self) {
            let mut buffer = [0; 256];
            let count = read(&mut self.host, &mut buffer);
            let mut reply = None;
            for byte in &buffer[..count] {
                match self.decoder.push(*byte) {
                    Some(Ok(frame)) if frame.kind() == Kind::Reply => {
                        let asked = frame.header().ack == self.sequence;
                        reply = asked.then(|| frame.message().unwrap()).or(reply);
                    }
                    Some(Ok(frame)) => self.events.push(frame.message().unwrap()),
                    Some(Err(error)) => panic!("{error}"),
                    None => {}
                }
            }
            if reply.is_some() {
                return reply;
            }
        }
        None
    }

    fn hello(&mut self, session: u32) -> Identity {
        (self.session, self.sequence) = (session, 0);
        let hello = Command::Hello {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA_HASH,
        };
        match self.ask(&hello) {
            Reply::Hello(identity) => identity,
            other => panic!("{other:?}"),
        }
    }

    fn status(&mut self) -> Status {
        match self.ask(&Command::Status) {
            Reply::Status(status) => status,
            other => panic!("{other:?}"),
        }
    }

    /// What the stages were reported to be.
    fn names(&self) -> Vec<(u8, Option<StageName>)> {
        let names = self.events.iter().filter_map(|event| match event {
            Event::StageIdentity { axis, answer, .. } => Some((*axis, answer.ok())),
            _ => None,
        });
        names.collect()
    }

    fn cycles_reported(&self) -> usize {
        let cycle = |event: &&Event| matches!(event, Event::Cycle { .. });
        self.events.iter().filter(cycle).count()
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        let _ended = self.child.kill();
        let _status = self.child.wait();
    }
}

fn accept(listener: &UnixListener) -> UnixStream {
    listener.set_nonblocking(true).unwrap();
    let start = Instant::now();
    loop {
        match listener.accept() {
            Ok((stream, _)) => {
                stream.set_nonblocking(false).unwrap();
                let some = Some(Duration::from_millis(100));
                stream.set_read_timeout(some).unwrap();
                return stream;
            }
            Err(error) => assert_eq!(error.kind(), ErrorKind::WouldBlock),
        }
        assert!(start.elapsed() < PATIENCE, "the emulator did not connect");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// What arrives within a tenth of a second.
fn read(stream: &mut UnixStream, buffer: &mut [u8]) -> usize {
    match stream.read(buffer) {
        Ok(0) => panic!("the emulator ended"),
        Ok(count) => count,
        Err(error) => {
            assert_eq!(error.kind(), ErrorKind::WouldBlock);
            0
        }
    }
}

/// The name of an axis that [`answer_as_stages`] gives.
fn name(axis: u8) -> String {
    format!("URS100BCC,SN{axis}")
}

/// Answers as two stages without an error do, until the emulator ends.
fn answer_as_stages(mut line: UnixStream) {
    let mut question = Vec::new();
    let mut byte = [0];
    loop {
        match line.read(&mut byte) {
            Ok(0) => return,
            Ok(_) if byte != *b"\r" => {
                question.extend(byte);
                continue;
            }
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => continue,
            Err(_) => return,
        }
        let answer = match question.as_slice() {
            b"TB?" => "0, 0, NO ERROR DETECTED".into(),
            [axis, b'I', b'D', b'?'] => name(axis - b'0'),
            _ => String::new(),
        };
        question.clear();
        if !answer.is_empty() && write!(line, "{answer}\r\n").is_err() {
            return;
        }
    }
}

/// Pins of a port that the log sets low and high.
fn driven(log: &str, port: char) -> (u32, u32) {
    let writes = log.lines().filter_map(|line| {
        let write = line.strip_prefix(&format!("GPIO{port}: unimplemented device "))?;
        u32::from_str_radix(write.strip_prefix(BSRR)?.strip_suffix(')')?, 16).ok()
    });
    writes.fold((0, 0), |(low, high), value| {
        (low | value >> 16, high | value & 0xFFFF)
    })
}

/// Before its tasks run a start has set every output low, and none high.
#[track_caller]
fn assert_started_low(log: &str) {
    let (start, _) = log.split_once(WATCHDOG_STARTED).expect("a start");
    let (low, high) = driven(start, 'E');
    assert_eq!((low & OUTPUTS_E, high & OUTPUTS_E), (OUTPUTS_E, 0));
    let (low, high) = driven(start, 'G');
    assert_eq!((low & OUTPUTS_G, high & OUTPUTS_G), (OUTPUTS_G, 0));
}

/// What the running program still did, then the way down, then the clocks of the next start.
#[track_caller]
fn assert_fell_safe(log: &str) {
    let (down, start) = log.split_once("RCC: ").expect("a reset");
    let (low, high) = driven(down, 'E');
    assert_eq!((low & DARK_E, high & OUTPUTS_E), (DARK_E, 0), "{down}");
    assert_started_low(start);
}

fn image() -> Option<PathBuf> {
    emulated_board("netduinoplus2-f405")
}

#[test]
fn a_start_sets_the_outputs_low_and_stops_the_stages_and_then_answers() {
    let Some(image) = image() else { return };
    let mut machine = Machine::start(&image);
    machine.stages_stopped();
    assert_started_low(&machine.log());
    let identity = machine.hello(7);
    assert_eq!(identity.protocol, PROTOCOL_VERSION);
    assert_eq!(identity.schema, SCHEMA_HASH);
    // The model has no reset flags.
    assert_eq!(identity.boot, Boot::Requested);
    // Nobody answers on a bus that the model lacks, and the plug's contact is low.
    assert_eq!((identity.lens, identity.projectors), (false, 1));
    // The receiver's interrupt and the transmitter's, again and again.
    for _ in 0..30 {
        let status = machine.status();
        assert_eq!((status.state, status.fault), (State::Unhomed, None));
        assert!(!status.led_on && !status.press.head_clear, "{status:?}");
    }
}

#[test]
fn the_stages_are_asked_and_answer_over_their_own_line() {
    let Some(image) = image() else { return };
    let mut machine = Machine::start(&image);
    machine.stages_stopped();
    machine.hello(7);
    let stage = StageConfig::DEFAULT;
    let configure = Command::ConfigureStage {
        version: STAGE_CONFIG_VERSION,
        stage,
    };
    assert_eq!(machine.ask(&configure), Reply::Accepted);
    let line = machine.stage.try_clone().unwrap();
    std::thread::spawn(move || answer_as_stages(line));
    let axes = [stage.rotation.number, stage.vertical.number];
    let named = axes.map(|axis| (axis, StageName::of(name(axis).as_bytes())));
    // An answer may come late where the machine is busy with something else: it is asked for again.
    let asked = (0..20).any(|_| {
        machine.events.clear();
        assert_eq!(machine.ask(&Command::IdentifyStages), Reply::Accepted);
        machine.listen(PATIENCE, |machine| machine.names().len() == 2);
        machine.names() == named
    });
    assert!(asked, "{:?}", machine.events);
}

#[test]
fn a_contact_reaches_the_interlock_through_its_interrupt() {
    let Some(image) = image() else { return };
    let mut machine = Machine::start(&image);
    machine.stages_stopped();
    machine.hello(7);
    assert!(!machine.status().press.open);
    // Press open B says so by being low.
    machine.set_contacts(1 << PRESS_OPEN_A);
    machine.edge(PRESS_OPEN_A, 1);
    let opened = |machine: &Machine| {
        let open = |event: &Event| matches!(event, Event::PressOpen { open: true, .. });
        machine.events.iter().any(open)
    };
    machine.listen(PATIENCE, opened);
    assert!(opened(&machine), "{:?}", machine.events);
    // A level alone is not looked at.
    machine.set_contacts(1 << PRESS_OPEN_A | 1 << CYCLE);
    machine.listen(SILENCE, |_| false);
    assert_eq!(machine.cycles_reported(), 0);
    machine.edge(CYCLE, 1);
    machine.listen(PATIENCE, |machine| machine.cycles_reported() > 0);
    machine.set_contacts(1 << PRESS_OPEN_A);
    machine.edge(CYCLE, 0);
    let press = machine.status().press;
    assert_eq!((press.open, press.cycles), (true, 1), "{press:?}");
    assert_eq!(machine.cycles_reported(), 1);
}

#[test]
fn a_sinking_supply_drops_the_outputs_and_the_next_start_stops_the_stages_and_says_why() {
    let Some(image) = image() else { return };
    let mut machine = Machine::start(&image);
    machine.stages_stopped();
    machine.hello(7);
    let before = machine.log().len();
    for level in [1, 0] {
        machine.act(&format!("set_irq_in armv7m unnamed-gpio-in {PVD} {level}"));
    }
    machine.stages_stopped();
    assert_fell_safe(&machine.log()[before..]);
    // It has forgotten the session, not the cause.
    let forgotten = Reply::Refused(Refusal::NoSession { got: 7 });
    assert_eq!(machine.ask(&Command::Status), forgotten);
    assert_eq!(machine.hello(8).boot, Boot::PowerUp);
    assert_eq!(machine.status().state, State::Unhomed);
    // The cause is told once; the reset pin leaves none.
    machine.order("{\"execute\":\"system_reset\"}");
    machine.stages_stopped();
    assert_eq!(machine.hello(9).boot, Boot::Requested);
}

/// Whatever the program then does, it ends in the processor's fault.
#[test]
fn a_program_whose_memory_is_overwritten_drops_the_outputs_and_starts_anew() {
    let Some(image) = image() else { return };
    let mut machine = Machine::start(&image);
    machine.stages_stopped();
    let before = machine.log().len();
    machine.act(&format!("memset {RAM:#x} 0x4000 0xff"));
    // A byte arrives, for a buffer that is no more.
    machine.host.write_all(&[0]).unwrap();
    machine.stages_stopped();
    assert_fell_safe(&machine.log()[before..]);
    assert_eq!(machine.hello(7).boot, Boot::Panic);
}
