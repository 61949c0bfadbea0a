//! The loop between a camera and the host's shared memory.

use std::time::Duration;

use flankscope_frames::{FrameHeader, FrameSink, FrameSlot, Labels, Ready};

use crate::backend::{Backend, CameraError, Description, Next, Status, Taken};
use crate::diagnosis::{diagnose, largest_socket_buffer};
use crate::frame_id::FrameIds;

/// How long one look for a frame lasts: the host waits for the arming at most as long.
const PATIENCE: Duration = Duration::from_millis(2);
/// How often an unplugged camera is looked for.
const RETRY: Duration = Duration::from_secs(1);

/// Serves the host until no frame can come any more, or nobody `wants` one; `say` hears what somebody should know.
///
/// A camera that is gone is looked for again: until then frames are missing, and the host sees that. One that cannot be armed
/// stays unarmed, and the host moves nothing.
///
/// # Errors
/// The camera cannot be configured at the start. One that came back and cannot be is tried again: a check may still be triggering it.
pub fn serve(
    backend: &mut impl Backend,
    sink: &mut impl FrameSink,
    wants: &dyn Fn() -> bool,
    say: &mut dyn FnMut(&str),
) -> Result<(), CameraError> {
    let mut server = Server {
        ids: None,
        me: None,
        labels: Labels::default(),
        counter: 0,
        session: 0,
        missing: 0,
        slot: None,
    };
    server.introduce(backend.configure()?, sink, say);
    while wants() {
        match server.step(backend, sink, say) {
            Ok(true) => {}
            Ok(false) => break,
            Err(error @ CameraError::Gone { .. }) => {
                say(&error.to_string());
                server.slot = None;
                let Some(description) = look_again(backend, wants, say) else {
                    break;
                };
                say("the camera is back; what it exposes until it is armed again is missing");
                server.introduce(description, sink, say);
            }
            Err(error) => say(&error.to_string()),
        }
    }
    server.diagnose(backend, say);
    Ok(())
}

/// Looks for a camera that is gone until it is there and takes its settings; nothing if nobody wants it any more.
fn look_again(
    backend: &mut impl Backend,
    wants: &dyn Fn() -> bool,
    say: &mut dyn FnMut(&str),
) -> Option<Description> {
    let mut said = String::new();
    while wants() {
        match backend.configure() {
            Ok(description) => return Some(description),
            Err(CameraError::Gone { .. }) => {}
            Err(error) => {
                let words = format!("the camera is back, but {error}");
                if words != said {
                    say(&words);
                }
                said = words;
            }
        }
        std::thread::sleep(RETRY);
    }
    None
}

struct Server<S> {
    ids: Option<FrameIds>,
    me: Option<Description>,
    labels: Labels,
    /// Number of the next frame since the process started.
    counter: u32,
    session: u32,
    /// Frames that never came, since the last arming.
    missing: u64,
    /// Loaned, and still empty.
    slot: Option<S>,
}

impl<S: FrameSlot> Server<S> {
    fn introduce(
        &mut self,
        me: Description,
        sink: &mut impl FrameSink<Slot = S>,
        say: &mut dyn FnMut(&str),
    ) {
        self.ids = Some(FrameIds::new(me.counting));
        self.me = Some(me);
        // Whatever it was armed for before it went, it is not any more.
        self.session = 0;
        self.speak(sink, say);
    }

    fn speak(&self, sink: &mut impl FrameSink<Slot = S>, say: &mut dyn FnMut(&str)) {
        let Some(me) = &self.me else { return };
        let word = Ready {
            session: self.session,
            counter: self.counter,
            width_px: me.width_px,
            height_px: me.height_px,
            bits: me.bits,
            reserved: 0,
            offset_dn: me.offset_dn.unwrap_or(f64::NAN),
            gain_e_per_dn: me.gain_e_per_dn.unwrap_or(f64::NAN),
            model: Ready::text(&me.model),
            link: Ready::text(&me.link),
        };
        if let Err(error) = sink.ready(word) {
            say(&error.to_string());
        }
    }

    /// One look at the host and one at the camera; false when nothing will come any more.
    fn step(
        &mut self,
        backend: &mut impl Backend,
        sink: &mut impl FrameSink<Slot = S>,
        say: &mut dyn FnMut(&str),
    ) -> Result<bool, CameraError> {
        if let Some(arm) = sink.armed() {
            self.diagnose(backend, say);
            self.missing = 0;
            if let Err(error) = backend.arm(arm.frames()) {
                // The host hears that it is not.
                self.session = 0;
                self.speak(sink, say);
                return Err(error);
            }
            self.labels.arm(arm);
            self.ids.iter_mut().for_each(FrameIds::armed);
            self.session = arm.session;
            self.speak(sink, say);
        }
        let Some(me) = &self.me else { return Ok(false) };
        let [width_px, height_px] = [me.width_px, me.height_px];
        let pixels = width_px as usize * height_px as usize;
        if self.slot.is_none() {
            match sink.loan(pixels, self.counter) {
                Ok(slot) => self.slot = Some(slot),
                Err(error) => {
                    // The host holds every slot: what comes now is lost, and counted.
                    let mut nowhere = vec![0; pixels];
                    return match backend.next(&mut nowhere, PATIENCE)? {
                        Next::Nothing => Ok(true),
                        Next::End => Ok(false),
                        Next::Whole(Taken { id, .. }) => {
                            say(&error.to_string());
                            self.skip(Some(id), say);
                            let _ = self.label();
                            Ok(true)
                        }
                        Next::Incomplete { id } => {
                            self.skip(id, say);
                            let _ = self.label();
                            Ok(true)
                        }
                    };
                }
            }
        }
        let Some(slot) = &mut self.slot else {
            return Ok(true);
        };
        match backend.next(slot.pixels(), PATIENCE)? {
            Next::Nothing => {}
            Next::End => return Ok(false),
            Next::Incomplete { id } => {
                self.skip(id, say);
                // Never as pixels: its number is missing.
                let _ = self.label();
            }
            Next::Whole(taken) => {
                self.skip(Some(taken.id), say);
                let (counter, session, label) = self.label();
                let header = FrameHeader {
                    session,
                    counter,
                    label,
                    width_px,
                    height_px,
                    stride_px: width_px,
                    measured: taken.measured,
                    exposure_start_us: taken.exposure_start_us,
                    exposure_end_us: taken.exposure_end_us,
                    exposure_end_monotonic_ns: taken.exposure_end_monotonic_ns,
                    ..FrameHeader::default()
                };
                if let Some(slot) = self.slot.take()
                    && let Err(lost) = sink.send(slot.seal(header))
                {
                    say(&lost.to_string());
                }
            }
        }
        Ok(true)
    }

    /// Says why frames were missing since the last arming, if they were.
    fn diagnose(&self, backend: &impl Backend, say: &mut dyn FnMut(&str)) {
        let status = Status {
            missing: self.missing,
            ..backend.status()
        };
        if let Some(words) = diagnose(&status, largest_socket_buffer()) {
            say(&words);
        }
    }

    /// Counts the frames that are missing before this one.
    fn skip(&mut self, id: Option<u64>, say: &mut dyn FnMut(&str)) {
        let Some(ids) = &mut self.ids else { return };
        let Some(id) = id else {
            return ids.unnumbered();
        };
        match ids.missing_before(id) {
            Ok(missing) => {
                self.missing += u64::from(missing);
                for _ in 0..missing {
                    let _ = self.label();
                }
            }
            Err(error) => {
                // Nobody knows where it belongs: a number that is left out spoils the view for the host.
                say(&error.to_string());
                let _ = self.label();
            }
        }
    }

    /// Number, session and place of the exposure that comes now.
    fn label(&mut self) -> (u32, u32, flankscope_frames::FrameLabel) {
        let counter = self.counter;
        self.counter = counter.wrapping_add(1);
        let (session, label) = self.labels.take();
        (counter, session, label)
    }
}
