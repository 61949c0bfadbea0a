//! Times the way of a frame: what memory can do, decoding one view, and the hand-over from the camera process to the host.
//! `cargo xtask bench` runs it. One JSON object per figure. With `decoding` it times views alone; with `counted` and a view's name it takes
//! that view once, for an instruction counter (`cargo xtask bench --instructions`).

use std::alloc::{GlobalAlloc, Layout, System};
use std::hint::black_box;
use std::io::BufRead;
use std::ops::Range;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use flankscope_bench::demo as die;
use flankscope_bench::world::{PatternSpec, World};
use flankscope_demo as demo;
use flankscope_frames::{
    Arm, BorrowedFrame, Frame, FrameHeader, FrameReceiver, FrameSender, FrameSink, FrameSlot,
    FrameSource, Overflow, Ready, SharedRoot, monotonic_ns,
};
use flankscope_profilometry::{
    Accumulator, DecodeOptions, Decoder, FrameKind, FrameView, PatternSet,
};
use rayon::prelude::*;

/// Counts every request for memory of this process.
struct Counting;

static REQUESTS: AtomicU64 = AtomicU64::new(0);

// SAFETY: everything is passed on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        REQUESTS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Views by their pattern set, and whether they are decoded core by core.
const VIEWS: [(&str, bool); 3] = [("insitu12", false), ("scan16", false), ("high12", true)];
const WIDTH: usize = 1_920;
const HEIGHT: usize = 1_200;
/// 80 frames a second.
const PERIOD: Duration = Duration::from_micros(12_500);
const WARM_UP: u32 = 100;
const FRAMES: u32 = 900;
const ROOT_VARIABLE: &str = "FLANKSCOPE_BENCH_CAMERA_ROOT";

fn main() -> Result<()> {
    if let Some(root) = std::env::var_os(ROOT_VARIABLE) {
        return camera(&SharedRoot::of_owner(root.as_ref())?);
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.as_slice() {
        [what] if what == "decoding" => return decoding(memory()),
        [what, view, ..] if what == "counted" => return count(view),
        _ => {}
    }
    let read_gb_per_s = memory();
    decoding(read_gb_per_s)?;
    waking();
    hand_over()
}

/// Best of several passes over more memory than any cache holds, all threads.
fn memory() -> f64 {
    let words = vec![1u64; 1 << 26];
    let mut rates = Vec::new();
    for _ in 0..9 {
        let start = Instant::now();
        let sum: u64 = words
            .par_chunks(1 << 18)
            .map(|chunk| {
                let mut lanes = [0u64; 16];
                for words in chunk.as_chunks::<16>().0 {
                    for (lane, word) in lanes.iter_mut().zip(words) {
                        *lane = lane.wrapping_add(*word);
                    }
                }
                lanes.iter().sum::<u64>()
            })
            .sum();
        black_box(sum);
        rates.push(8.0 * words.len() as f64 / start.elapsed().as_secs_f64() * 1e-9);
    }
    rates.sort_by(f64::total_cmp);
    let (median, best) = (rates[rates.len() / 2], rates[rates.len() - 1]);
    println!(
        "{{\"name\": \"memory/read\", \"gb_per_s\": {median:.2}, \"best_gb_per_s\": {best:.2}, \"threads\": {}}}",
        rayon::current_num_threads()
    );
    median
}

/// A view of the demo die: its decoder and frames.
struct View {
    name: &'static str,
    decoder: Decoder,
    frames: Vec<(FrameKind, Vec<u16>)>,
}

impl View {
    /// By blocks of pixels at one exposure, or as the demo's inspection has it: core by core, at both exposures of the head.
    fn new(name: &'static str, by_core: bool) -> Result<Self> {
        let world = World::new(&die::world_config()?)?;
        let specs = PatternSpec::named(name).context("a built-in set")?;
        let rotation_rad = -die::gear().tooth_centre_rad(12);
        let view = world.prepare(rotation_rad, die::HEIGHT_MM, &specs)?;
        let mut head = demo::head();
        let mut exposures_us = vec![20_000];
        if by_core {
            head.core_map = Some(Arc::new(demo::core_map()?));
            exposures_us = head.exposures_us.clone();
        }
        let set = PatternSet::named(name)?;
        let decoder = Decoder::new(&head, &set, &exposures_us, DecodeOptions::for_head(&head))?;
        let mut frames = Vec::new();
        for (number, kind) in decoder.capture_order().enumerate() {
            let fringe = number.checked_sub(1).map(|at| 1 + at % specs.len());
            let exposure_us = exposures_us[kind.exposure().unwrap_or(0)];
            let mut pixels = vec![0; WIDTH * HEIGHT];
            let pattern = fringe.unwrap_or(0) as u16;
            world.render(
                &view,
                pattern,
                exposure_us,
                true,
                number as u32,
                &mut pixels,
            )?;
            frames.push((kind, pixels));
        }
        Ok(Self {
            name,
            decoder,
            frames,
        })
    }

    fn add(&self, sums: &mut Accumulator, frames: Range<usize>) -> Result<()> {
        for (kind, pixels) in &self.frames[frames] {
            sums.add(FrameView::packed(pixels, WIDTH, HEIGHT), *kind)?;
        }
        Ok(())
    }

    /// Prints how long summing and decoding take on so many threads.
    fn time(&self, threads: usize, read_gb_per_s: f64) -> Result<()> {
        let mut sums = self.decoder.begin();
        let last = self.frames.len() - 1;
        let (mut frames, mut after_last, mut whole, mut points) =
            (Vec::new(), Vec::new(), Vec::new(), 0);
        for _ in 0..25 {
            sums.reset();
            let start = Instant::now();
            self.add(&mut sums, 0..last)?;
            let before_ms = ms(start);
            self.add(&mut sums, last..last + 1)?;
            frames.push(ms(start));
            points = self.decoder.finish(&sums)?.cloud.len();
            whole.push(ms(start));
            after_last.push(ms(start) - before_ms);
        }
        let [frames_ms, after_last_ms, whole_ms] = [frames, after_last, whole].map(|mut ms| {
            ms.sort_by(f64::total_cmp);
            ms[ms.len() / 2]
        });
        let gigabytes = (2 * WIDTH * HEIGHT * self.frames.len()) as f64 * 1e-9;
        let share = gigabytes / (frames_ms * 1e-3) / read_gb_per_s;
        println!(
            "{{\"name\": \"decode/{}\", \"threads\": {threads}, \"frames\": {}, \"cells\": {}, \"points\": {points}, \
             \"frames_ms\": {frames_ms:.3}, \"frame_ms\": {:.3}, \"after_last_ms\": {after_last_ms:.3}, \
             \"whole_ms\": {whole_ms:.3}, \"share_of_read_bandwidth\": {share:.3}}}",
            self.name,
            self.frames.len(),
            self.decoder.grid().len(),
            frames_ms / self.frames.len() as f64,
        );
        Ok(())
    }
}

fn ms(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

/// Views from frames to points.
fn decoding(read_gb_per_s: f64) -> Result<()> {
    for (name, by_core) in VIEWS {
        let view = View::new(name, by_core)?;
        for threads in [1, rayon::current_num_threads()] {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()?;
            pool.install(|| view.time(threads, read_gb_per_s))?;
        }
    }
    Ok(())
}

/// What an instruction counter looks at.
#[inline(never)]
fn counted<T>(work: impl FnOnce() -> T) -> T {
    black_box(work())
}

/// Takes one view once, from frames to points, on this thread and inside a function of its own.
fn count(name: &str) -> Result<()> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build_global()?;
    let mut views = VIEWS.iter().filter(|(view, _)| *view == name);
    let &(name, by_core) = views.next().context("no such view")?;
    let view = View::new(name, by_core)?;
    let mut sums = view.decoder.begin();
    let decoded = counted(|| {
        view.add(&mut sums, 0..view.frames.len())?;
        anyhow::Ok(view.decoder.finish(&sums)?)
    })?;
    // An empty view would be counted as a fast one.
    anyhow::ensure!(
        decoded.cloud.len() > 50_000,
        "{} points",
        decoded.cloud.len()
    );
    Ok(())
}

/// The camera process: one frame per period, and at its end how often it asked for memory.
fn camera(root: &SharedRoot) -> Result<()> {
    let mut sender = FrameSender::open(root, Overflow::Drop)?;
    let arm = loop {
        if let Some(arm) = sender.armed() {
            sender.ready(Ready {
                session: arm.session,
                ..Ready::default()
            })?;
            break arm;
        }
        std::thread::sleep(Duration::from_millis(1));
    };
    let mut due = Instant::now();
    let mut before = 0;
    for counter in 0..WARM_UP + FRAMES {
        if counter == WARM_UP {
            before = REQUESTS.load(Ordering::Relaxed);
        }
        due += PERIOD;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        let mut frame = sender.loan(WIDTH * HEIGHT, counter)?;
        // What a camera's driver writes.
        frame.pixels().fill(counter as u16);
        let header = FrameHeader {
            session: arm.session,
            counter,
            width_px: WIDTH as u32,
            height_px: HEIGHT as u32,
            stride_px: WIDTH as u32,
            exposure_end_monotonic_ns: monotonic_ns(),
            ..FrameHeader::default()
        };
        let _dropped = sender.send(frame.seal(header));
    }
    println!("{}", REQUESTS.load(Ordering::Relaxed) - before);
    Ok(())
}

/// How long this machine takes to wake a thread that sleeps: nothing that wakes the host can be faster.
fn waking() {
    let (woken_at, answer_ns) = (AtomicU64::new(0), AtomicU64::new(0));
    let mut delays_us = std::thread::scope(|scope| {
        let sleeper = scope.spawn(|| {
            for _ in 0..FRAMES {
                let asked_ns = loop {
                    match woken_at.swap(0, Ordering::AcqRel) {
                        0 => std::thread::park(),
                        asked_ns => break asked_ns,
                    }
                };
                let delay_ns = monotonic_ns().saturating_sub(asked_ns);
                answer_ns.store(delay_ns.max(1), Ordering::Release);
            }
        });
        let mut delays_us = Vec::new();
        for _ in 0..FRAMES {
            std::thread::sleep(PERIOD);
            answer_ns.store(0, Ordering::Release);
            woken_at.store(monotonic_ns(), Ordering::Release);
            sleeper.thread().unpark();
            let delay_ns = loop {
                match answer_ns.load(Ordering::Acquire) {
                    0 => std::hint::spin_loop(),
                    delay_ns => break delay_ns,
                }
            };
            delays_us.push(delay_ns as f64 * 1e-3);
        }
        delays_us
    });
    delays_us.sort_by(f64::total_cmp);
    let at = |share: f64| delays_us[((delays_us.len() - 1) as f64 * share).round() as usize];
    println!(
        "{{\"name\": \"wake\", \"median_us\": {:.1}, \"p99_us\": {:.1}}}",
        at(0.5),
        at(0.99)
    );
}

fn hand_over() -> Result<()> {
    let base = tempfile::tempdir()?;
    let root = SharedRoot::create(base.path())?;
    let mut receiver = FrameReceiver::create(&root)?;
    let mut camera = Command::new(std::env::current_exe()?)
        .env(ROOT_VARIABLE, root.path())
        .stdout(Stdio::piped())
        .spawn()?;
    receiver.arm(Arm {
        session: 1,
        first_view: 0,
        views: 1,
        exposures: 1,
        patterns: 1,
    })?;
    let mut delays_us = Vec::with_capacity((WARM_UP + FRAMES) as usize);
    let mut before = 0;
    let begun = Instant::now();
    while delays_us.len() < (WARM_UP + FRAMES) as usize && begun.elapsed() < Duration::from_secs(60)
    {
        if delays_us.len() == WARM_UP as usize {
            before = REQUESTS.load(Ordering::Relaxed);
        }
        let Some(frame) = receiver.receive(Duration::from_secs(1))? else {
            continue;
        };
        // Taken before the host checks the pixels' checksum.
        let published_ns = frame.header().published_monotonic_ns;
        let delay_ns = frame.received_monotonic_ns().saturating_sub(published_ns);
        delays_us.push(delay_ns as f64 * 1e-3);
    }
    let requests = REQUESTS.load(Ordering::Relaxed) - before;
    let mut line = String::new();
    let stdout = camera.stdout.take().context("the camera's output")?;
    std::io::BufReader::new(stdout).read_line(&mut line)?;
    camera.wait()?;
    let sent_requests: u64 = line.trim().parse().context("the camera's count")?;
    let mut steady = delays_us.split_off((WARM_UP as usize).min(delays_us.len()));
    steady.sort_by(f64::total_cmp);
    let at = |share: f64| steady[((steady.len() - 1) as f64 * share).round() as usize];
    println!(
        "{{\"name\": \"handover\", \"frames\": {}, \"median_us\": {:.1}, \"p99_us\": {:.1}, \"worst_us\": {:.1}, \
         \"bytes_copied\": {}, \"allocations_host\": {requests}, \"allocations_camera\": {sent_requests}}}",
        steady.len(),
        at(0.5),
        at(0.99),
        at(1.0),
        Frame::bytes_copied(),
    );
    Ok(())
}
