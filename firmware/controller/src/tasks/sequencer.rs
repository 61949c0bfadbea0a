//! The sequencer task: carries what happened to the sequence, and does what the sequence says.

use super::{Mailboxes, Outgoing, Request};
use crate::command_handler::{CommandHandler, LinkCounts};
use crate::devices::{Camera, Dmd, Led, Optics};
use crate::interlock::Position;
use crate::lens::{Lens, LensFault};
use crate::liveness::Task;
use crate::press::{NoPress, Press};
use crate::sequence::{Action, Actions, Input};
use crate::stage::StageRequest;
use core::sync::atomic::Ordering;
use embassy_futures::select::{Either, Either4, select, select4};
use embassy_time::{Duration, Instant, Timer, with_timeout};
use flankscope_protocol::{Event, Fault, Timestamp};

/// A pattern selection that takes longer than this counts as refused; on a 400 kHz bus it takes 0.2 ms.
const SELECT_TIMEOUT: Duration = Duration::from_millis(20);

/// A lens that takes longer is silent: on a 400 kHz bus it is told, tested and read within [`crate::max14574::TEST_POLLS`] + 2 ms.
const LENS_TIMEOUT: Duration = Duration::from_millis(20);

/// The controller's clock.
#[must_use]
pub fn now() -> Timestamp {
    Timestamp(Instant::now().as_micros())
}

/// Runs the sequence for ever on a table, without a press.
pub async fn sequencer<L: Led, D: Dmd, C: Camera, N: Lens>(
    handler: CommandHandler,
    optics: Optics<L, D, C, N>,
    mail: &Mailboxes,
) -> ! {
    press_sequencer(handler, optics, NoPress, mail).await
}

/// Runs the sequence for ever: waits for a command, a stage, a pin, the press or a deadline, and does what the
/// interlock and the sequence say, in this order.
pub async fn press_sequencer<L: Led, D: Dmd, C: Camera, N: Lens, P: Press>(
    mut handler: CommandHandler,
    mut optics: Optics<L, D, C, N>,
    mut press: P,
    mail: &Mailboxes,
) -> ! {
    let mut unreported = 0u32;
    // Whatever the reset's cause is said to be: what was set off before it may still be under way.
    let _hanging = mail.stage_requests.try_send(StageRequest::Stop);
    handler.sequence.begin(now());
    handler.projectors_fitted = optics.projectors();
    // Off, too, is a lens that kept its voltage over a reset.
    let lens_off = with_timeout(LENS_TIMEOUT, optics.lens.off());
    handler.lens_fitted = matches!(
        mail.liveness.alive(Task::Sequencer, lens_off).await,
        Ok(true)
    );
    loop {
        watch_press(&mut handler, &mut optics, &mut press, mail, &mut unreported).await;
        let awaiting = handler.sequence.awaiting();
        let deadline = handler.deadline(now());
        let seen = handler.interlock.levels();
        let any = select(
            press.changed(seen),
            select4(
                mail.requests.receive(),
                mail.stage_reports.receive(),
                sleep_until(deadline),
                optics.wait(awaiting),
            ),
        );
        let woken = mail.liveness.alive(Task::Sequencer, any).await;
        // The press first: what it forbids must not begin in this step either.
        watch_press(&mut handler, &mut optics, &mut press, mail, &mut unreported).await;
        let Either::Second(woken) = woken else {
            continue;
        };
        let mut actions = Actions::new();
        let mut reply = None;
        match woken {
            Either4::First(request) => {
                let link = LinkCounts {
                    frames_dropped: mail.frames_dropped.load(Ordering::Relaxed),
                    events_lost: mail.events_lost.load(Ordering::Relaxed),
                };
                let Request { header, command } = request;
                let answer = handler.handle(now(), header, command.as_ref(), link, &mut actions);
                mail.session
                    .store(handler.session().unwrap_or(0), Ordering::Relaxed);
                reply = Some(Outgoing::Reply(header, answer));
            }
            Either4::Second(report) => handler.sequence.step(now(), report.into(), &mut actions),
            Either4::Third(()) => handler.sequence.step(now(), Input::Tick, &mut actions),
            Either4::Fourth(input) => handler.sequence.step(now(), input, &mut actions),
        }
        perform(
            &mut handler,
            &mut optics,
            mail,
            &mut actions,
            &mut unreported,
        )
        .await;
        // The outputs came first: an accepted abort has already put out the LED.
        if let Some(reply) = reply {
            // No room: the host asks again, and the reply is remembered.
            let _room = mail.outgoing.try_send(reply);
        }
    }
}

/// Looks at the press, drives its outputs, and passes on what the interlock found.
async fn watch_press<L: Led, D: Dmd, C: Camera, N: Lens, P: Press>(
    handler: &mut CommandHandler,
    optics: &mut Optics<L, D, C, N>,
    press: &mut P,
    mail: &Mailboxes,
    unreported: &mut u32,
) {
    let at = now();
    let parked = handler.sequence.head(at).position == Position::Retracted;
    let change = handler.sample_inputs(at, press.levels(parked));
    let says = handler.interlock.outputs();
    if !says.may_enter {
        // Whatever the sequence still believes.
        optics.dark();
    }
    press.drive(says.head_clear, handler.verdict.lines(at));
    let mut actions = Actions::new();
    let count = handler.interlock.cycles();
    if change.cycle {
        report(mail, Event::Cycle { count, at }, unreported);
    }
    if let Some(open) = change.press_open {
        report(mail, Event::PressOpen { open, at }, unreported);
    }
    match change.fault {
        Some(fault) => handler
            .sequence
            .step(at, Input::Unsafe(fault), &mut actions),
        None if change.entered => handler.sequence.step(at, Input::MayEnter, &mut actions),
        None => return,
    }
    perform(handler, optics, mail, &mut actions, unreported).await;
}

/// Carries out actions in order, and what follows from them; none is left. Lent, not given: they are a kilobyte, and
/// copying it would be most of the time from an alarm to its edge.
async fn perform<L: Led, D: Dmd, C: Camera, N: Lens>(
    handler: &mut CommandHandler,
    optics: &mut Optics<L, D, C, N>,
    mail: &Mailboxes,
    actions: &mut Actions,
    unreported: &mut u32,
) {
    loop {
        let mut follow_up = None;
        for action in actions.iter() {
            match *action {
                Action::LedOn(projector, current) if handler.interlock.outputs().may_enter => {
                    optics.light(projector, current);
                }
                // Its current will be missed, which is a fault.
                Action::LedOn(..) => {}
                Action::LedOff => optics.dark(),
                Action::CameraTrigger(level) => optics.camera.trigger(level),
                Action::DmdTrigger(whose) => optics.show(whose),
                Action::SelectPattern(projector, pattern) => {
                    let selection = optics.select(projector, pattern);
                    let taken = with_timeout(SELECT_TIMEOUT, selection).await;
                    follow_up = Some(Input::PatternSelected(matches!(taken, Ok(Ok(())))));
                }
                Action::AskPattern(projector) => {
                    let asked = with_timeout(SELECT_TIMEOUT, optics.is_loaded(projector)).await;
                    let loaded = asked.ok().and_then(Result::ok);
                    follow_up = Some(Input::PatternLoaded(loaded));
                }
                Action::SetLens(counts) => {
                    follow_up = Some(in_time(optics.lens.set(counts)).await);
                }
                Action::CheckLens(counts) => {
                    follow_up = Some(in_time(optics.lens.check(counts)).await);
                }
                Action::LensOff => {
                    // One that does not obey fails at its next setting.
                    let _obeyed = with_timeout(LENS_TIMEOUT, optics.lens.off()).await;
                }
                Action::Identify { ticket } => {
                    let stage = *handler.sequence.stage_to_be();
                    follow_up = ask(mail, StageRequest::Identify { ticket, stage }).or(follow_up);
                }
                Action::Home { ticket } => {
                    let stage = *handler.sequence.stage();
                    follow_up = ask(mail, StageRequest::Home { ticket, stage }).or(follow_up)
                }
                Action::Move { ticket, view } => {
                    follow_up = ask(mail, StageRequest::Move { ticket, view }).or(follow_up);
                }
                Action::Retract { ticket, vertical } => {
                    follow_up = ask(mail, StageRequest::Retract { ticket, vertical }).or(follow_up);
                }
                Action::StopStages => follow_up = ask(mail, StageRequest::Stop).or(follow_up),
                Action::Report(event) => {
                    if !report(mail, event, unreported) {
                        follow_up = Some(Input::EventsLost);
                    }
                }
            }
        }
        actions.clear();
        let Some(input) = follow_up else { return };
        handler.sequence.step(now(), input, actions);
    }
}

/// What the lens answers, if it does.
async fn in_time(asked: impl Future<Output = Result<(), LensFault>>) -> Input {
    let answer = with_timeout(LENS_TIMEOUT, asked).await;
    Input::Lens(answer.unwrap_or(Err(LensFault::of(Fault::LensSilent, None))))
}

/// Queues an event; false on the first one of a row that finds no room.
///
/// A hole is announced by [`Event::EventsLost`] as soon as there is room again.
fn report(mail: &Mailboxes, event: Event, unreported: &mut u32) -> bool {
    if *unreported > 0 {
        let lost = Event::EventsLost {
            count: *unreported,
            at: now(),
        };
        if mail.outgoing.free_capacity() >= 2
            && mail.outgoing.try_send(Outgoing::Event(lost)).is_ok()
        {
            *unreported = 0;
        }
    }
    if *unreported == 0 && mail.outgoing.try_send(Outgoing::Event(event)).is_ok() {
        return true;
    }
    *unreported = unreported.saturating_add(1);
    mail.events_lost.fetch_add(1, Ordering::Relaxed);
    *unreported > 1
}

/// Queues a request to the stages; the answer to it if that is not possible because they hang.
fn ask(mail: &Mailboxes, request: StageRequest) -> Option<Input> {
    mail.stage_requests.try_send(request).err()?;
    request.failed(Fault::StageSilent).map(Input::from)
}

async fn sleep_until(deadline: Option<Timestamp>) {
    match deadline {
        Some(at) => Timer::at(Instant::from_micros(at.get())).await,
        None => core::future::pending().await,
    }
}
