//! The stage task: a request is started, then asked about until both axes stand; a newer one overtakes an older one between two
//! questions.
//!
//! At a view the stages are asked on and on whether they still stand there: a head in the die whose position is lost comes
//! out, it does not wait for the next move to find that out.

use super::Mailboxes;
use crate::liveness::Task;
use crate::stage::{Pose, Stage, StageFault, StageReport, StageRequest};
use core::pin::pin;
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Timer, with_timeout};
use flankscope_protocol::Fault;

/// How often the stages are asked whether they stand. At 19200 baud a question with its answer takes 4 ms of the wire.
const POLL: Duration = Duration::from_millis(5);
/// How often they are asked whether they still stand at a view. With [`Stage::watch_limit`], 71 ms at the slowest line allowed, and the
/// time to light off and retract, a lost position is seen within 0.1 s.
const WATCH: Duration = Duration::from_millis(25);

/// Serves the sequence's requests for ever.
pub async fn serve_stage(mut stage: impl Stage, mail: &Mailboxes) -> ! {
    let mut next = None;
    let mut at_view = None;
    loop {
        let request = match next.take() {
            Some(request) => request,
            None => {
                let next = next_request(&mut stage, at_view.take(), mail);
                mail.liveness.alive(Task::Stage, next).await
            }
        };
        // Every question has a time limit of its own, so this ends.
        if let StageRequest::Identify {
            ticket,
            stage: asked_of,
        } = &request
        {
            let asked = stage.identity(asked_of);
            let outcome = mail.liveness.alive(Task::Stage, asked).await;
            let sent = mail.stage_reports.send(StageReport::Identity {
                ticket: *ticket,
                outcome,
            });
            mail.liveness.alive(Task::Stage, sent).await;
            continue;
        }
        let started = mail.liveness.alive(Task::Stage, stage.start(request)).await;
        let mut outcome = started.map(|()| None);
        let overtaken = loop {
            match outcome {
                Ok(None) => {}
                Ok(Some(pose)) => break Ok(pose),
                Err(fault) => break Err(fault),
            }
            match select(mail.stage_requests.receive(), Timer::after(POLL)).await {
                Either::First(newer) => {
                    next = Some(newer);
                    break Err(StageFault {
                        fault: Fault::OutOfStep,
                        detail: 0,
                    });
                }
                Either::Second(()) => {
                    outcome = mail.liveness.alive(Task::Stage, stage.standing()).await;
                }
            }
        };
        if let (None, Some(ticket)) = (&next, request.ticket()) {
            let report = StageReport::Motion {
                ticket,
                outcome: overtaken,
            };
            let sent = mail.stage_reports.send(report);
            mail.liveness.alive(Task::Stage, sent).await;
            if let (StageRequest::Move { .. }, Ok(pose)) = (request, overtaken) {
                at_view = Some((ticket, pose));
            }
        }
    }
}

/// Waits for the next request. Meanwhile, at a view, reports under the ticket that led there whatever is not as it was.
async fn next_request(
    stage: &mut impl Stage,
    mut at_view: Option<(u16, Pose)>,
    mail: &Mailboxes,
) -> StageRequest {
    let fault = |fault| Err(StageFault { fault, detail: 0 });
    while let Some((ticket, pose)) = at_view {
        if let Ok(request) = with_timeout(WATCH, mail.stage_requests.receive()).await {
            return request;
        }
        let limit = stage.watch_limit();
        let mut asking = pin!(stage.standing());
        let answer = with_timeout(limit, asking.as_mut()).await;
        let outcome = match answer {
            Ok(Ok(Some(pose))) => Ok(pose),
            Ok(Ok(None)) => fault(Fault::OffPosition),
            Ok(Err(fault)) => Err(fault),
            Err(_) => fault(Fault::StageSilent),
        };
        if outcome != Ok(pose) {
            let report = StageReport::Motion { ticket, outcome };
            mail.stage_reports.send(report).await;
            at_view = outcome.ok().map(|pose| (ticket, pose));
        }
        if answer.is_err() {
            // Told already, but heard to its end: a late answer must not be taken for another's.
            let _late = asking.await;
        }
    }
    mail.stage_requests.receive().await
}
