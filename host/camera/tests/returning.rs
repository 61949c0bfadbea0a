//! A camera that goes in the middle of a check and comes back while the check still triggers it.

use std::time::Duration;

use flankscope_camera::backend::{Backend, CameraError, Description, Next, Status, Taken};
use flankscope_camera::frame_id::Counting;
use flankscope_camera::serve::serve;
use flankscope_frames::{Arm, FrameHeader, FrameSink, FrameSlot, Ready, SealedFrame, SendError};

/// Each call takes the next of its list.
struct Loose {
    found: Vec<Result<(), CameraError>>,
    next: Vec<Result<Next, CameraError>>,
}

fn gone() -> CameraError {
    CameraError::Gone {
        reason: "unplugged".into(),
    }
}

fn triggered() -> CameraError {
    CameraError::Setting {
        setting: "TriggerMode".into(),
        reason: "frames come though nothing triggers the camera".into(),
    }
}

fn frame(id: u64) -> Result<Next, CameraError> {
    Ok(Next::Whole(Taken {
        id,
        exposure_start_us: 0,
        exposure_end_us: 0,
        exposure_end_monotonic_ns: 0,
        measured: 0,
    }))
}

impl Backend for Loose {
    fn configure(&mut self) -> Result<Description, CameraError> {
        self.found.remove(0).map(|()| Description {
            model: "loose".into(),
            link: "plug".into(),
            width_px: 2,
            height_px: 2,
            bits: 12,
            offset_dn: None,
            gain_e_per_dn: None,
            counting: Counting::SixtyFour,
        })
    }

    fn arm(&mut self, _frames: u32) -> Result<(), CameraError> {
        Ok(())
    }

    fn next(&mut self, _slot: &mut [u16], _patience: Duration) -> Result<Next, CameraError> {
        self.next.remove(0)
    }

    fn status(&self) -> Status {
        Status::default()
    }
}

struct Slot([u16; 4], FrameHeader);

impl FrameSlot for Slot {
    fn pixels(&mut self) -> &mut [u16] {
        &mut self.0
    }

    fn header_mut(&mut self) -> &mut FrameHeader {
        &mut self.1
    }
}

/// A host that arms a camera whenever it says that it is not.
#[derive(Default)]
struct Host {
    due: bool,
    sessions: Vec<u32>,
    frames: Vec<(u32, u32)>,
}

impl FrameSink for Host {
    type Slot = Slot;

    fn armed(&mut self) -> Option<Arm> {
        std::mem::take(&mut self.due).then_some(Arm {
            session: 5,
            views: 1,
            exposures: 1,
            patterns: 7,
            ..Arm::default()
        })
    }

    fn ready(&mut self, ready: Ready) -> Result<(), SendError> {
        self.due = ready.session == 0;
        self.sessions.push(ready.session);
        Ok(())
    }

    fn loan(&mut self, _pixels: usize, _counter: u32) -> Result<Slot, SendError> {
        Ok(Slot([0; 4], FrameHeader::default()))
    }

    fn send(&mut self, frame: SealedFrame<Slot>) -> Result<(), SendError> {
        let Slot(_, header) = frame.into_slot();
        self.frames.push((header.counter, header.session));
        Ok(())
    }
}

#[test]
fn it_is_tried_until_it_can_be_used_and_armed_anew() {
    let mut camera = Loose {
        found: vec![
            Ok(()),
            Err(gone()),
            Err(triggered()),
            Err(triggered()),
            Ok(()),
        ],
        next: vec![frame(1), Err(gone()), frame(1), Ok(Next::End)],
    };
    let mut host = Host::default();
    let mut said = Vec::new();
    let served = serve(&mut camera, &mut host, &|| true, &mut |words| {
        said.push(words.to_owned());
    });
    assert!(served.is_ok(), "{served:?}");
    assert_eq!(host.sessions, [0, 5, 0, 5]);
    // Its own numbers begin again, the host's do not.
    assert_eq!(host.frames, [(0, 5), (1, 5)]);
    let about: Vec<&String> = said.iter().filter(|words| words.contains("back")).collect();
    assert_eq!(about.len(), 2, "{said:?}");
    assert!(
        about[0].contains("but TriggerMode") && about[1].contains("is missing"),
        "{said:?}"
    );
    // At the start nothing can be explained by a check.
    let mut camera = Loose {
        found: vec![Err(triggered())],
        next: Vec::new(),
    };
    let served = serve(&mut camera, &mut Host::default(), &|| true, &mut |_| ());
    assert!(matches!(served, Err(CameraError::Setting { .. })));
}
