//! The limits of a watch at a view follow from the speed of the line to the stages: an ESP301 as slow as it may be, on lines whose
//! characters take their time.

use embassy_time::{Duration, Timer, with_timeout};
use embedded_io_async::{Read, Write};
use flankscope_controller::stage::esp301::Esp301;
use flankscope_controller::stage::{StageReport, StageRequest};
use flankscope_controller::{Mailboxes, serve_stage};
use flankscope_protocol::{Fault, Limits, Line, Micrometres, Microradians, StageConfig, View};
use flankscope_sim::{Clock, Port, Sim, now_us};
use std::cell::{Cell, RefCell};
use std::rc::Rc;

/// Within how long the controller's documentation promises that a lost position is seen.
const SEEN_US: u64 = 100_000;
/// How long an ESP301 takes for an answer at most, before its first character.
const ANSWER: Duration = Duration::from_millis(5);
/// How long the view is watched at least before the stages fall silent: several watches of the slowest line.
const WATCHED_MS: u64 = 500;
/// How much later, so that they fall silent anywhere between two watches of any line: a watch and the pause behind it take up to 140 ms.
const LATER_MS: [u64; 12] = [0, 12, 24, 36, 48, 60, 72, 84, 96, 108, 120, 132];

/// Stages that always stand, and answer as late and at such length as an ESP301 may.
async fn answer_slowly(mut port: Port, silent: Rc<Cell<bool>>, answered_us: Rc<Cell<u64>>) {
    let mut question = Vec::new();
    loop {
        let mut byte = [0];
        let Ok(_) = port.read(&mut byte).await;
        if byte != *b"\r" {
            question.extend(byte);
            continue;
        }
        let answer = match question.as_slice() {
            b"1MD?" | b"2MD?" => "1\r\n",
            b"1TP?" | b"2TP?" => "-123.456000\r\n",
            b"TB?" => "0, 1234567, NO ERROR DETECTED\r\n",
            _ => "",
        };
        question.clear();
        if !answer.is_empty() && !silent.get() {
            Timer::after(ANSWER).await;
            let Ok(()) = port.write_all(answer.as_bytes()).await;
            let Ok(()) = port.flush().await;
            answered_us.set(now_us());
        }
    }
}

/// What a watch reported of stages that stood and answered, and how long after their last answer they were reported silent, us.
fn watch_at(baud: u32, watched_ms: u64) -> (Option<StageReport>, u64) {
    let sim = Sim::new(Clock::Stepped);
    let mail: &'static Mailboxes = Box::leak(Box::new(Mailboxes::new()));
    let (device, controller) = Port::pair();
    let silent = Rc::new(Cell::new(false));
    let answered_us = Rc::new(Cell::new(0));
    sim.spawn(answer_slowly(
        device,
        Rc::clone(&silent),
        Rc::clone(&answered_us),
    ));
    sim.spawn(async move {
        serve_stage(Esp301::new(controller), mail).await;
    });
    let outcome = Rc::new(RefCell::new(None));
    let told = Rc::clone(&outcome);
    sim.spawn(async move {
        let mut stage = StageConfig::DEFAULT;
        stage.line.baud = baud;
        let view = View {
            rotation: Microradians(0),
            vertical: Micrometres(0),
        };
        for request in [
            StageRequest::Home { ticket: 1, stage },
            StageRequest::Move { ticket: 2, view },
        ] {
            mail.stage_requests.send(request).await;
            let report = mail.stage_reports.receive().await;
            assert!(
                matches!(report, StageReport::Motion { outcome: Ok(_), .. }),
                "{baud} baud: {report:?}"
            );
        }
        let watched = Duration::from_millis(watched_ms);
        let alarm = with_timeout(watched, mail.stage_reports.receive()).await.ok();
        silent.set(true);
        if alarm.is_none() {
            let report = mail.stage_reports.receive().await;
            assert!(
                matches!(
                    report,
                    StageReport::Motion { ticket: 2, outcome: Err(fault) } if fault.fault == Fault::StageSilent
                ),
                "{baud} baud: {report:?}"
            );
        }
        *told.borrow_mut() = Some((alarm, now_us() - answered_us.get()));
    });
    assert!(sim.run_until(|| outcome.borrow().is_some()));
    outcome.take().expect("the run ended with it")
}

/// The slowest line that a station may name is the slowest on which a lost position is still seen in time; on all of them, stages that
/// answer as late as they may are not called silent.
#[test]
fn a_watch_bears_the_time_on_the_wire_and_is_in_time_on_every_line_allowed() {
    let seen_us = |baud| {
        let seen = LATER_MS.map(|later_ms| {
            let (alarm, seen_us) = watch_at(baud, WATCHED_MS + later_ms);
            assert_eq!(alarm, None, "{baud} baud: stages that answer");
            seen_us
        });
        seen.into_iter().max().unwrap_or_default()
    };
    let slowest = Limits::DEFAULT.stage_baud_min;
    for baud in [slowest, 57_600, StageConfig::DEFAULT.line.baud, 921_600] {
        let seen_us = seen_us(baud);
        assert!(seen_us <= SEEN_US, "{baud} baud: seen after {seen_us} us");
    }
    // A line that must be refused: half as fast.
    let seen_us = seen_us(slowest / 2);
    assert!(seen_us > SEEN_US, "seen after {seen_us} us");
}

/// The wire has its time to the microsecond, each direction its own.
#[test]
fn characters_take_ten_bits_each_way() {
    let sim = Sim::new(Clock::Stepped);
    let (mut here, mut there) = Port::pair();
    let line = Line {
        baud: 19_200,
        ..StageConfig::DEFAULT.line
    };
    here.set(line);
    let times = Rc::new(RefCell::new(Vec::new()));
    let told = Rc::clone(&times);
    sim.spawn(async move {
        let mut byte = [0];
        for _ in 0..48 {
            let Ok(_) = there.read(&mut byte).await;
        }
        let Ok(()) = there.write_all(&[byte[0]; 24]).await;
    });
    sim.spawn(async move {
        let Ok(()) = here.write_all(&[7; 48]).await;
        let Ok(()) = here.flush().await;
        told.borrow_mut().push(now_us());
        let mut byte = [0];
        for _ in 0..24 {
            let Ok(_) = here.read(&mut byte).await;
        }
        told.borrow_mut().push(now_us());
    });
    assert!(sim.run_until(|| times.borrow().len() == 2));
    // 48 characters of 10 bits at 19 200 bit/s are 25 ms; a character is rounded down to a whole nanosecond, its arrival up to a microsecond.
    assert_eq!(*times.borrow(), [25_000, 37_500]);
}
