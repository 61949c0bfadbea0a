//! What the host makes of the frames of a run, by the product's own pairing of triggers and frames.

use flankscope_bench::devices::Exposure;
use flankscope_frames::{Arm, FrameHeader, FrameLabel};
use flankscope_instrument::acquisition::pair;
use flankscope_protocol::{CapturePlan, Event, Trigger};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

/// How a frame does not reach the host as it was exposed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FrameFault {
    /// It never comes.
    Missing,
    /// It comes twice.
    Duplicate,
    /// It comes after the next one.
    Late,
    /// A bit of its header is wrong.
    Corrupt,
}

impl FrameFault {
    pub const ALL: [Self; 4] = [Self::Missing, Self::Duplicate, Self::Late, Self::Corrupt];
}

/// One view of a completed capture, as the host got it.
pub struct Received {
    /// The pairing took it.
    pub accepted: bool,
    /// One of its frames was spoiled on the way.
    pub struck: bool,
    /// What really stood on the mirrors is what the triggers say, frame by frame.
    pub true_to_triggers: bool,
}

/// A frame under way, and what really stood on the mirrors.
#[derive(Clone, Copy)]
struct Sent {
    header: FrameHeader,
    shown: u16,
}

/// Labels the exposures as the camera process does, spoils the first one at or after the time given, and pairs.
pub fn receive(
    plan: &CapturePlan,
    events: &[Event],
    exposures: &[Exposure],
    mut spoil: Option<(FrameFault, u64)>,
    random: &mut Pcg64Mcg,
) -> Vec<Received> {
    let arm = Arm::of(plan);
    let mut received = Vec::new();
    for (triggers, until_us) in completed(events) {
        let Some(from_us) = triggers.first().map(|first| first.dmd_at.get()) else {
            continue;
        };
        let in_capture = |exposure: &&Exposure| (from_us..until_us).contains(&exposure.start_us);
        let mut frames: Vec<Sent> = exposures
            .iter()
            .filter(in_capture)
            .enumerate()
            .map(|(n, exposure)| sent(&arm, n as u32, exposure))
            .collect();
        let mut struck = None;
        if let Some((fault, since_us)) = spoil
            && let Some(nth) = frames
                .iter()
                .position(|frame| frame.header.exposure_start_us >= since_us)
        {
            spoil = None;
            // Late means after the next of its view: the last of a view cannot be.
            let last = frames[nth].header.label.in_view + 1 == arm.order().frames();
            let nth = nth - usize::from(last);
            struck = Some(frames[nth].header.label.view);
            strike(&mut frames, fault, nth, random);
        }
        for view in 0..arm.views {
            let fired: Vec<Trigger> = triggers
                .iter()
                .copied()
                .filter(|trigger| u16::from(trigger.view) == view)
                .collect();
            let got = || frames.iter().filter(|sent| sent.header.label.view == view);
            let headers: Vec<FrameHeader> = got().map(|sent| sent.header).collect();
            let shown = got().map(|sent| sent.shown);
            received.push(Received {
                accepted: pair(&fired, &headers).is_ok(),
                struck: struck == Some(view),
                true_to_triggers: shown.eq(fired.iter().map(|trigger| trigger.pattern)),
            });
        }
    }
    received
}

fn sent(arm: &Arm, nth: u32, exposure: &Exposure) -> Sent {
    Sent {
        header: FrameHeader {
            session: arm.session,
            counter: exposure.counter,
            label: arm.label(nth).unwrap_or(FrameLabel::BEYOND),
            measured: FrameHeader::ALL_MEASURED,
            exposure_start_us: exposure.start_us,
            exposure_end_us: exposure.end_us,
            ..FrameHeader::default()
        },
        shown: exposure.shown[0].unwrap_or(u16::MAX),
    }
}

/// The triggers of every completed capture, and when it was over.
fn completed(events: &[Event]) -> Vec<(Vec<Trigger>, u64)> {
    let (mut captures, mut triggers) = (Vec::new(), Vec::new());
    for event in events {
        match event {
            Event::Triggered(trigger) => {
                if trigger.view == 0 && trigger.frame == 0 {
                    triggers.clear();
                }
                triggers.push(*trigger);
            }
            Event::CaptureDone { at, .. } => {
                captures.push((core::mem::take(&mut triggers), at.get()));
            }
            _ => {}
        }
    }
    captures
}

fn strike(frames: &mut Vec<Sent>, fault: FrameFault, nth: usize, random: &mut Pcg64Mcg) {
    match fault {
        FrameFault::Missing => {
            frames.remove(nth);
        }
        FrameFault::Duplicate => frames.insert(nth, frames[nth]),
        FrameFault::Late => frames.swap(nth, nth + 1),
        FrameFault::Corrupt => {
            let header = &mut frames[nth].header;
            match random.random_range(0..4) {
                0 => header.counter ^= 1 << random.random_range(0..32),
                1 => header.label.pattern ^= 1 << random.random_range(0..16),
                // Times are good to some hundred microseconds only.
                2 => header.exposure_start_us ^= 1 << random.random_range(12..48),
                _ => header.exposure_end_us ^= 1 << random.random_range(12..48),
            }
        }
    }
}
