//! What a watch of the history does now, read from its socket by a thread of its own. It is shown and decides nothing.

use std::io::{self, BufRead, BufReader, Read};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

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
        match serde_json::from_slice(&line)? {
            LiveLine::State(state) => {
                publish.send_modify(|live| live.state = Some(Arc::new(state)));
            }
            LiveLine::Pictures(mut pictures) => {
                pictures.retain(is_shown);
                publish.send_modify(|live| live.pictures = pictures.into());
            }
        }
    }
    Ok(())
}

/// Whether a picture is a picture.
fn is_shown(picture: &LivePicture) -> bool {
    picture.image.starts_with("data:image/png;base64,")
        && picture.size_px.iter().all(|px| px.is_finite() && *px > 0.0)
}
