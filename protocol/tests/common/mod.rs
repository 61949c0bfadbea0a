//! One sample of every message and of every enum variant a message can carry.
//!
//! `each!` expands to an exhaustive match, so a new variant does not compile until it has a sample here, and hence
//! golden bytes.
#![allow(dead_code, missing_docs)] // each test binary uses its part

pub mod feed;

use flankscope_protocol::message::Boot;
use flankscope_protocol::plan::Wait;
use flankscope_protocol::*;

macro_rules! each {
    ($type:ty: $($pattern:pat => $sample:expr),+ $(,)?) => {{
        fn _exhaustive(value: &$type) {
            match value {
                $($pattern => (),)+
            }
        }
        let samples: Vec<$type> = vec![$({
            let sample: $type = $sample;
            assert!(matches!(sample, $pattern), "the sample for {} is {sample:?}", stringify!($pattern));
            sample
        }),+];
        samples
    }};
}

const AT: Timestamp = Timestamp(1_234_567_890);

/// A short plan, so that all triples of bit flips can be tried.
pub fn short_plan() -> CapturePlan {
    CapturePlan {
        session: 3,
        views: [View {
            rotation: Microradians(-1_234_567),
            vertical: Micrometres(33_000),
        }]
        .into_iter()
        .collect(),
        exposures: [Microseconds(10_000)].into_iter().collect(),
        fringes: [FringeSet {
            periods: 48,
            steps: 8,
        }]
        .into_iter()
        .collect(),
        led: Milliamps(700),
        settle: Microseconds(50_000),
        dmd_settle: Microseconds(500),
        camera_readout: Microseconds(12_500),
        retract: Micrometres(100_000),
        timeouts: Timeouts::default(),
        focus: None,
        projectors: 1,
    }
}

/// As long as a plan can be on the wire: every list full, every integer of the longest encoding.
pub fn longest_plan() -> CapturePlan {
    CapturePlan {
        session: u32::MAX,
        views: [View {
            rotation: Microradians(i32::MIN),
            vertical: Micrometres(i32::MIN),
        }; plan::MAX_VIEWS]
            .into_iter()
            .collect(),
        exposures: [Microseconds(u32::MAX); plan::MAX_EXPOSURES]
            .into_iter()
            .collect(),
        fringes: [FringeSet {
            periods: u16::MAX,
            steps: u8::MAX,
        }; plan::MAX_FRINGE_SETS]
            .into_iter()
            .collect(),
        led: Milliamps(u16::MAX),
        settle: Microseconds(u32::MAX),
        dmd_settle: Microseconds(u32::MAX),
        camera_readout: Microseconds(u32::MAX),
        retract: Micrometres(i32::MIN),
        timeouts: Timeouts {
            motion: Microseconds(u32::MAX),
            led: Microseconds(u32::MAX),
            dmd: Microseconds(u32::MAX),
            camera: Microseconds(u32::MAX),
        },
        focus: Some(Focus {
            counts: LensCounts(u16::MAX),
            settle: Microseconds(u32::MAX),
        }),
        projectors: u8::MAX,
    }
}

pub fn commands() -> Vec<Command> {
    let mut all = each!(Command:
        Command::Hello { .. } => Command::Hello { protocol: 1, schema: 0x1234_5678 },
        Command::LoadPlan(_) => Command::LoadPlan(short_plan()),
        Command::Start { .. } => Command::Start { session: 3 },
        Command::Abort => Command::Abort,
        Command::Retract => Command::Retract,
        Command::Home => Command::Home,
        Command::Heartbeat => Command::Heartbeat,
        Command::Status => Command::Status,
        Command::AcknowledgeFault => Command::AcknowledgeFault,
        Command::ShowVerdict { .. } => Command::ShowVerdict { go: true },
        Command::ConfigureStage { .. } =>
            Command::ConfigureStage { version: stage::STAGE_CONFIG_VERSION, stage: stage_config() },
        Command::IdentifyStages => Command::IdentifyStages,
    );
    all.extend(
        stages()
            .into_iter()
            .map(|stage| Command::ConfigureStage { version: 9, stage }),
    );
    let focus = Focus {
        counts: LensCounts(541),
        settle: Microseconds(150_000),
    };
    all.push(Command::LoadPlan(CapturePlan {
        focus: Some(focus),
        ..short_plan()
    }));
    all.push(Command::LoadPlan(CapturePlan {
        projectors: 2,
        ..short_plan()
    }));
    all
}

pub fn states() -> Vec<State> {
    each!(State:
        State::Unhomed => State::Unhomed,
        State::Homing => State::Homing,
        State::Ready => State::Ready,
        State::Moving => State::Moving,
        State::Settling => State::Settling,
        State::Cooling => State::Cooling,
        State::Lighting => State::Lighting,
        State::Capturing => State::Capturing,
        State::Darkening => State::Darkening,
        State::Retracting => State::Retracting,
        State::Faulted => State::Faulted,
        State::Claiming => State::Claiming,
    )
}

fn whys() -> Vec<Why> {
    each!(Why:
        Why::Sequence => Why::Sequence,
        Why::Start => Why::Start,
        Why::Abort => Why::Abort,
        Why::Retract => Why::Retract,
        Why::Home => Why::Home,
        Why::Complete => Why::Complete,
        Why::Fault(_) => Why::Fault(Fault::DmdNotReady.code()),
        Why::Acknowledged => Why::Acknowledged,
    )
}

fn boots() -> Vec<Boot> {
    each!(Boot:
        Boot::PowerUp => Boot::PowerUp,
        Boot::Watchdog => Boot::Watchdog,
        Boot::Panic => Boot::Panic,
        Boot::Requested => Boot::Requested,
    )
}

fn waits() -> Vec<Wait> {
    each!(Wait:
        Wait::Settle => Wait::Settle,
        Wait::DmdSettle => Wait::DmdSettle,
        Wait::CameraReadout => Wait::CameraReadout,
        Wait::MotionTimeout => Wait::MotionTimeout,
        Wait::LedTimeout => Wait::LedTimeout,
        Wait::DmdTimeout => Wait::DmdTimeout,
        Wait::CameraTimeout => Wait::CameraTimeout,
        Wait::FocusSettle => Wait::FocusSettle,
    )
}

fn plan_errors() -> Vec<PlanError> {
    let (us, um, urad) = (Microseconds, Micrometres, Microradians);
    let mut all = each!(PlanError:
        PlanError::NoViews => PlanError::NoViews,
        PlanError::NoExposures => PlanError::NoExposures,
        PlanError::NoFringes => PlanError::NoFringes,
        PlanError::ExposureTooShort { .. } => PlanError::ExposureTooShort { got: us(1), limit: us(1_000) },
        PlanError::ExposureTooLong { .. } => PlanError::ExposureTooLong { got: us(200_000), limit: us(100_000) },
        PlanError::ExposuresNotAscending { .. } => PlanError::ExposuresNotAscending { got: us(10), limit: us(20) },
        PlanError::TooFewSteps { .. } => PlanError::TooFewSteps { got: 2, limit: 3 },
        PlanError::TooFewPeriods { .. } => PlanError::TooFewPeriods { got: 0, limit: 1 },
        PlanError::TooManyPatterns { .. } => PlanError::TooManyPatterns { got: 300, limit: 128 },
        PlanError::TooManyFrames { .. } => PlanError::TooManyFrames { got: 300, limit: 256 },
        PlanError::LedCurrent { .. } => PlanError::LedCurrent { got: Milliamps(5_000), limit: Milliamps(3_000) },
        PlanError::LedOnTime { .. } => PlanError::LedOnTime { got: us(5_000_000), limit: us(4_000_000) },
        PlanError::RotationOutOfTravel { .. } =>
            PlanError::RotationOutOfTravel { got: urad(-9), min: urad(-8), max: urad(8) },
        PlanError::VerticalOutOfTravel { .. } => PlanError::VerticalOutOfTravel { got: um(9), min: um(-8), max: um(8) },
        PlanError::WaitTooLong { .. } => PlanError::WaitTooLong { which: Wait::Settle, got: us(9), limit: us(8) },
        PlanError::WaitTooShort { .. } =>
            PlanError::WaitTooShort { which: Wait::LedTimeout, got: us(0), limit: us(1_000) },
        PlanError::FocusOutOfRange { .. } =>
            PlanError::FocusOutOfRange { got: LensCounts(900), min: LensCounts(200), max: LensCounts(800) },
        PlanError::Projectors { .. } => PlanError::Projectors { got: 3, limit: 2 },
    );
    all.extend(waits().into_iter().map(|which| PlanError::WaitTooLong {
        which,
        got: us(9),
        limit: us(8),
    }));
    all
}

fn stage_values() -> Vec<StageValue> {
    each!(StageValue:
        StageValue::Baud => StageValue::Baud,
        StageValue::RotationNumber => StageValue::RotationNumber,
        StageValue::RotationSpeed => StageValue::RotationSpeed,
        StageValue::RotationAcceleration => StageValue::RotationAcceleration,
        StageValue::RotationFrom => StageValue::RotationFrom,
        StageValue::RotationTo => StageValue::RotationTo,
        StageValue::RotationHome => StageValue::RotationHome,
        StageValue::RotationHomeSpeed => StageValue::RotationHomeSpeed,
        StageValue::VerticalNumber => StageValue::VerticalNumber,
        StageValue::VerticalSpeed => StageValue::VerticalSpeed,
        StageValue::VerticalAcceleration => StageValue::VerticalAcceleration,
        StageValue::VerticalFrom => StageValue::VerticalFrom,
        StageValue::VerticalTo => StageValue::VerticalTo,
        StageValue::VerticalHome => StageValue::VerticalHome,
        StageValue::VerticalHomeSpeed => StageValue::VerticalHomeSpeed,
    )
}

fn stage_errors() -> Vec<StageError> {
    let what = StageValue::VerticalTo;
    let mut all = each!(StageError:
        StageError::Version { .. } => StageError::Version { got: 2, want: 1 },
        StageError::Outside { .. } => StageError::Outside { what, got: -9, min: -8, max: 8 },
        StageError::Inverted { .. } => StageError::Inverted { what, got: -9, limit: 8 },
        StageError::SameNumber { .. } => StageError::SameNumber { got: 1 },
        StageError::TooSlow { .. } => StageError::TooSlow {
            what: StageValue::VerticalSpeed,
            value: 1,
            got: Microseconds(375_001_562),
            limit: Microseconds(60_000_000),
        },
        StageError::Model { .. } => StageError::Model { axis: 2, got: name("IMS300V, 7") },
        StageError::LineForm { .. } =>
            StageError::LineForm { got: Line { parity: Parity::Odd, flow: FlowControl::RtsCts, ..Line::HOST } },
    );
    all.extend(stage_values().into_iter().map(|what| StageError::Outside {
        what,
        got: 9,
        min: -8,
        max: 8,
    }));
    all
}

fn name(text: &str) -> StageName {
    StageName::of(text.as_bytes()).expect("printable")
}

/// With the line that the golden bytes were written with: another default is no other layout.
fn stage_config() -> StageConfig {
    let mut stage = StageConfig::DEFAULT;
    stage.line.baud = 115_200;
    stage
}

/// The stages with every way of homing, and with their models.
fn stages() -> Vec<StageConfig> {
    let mut stage = stage_config();
    let ways = each!(HomeAt:
        HomeAt::SwitchAndIndex => HomeAt::SwitchAndIndex,
        HomeAt::Switch => HomeAt::Switch,
        HomeAt::UpperLimit => HomeAt::UpperLimit,
        HomeAt::LowerLimit => HomeAt::LowerLimit,
    );
    let mut all: Vec<_> = ways
        .into_iter()
        .map(|home_at| {
            (stage.rotation.home_at, stage.vertical.home_at) = (home_at, home_at);
            stage
        })
        .collect();
    stage.rotation.model = Some(name("URS150BCC"));
    stage.vertical.model = Some(name("IMS300V"));
    all.push(stage);
    all
}

fn refusals() -> Vec<Refusal> {
    let mut all = each!(Refusal:
        Refusal::ProtocolVersion { .. } => Refusal::ProtocolVersion { got: 2, want: 1 },
        Refusal::SchemaHash { .. } => Refusal::SchemaHash { got: 0x1234_5678, want: 0x8765_4321 },
        Refusal::NoSession { .. } => Refusal::NoSession { got: 77 },
        Refusal::StaleSequence { .. } => Refusal::StaleSequence { got: 4, last: 9 },
        Refusal::Unreadable => Refusal::Unreadable,
        Refusal::Plan(_) => Refusal::Plan(PlanError::NoViews),
        Refusal::NoPlan => Refusal::NoPlan,
        Refusal::WrongPlan { .. } => Refusal::WrongPlan { got: 5, want: 3 },
        Refusal::Busy { .. } => Refusal::Busy { state: State::Capturing },
        Refusal::NotHomed => Refusal::NotHomed,
        Refusal::Faulted { .. } => Refusal::Faulted { fault: Fault::LedNotOn.code() },
        Refusal::Interlock { .. } => Refusal::Interlock { fault: Fault::PressNotOpen.code() },
        Refusal::Stage(_) => Refusal::Stage(StageError::SameNumber { got: 1 }),
        Refusal::NotConfigured => Refusal::NotConfigured,
        Refusal::NoLens => Refusal::NoLens,
        Refusal::TooFewProjectors { .. } => Refusal::TooFewProjectors { got: 2, fitted: 1 },
    );
    all.extend(plan_errors().into_iter().map(Refusal::Plan));
    all.extend(stage_errors().into_iter().map(Refusal::Stage));
    all
}

fn identity(boot: Boot) -> Identity {
    Identity {
        protocol: 1,
        schema: 0x1234_5678,
        firmware: [0, 1, 0],
        limits: Limits {
            stage_baud_min: 1_200,
            ..Limits::DEFAULT
        },
        host_silence: Microseconds(100_000),
        verdict_life: Microseconds(5_000_000),
        boot,
        lens: true,
        projectors: 2,
    }
}

fn status(state: State) -> Status {
    Status {
        state,
        fault: Some(Fault::MotionTimeout.code()),
        plan: Some(3),
        view: 2,
        frame: 24,
        led_on: true,
        homed: true,
        rotation: Microradians(74_800),
        vertical: Micrometres(33_000),
        press: PressStatus {
            open: true,
            head_clear: false,
            go: true,
            cycles: 1_000,
        },
        at: AT,
        frames_dropped: 1,
        events_lost: 0,
    }
}

pub fn replies() -> Vec<Reply> {
    let mut all = each!(Reply:
        Reply::Accepted => Reply::Accepted,
        Reply::Refused(_) => Reply::Refused(Refusal::NoPlan),
        Reply::Hello(_) => Reply::Hello(identity(Boot::PowerUp)),
        Reply::Status(_) => Reply::Status(status(State::Ready)),
    );
    all.extend(refusals().into_iter().map(Reply::Refused));
    all.extend(boots().into_iter().map(|boot| Reply::Hello(identity(boot))));
    all.extend(
        states()
            .into_iter()
            .map(|state| Reply::Status(status(state))),
    );
    all
}

pub fn events() -> Vec<Event> {
    let mut all = each!(Event:
        Event::StateChanged { .. } =>
            Event::StateChanged { prev: State::Ready, next: State::Moving, why: Why::Start, at: AT },
        Event::Triggered(_) => Event::Triggered(Trigger {
            session: 3,
            view: 2,
            frame: 24,
            pattern: 12,
            exposure: Microseconds(30_000),
            dmd_at: Timestamp(1_000_000),
            camera_at: Timestamp(1_000_700),
            end_at: Timestamp(1_030_700),
        }),
        Event::InPosition { .. } =>
            Event::InPosition { view: 2, rotation: Microradians(-1), vertical: Micrometres(33_000), at: AT },
        Event::Led { .. } => Event::Led { projector: Projector::First, on: true, at: AT },
        Event::ViewDone { .. } => Event::ViewDone { session: 3, view: 2, frames: 25, at: AT },
        Event::CaptureDone { .. } => Event::CaptureDone { session: 3, views: 3, frames: 75, at: AT },
        Event::Fault { .. } =>
            Event::Fault { fault: Fault::StageError.code(), state: State::Moving, detail: 106, at: AT },
        Event::EventsLost { .. } => Event::EventsLost { count: 4, at: AT },
        Event::Cycle { .. } => Event::Cycle { count: 1_000, at: AT },
        Event::PressOpen { .. } => Event::PressOpen { open: true, at: AT },
        Event::StageIdentity { .. } => Event::StageIdentity {
            axis: 1,
            answer: Ok(name("URS150BCC, SN0001")),
            at: AT,
        },
    );
    all.push(Event::StageIdentity {
        axis: 2,
        answer: Err(Fault::StageSilent.code()),
        at: AT,
    });
    let projectors = each!(Projector:
        Projector::First => Projector::First,
        Projector::Second => Projector::Second,
    );
    all.extend(projectors.into_iter().map(|projector| Event::Led {
        projector,
        on: false,
        at: AT,
    }));
    all.extend(whys().into_iter().map(|why| Event::StateChanged {
        prev: State::Moving,
        next: State::Settling,
        why,
        at: AT,
    }));
    all
}

pub const HEADER: Header = Header {
    session: 0xDEAD_00EF,
    sequence: 0x0102,
    ack: 0x0100,
};

/// The frame of a message under [`HEADER`].
pub fn frame<M: Message>(message: &M) -> Vec<u8> {
    let mut wire = [0; MAX_FRAME_BYTES];
    let length = encode(HEADER, message, &mut wire).expect("every message fits");
    wire[..length].to_vec()
}
