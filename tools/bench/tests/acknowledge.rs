//! A controller that a fault has stopped, behind a pseudo-terminal: nothing but a person's word brings it back.

mod common;

use std::path::Path;
use std::time::Duration;

use flankscope_bench::devices::{Exposure, ExposureSink, InstrumentConfig, run};
use flankscope_instrument::controller::{Client, ClientError, ClientSettings};
use flankscope_instrument::doctor::{self, Health};
use flankscope_protocol::{Command, Event, Fault, Refusal, StageConfig, StageName, State};

struct Unlit;

impl ExposureSink for Unlit {
    fn exposed(&mut self, _: Exposure) {}
}

/// What a home search of these stages ends in: the state, or the fault.
fn home(port: &Path, stage: &StageConfig) -> Result<Result<State, Option<Fault>>, ClientError> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime");
    runtime.block_on(async {
        let mut client = Client::connect(port, ClientSettings::default()).await?;
        client.configure(stage).await?;
        client.order(&Command::Home).await?;
        loop {
            match client.event(Duration::from_secs(20)).await? {
                Event::Fault { fault, .. } => return Ok(Err(fault.known())),
                Event::StateChanged { next, .. } if next == State::Ready => return Ok(Ok(next)),
                _ => {}
            }
        }
    })
}

#[test]
fn a_fault_is_told_until_somebody_acknowledges_it_and_then_work_goes_on() {
    let instrument = run(InstrumentConfig::paced(20.0), Unlit).expect("a pseudo-terminal");
    let port = instrument.port().to_path_buf();
    let ours = StageConfig::DEFAULT;
    let mut others = ours;
    others.rotation.model = StageName::of(b"ANOTHER");
    let stopped = home(&port, &others).expect("it answers");
    assert_eq!(stopped, Err(Some(Fault::OtherStage)));

    // Looking changes nothing, however often.
    let look = |acknowledge_fault: bool| {
        let [controller, stages, _] =
            doctor::controller(&port, ClientSettings::default(), &ours, acknowledge_fault);
        (controller, stages)
    };
    for _ in 0..2 {
        let (controller, _) = look(false);
        assert_eq!(controller.health, Health::Failed, "{controller:?}");
        assert!(
            controller
                .remedy
                .expect("a remedy")
                .contains("--acknowledge-fault")
        );
    }
    let refused = home(&port, &ours).expect_err("it stands in its fault");
    assert!(
        matches!(refused, ClientError::Refused(Refusal::Faulted { .. })),
        "{refused}"
    );

    let (controller, stages) = look(true);
    assert_eq!(controller.health, Health::Ok, "{controller:?}");
    assert!(
        controller.seen.contains("has been acknowledged"),
        "{controller:?}"
    );
    // Nothing has moved: where the stages are is not known yet.
    assert_eq!(stages.figures["homed"], false);
    let (controller, _) = look(false);
    assert!(!controller.seen.contains("acknowledged"), "{controller:?}");
    assert_eq!(home(&port, &ours).expect("it answers"), Ok(State::Ready));
    instrument.stop().expect("no panic");
}
