//! Cameras that are late, of another head, or endless.

use super::*;

#[test]
fn the_picture_shows_the_lit_part_in_full_contrast() {
    // 8 x 6 px with padding; a lit patch of 3 x 2 at (2, 1), one glaring pixel in it.
    let (width, height, stride) = (8, 6, 10);
    let mut pixels = vec![100_u16; stride * height];
    for (x, y, dn) in [
        (2, 1, 1000),
        (3, 1, 2000),
        (4, 1, 3000),
        (2, 2, 1000),
        (3, 2, 4095),
        (4, 2, 1000),
    ] {
        pixels[y * stride + x] = dn;
    }
    let settings = settings_of(None);
    let picture = picture(
        FrameView {
            pixels: &pixels,
            width,
            height,
            stride,
        },
        settings,
    );
    assert_eq!((picture.width, picture.height), (3, 2));
    assert_eq!(picture.grey[4], 255, "the brightest is white");
    let expected = |dn: f64| ((dn - 140.0) / (4095.0 - 140.0) * 255.0) as u8;
    assert_eq!(
        picture.grey[..3],
        [expected(1000.0), expected(2000.0), expected(3000.0)]
    );
}

/// A camera that reports its state after a number of polls.
struct Spoken {
    words: Vec<Ready>,
    armed: Vec<u32>,
}

struct NoFrame;

impl BorrowedFrame for NoFrame {
    fn header(&self) -> &FrameHeader {
        unreachable!("there is none")
    }
    fn pixels(&self) -> &[u16] {
        &[]
    }
    fn received_monotonic_ns(&self) -> u64 {
        0
    }
}

impl FrameSource for Spoken {
    type Frame = NoFrame;
    fn arm(&mut self, arm: Arm) -> Result<(), ReceiveError> {
        self.armed.push(arm.session);
        Ok(())
    }
    fn ready(&mut self) -> Result<Option<Ready>, ReceiveError> {
        Ok(self.words.pop())
    }
    fn receive(&mut self, _: Duration) -> Result<Option<NoFrame>, ReceiveError> {
        Ok(None)
    }
}

fn settings_of(sensor: Option<Sensor>) -> RecorderSettings {
    RecorderSettings {
        lit_dn: 140.0,
        keepsake: Keepsake {
            exposure: 0,
            pattern: 1,
        },
        full_scale_dn: 4095,
        camera: HeadCamera {
            size_px: [8, 6],
            sensor,
        },
    }
}

type Events = tokio::sync::mpsc::UnboundedReceiver<Recorded>;

/// A recorder of frames from `source`, planned as a head's set has them, and what it reports.
fn recorder_of<S: FrameSource>(
    source: S,
    sensor: Option<Sensor>,
) -> (Recorder<'static, S>, Events) {
    let decoder = crate::acquisition::sums::tests::decoder();
    let planned = crate::acquisition::sums::planned_frames(&decoder, &[]);
    let (_orders, receiver) = std::sync::mpsc::channel();
    let (events, recorded) = tokio::sync::mpsc::unbounded_channel();
    let fresh = move || ViewSums::new(&decoder, 1);
    let settings = settings_of(sensor);
    let recorder = Recorder::new(source, settings, planned, receiver, events, fresh);
    (recorder, recorded)
}

fn arm_with(words: &[Ready], sensor: Option<Sensor>) -> Result<(), CameraError> {
    let source = Spoken {
        words: words.iter().rev().copied().collect(),
        armed: Vec::new(),
    };
    let (mut recorder, _recorded) = recorder_of(source, sensor);
    let armed = recorder.arm_camera(Arm {
        session: 7,
        ..Arm::default()
    });
    assert!(recorder.open.is_none(), "nothing is summed");
    armed
}

/// Two views of four patterns and a dark frame.
const PLAN: Arm = Arm {
    session: 7,
    first_view: 0,
    views: 2,
    exposures: 1,
    patterns: 4,
};

/// A camera whose frames the test makes.
struct Made<F>(F);

impl<F: FnMut() -> Option<FrameHeader>> FrameSource for Made<F> {
    type Frame = Blank;
    fn arm(&mut self, _: Arm) -> Result<(), ReceiveError> {
        Ok(())
    }
    fn ready(&mut self) -> Result<Option<Ready>, ReceiveError> {
        Ok(None)
    }
    fn receive(&mut self, _: Duration) -> Result<Option<Blank>, ReceiveError> {
        Ok((self.0)().map(Blank))
    }
}

struct Blank(FrameHeader);

impl BorrowedFrame for Blank {
    fn header(&self) -> &FrameHeader {
        &self.0
    }
    fn pixels(&self) -> &[u16] {
        &[]
    }
    fn received_monotonic_ns(&self) -> u64 {
        0
    }
}

#[test]
fn a_camera_that_never_ends_is_given_up_and_fills_no_memory() {
    // Of a session long past, of one that never was, and of the present one.
    for (session, most) in [(3, 0), (9, PLAN.frames() + 1), (7, PLAN.frames() + 1)] {
        let mut header = FrameHeader {
            session,
            ..FrameHeader::default()
        };
        // Each of another view.
        let endless = Made(move || {
            header.label.view = header.label.view.wrapping_add(1);
            Some(header)
        });
        let (mut recorder, mut recorded) = recorder_of(endless, None);
        recorder.arm = Some(PLAN);
        recorder.earlier = VecDeque::from([3]);
        let begun = Instant::now();
        recorder.drain();
        recorder.close();
        assert!(begun.elapsed() < 20 * DRAINING, "{:?}", begun.elapsed());
        let mut views = 0;
        while let Ok(Recorded::View(view)) = recorded.try_recv() {
            let foreign = matches!(
                view.problem,
                Some(ViewError::Session {
                    got: 9,
                    expected: 7
                })
            );
            assert!(
                view.problem.is_some() && foreign == (session == 9),
                "{:?}",
                view.problem
            );
            views += 1;
        }
        assert_eq!(views, most, "session {session}");
    }
}

/// A host that is slow, or frames that are read from a disk.
#[test]
fn frames_that_come_one_by_one_are_waited_for_however_long_all_of_them_take() {
    let mut left = PLAN.frames();
    let slow = Made(move || {
        left = left.checked_sub(1)?;
        std::thread::sleep(DRAINING / (PLAN.frames() - 2));
        Some(FrameHeader {
            session: PLAN.session,
            ..FrameHeader::default()
        })
    });
    let (mut recorder, _recorded) = recorder_of(slow, None);
    recorder.arm = Some(PLAN);
    recorder.drain();
    assert_eq!(recorder.arrived, PLAN.frames());
}

#[test]
fn nothing_moves_before_the_heads_camera_is_armed_for_this_capture() {
    let sensor = Sensor {
        full_well_e: 32_400.0,
        gain_e_per_dn: 7.91,
        read_noise_e: 7.0,
        offset_dn: 100.0,
        bits: 12,
    };
    let of = |session| Ready {
        session,
        width_px: 8,
        height_px: 6,
        bits: 12,
        model: Ready::text("F 1"),
        ..Ready::default()
    };
    let told = Ready {
        offset_dn: 95.0,
        gain_e_per_dn: 8.0,
        ..of(7)
    };
    for words in [&[of(7)][..], &[of(0), of(3), of(7)], &[told]] {
        assert_eq!(arm_with(words, Some(sensor)), Ok(()));
    }
    for (word, said) in [
        (
            Ready {
                width_px: 6,
                height_px: 8,
                ..of(7)
            },
            "F 1 has 6 x 8 px, the head file says 8 x 6",
        ),
        (
            Ready { bits: 8, ..of(7) },
            "F 1 has 8 bits, the head file says 12",
        ),
        (
            Ready {
                gain_e_per_dn: 0.5,
                ..of(7)
            },
            "0.500 electrons per count",
        ),
        (
            Ready {
                offset_dn: 0.0,
                ..of(7)
            },
            "0.0 counts in the dark",
        ),
    ] {
        let error = arm_with(&[word], Some(sensor)).unwrap_err().to_string();
        assert!(error.contains(said), "{said}: {error}");
    }
    for (words, state) in [
        (&[][..], "has not come"),
        (&[of(3)], "armed for another capture"),
    ] {
        let error = arm_with(words, Some(sensor)).unwrap_err().to_string();
        assert!(error.contains(state), "{error}");
    }
}
