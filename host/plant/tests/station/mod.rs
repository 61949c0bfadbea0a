//! A station with a history, and the plant's process that shows it.

use std::io::{BufRead, BufReader, Lines, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use flankscope_tests::{Killed, flankscope, run, state, with_small_head};

pub fn plant() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_flankscope-plant"));
    command.env("FLANKSCOPE_STATE", state());
    command
}

/// What the command prints.
pub fn printed(arguments: &[&str], file: &Path) -> String {
    let output = plant().args(arguments).arg(file).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

/// A folder with a history, settings and a user.
pub struct Station {
    pub folder: tempfile::TempDir,
    pub token: String,
}

impl Station {
    pub fn new(stale_after_s: u32) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let users = folder.path().join("users.toml");
        let token = printed(
            &["token", "Anna", "--role", "acknowledge", "--users"],
            &users,
        );
        let settings = format!(
            "history = \"press.db\"\nstale_after_s = {stale_after_s}\nreports = \"out\"\n\n\
             [page]\nlisten = \"127.0.0.1:0\"\nusers = \"users.toml\"\n\n[modbus]\nlisten = \"127.0.0.1:0\"\n"
        );
        std::fs::write(folder.path().join("plant.toml"), settings).unwrap();
        Self { folder, token }
    }

    pub fn history(&self) -> PathBuf {
        self.folder.path().join("press.db")
    }

    /// Checks the demo die's tooth 40, and returns the exit code.
    pub fn check(&self, more: &[&str]) -> i32 {
        let mut check = flankscope();
        check.args(["inspect", "--speed", "max", "--quiet"]);
        with_small_head(&mut check, &["--link", "sim", "--teeth", "40"]);
        check.arg("--history").arg(self.history());
        check.arg("--report").arg(self.folder.path().join("out"));
        run(check.args(more)).code
    }

    pub fn serve(&self) -> Plant {
        let mut child = plant()
            .arg("serve")
            .arg(self.folder.path().join("plant.toml"))
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut printed = Printed::by_child(&mut child);
        Plant {
            page: printed.address("page     http"),
            modbus: printed.address("modbus"),
            token: self.token.clone(),
            process: Killed(child),
        }
    }
}

/// Lines that the plant's process prints when it begins.
pub struct Printed(Lines<BufReader<ChildStdout>>);

impl Printed {
    pub fn by_child(child: &mut Child) -> Self {
        Self(BufReader::new(child.stdout.take().unwrap()).lines())
    }

    /// What follows these words in the next line.
    pub fn after(&mut self, words: &str) -> String {
        let line = self.0.next().unwrap().unwrap();
        let address = line.strip_prefix(words);
        address.unwrap_or_else(|| panic!("{line}")).trim().into()
    }

    pub fn address(&mut self, words: &str) -> SocketAddr {
        let address = self.after(words);
        let address = address.trim_start_matches('s').trim_start_matches("://");
        address.trim_end_matches('/').parse().unwrap()
    }
}

/// The plant's process, where it listens, and a token for it.
pub struct Plant {
    pub page: SocketAddr,
    pub modbus: SocketAddr,
    pub token: String,
    pub process: Killed,
}

/// Status and text of an answer, headers included.
pub struct Answer {
    pub status: u16,
    pub text: String,
}

impl Plant {
    /// Sends a request as it is spelled here.
    pub fn send(&self, request: &str) -> Answer {
        let mut stream = TcpStream::connect(self.page).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let text = String::from_utf8_lossy(&answer).into_owned();
        let status = text
            .split(' ')
            .nth(1)
            .and_then(|status| status.parse().ok());
        Answer {
            status: status.unwrap_or_else(|| panic!("{text}")),
            text,
        }
    }

    pub fn get(&self, path: &str, headers: &str) -> Answer {
        let host = self.page;
        self.send(&format!(
            "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{headers}\r\n"
        ))
    }

    pub fn post(&self, path: &str, headers: &str, form: &str) -> Answer {
        let (host, length) = (self.page, form.len());
        self.send(&format!(
            "POST {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nContent-Type: application/x-www-form-urlencoded\r\n\
             Content-Length: {length}\r\n{headers}\r\n{form}"
        ))
    }

    pub fn with_token(&self, path: &str) -> Answer {
        self.get(path, &format!("Authorization: Bearer {}\r\n", self.token))
    }

    /// The board, once it shows this.
    pub fn board_with(&self, wanted: &str) -> String {
        self.page_with("/board", wanted)
    }

    /// A page, once it shows this.
    pub fn page_with(&self, path: &str, wanted: &str) -> String {
        let end = Instant::now() + Duration::from_secs(120);
        loop {
            let page = self.with_token(path).text;
            if page.contains(wanted) {
                return page;
            }
            assert!(Instant::now() < end, "no {wanted} in {page}");
            std::thread::sleep(Duration::from_millis(200));
        }
    }

    /// A Modbus request (the bytes after unit and length, by the protocol's specification) and the bytes of its answer.
    pub fn ask_registers(&self, request: [u8; 5]) -> Vec<u8> {
        let mut stream = TcpStream::connect(self.modbus).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        let mut frame = vec![0x12, 0x34, 0, 0, 0, 6, 1];
        frame.extend(request);
        stream.write_all(&frame).unwrap();
        let mut head = [0; 7];
        stream.read_exact(&mut head).unwrap();
        assert_eq!(
            head[..4],
            [0x12, 0x34, 0, 0],
            "transaction and protocol come back"
        );
        let mut answer = vec![0; usize::from(u16::from_be_bytes([head[4], head[5]])) - 1];
        stream.read_exact(&mut answer).unwrap();
        answer
    }

    /// Memory of the process, kB.
    pub fn resident_kb(&self) -> f64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.process.0.id()));
        let status = status.unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        line.unwrap()
            .trim()
            .trim_end_matches(" kB")
            .parse()
            .unwrap()
    }

    pub fn registers(&self) -> Vec<u16> {
        let answer = self.ask_registers([4, 0, 0, 0, 10]);
        assert_eq!(answer[..2], [4, 20]);
        let words = answer[2..].chunks_exact(2);
        words
            .map(|word| u16::from_be_bytes([word[0], word[1]]))
            .collect()
    }
}
