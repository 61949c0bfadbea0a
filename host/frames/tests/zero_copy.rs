//! Two processes, one shared segment: frames are borrowed in place, and a killed side never poisons the next run.
//!
//! The camera process is this test binary started again (`camera_process` below, asleep unless it is told a root).

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use flankscope_frames::{
    Arm, BorrowedFrame, Frame, FrameHeader, FrameReceiver, FrameSender, FrameSink, FrameSlot,
    FrameSource, Overflow, Ready, SharedRoot, monotonic_ns,
};

const ROOT_VARIABLE: &str = "FLANKSCOPE_TEST_CAMERA_ROOT";
const WIDTH: u32 = 640;
const HEIGHT: u32 = 400;

/// The camera process: waits for an arming, then sends that many frames whose pixels are known by position.
#[test]
fn camera_process() {
    let Some(root) = std::env::var_os(ROOT_VARIABLE) else {
        return;
    };
    let mut sender = FrameSender::open(
        &SharedRoot::of_owner(root.as_ref()).unwrap(),
        Overflow::Drop,
    )
    .unwrap();
    let mut counter = 0;
    loop {
        std::thread::sleep(Duration::from_millis(1));
        let Some(arm) = sender.armed() else { continue };
        let session = arm.session;
        let word = Ready {
            session,
            counter,
            ..Ready::default()
        };
        sender.ready(word).unwrap();
        for nth in 0..arm.frames() {
            let mut frame = sender.loan((WIDTH * HEIGHT) as usize, counter).unwrap();
            for (i, pixel) in frame.pixels().iter_mut().enumerate() {
                *pixel = pixel_of(counter, i);
            }
            let header = FrameHeader {
                session: arm.session,
                counter,
                label: arm.label(nth).unwrap(),
                width_px: WIDTH,
                height_px: HEIGHT,
                stride_px: WIDTH,
                exposure_end_monotonic_ns: monotonic_ns(),
                ..FrameHeader::default()
            };
            let _ = sender.send(frame.seal(header)); // a host that does not take frames is one of the cases
            counter += 1;
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

fn pixel_of(counter: u32, i: usize) -> u16 {
    (counter
        .wrapping_mul(2_654_435_761)
        .wrapping_add((i as u32).wrapping_mul(40_503))
        >> 20) as u16
}

struct Camera(Child);

impl Camera {
    fn start(root: &SharedRoot) -> Self {
        let child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "camera_process", "--nocapture"])
            .env(ROOT_VARIABLE, root.path())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        Self(child)
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        let _ = self.0.kill(); // SIGKILL on Unix
        let _ = self.0.wait();
    }
}

fn receive(receiver: &mut FrameReceiver) -> Frame {
    let start = Instant::now();
    loop {
        if let Some(frame) = receiver.receive(Duration::from_millis(100)).unwrap() {
            return frame;
        }
        assert!(
            start.elapsed() < Duration::from_secs(20),
            "no frame came: the camera process is stuck"
        );
    }
}

/// The mapping of this process that holds `address`, as the kernel lists it.
fn mapping_of(address: usize) -> String {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    for line in maps.lines() {
        let range = line.split_whitespace().next().unwrap();
        let (low, high) = range.split_once('-').unwrap();
        let parse = |text| usize::from_str_radix(text, 16).unwrap();
        if (parse(low)..parse(high)).contains(&address) {
            return line.to_string();
        }
    }
    panic!("{address:#x} is not mapped");
}

#[test]
fn frames_are_read_where_the_other_process_wrote_them() {
    let base = tempfile::tempdir().unwrap();
    let root = SharedRoot::create(base.path()).unwrap();
    let mut receiver = FrameReceiver::create(&root).unwrap();
    let _camera = Camera::start(&root);
    receiver
        .arm(Arm {
            session: 9,
            first_view: 0,
            views: 2,
            exposures: 2,
            patterns: 12,
        })
        .unwrap();
    let mut held = None; // one frame is kept over the whole capture, as the report does
    for nth in 0..50_u32 {
        let frame = receive(&mut receiver);
        let header = *frame.header();
        assert_eq!((header.session, header.counter), (9, nth));
        assert_eq!(
            (
                u32::from(header.label.view),
                u32::from(header.label.in_view)
            ),
            (nth / 25, nth % 25)
        );
        let pixels = frame.pixels();
        assert!(
            pixels
                .iter()
                .enumerate()
                .all(|(i, &p)| p == pixel_of(nth, i)),
            "frame {nth} is torn"
        );
        // Both ends of the payload lie in one shared mapping of a segment with the root's prefix.
        let first = mapping_of(pixels.as_ptr() as usize);
        let last = mapping_of(&raw const pixels[pixels.len() - 1] as usize);
        assert_eq!(first, last);
        assert!(
            first.contains(&format!("/dev/shm/{}", root.prefix())),
            "not in the shared segment: {first}"
        );
        let flags = first.split_whitespace().nth(1).unwrap();
        assert!(
            flags.ends_with('s'),
            "a private mapping would be a copy on write: {first}"
        );
        if nth == 0 {
            held = Some(frame);
        }
    }
    let held = held.unwrap();
    assert!(
        held.pixels()
            .iter()
            .enumerate()
            .all(|(i, &p)| p == pixel_of(0, i)),
        "a held frame is never overwritten"
    );
    assert_eq!(Frame::bytes_copied(), 0);
}

#[test]
fn a_host_that_takes_no_frames_sees_the_gap() {
    let base = tempfile::tempdir().unwrap();
    let root = SharedRoot::create(base.path()).unwrap();
    let mut receiver = FrameReceiver::create(&root).unwrap();
    let _camera = Camera::start(&root);
    receiver
        .arm(Arm {
            session: 1,
            first_view: 0,
            views: 1,
            exposures: 1,
            patterns: 39,
        })
        .unwrap();
    let first = receive(&mut receiver);
    assert_eq!(first.header().counter, 0);
    std::thread::sleep(Duration::from_millis(500)); // 39 more frames were offered to a buffer of 16
    let mut counters = vec![0];
    while let Some(frame) = receiver.receive(Duration::from_millis(200)).unwrap() {
        counters.push(frame.header().counter);
    }
    assert!(
        counters.len() < 40,
        "nothing was lost, so this test showed nothing: {counters:?}"
    );
    assert!(
        counters.windows(2).all(|w| w[0] < w[1]),
        "frames are lost, never reordered or repeated"
    );
}

#[test]
fn after_kill_of_either_side_the_next_run_works() {
    let base = tempfile::tempdir().unwrap();
    for cycle in 0..20_u64 {
        // The previous cycle's owner is "killed": its root and segments stay behind unlocked.
        let root = SharedRoot::create(base.path()).unwrap();
        let mut receiver = FrameReceiver::create(&root).unwrap();
        let camera = Camera::start(&root);
        receiver
            .arm(Arm {
                session: cycle as u32,
                first_view: 0,
                views: 100,
                exposures: 1,
                patterns: 4,
            })
            .unwrap();
        if cycle % 2 == 0 {
            // Kill it at some moment of its start, which is when service files are half made.
            std::thread::sleep(Duration::from_micros(cycle * 700));
            drop(camera);
            let root = SharedRoot::create(base.path()).unwrap();
            let mut receiver = FrameReceiver::create(&root).unwrap();
            let _camera = Camera::start(&root);
            receiver
                .arm(Arm {
                    session: 77,
                    first_view: 0,
                    views: 1,
                    exposures: 1,
                    patterns: 4,
                })
                .unwrap();
            assert_eq!(receive(&mut receiver).header().session, 77);
        } else {
            assert_eq!(receive(&mut receiver).header().session, cycle as u32);
            std::mem::forget(receiver); // a host that ends without dropping its ports, as SIGKILL does
        }
    }
}

/// There is room for one camera: whoever comes second publishes nothing, and the first one's frames go on.
#[test]
fn a_rival_camera_cannot_publish() {
    let base = tempfile::tempdir().unwrap();
    let root = SharedRoot::create(base.path()).unwrap();
    let mut receiver = FrameReceiver::create(&root).unwrap();
    let _camera = Camera::start(&root);
    receiver
        .arm(Arm {
            session: 5,
            first_view: 0,
            views: 1,
            exposures: 1,
            patterns: 9,
        })
        .unwrap();
    assert_eq!(receive(&mut receiver).header().counter, 0);
    let root = SharedRoot::of_owner(root.path()).unwrap();
    let rival = FrameSender::open(&root, Overflow::Drop);
    let error = rival.unwrap_err().to_string();
    assert!(error.contains("cannot publish frames"), "{error}");
    for counter in 1..10 {
        let frame = receive(&mut receiver);
        assert_eq!(
            (frame.header().session, frame.header().counter),
            (5, counter)
        );
    }
}

/// A camera that says nothing holds nobody up, however little is left of a wait: sockets count microseconds, and none is for ever.
#[test]
fn the_shortest_waits_end() {
    let (done, ended) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let base = tempfile::tempdir().unwrap();
        let root = SharedRoot::create(base.path()).unwrap();
        let mut receiver = FrameReceiver::create(&root).unwrap();
        // As long as looking for a frame takes, so that next to nothing is left to wait for: nearer and nearer from either side.
        let mut wait_ns = 20_000_u64;
        for _ in 0..400 {
            let begin = Instant::now();
            let frame = receiver.receive(Duration::from_nanos(wait_ns)).unwrap();
            assert!(frame.is_none());
            wait_ns = match begin.elapsed() > Duration::from_micros(500) {
                true => wait_ns.saturating_sub(200),
                false => wait_ns + 200,
            };
        }
        done.send(()).unwrap();
    });
    ended
        .recv_timeout(Duration::from_secs(60))
        .expect("a wait that does not end");
}
