//! One function per promise of a camera process.

use std::path::Path;
use std::time::{Duration, Instant};

use super::{Rig, Settings, Violation};
use crate::arm::Arm;
use crate::header::{EXPOSURE_TOLERANCE_US, FrameHeader, FrameLabel, monotonic_ns};
use crate::link::{BorrowedFrame, FrameSource};
use crate::receiver::{Frame, FrameReceiver};
use crate::root::SharedRoot;
use crate::services::BUFFERED_FRAMES;

type Check = fn(&mut dyn Rig, &Path, &Settings) -> Result<(), Violation>;

/// Every check, by what it finds true.
pub(super) const ALL: &[(&str, Check)] = &[
    ("a plan arrives whole and in order", whole_plan),
    (
        "an exposure beyond the plan is labelled so",
        beyond_the_plan,
    ),
    ("an arming that came first counts", armed_before_start),
    ("a new arming begins a new count", armed_again),
    (
        "what a slow host misses shows in the counters alone",
        slow_host,
    ),
    ("a host that went away harms nothing", dead_host),
    ("a process that ended is replaced in place", restarted),
    (
        "a killed process leaves nothing that harms the next",
        killed,
    ),
];

/// Two views of a small plan: every kind of place that a frame can have.
const PLAN: Arm = Arm {
    session: 41,
    first_view: 0,
    views: 2,
    exposures: 2,
    patterns: 3,
};
/// More frames than any check fires.
const LONG: Arm = Arm {
    session: 42,
    first_view: 3,
    views: 64,
    exposures: 4,
    patterns: 16,
};
/// Longest pause of [`slow_host`] is this doubled so many times.
const PAUSE: Duration = Duration::from_millis(100);
const PAUSES: u32 = 6;
/// A frame that nobody triggered follows within this, or not at all.
const EXTRA_FRAME_PATIENCE: Duration = Duration::from_millis(100);

/// The host's end of one run.
struct Host<'a> {
    rig: &'a mut dyn Rig,
    settings: Settings,
    source: FrameReceiver,
    root: SharedRoot,
    /// Exposures fired at this process.
    fired: u32,
    arm: Arm,
    /// Exposures fired before the arming.
    before_arming: u32,
    /// The process runs, and has said its first word.
    connected: bool,
    announced_px: [u32; 2],
    size_px: Option<[u32; 3]>,
}

impl<'a> Host<'a> {
    /// Makes a root and starts the process there; armed with `arm` before it comes, if that is given.
    fn start(
        rig: &'a mut dyn Rig,
        base: &Path,
        settings: &Settings,
        arm: Option<Arm>,
    ) -> Result<Self, Violation> {
        let root = SharedRoot::create(base)?;
        let source = FrameReceiver::create(&root)?;
        let mut host = Self {
            rig,
            settings: *settings,
            source,
            root,
            fired: 0,
            arm: Arm::default(),
            before_arming: 0,
            connected: false,
            announced_px: [0; 2],
            size_px: None,
        };
        if let Some(arm) = arm {
            host.arm(arm)?;
        }
        host.connect()?;
        Ok(host)
    }

    /// Starts the process and waits until it has opened its end.
    fn connect(&mut self) -> Result<(), Violation> {
        self.rig.start(self.root.path())?;
        self.fired = 0;
        self.before_arming = 0;
        self.connected = false;
        let patience = self.settings.patience;
        let end = Instant::now() + patience;
        while !self.source.camera_connected() {
            if Instant::now() > end {
                return Err(Violation::NoCamera { patience });
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        self.connected = true;
        // The new peer gets an earlier arming, too.
        self.ready(self.arm.session)
    }

    /// Waits until the camera has said that it is armed for a session, and drained.
    fn ready(&mut self, session: u32) -> Result<(), Violation> {
        let patience = self.settings.patience;
        let end = Instant::now() + patience;
        loop {
            if let Some(word) = self.source.ready()?.filter(|word| word.session == session) {
                if word.counter != self.fired {
                    return Err(Violation::NextFrame {
                        got: word.counter,
                        expected: self.fired,
                    });
                }
                self.announced_px = [word.width_px, word.height_px];
                return Ok(());
            }
            if let Some(frame) = self.source.receive(Duration::from_millis(2))? {
                return Err(Violation::Untriggered {
                    counter: frame.header().counter,
                });
            }
            if Instant::now() > end {
                return Err(Violation::NotReady { session, patience });
            }
        }
    }

    fn arm(&mut self, arm: Arm) -> Result<(), Violation> {
        self.source.arm(arm)?;
        self.arm = arm;
        self.before_arming = self.fired;
        match self.connected {
            true => self.ready(arm.session),
            false => Ok(()),
        }
    }

    fn fire(&mut self) -> Result<(), Violation> {
        self.rig.trigger(self.settings.exposure_us)?;
        self.fired += 1;
        Ok(())
    }

    /// Fires one exposure and takes its frame.
    fn expose(&mut self) -> Result<Frame, Violation> {
        let fired_ns = monotonic_ns();
        self.fire()?;
        let (nth, patience) = (self.fired - 1, self.settings.patience);
        let frame = self
            .source
            .receive(patience)?
            .ok_or(Violation::NoFrame { nth, patience })?;
        let header = frame.header();
        if header.counter != nth {
            return Err(Violation::Counter {
                got: header.counter,
                expected: nth,
            });
        }
        self.check(&frame)?;
        follows(
            header,
            "the end of exposure",
            header.exposure_end_monotonic_ns,
            "its trigger",
            fired_ns,
        )?;
        Ok(frame)
    }

    /// What holds for every frame, whichever were lost before it.
    fn check(&mut self, frame: &Frame) -> Result<(), Violation> {
        let header = *frame.header();
        let counter = header.counter;
        if header.session != self.arm.session {
            return Err(Violation::Session {
                counter,
                got: header.session,
                expected: self.arm.session,
            });
        }
        let since_arming = counter.checked_sub(self.before_arming);
        let expected = since_arming
            .and_then(|nth| self.arm.label(nth))
            .unwrap_or(FrameLabel::BEYOND);
        if header.label != expected {
            return Err(Violation::Label {
                counter,
                got: header.label,
                expected,
            });
        }
        let got_px = [header.width_px, header.height_px, header.stride_px];
        let expected_px = *self.size_px.get_or_insert(got_px);
        if got_px != expected_px || got_px.contains(&0) {
            return Err(Violation::Size {
                counter,
                got_px,
                expected_px,
            });
        }
        let got_us = header
            .exposure_end_us
            .saturating_sub(header.exposure_start_us);
        let commanded_us = u64::from(self.settings.exposure_us);
        if got_us.abs_diff(commanded_us) > EXPOSURE_TOLERANCE_US {
            return Err(Violation::Exposure {
                counter,
                got_us,
                commanded_us,
            });
        }
        if header.measured & !FrameHeader::ALL_MEASURED != 0 {
            return Err(Violation::Measured {
                counter,
                got: header.measured,
            });
        }
        let got_px = [header.width_px, header.height_px];
        if got_px != self.announced_px {
            return Err(Violation::Announced {
                counter,
                announced_px: self.announced_px,
                got_px,
            });
        }
        let (ended_ns, published_ns) = (
            header.exposure_end_monotonic_ns,
            header.published_monotonic_ns,
        );
        follows(
            &header,
            "its hand-over",
            published_ns,
            "the end of exposure",
            ended_ns,
        )?;
        let received_ns = frame.received_monotonic_ns();
        follows(
            &header,
            "its arrival",
            received_ns,
            "its hand-over",
            published_ns,
        )
    }

    /// No frame comes that nobody triggered.
    fn quiet(&mut self) -> Result<(), Violation> {
        match self.source.receive(EXTRA_FRAME_PATIENCE)? {
            None => Ok(()),
            Some(frame) => Err(Violation::Untriggered {
                counter: frame.header().counter,
            }),
        }
    }

    fn stop(&mut self) -> Result<(), Violation> {
        let patience = self.settings.patience;
        if self.rig.stop(patience)? {
            Ok(())
        } else {
            Err(Violation::Outlives { patience })
        }
    }
}

fn follows(
    header: &FrameHeader,
    what: &'static str,
    later_ns: u64,
    before: &'static str,
    earlier_ns: u64,
) -> Result<(), Violation> {
    if later_ns >= earlier_ns {
        return Ok(());
    }
    Err(Violation::Time {
        counter: header.counter,
        what,
        later_ns,
        before,
        earlier_ns,
    })
}

fn whole_plan(rig: &mut dyn Rig, base: &Path, settings: &Settings) -> Result<(), Violation> {
    let mut host = Host::start(rig, base, settings, None)?;
    host.arm(PLAN)?;
    let mut before = None;
    let mut started_us = None;
    for _ in 0..PLAN.frames() {
        let frame = host.expose()?;
        let header = frame.header();
        let start_us = header.exposure_start_us;
        if let Some(earlier_us) = started_us.replace(start_us) {
            let [later_ns, earlier_ns] =
                [start_us, earlier_us].map(|us: u64| us.saturating_mul(1000));
            follows(
                header,
                "its exposure",
                later_ns,
                "the one before",
                earlier_ns,
            )?;
        }
        before.get_or_insert(host.root.segment_bytes());
    }
    host.quiet()?;
    let (before_bytes, after_bytes) = (before.unwrap_or_default(), host.root.segment_bytes());
    if after_bytes > before_bytes {
        return Err(Violation::Grown {
            before_bytes,
            after_bytes,
        });
    }
    host.stop()
}

fn beyond_the_plan(rig: &mut dyn Rig, base: &Path, settings: &Settings) -> Result<(), Violation> {
    let mut host = Host::start(rig, base, settings, None)?;
    host.expose()?; // nobody has armed it
    host.arm(Arm { views: 1, ..PLAN })?;
    for _ in 0..=u32::from(PLAN.order().frames()) {
        host.expose()?;
    }
    Ok(())
}

fn armed_before_start(
    rig: &mut dyn Rig,
    base: &Path,
    settings: &Settings,
) -> Result<(), Violation> {
    let mut host = Host::start(rig, base, settings, Some(PLAN))?;
    host.expose().map(drop)
}

fn armed_again(rig: &mut dyn Rig, base: &Path, settings: &Settings) -> Result<(), Violation> {
    let mut host = Host::start(rig, base, settings, None)?;
    host.arm(PLAN)?;
    for _ in 0..3 {
        host.expose()?;
    }
    // In the middle of a view, for a view that is captured again: counters go on, labels begin there.
    host.arm(Arm {
        session: 43,
        first_view: 1,
        views: 1,
        ..PLAN
    })?;
    for _ in 0..PLAN.order().frames() {
        host.expose()?;
    }
    Ok(())
}

fn slow_host(rig: &mut dyn Rig, base: &Path, settings: &Settings) -> Result<(), Violation> {
    let mut host = Host::start(rig, base, settings, None)?;
    host.arm(LONG)?;
    host.expose()?;
    let mut due = 1;
    for pause in 0..PAUSES {
        for _ in 0..2 * BUFFERED_FRAMES {
            host.fire()?;
        }
        if !settings.waits {
            std::thread::sleep(PAUSE * 2u32.pow(pause));
        }
        let mut lost = 0;
        while due < host.fired {
            let Some(frame) = host.source.receive(Duration::from_millis(500))? else {
                lost += host.fired - due; // the last ones
                break;
            };
            let counter = frame.header().counter;
            if !(due..host.fired).contains(&counter) || (settings.waits && counter != due) {
                return Err(Violation::Counter {
                    got: counter,
                    expected: due,
                });
            }
            host.check(&frame)?;
            lost += counter - due;
            due = counter + 1;
        }
        // Whatever was lost, the next frame has its own number again.
        host.expose()?;
        due = host.fired;
        if lost > 0 || settings.waits {
            return Ok(());
        }
    }
    Err(Violation::NothingLost { fired: host.fired })
}

fn dead_host(rig: &mut dyn Rig, base: &Path, settings: &Settings) -> Result<(), Violation> {
    let mut host = Host::start(rig, base, settings, None)?;
    host.arm(LONG)?;
    host.expose()?;
    // The host's ports go without a word, in the middle of a view.
    let Host {
        rig, source, root, ..
    } = host;
    drop(source);
    for _ in 0..4 {
        // A camera that ended because nobody listens is as good as one that goes on.
        if rig.trigger(settings.exposure_us).is_err() {
            break;
        }
    }
    let patience = settings.patience;
    let ended = rig.stop(patience)?;
    drop(root);
    if ended {
        Ok(())
    } else {
        Err(Violation::Outlives { patience })
    }
}

fn restarted(rig: &mut dyn Rig, base: &Path, settings: &Settings) -> Result<(), Violation> {
    let mut host = Host::start(rig, base, settings, None)?;
    host.arm(PLAN)?;
    for _ in 0..3 {
        host.expose()?;
    }
    host.stop()?;
    host.connect()?;
    host.arm(Arm {
        session: 44,
        ..PLAN
    })?;
    // Its counters begin anew.
    host.expose().map(drop)
}

fn killed(rig: &mut dyn Rig, base: &Path, settings: &Settings) -> Result<(), Violation> {
    for wait_us in [0, 700, 1_900, 5_300] {
        let root = SharedRoot::create(base)?;
        let _source = FrameReceiver::create(&root)?;
        // In the middle of its start, when the files of its services are half made.
        rig.start(root.path())?;
        std::thread::sleep(Duration::from_micros(wait_us));
        rig.kill()?;
        // The host's answer to a dead camera is a new root.
        let mut host = Host::start(rig, base, settings, None)?;
        host.arm(PLAN)?;
        host.expose()?;
        // In the middle of a view.
        host.rig.kill()?;
    }
    Ok(())
}
