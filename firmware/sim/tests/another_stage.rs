//! A stage of somebody else's: one `impl Stage`, handed to `serve_stage`, and the sequence's requests are served by it.

use embassy_time::{Duration, Instant, Timer};
use flankscope_controller::stage::{Pose, Stage, StageFault, StageReport, StageRequest};
use flankscope_controller::{Mailboxes, serve_stage};
use flankscope_protocol::{Fault, Micrometres, Microradians, StageConfig, StageName, View};
use flankscope_sim::{Clock, Sim, now_us};
use std::cell::RefCell;
use std::rc::Rc;

/// Needs 20 ms for whatever it is asked, and knows no way to halt.
struct Slide {
    going_to: Pose,
    there_at: Instant,
}

const HOME: Pose = Pose {
    rotation: Microradians(0),
    vertical: Micrometres(0),
};

impl Stage for Slide {
    async fn start(&mut self, request: StageRequest) -> Result<(), StageFault> {
        self.going_to = match request {
            StageRequest::Home { .. } => HOME,
            StageRequest::Move { view, .. } => Pose {
                rotation: view.rotation,
                vertical: view.vertical,
            },
            StageRequest::Retract { vertical, .. } => Pose {
                vertical,
                ..self.going_to
            },
            StageRequest::Stop | StageRequest::Identify { .. } => {
                return Err(StageFault {
                    fault: Fault::StageError,
                    detail: 1,
                });
            }
        };
        self.there_at = Instant::now() + Duration::from_millis(20);
        Ok(())
    }

    async fn standing(&mut self) -> Result<Option<Pose>, StageFault> {
        Ok((Instant::now() >= self.there_at).then_some(self.going_to))
    }

    fn watch_limit(&self) -> Duration {
        Duration::from_millis(60)
    }

    async fn identity(&mut self, _: &StageConfig) -> Result<[StageName; 2], StageFault> {
        let name = StageName::of(b"SLIDE, 7").ok_or(StageFault {
            fault: Fault::StageReply,
            detail: 0,
        })?;
        Ok([name; 2])
    }
}

#[test]
fn a_driver_of_your_own_serves_the_sequence() {
    let sim = Sim::new(Clock::Stepped);
    let mail: &'static Mailboxes = Box::leak(Box::new(Mailboxes::new()));
    sim.spawn(async move {
        let slide = Slide {
            going_to: HOME,
            there_at: Instant::MIN,
        };
        serve_stage(slide, mail).await;
    });
    let view = View {
        rotation: Microradians(12_345),
        vertical: Micrometres(33_000),
    };
    let reports = Rc::new(RefCell::new(Vec::new()));
    let told = Rc::clone(&reports);
    sim.spawn(async move {
        let requests = [
            StageRequest::Home {
                ticket: 1,
                stage: StageConfig::DEFAULT,
            },
            StageRequest::Move { ticket: 2, view },
            StageRequest::Identify {
                ticket: 4,
                stage: StageConfig::DEFAULT,
            },
            StageRequest::Retract {
                ticket: 3,
                vertical: Micrometres(-5_000),
            },
        ];
        for request in requests {
            mail.stage_requests.send(request).await;
            let report = mail.stage_reports.receive().await;
            told.borrow_mut().push((now_us() / 1000, report));
        }
        Timer::after(Duration::from_millis(1)).await;
    });
    sim.run_until(|| reports.borrow().len() == 4);
    let poses: Vec<_> = reports
        .borrow()
        .iter()
        .filter_map(|(_, report)| match *report {
            StageReport::Motion { ticket, outcome } => Some((ticket, outcome)),
            StageReport::Identity { ticket, outcome } => {
                assert_eq!(ticket, 4);
                assert!(
                    outcome
                        .is_ok_and(|names| names.map(|name| name.model() == b"SLIDE") == [true; 2])
                );
                None
            }
        })
        .collect();
    let there = Pose {
        rotation: view.rotation,
        vertical: view.vertical,
    };
    let out = Pose {
        vertical: Micrometres(-5_000),
        ..there
    };
    assert_eq!(poses, [(1, Ok(HOME)), (2, Ok(there)), (3, Ok(out))]);
    // Each took its 20 ms and at most one more question.
    let last_ms = reports.borrow().last().map(|(ms, _)| *ms);
    assert!(
        last_ms.is_some_and(|ms| (60..=75).contains(&ms)),
        "{last_ms:?}"
    );
}
