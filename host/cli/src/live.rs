//! The socket on which a watch says what it does: for `flankscope-plant`, or whatever else the station's user runs.
//!
//! The watch leaves its lines in memory and goes on; a thread of its own writes them, so that no reader, however slow, holds up a
//! check. Nothing is read from a reader.

use std::fs::Permissions;
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use flankscope_foundation::clock::BootTime;
use flankscope_jobs::inspection::ViewOutcome;
use flankscope_jobs::job::Job;
use flankscope_jobs::watch::{WatchEvent, WatchSettings};
use flankscope_metrology::verdict::Shown;
use flankscope_record::document::{LiveLine, LivePicture, LiveState, LiveStep, live_socket};
use flankscope_record::origin::Setting;
use flankscope_report::live_pictures;

use crate::progress::Steps;

/// Readers at a time.
const MOST_READERS: usize = 8;
/// Shortest time between two lines; a display shows no more.
const BETWEEN: Duration = Duration::from_millis(100);
/// Time for which a statement holds: the watch repeats the verdict, and with it the statement, every 1.25 s, and the press
/// forgets a verdict after 5 s. A check reports its steps, of which the longest takes no longer than the press is held.
const HOLDS: Duration = Duration::from_secs(5);
/// How long a reader may take to accept a line.
const PATIENCE: Duration = Duration::from_millis(500);

/// Follows a watch and shows on the socket what it does.
pub struct LiveWatch {
    socket: LiveSocket,
    state: LiveState,
    steps: Steps,
    begun: Instant,
    /// Press cycles between checks.
    every: u32,
    /// Time for which a statement during a check holds.
    hold_limit: Duration,
}

impl LiveWatch {
    /// Shows a watch by this job beside the history at `history`.
    ///
    /// # Errors
    /// As of [`LiveSocket::open`].
    pub fn open(
        history: &Path,
        setting: &Setting,
        job: &Job<ViewOutcome>,
        settings: &WatchSettings,
    ) -> io::Result<Self> {
        let state = LiveState::new(
            setting.station.clone(),
            job.die().tool,
            setting.link.is_simulated(),
            job.head_dates(),
        );
        let mut watch = Self {
            socket: LiveSocket::open(history)?,
            state,
            steps: Steps::new(job.view_names()),
            begun: Instant::now(),
            every: settings.every,
            hold_limit: settings.hold_limit,
        };
        watch.show();
        Ok(watch)
    }

    /// Takes one event.
    pub fn take(&mut self, told: &WatchEvent) {
        match told {
            WatchEvent::Cycle(cycle) => self.state.press_cycles = *cycle,
            WatchEvent::Checking(_) => {
                self.begun = Instant::now();
                self.state.is_checking = true;
                self.state.steps.clear();
                self.note("press held".into());
            }
            WatchEvent::Step(progress) => match self.steps.step(*progress) {
                Some(what) => self.note(what),
                None => return,
            },
            WatchEvent::Missed(_, fault) => {
                self.state.is_checking = false;
                self.state.made.missed_checks += 1;
                self.note(format!(
                    "no check: the press did not admit the head ({fault})"
                ));
            }
            WatchEvent::Checked(checked) => {
                self.state.is_checking = false;
                self.state.shown = checked.shown.word().into();
                self.state.due_cycles = checked.cycle.wrapping_add(self.every);
                let frames = &checked.inspection.frames;
                let made = &mut self.state.made;
                made.checks += 1;
                made.frames_triggered += frames.triggered;
                made.frames_lost += frames.triggered.saturating_sub(frames.received);
                made.recaptured_views += u64::from(frames.recaptured_views);
                self.note(format!("press released: {}", checked.inspection.verdict));
                self.socket
                    .show_pictures(live_pictures(&checked.inspection));
            }
            WatchEvent::Resumed(shown)
            | WatchEvent::Expired(shown)
            | WatchEvent::Repeated(shown) => {
                self.state.shown = shown.word().into();
            }
            WatchEvent::Requested(who) => {
                self.state.due_cycles = self.state.press_cycles;
                self.note(format!("{who} wants a check at the next opening"));
            }
            WatchEvent::Acknowledged => {
                self.state.shown = Shown::Unchecked.word().into();
                self.state.due_cycles = self.state.press_cycles;
            }
            WatchEvent::NotAcknowledged(_) => return,
        }
        self.show();
    }

    /// Makes the next statement.
    fn show(&mut self) {
        let holds = match self.state.is_checking {
            true => HOLDS.max(self.hold_limit),
            false => HOLDS,
        };
        self.state.sequence += 1;
        self.state.said_at = Some(BootTime::now());
        self.state.holds_ms = u64::try_from(holds.as_millis()).unwrap_or(u64::MAX);
        self.socket.show(&self.state);
    }

    fn note(&mut self, what: String) {
        let at_ms = u64::try_from(self.begun.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.state.steps.push(LiveStep { at_ms, what });
    }
}

/// The socket; removed when this is dropped.
struct LiveSocket {
    path: PathBuf,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    lines: Mutex<Lines>,
    changed: Condvar,
}

/// The newest line of each kind.
#[derive(Default)]
struct Lines {
    state: Arc<str>,
    pictures: Arc<str>,
    is_over: bool,
}

impl LiveSocket {
    /// Listens beside the history at `history`; for the same user only.
    ///
    /// # Errors
    /// Another watch of this history shows itself there, or no socket can be made there.
    fn open(history: &Path) -> io::Result<Self> {
        let path = live_socket(history);
        if UnixStream::connect(&path).is_ok() {
            return Err(io::Error::new(
                io::ErrorKind::AddrInUse,
                "another watch of this history listens there",
            ));
        }
        // It appears under its name when others can no longer open it; what an earlier watch left is replaced.
        let mut made = path.clone().into_os_string();
        made.push(format!(".{}", std::process::id()));
        let made = PathBuf::from(made);
        let listener = UnixListener::bind(&made)?;
        let ready = std::fs::set_permissions(&made, Permissions::from_mode(0o600))
            .and_then(|()| listener.set_nonblocking(true))
            .and_then(|()| std::fs::rename(&made, &path));
        if let Err(error) = ready {
            let _ = std::fs::remove_file(&made);
            return Err(error);
        }
        let shared = Arc::new(Shared::default());
        let of_thread = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name("live".into())
            .spawn(move || serve(&listener, &of_thread))?;
        Ok(Self {
            path,
            shared,
            thread: Some(thread),
        })
    }

    /// What the watch does now.
    fn show(&self, state: &LiveState) {
        let line = line(&LiveLine::State(state.clone()));
        self.set(|lines| lines.state = line);
    }

    /// The pictures of the check that ended.
    fn show_pictures(&self, pictures: Vec<LivePicture>) {
        let line = line(&LiveLine::Pictures(pictures));
        self.set(|lines| lines.pictures = line);
    }

    fn set(&self, change: impl FnOnce(&mut Lines)) {
        let lines = &self.shared.lines;
        change(&mut lines.lock().unwrap_or_else(PoisonError::into_inner));
        self.shared.changed.notify_one();
    }
}

impl Drop for LiveSocket {
    fn drop(&mut self) {
        self.set(|lines| lines.is_over = true);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        let _ = std::fs::remove_file(&self.path);
    }
}

fn line(of: &LiveLine) -> Arc<str> {
    serde_json::to_string(of).map_or_else(|_| "".into(), |json| format!("{json}\n").into())
}

/// A reader and the lines that it has.
struct Reader {
    stream: UnixStream,
    state: Arc<str>,
    pictures: Arc<str>,
}

impl Reader {
    fn new(stream: UnixStream) -> io::Result<Self> {
        stream.set_nonblocking(false)?;
        stream.set_write_timeout(Some(PATIENCE))?;
        Ok(Self {
            stream,
            state: "".into(),
            pictures: "".into(),
        })
    }

    /// Writes what it does not have yet.
    fn catch_up(&mut self, [state, pictures]: &[Arc<str>; 2]) -> io::Result<()> {
        for (has, now) in [(&mut self.state, state), (&mut self.pictures, pictures)] {
            if !Arc::ptr_eq(has, now) {
                self.stream.write_all(now.as_bytes())?;
                *has = Arc::clone(now);
            }
        }
        Ok(())
    }
}

fn serve(listener: &UnixListener, shared: &Shared) {
    let mut readers: Vec<Reader> = Vec::new();
    loop {
        let lines = shared.lines.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = shared.changed.wait_timeout(lines, BETWEEN);
        let (lines, _) = waited.unwrap_or_else(PoisonError::into_inner);
        if lines.is_over {
            return;
        }
        let now = [Arc::clone(&lines.state), Arc::clone(&lines.pictures)];
        drop(lines);
        while let Ok((stream, _)) = listener.accept() {
            if readers.len() < MOST_READERS {
                readers.extend(Reader::new(stream));
            }
        }
        // One that does not read, or is gone, is dropped.
        readers.retain_mut(|reader| reader.catch_up(&now).is_ok());
        std::thread::sleep(BETWEEN);
    }
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader};

    use super::*;

    fn state(cycle: u32) -> LiveState {
        let mut state = LiveState::new(
            "press 7".into(),
            "die".into(),
            true,
            flankscope_profilometry::head::HeadDates::default(),
        );
        state.press_cycles = cycle;
        state
    }

    /// Reads states until one says this cycle.
    fn read_until(stream: UnixStream, cycle: u32) {
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        let found = BufReader::new(stream).lines().any(|line| {
            let line = serde_json::from_str(&line.unwrap()).unwrap();
            matches!(line, LiveLine::State(state) if state.press_cycles == cycle)
        });
        assert!(found);
    }

    #[test]
    fn whoever_comes_gets_the_newest_state_and_one_that_does_not_read_holds_up_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let history = folder.path().join("press.db");
        // Left by a watch that was killed.
        drop(UnixListener::bind(live_socket(&history)).unwrap());
        let socket = LiveSocket::open(&history).unwrap();
        let mode = std::fs::metadata(&socket.path)
            .unwrap()
            .permissions()
            .mode();
        assert_eq!(mode & 0o777, 0o600);
        let twice = LiveSocket::open(&history).err().unwrap();
        assert!(twice.to_string().contains("another watch"), "{twice}");

        socket.show(&state(1));
        let asleep = UnixStream::connect(&socket.path).unwrap();
        // More than a socket's buffer takes.
        socket.show_pictures(vec![LivePicture {
            caption: "large".into(),
            image: "x".repeat(2 << 20),
            size_px: [1.0; 2],
        }]);
        for cycle in 0..1000 {
            socket.show(&state(cycle));
        }
        read_until(UnixStream::connect(&socket.path).unwrap(), 999);
        drop(asleep);
        let path = socket.path.clone();
        drop(socket);
        assert!(!path.exists());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
