//! The sequence in hand-stepped time, against a world of ideal devices that can be cloned and disturbed at any step.

extern crate std;

mod disturbed;
mod identity;
mod lens;
mod two_projectors;

use super::*;
use crate::diagrams;
use flankscope_protocol::{Limits, Microseconds, Milliamps, Trigger, View};

use crate::lens::LensFault;
use crate::stage_fault::StageFault;
use flankscope_protocol::{FringeSet, LensCounts, StageName, Timeouts};
use std::{vec, vec::Vec};

const RETRACTED: Micrometres = Micrometres(90_000);

fn config() -> Config {
    Config {
        host_silence: Microseconds::from_millis(100),
        ..Config::DEFAULT
    }
}

fn plan() -> CapturePlan {
    CapturePlan {
        session: 9,
        views: [(0, 33_000), (74_800, 33_000), (-149_600, 20_000)]
            .map(|(rotation, vertical)| View {
                rotation: Microradians(rotation),
                vertical: Micrometres(vertical),
            })
            .into_iter()
            .collect(),
        exposures: [10_000, 30_000].map(Microseconds).into_iter().collect(),
        fringes: [
            FringeSet {
                periods: 4,
                steps: 4,
            },
            FringeSet {
                periods: 48,
                steps: 8,
            },
        ]
        .into_iter()
        .collect(),
        led: Milliamps(700),
        settle: Microseconds(20_000),
        dmd_settle: Microseconds(500),
        camera_readout: Microseconds(12_500),
        retract: RETRACTED,
        timeouts: Timeouts::default(),
        focus: None,
        projectors: 1,
    }
}

#[derive(Debug, Clone, Copy)]
struct Led {
    on: bool,
    flips_at: Timestamp,
}

/// Ideal devices: each answers after a fixed time.
#[derive(Debug, Clone)]
struct World {
    leds: [Led; 2],
    ready_at: Option<Timestamp>,
    dmd_switch_us: u32,
    /// Questions for which the DMD fetches a selected pattern, and those that are left.
    pattern_takes: u32,
    pattern_loads: u32,
    exposing: bool,
    exposing_flips_at: Timestamp,
    motion: Option<(Timestamp, u16, View)>,
    pose: View,
    lens: Option<LensCounts>,
    lens_says: Result<(), LensFault>,
    stages_are: Result<[StageName; 2], StageFault>,
    /// They are not asked, or do not answer.
    stages_mute: bool,
    /// No device answers any more.
    frozen: bool,
    host_alive: bool,
    host_next: Timestamp,
    /// How much later than its deadline the sequence is woken.
    lateness_us: u64,
}

const LED_RISE_US: u32 = 200;
const DMD_SWITCH_US: u32 = 700;
const STROBE_US: u32 = 5;
const MOTION_US: u32 = 300_000;
const HEARTBEAT_US: u32 = 30_000;

#[derive(Debug, Clone)]
struct Rig {
    now: Timestamp,
    sequence: Sequence,
    world: World,
    /// Every action with its time.
    log: Vec<(Timestamp, Action)>,
}

impl Rig {
    fn new(config: Config) -> Self {
        let home = View {
            rotation: Microradians(0),
            vertical: StageConfig::DEFAULT.vertical.home,
        };
        let world = World {
            leds: [Led {
                on: false,
                flips_at: Timestamp(0),
            }; 2],
            ready_at: None,
            dmd_switch_us: DMD_SWITCH_US,
            pattern_takes: 0,
            pattern_loads: 0,
            exposing: false,
            exposing_flips_at: Timestamp(0),
            motion: None,
            pose: home,
            lens: None,
            lens_says: Ok(()),
            stages_are: Err(StageFault {
                fault: Fault::StageSilent,
                detail: 0,
            }),
            stages_mute: false,
            frozen: false,
            host_alive: true,
            host_next: Timestamp(0),
            lateness_us: 0,
        };
        Self {
            now: Timestamp(1_000),
            sequence: Sequence::new(config),
            world,
            log: Vec::new(),
        }
    }

    fn homed(config: Config, plan: CapturePlan) -> Self {
        let mut rig = Self::new(config);
        rig.order(|sequence, now, out| sequence.home(now, out));
        rig.run();
        assert_eq!(rig.sequence.state(), State::Ready);
        assert_eq!(plan.validate(&config.limits), Ok(()));
        rig.sequence.store(plan);
        rig.log.clear();
        rig
    }

    /// Homed and started.
    fn started(config: Config, plan: CapturePlan) -> Self {
        let mut rig = Self::homed(config, plan);
        rig.order(|sequence, now, out| sequence.start(now, out));
        assert_eq!(rig.sequence.state(), State::Claiming);
        rig.input(Input::MayEnter);
        rig
    }

    fn order(&mut self, order: impl FnOnce(&mut Sequence, Timestamp, &mut Actions)) {
        let mut out = Actions::new();
        order(&mut self.sequence, self.now, &mut out);
        self.perform(out);
    }

    fn input(&mut self, input: Input) {
        let mut out = Actions::new();
        self.sequence.step(self.now, input, &mut out);
        self.perform(out);
    }

    fn perform(&mut self, actions: Actions) {
        assert!(actions.len() < MAX_ACTIONS, "no room left: {actions:?}");
        let (mut selected, mut loading, mut asked, mut identified) = (false, false, false, None);
        for action in actions {
            self.log.push((self.now, action));
            let world = &mut self.world;
            match action {
                Action::LedOn(projector, _) => {
                    // Not even the light that goes out is left.
                    let dark = |led: &Led| !led.on && led.flips_at <= self.now;
                    assert!(world.leds.iter().all(dark), "two LEDs at once");
                    world.leds[projector as usize] = Led {
                        on: true,
                        flips_at: self.now.after(Microseconds(LED_RISE_US)),
                    };
                }
                Action::LedOff => {
                    for led in world.leds.iter_mut().filter(|led| led.on) {
                        *led = Led {
                            on: false,
                            flips_at: self.now.after(Microseconds(LED_RISE_US)),
                        };
                    }
                }
                Action::SelectPattern(projector, _) => {
                    assert!(world.leds[projector as usize].on, "selected in the dark");
                    (world.ready_at, selected) = (None, true);
                }
                Action::AskPattern(_) => loading = true,
                Action::DmdTrigger(Some(projector)) => {
                    assert!(world.pattern_loads == 0, "triggered before it was loaded");
                    assert!(world.leds[projector as usize].on, "shown in the dark");
                    world.ready_at = Some(self.now.after(Microseconds(world.dmd_switch_us)))
                }
                Action::DmdTrigger(None) => {}
                Action::CameraTrigger(level) => {
                    if level != world.exposing {
                        (world.exposing, world.exposing_flips_at) =
                            (level, self.now.after(Microseconds(STROBE_US)));
                    }
                }
                Action::Identify { ticket } => identified = Some(ticket),
                Action::Home { ticket } => {
                    let vertical = self.sequence.stage().vertical.home;
                    let view = View {
                        rotation: Microradians(0),
                        vertical,
                    };
                    world.motion = Some((self.now.after(Microseconds(MOTION_US)), ticket, view));
                }
                Action::Move { ticket, view } => {
                    assert!(
                        !world.leds.iter().any(|led| led.on),
                        "moving with the LED on"
                    );
                    world.motion = Some((self.now.after(Microseconds(MOTION_US)), ticket, view));
                }
                Action::Retract { ticket, vertical } => {
                    let view = View {
                        vertical,
                        ..world.pose
                    };
                    world.motion = Some((self.now.after(Microseconds(MOTION_US)), ticket, view));
                }
                Action::SetLens(counts) => (world.lens, asked) = (Some(counts), true),
                Action::CheckLens(counts) => {
                    assert_eq!(world.lens, Some(counts));
                    asked = true;
                }
                Action::LensOff => world.lens = None,
                Action::StopStages => world.motion = None,
                Action::Report(_) => {}
            }
        }
        if selected && !self.world.frozen {
            self.world.pattern_loads = self.world.pattern_takes;
            self.input(Input::PatternSelected(true));
        }
        if loading && !self.world.frozen {
            let loads = self.world.pattern_loads;
            self.world.pattern_loads = loads.saturating_sub(1);
            self.input(Input::PatternLoaded(Some(loads == 0)));
        }
        if let Some(ticket) = identified
            && !self.world.frozen
            && !self.world.stages_mute
        {
            let outcome = self.world.stages_are;
            self.input(Input::StagesAre { ticket, outcome });
        }
        if asked && !self.world.frozen {
            self.input(Input::Lens(self.world.lens_says));
        }
    }

    /// The next thing the world says, and when; levels that already hold are said at once.
    fn next(&self) -> Option<(Timestamp, Input)> {
        let (world, awaiting) = (&self.world, self.sequence.awaiting());
        let mut said = Vec::new();
        if !world.frozen {
            for projector in Projector::ALL {
                let Led { on, flips_at } = world.leds[projector as usize];
                if awaiting.led_sense[projector as usize] == Some(on) {
                    said.push((flips_at, Input::LedSense(projector, on)));
                }
            }
            if let Some(at) = world.ready_at.filter(|_| awaiting.dmd_ready.is_some()) {
                said.push((at, Input::DmdReady));
            }
            match awaiting.camera {
                Some(CameraWait::Ready) if !world.exposing => {
                    said.push((world.exposing_flips_at, Input::CameraReady))
                }
                Some(CameraWait::Exposing(level)) if level == world.exposing => {
                    said.push((world.exposing_flips_at, Input::CameraExposing(level)));
                }
                _ => {}
            }
            if let Some((at, ticket, view)) = world.motion {
                let View { rotation, vertical } = view;
                said.push((
                    at,
                    Input::InPosition {
                        ticket,
                        rotation,
                        vertical,
                    },
                ));
            }
        }
        if self.sequence.state() == State::Claiming {
            said.push((self.now, Input::MayEnter));
        }
        if world.host_alive && self.sequence.capturing() {
            said.push((world.host_next, Input::HostAlive));
        }
        if let Some(deadline) = self.sequence.deadline() {
            said.push((Timestamp(deadline.get() + world.lateness_us), Input::Tick));
        }
        said.into_iter()
            .map(|(at, input)| (at.max(self.now), input))
            .min_by_key(|(at, _)| *at)
    }

    /// One step; false when nothing is left to happen.
    fn advance(&mut self) -> bool {
        let Some((at, input)) = self.next() else {
            return false;
        };
        self.now = at;
        match input {
            Input::InPosition { .. } => {
                if let Some((_, _, view)) = self.world.motion.take() {
                    self.world.pose = view;
                }
            }
            Input::HostAlive => self.world.host_next = at.after(Microseconds(HEARTBEAT_US)),
            _ => {}
        }
        self.input(input);
        true
    }

    fn run(&mut self) {
        for _ in 0..10_000 {
            if !self.advance() {
                return;
            }
        }
        panic!("no rest after 10 000 steps in {:?}", self.sequence.step);
    }

    fn events(&self) -> impl Iterator<Item = Event> + '_ {
        self.log.iter().filter_map(|(_, action)| match action {
            Action::Report(event) => Some(*event),
            _ => None,
        })
    }

    fn triggers(&self) -> Vec<Trigger> {
        self.events()
            .filter_map(|event| match event {
                Event::Triggered(trigger) => Some(trigger),
                _ => None,
            })
            .collect()
    }

    fn faults(&self) -> Vec<Fault> {
        self.events()
            .filter_map(|event| match event {
                Event::Fault { fault, .. } => fault.known(),
                _ => None,
            })
            .collect()
    }

    fn dark(&self) -> bool {
        let lit = self.world.leds.iter().any(|led| led.on);
        !lit && !self.world.exposing && self.sequence.lamps.enabled().is_none()
    }
}

/// Every step of an undisturbed capture by one projector, and by two.
fn every_step() -> Vec<Rig> {
    let mut steps = steps_of(plan());
    steps.extend(steps_of(two_projectors::plan()));
    steps
}

fn steps_of(plan: CapturePlan) -> Vec<Rig> {
    let mut rig = Rig::started(config(), plan);
    let mut steps = vec![rig.clone()];
    while rig.advance() {
        steps.push(rig.clone());
    }
    steps
}

#[test]
fn a_capture_takes_every_frame_in_the_order_of_the_plan() {
    let mut rig = Rig::started(config(), plan());
    rig.run();
    let plan = plan();
    let mut expected = Vec::new();
    for view in 0..3u8 {
        for frame in 0..plan.frames_per_view() {
            let spec = plan.frame(frame).expect("a frame of the plan");
            expected.push((view, frame, spec.pattern, spec.exposure));
        }
    }
    let taken: Vec<_> = rig
        .triggers()
        .iter()
        .map(|t| (t.view, t.frame, t.pattern, t.exposure))
        .collect();
    assert_eq!(taken, expected);
    assert_eq!(
        rig.triggers()[0].pattern,
        0,
        "the dark index frame comes first"
    );
    for t in rig.triggers() {
        assert_eq!(
            t.end_at,
            t.camera_at.after(t.exposure),
            "the pulse is the exposure"
        );
        assert!(
            t.camera_at >= t.dmd_at.after(Microseconds(DMD_SWITCH_US + 500)),
            "the pattern stands"
        );
    }
    assert_eq!(rig.faults(), []);
    assert_eq!(
        (rig.sequence.state(), rig.world.pose.vertical),
        (State::Ready, RETRACTED)
    );
    let done = Event::CaptureDone {
        session: 9,
        views: 3,
        frames: 75,
        at: rig.now,
    };
    assert!(rig.events().any(|event| event == done));
}

#[test]
fn states_follow_each_other_as_drawn() {
    let mut rig = Rig::started(config(), plan());
    rig.run();
    let mut states = vec![State::Ready];
    for event in rig.events() {
        if let Event::StateChanged { prev, next, .. } = event {
            assert_eq!(states.last(), Some(&prev));
            states.push(next);
        }
    }
    let view = [
        State::Moving,
        State::Settling,
        State::Lighting,
        State::Capturing,
        State::Darkening,
    ];
    let expected = [
        &[State::Ready, State::Claiming][..],
        &view,
        &view,
        &view,
        &[State::Retracting, State::Ready],
    ]
    .concat();
    assert_eq!(states, expected);
}

/// The DMD fetches every pattern for a while: its trigger waits for that, and no longer than the plan says.
#[test]
fn a_pattern_is_triggered_once_it_is_loaded() {
    let mut rig = Rig::started(config(), plan());
    rig.world.pattern_takes = 3;
    rig.run();
    assert_eq!((rig.faults(), rig.sequence.state()), (vec![], State::Ready));
    let mut selected = None;
    let mut triggered = 0;
    for (at, action) in &rig.log {
        match action {
            Action::SelectPattern(..) => selected = Some(*at),
            Action::DmdTrigger(Some(_)) => {
                let waited_us = at.since_us(selected.expect("a pattern"));
                // Three questions are answered with no, each a pause apart.
                assert_eq!(waited_us, 3 * u64::from(LOADING_POLL.get()));
                triggered += 1;
            }
            _ => {}
        }
    }
    assert!(triggered > 0);
    let mut rig = Rig::started(config(), plan());
    rig.world.pattern_takes = u32::MAX;
    rig.run();
    assert_eq!(rig.sequence.fault(), Some(Fault::DmdSelect));
    let lit = |action: &Action| matches!(action, Action::DmdTrigger(Some(_)));
    assert!(!rig.log.iter().any(|(_, action)| lit(action)));
}

#[test]
fn the_pattern_shown_is_the_one_selected_last() {
    let mut rig = Rig::started(config(), plan());
    rig.run();
    let mut selected = None;
    let mut shown = Vec::new();
    for (_, action) in &rig.log {
        match action {
            Action::SelectPattern(_, pattern) => selected = Some(*pattern),
            Action::CameraTrigger(true) => shown.push(selected.expect("a pattern")),
            _ => {}
        }
    }
    let reported: Vec<_> = rig
        .triggers()
        .iter()
        .map(|trigger| trigger.pattern)
        .collect();
    assert_eq!(shown, reported);
}

#[test]
fn the_led_is_on_only_between_settle_and_the_last_frame() {
    let mut rig = Rig::started(config(), plan());
    while rig.advance() {
        let lit = rig.sequence.lamps.enabled().is_some();
        let may = matches!(rig.sequence.state(), State::Lighting | State::Capturing);
        assert_eq!(lit, may, "in {:?}", rig.sequence.step);
        assert!(
            !(lit && rig.world.motion.is_some()),
            "moving with the LED on"
        );
    }
    let settled: Vec<_> = rig
        .log
        .iter()
        .filter(|(_, action)| {
            matches!(
                action,
                Action::LedOn(..) | Action::Report(Event::InPosition { .. })
            )
        })
        .map(|(at, _)| *at)
        .collect();
    for pair in settled.chunks(2) {
        assert_eq!(pair[1], pair[0].after(plan().settle));
    }
    assert_eq!(settled.len(), 6);
}

#[test]
fn readout_overlaps_the_next_exposure_but_never_its_end() {
    for readout in [0, 500, 5_000, 12_500, 29_000, 60_000] {
        for exposures in [&[1_000][..], &[10_000, 30_000], &[2_000, 12_000, 50_000]] {
            let plan = CapturePlan {
                camera_readout: Microseconds(readout),
                exposures: exposures.iter().copied().map(Microseconds).collect(),
                fringes: [FringeSet {
                    periods: 4,
                    steps: 4,
                }]
                .into_iter()
                .collect(),
                ..plan()
            };
            let mut rig = Rig::started(config(), plan);
            rig.run();
            let triggers = rig.triggers();
            assert_eq!(triggers.len(), 3 * (1 + 4 * exposures.len()));
            for pair in triggers
                .windows(2)
                .filter(|pair| pair[0].view == pair[1].view)
            {
                let [last, this] = [pair[0], pair[1]];
                let readout_end = last.end_at.after(Microseconds(readout));
                assert!(
                    this.end_at >= readout_end,
                    "{this:?} ends inside the readout of {last:?}"
                );
                // And no later than needed: as soon as the pattern stands or the readout allows.
                let stands = this.dmd_at.after(Microseconds(DMD_SWITCH_US + 500));
                let allowed = Timestamp(
                    readout_end
                        .get()
                        .saturating_sub(u64::from(this.exposure.get())),
                );
                assert_eq!(this.camera_at, stands.max(allowed));
            }
        }
    }
}

/// Every change of state in captures that are disturbed in every way at every step, with what causes it.
fn every_change() -> diagrams::Changes {
    let orders: [fn(&mut Sequence, Timestamp, &mut Actions); 4] = [
        Sequence::abort,
        Sequence::retract,
        Sequence::home,
        Sequence::acknowledge,
    ];
    let hot = Limits {
        led_on_max: Microseconds(900_000),
        led_duty_permille: 200,
        ..Limits::DEFAULT
    };
    let mut rigs = Vec::new();
    let captures = [
        (Limits::DEFAULT, plan()),
        (hot, plan()),
        (Limits::DEFAULT, two_projectors::plan()),
    ];
    for (limits, plan) in captures {
        let mut rig = Rig::new(Config { limits, ..config() });
        rig.sequence.store(plan);
        rigs.push(rig.clone());
        rig.order(|sequence, now, out| sequence.home(now, out));
        rigs.push(rig.clone());
        while rig.advance() {
            rigs.push(rig.clone());
        }
        rig.order(|sequence, now, out| sequence.start(now, out));
        rigs.push(rig.clone());
        while rig.advance() {
            rigs.push(rig.clone());
        }
    }
    let mut changes = diagrams::Changes::new();
    let mut note = |rig: &Rig| {
        for event in rig.events() {
            if let Event::StateChanged {
                prev, next, why, ..
            } = event
            {
                let cause = match why {
                    Why::Sequence => "".into(),
                    Why::Fault(code) if code == Fault::LedCooling.code() => "LED too hot".into(),
                    Why::Fault(_) => "fault".into(),
                    other => std::format!("{other:?}").to_lowercase(),
                };
                let change = (std::format!("{prev:?}"), std::format!("{next:?}"));
                changes.entry(change).or_default().insert(cause);
            }
        }
    };
    let mut disturbed = Vec::new();
    for rig in &rigs {
        note(rig);
        for order in orders {
            // The command handler judges an order before it comes here: homing only at rest.
            let busy = !matches!(
                rig.sequence.state(),
                State::Unhomed | State::Ready | State::Faulted
            );
            if busy && order as usize == Sequence::home as fn(_, _, _) as usize {
                continue;
            }
            let mut rig = rig.clone();
            rig.order(order);
            disturbed.push(rig);
        }
        let (mut lost, mut frozen) = (rig.clone(), rig.clone());
        lost.input(Input::EventsLost);
        frozen.world.frozen = true;
        disturbed.extend([lost, frozen]);
    }
    for mut rig in disturbed {
        rig.run();
        if rig.sequence.state() == State::Faulted {
            let mut retracted = rig.clone();
            retracted.order(|sequence, now, out| sequence.retract(now, out));
            retracted.run();
            note(&retracted);
            rig.order(|sequence, now, out| sequence.acknowledge(now, out));
        }
        note(&rig);
    }
    changes
}

#[test]
fn every_change_of_state_is_drawn_in_the_readme_and_no_other() {
    let capture = [
        "Claiming",
        "Moving",
        "Settling",
        "Cooling",
        "Lighting",
        "Capturing",
        "Darkening",
    ];
    let diagram = diagrams::mermaid("Unhomed", ("Capture", &capture), &every_change());
    diagrams::assert_drawn("sequence", &diagram);
}
