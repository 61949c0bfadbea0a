//! Frame counts, durations and memory of a run, as documents state them.

use std::time::Duration;

use flankscope_frames::{Frame, monotonic_ns};
use flankscope_instrument::acquisition::{Counts, Run};
use flankscope_record::document::{FrameCount, Handover, LastExposure, Timing};
use flankscope_record::origin::Link;

/// Durations of a run that began at `begun_ns` and had its verdict at `verdict_ns`, both by the host's monotonic clock.
pub(crate) fn timing<O>(run: &Run<O>, begun_ns: u64, verdict_ns: u64) -> Timing {
    let between = |from: u64, to: u64| to.saturating_sub(from) as f64 / 1e6;
    Timing {
        total: between(begun_ns, monotonic_ns()),
        positioning: run.timeline.positioning_ms(),
        exposure: run.timeline.exposure_ms(),
        last_exposure_to_verdict: between(run.counts.last_exposure_ns, verdict_ns),
    }
}

/// When the last exposure of a run ended, if it exposed anything: a recording does not.
pub(crate) fn last_exposure<O>(run: &Run<O>, link: &Link) -> Option<LastExposure> {
    let is_live = !matches!(link, Link::Recorded(_) | Link::Clouds(_));
    let ended_ns = run.counts.last_exposure_ns;
    (is_live && ended_ns > 0).then(|| {
        let age_ns = monotonic_ns().saturating_sub(ended_ns);
        LastExposure::before_now(Duration::from_nanos(age_ns))
    })
}

/// Frame counts and transfer times of a run.
pub(crate) fn frame_count(mut counts: Counts) -> FrameCount {
    FrameCount {
        triggered: counts.triggered,
        received: counts.received,
        bytes_copied: Frame::bytes_copied(),
        recaptured_views: counts.recaptured,
        late_ms: (counts.late_ms > 0.0).then_some(counts.late_ms),
        handover_us: Handover::of(&mut counts.handover_ns),
    }
}

/// High-water mark of this process's resident memory, from the kernel.
pub(crate) fn peak_memory_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let kilobytes = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    kilobytes
        .trim()
        .trim_end_matches(" kB")
        .parse::<f64>()
        .ok()
        .map(|kb| kb / 1024.0)
}
