//! A request for a check before it is due: a small file beside the history, which the watch of that history takes away when it obeys.

use std::io::{self, BufRead, BufReader, Read};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use flankscope_foundation::display::plain;
use flankscope_foundation::files::{read_regular, write_whole_with_mode};

use crate::beside::beside;
use crate::document::{LiveLine, MOST_LIVE_BYTES, live_socket};

/// Longest content, bytes: a name.
const MOST_BYTES: u64 = 256;
/// How long a watch may take to say what it watches.
const PATIENCE: Duration = Duration::from_secs(2);

/// Why no check was requested.
#[derive(Debug, thiserror::Error)]
pub enum RequestError {
    /// Nothing would obey.
    #[error("no watch runs on this history: a check is started by one, or by flankscope inspect")]
    NoWatch,
    /// The watch is of another tool.
    #[error("the watch that runs is of {watched}, not of {wanted}")]
    OtherTool {
        /// Tool of the watch.
        watched: String,
        /// Tool that was to be checked.
        wanted: String,
    },
    /// The file cannot be written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

/// Asks the watch of a history for a check at the next opening of the press, in the name of `who`; of `tool`, if one is meant. A second
/// request before that changes nothing.
///
/// # Errors
/// No watch runs, it is of another tool, or the request cannot be stored.
pub fn request_check(history: &Path, tool: Option<&str>, who: &str) -> Result<(), RequestError> {
    let watched = watched_tool(history).map_err(|_| RequestError::NoWatch)?;
    if let Some(wanted) = tool.filter(|wanted| *wanted != watched) {
        let wanted = wanted.to_owned();
        return Err(RequestError::OtherTool { watched, wanted });
    }
    let path = file_of(history);
    write_whole_with_mode(&path, who.as_bytes(), 0o600)
        .map_err(|source| RequestError::Io { path, source })
}

/// Takes a request away and returns who made it. One that cannot be taken away is none: it would ask again at every opening.
#[must_use]
pub fn take_check_request(history: &Path) -> Option<String> {
    let path = file_of(history);
    let content = read_regular(&path, MOST_BYTES).ok();
    let who = content.map(|bytes| plain(&String::from_utf8_lossy(&bytes)).into_owned());
    std::fs::remove_file(&path).ok()?;
    Some(who.unwrap_or_else(|| "somebody".into()))
}

fn file_of(history: &Path) -> PathBuf {
    beside(history, ".check")
}

/// Name of the tool whose watch runs on a history.
fn watched_tool(history: &Path) -> io::Result<String> {
    let stream = UnixStream::connect(live_socket(history))?;
    stream.set_read_timeout(Some(PATIENCE))?;
    let mut lines = BufReader::new(stream.take(MOST_LIVE_BYTES)).lines();
    let line = lines.next().ok_or(io::ErrorKind::UnexpectedEof)??;
    match serde_json::from_str(&line)? {
        LiveLine::State(state) => Ok(state.tool),
        LiveLine::Pictures(_) => Err(io::ErrorKind::InvalidData.into()),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::os::unix::fs::PermissionsExt;
    use std::os::unix::net::UnixListener;
    use std::thread;

    use super::*;
    use crate::document::LiveState;
    use flankscope_profilometry::head::HeadDates;

    #[test]
    fn a_request_is_obeyed_once_and_only_where_a_watch_of_that_tool_runs() {
        let folder = tempfile::tempdir().unwrap();
        let history = folder.path().join("press.db");
        let refused = request_check(&history, None, "Anna");
        assert!(matches!(refused, Err(RequestError::NoWatch)), "{refused:?}");
        assert_eq!(take_check_request(&history), None);

        let listener = UnixListener::bind(live_socket(&history)).unwrap();
        let watch = thread::spawn(move || {
            let state = LiveState::new("press 7".into(), "die".into(), true, HeadDates::default());
            let line = serde_json::to_string(&LiveLine::State(state)).unwrap();
            for _ in 0..3 {
                let (mut stream, _) = listener.accept().unwrap();
                writeln!(stream, "{line}").unwrap();
            }
        });
        let other = request_check(&history, Some("other"), "Anna");
        let words = other.unwrap_err().to_string();
        assert_eq!(words, "the watch that runs is of die, not of other");
        assert_eq!(take_check_request(&history), None);
        request_check(&history, Some("die"), "Bert").unwrap();
        request_check(&history, None, "Anna").unwrap();
        watch.join().unwrap();
        let mode = std::fs::metadata(file_of(&history))
            .unwrap()
            .permissions()
            .mode();
        assert_eq!(mode & 0o777, 0o600);
        assert_eq!(take_check_request(&history).as_deref(), Some("Anna"));
        assert_eq!(take_check_request(&history), None);

        // What somebody else left there is no name, and no command to a terminal either.
        std::fs::write(file_of(&history), "\u{1b}[2J").unwrap();
        let who = take_check_request(&history).unwrap();
        assert!(!who.contains('\u{1b}'), "{who:?}");
        std::fs::write(file_of(&history), "a".repeat(1000)).unwrap();
        assert_eq!(take_check_request(&history).as_deref(), Some("somebody"));
        // One that stays asks for nothing.
        std::fs::create_dir(file_of(&history)).unwrap();
        assert_eq!(take_check_request(&history), None);
    }
}
