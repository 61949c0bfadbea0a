//! What a watch of the history does now, read from its socket by a thread of its own. It is shown and decides nothing.
//!
//! Each statement of the watch says when it was made and for how long it holds, by the time since the computer started. So neither a
//! watch that was stopped nor a statement that was delayed on its way is taken for the present.

use std::io::{self, BufRead, BufReader, Read};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use flankscope_foundation::clock::BootTime;
use flankscope_record::document::{LiveLine, LivePicture, LiveState, MOST_LIVE_BYTES, live_socket};
use tokio::sync::watch;

/// How often it looks for a watch while none runs.
const EVERY: Duration = Duration::from_secs(1);

/// What the watch said last.
#[derive(Clone, Debug, Default)]
pub struct Live {
    /// None while no watch runs.
    pub state: Option<Arc<LiveState>>,
    /// Pictures of the last check.
    pub pictures: Arc<[LivePicture]>,
}

/// Begins to follow a watch of the history at `history`, now or whenever one runs.
///
/// # Errors
/// No thread can be started.
pub fn follow(history: &Path) -> io::Result<watch::Receiver<Live>> {
    let socket = live_socket(history);
    let (publish, live) = watch::channel(Live::default());
    thread::Builder::new().name("live".into()).spawn(move || {
        while !publish.is_closed() {
            if let Ok(stream) = UnixStream::connect(&socket) {
                if let Err(error) = read(stream, &publish) {
                    tracing::warn!("{}: {error}", socket.display());
                }
                publish.send_replace(Live::default());
            }
            thread::sleep(EVERY);
        }
    })?;
    Ok(live)
}

impl Live {
    /// Time for which the last statement still holds; zero if it does no longer.
    pub fn valid_for(&self, now: &BootTime) -> Duration {
        self.state
            .as_ref()
            .map_or(Duration::ZERO, |state| state.valid_for(now))
    }

    /// Last statement of the watch; none if it no longer holds.
    pub fn current(&self, now: &BootTime) -> Option<&LiveState> {
        let state = self.state.as_deref();
        state.filter(|_| !self.valid_for(now).is_zero())
    }

    /// Takes a line of the watch; a statement that is not newer than the last one is left out.
    fn take(&mut self, line: LiveLine) {
        match line {
            LiveLine::State(state) => {
                let is_newer = |before: &Arc<LiveState>| state.sequence > before.sequence;
                if self.state.as_ref().is_none_or(is_newer) {
                    self.state = Some(Arc::new(state));
                }
            }
            LiveLine::Pictures(mut pictures) => {
                pictures.retain(is_shown);
                self.pictures = pictures.into();
            }
        }
    }
}

/// Reads until the watch ends.
fn read(stream: UnixStream, publish: &watch::Sender<Live>) -> io::Result<()> {
    let mut lines = BufReader::new(stream);
    let mut line = Vec::new();
    while !publish.is_closed() {
        line.clear();
        let length = (&mut lines)
            .take(MOST_LIVE_BYTES)
            .read_until(b'\n', &mut line)?;
        if length == 0 {
            break;
        }
        if line.last() != Some(&b'\n') {
            let why = format!("a line of more than {MOST_LIVE_BYTES} bytes");
            return Err(io::Error::new(io::ErrorKind::InvalidData, why));
        }
        let statement = serde_json::from_slice(&line)?;
        publish.send_modify(|live| live.take(statement));
    }
    Ok(())
}

/// Whether a picture is a picture.
fn is_shown(picture: &LivePicture) -> bool {
    picture.image.starts_with("data:image/png;base64,")
        && picture.size_px.iter().all(|px| px.is_finite() && *px > 0.0)
}

#[cfg(test)]
mod tests {
    use flankscope_record::document::HeadDates;

    use super::*;

    fn statement(sequence: u64, shown: &str, said_at: &BootTime) -> LiveLine {
        let mut state = LiveState::new("press 7".into(), "die".into(), true, HeadDates::default());
        shown.clone_into(&mut state.shown);
        (state.sequence, state.said_at) = (sequence, Some(said_at.clone()));
        state.holds_ms = 5_000;
        LiveLine::State(state)
    }

    #[test]
    fn a_statement_holds_for_its_time_and_no_longer() {
        let second = |s: u64| BootTime {
            boot: "this start".into(),
            since_boot_ms: 1000 * s,
        };
        let mut live = Live::default();
        live.take(statement(1, "go", &second(100)));
        for (now_s, holds) in [(100, true), (104, true), (105, false), (400, false)] {
            assert_eq!(live.current(&second(now_s)).is_some(), holds, "{now_s} s");
        }
        // A watch or a process that was stopped delivers what it said before.
        live.take(statement(2, "go", &second(101)));
        assert!(live.current(&second(110)).is_none());
        live.take(statement(3, "no-go", &second(109)));
        assert_eq!(live.current(&second(110)).unwrap().shown, "no-go");
        assert_eq!(live.valid_for(&second(110)), Duration::from_secs(4));
        // An older statement does not replace a newer one.
        live.take(statement(2, "go", &second(109)));
        assert_eq!(live.current(&second(110)).unwrap().shown, "no-go");
        // A statement of another start of the computer, of the future, or of a watch that does not say when.
        let mut other = second(109);
        other.boot = "another start".into();
        for moment in [other, second(200)] {
            live.take(statement(4, "go", &moment));
            assert!(live.current(&second(110)).is_none());
            live = Live::default();
        }
        let old = LiveState::new("press 7".into(), "die".into(), true, HeadDates::default());
        live.take(LiveLine::State(old));
        assert!(live.state.is_some() && live.current(&second(0)).is_none());
    }
}
