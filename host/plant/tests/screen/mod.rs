//! A browser that is told what to do through a pipe (Chrome DevTools Protocol: requests and answers as JSON, each ended by a zero byte).

use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use flankscope_test_requisites::browser;
use flankscope_tests::Killed;
use serde_json::{Value, json};

/// Longest time for anything that a page is to show.
const AT_MOST: Duration = Duration::from_secs(30);

/// One page in a headless browser.
pub struct Screen {
    requests: File,
    answers: BufReader<File>,
    session: Option<String>,
    asked: u64,
    _process: Killed,
    _profile: tempfile::TempDir,
}

impl Screen {
    /// An empty page of this size, px; none where there is no browser.
    pub fn open(width_px: u32, height_px: u32) -> Option<Self> {
        let program = browser()?;
        let profile = tempfile::tempdir().unwrap();
        let [requests, answers] = ["requests", "answers"].map(|name| {
            let path = profile.path().join(name);
            rustix::fs::mknodat(
                rustix::fs::CWD,
                &path,
                rustix::fs::FileType::Fifo,
                rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR,
                0,
            )
            .unwrap();
            path
        });
        let started = Command::new("sh")
            .args(["-c", "exec \"$@\" 3<\"$REQUESTS\" 4>\"$ANSWERS\"", "sh"])
            .arg(program)
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--no-first-run",
            ])
            .args([
                "--remote-debugging-pipe",
                "--enable-automation",
                "--mute-audio",
            ])
            .arg(format!("--window-size={width_px},{height_px}"))
            .arg(format!(
                "--user-data-dir={}",
                profile.path().join("profile").display()
            ))
            .env("REQUESTS", &requests)
            .env("ANSWERS", &answers)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        let process = Killed(started.unwrap());
        let mut screen = Self {
            requests: File::options().write(true).open(requests).unwrap(),
            answers: BufReader::new(File::open(answers).unwrap()),
            session: None,
            asked: 0,
            _process: process,
            _profile: profile,
        };
        let page = screen.ask("Target.createTarget", json!({ "url": "about:blank" }));
        let attached = json!({ "targetId": page["targetId"], "flatten": true });
        let session = screen.ask("Target.attachToTarget", attached);
        screen.session = Some(session["sessionId"].as_str().unwrap().to_owned());
        screen.resize(width_px, height_px);
        Some(screen)
    }

    /// Sends one request and returns its result.
    pub fn ask(&mut self, method: &str, params: Value) -> Value {
        let answer = self.try_ask(method, params);
        answer.unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    fn try_ask(&mut self, method: &str, params: Value) -> Result<Value, Value> {
        self.asked += 1;
        let mut request = json!({ "id": self.asked, "method": method, "params": params });
        if let Some(session) = &self.session {
            request["sessionId"] = session.as_str().into();
        }
        let mut bytes = request.to_string().into_bytes();
        bytes.push(0);
        self.requests.write_all(&bytes).unwrap();
        loop {
            let mut answer = Vec::new();
            let length = self.answers.read_until(0, &mut answer).unwrap();
            assert!(length > 0, "the browser ended");
            answer.pop();
            // Events come between answers.
            let mut answer: Value = serde_json::from_slice(&answer).unwrap();
            if answer["id"] == self.asked {
                return match answer["error"].take() {
                    Value::Null => Ok(answer["result"].take()),
                    error => Err(error),
                };
            }
        }
    }

    pub fn resize(&mut self, width_px: u32, height_px: u32) {
        let size = json!({ "width": width_px, "height": height_px, "deviceScaleFactor": 1, "mobile": false });
        self.ask("Emulation.setDeviceMetricsOverride", size);
    }

    pub fn go_to(&mut self, address: &str) {
        self.ask("Page.navigate", json!({ "url": address }));
    }

    /// What a script of the page returns, after its promises.
    pub fn value(&mut self, script: &str) -> Value {
        let value = self.try_value(script);
        value.unwrap_or_else(|error| panic!("{script}: {error}"))
    }

    fn try_value(&mut self, script: &str) -> Result<Value, Value> {
        let how = json!({ "expression": script, "awaitPromise": true, "returnByValue": true });
        let mut answer = self.try_ask("Runtime.evaluate", how)?;
        match answer["exceptionDetails"].take() {
            Value::Null => Ok(answer["result"]["value"].take()),
            error => Err(error),
        }
    }

    /// Waits until a script returns true, on whatever page is there by then.
    pub fn until(&mut self, script: &str) {
        let end = Instant::now() + AT_MOST;
        loop {
            let last = self.try_value(script);
            if last == Ok(true.into()) {
                return;
            }
            if Instant::now() > end {
                let page = self.try_value("document.body.innerText");
                panic!("never {script}, but {last:?} on {page:?}");
            }
            thread::sleep(Duration::from_millis(50));
        }
    }

    /// Waits until an element shows this text.
    pub fn until_shown(&mut self, selector: &str, text: &str) {
        let [selector, text] = [selector, text].map(|text| Value::from(text).to_string());
        self.until(&format!(
            "(document.querySelector({selector})?.innerText ?? \"\").includes({text})"
        ));
    }

    /// Clicks on the middle of an element, as a mouse does.
    pub fn click(&mut self, selector: &str) {
        let selector = Value::from(selector);
        let at = self.value(&format!(
            "(() => {{ const e = document.querySelector({selector}); e.scrollIntoView({{ block: \"center\" }}); \
             const b = e.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; }})()"
        ));
        for kind in ["mousePressed", "mouseReleased"] {
            self.ask(
                "Input.dispatchMouseEvent",
                json!({ "type": kind, "x": at[0], "y": at[1], "button": "left", "clickCount": 1 }),
            );
        }
    }

    /// Types into what has the focus.
    pub fn type_text(&mut self, text: &str) {
        self.ask("Input.insertText", json!({ "text": text }));
    }

    /// The page as it is seen: width, and rows of red, green and blue.
    pub fn picture(&mut self) -> (usize, Vec<[u8; 3]>) {
        let shot = self.ask("Page.captureScreenshot", json!({ "format": "png" }));
        let bytes = BASE64.decode(shot["data"].as_str().unwrap()).unwrap();
        let mut png = png::Decoder::new(std::io::Cursor::new(bytes));
        png.set_transformations(
            png::Transformations::normalize_to_color8() | png::Transformations::STRIP_16,
        );
        let mut png = png.read_info().unwrap();
        let mut pixels = vec![0; png.output_buffer_size().unwrap()];
        let info = png.next_frame(&mut pixels).unwrap();
        let samples = info.color_type.samples();
        let pixels = pixels.chunks_exact(samples).map(|px| [px[0], px[1], px[2]]);
        (info.width as usize, pixels.collect())
    }

    /// Bytes of the page's objects after what is unused was freed, and its elements and listeners.
    pub fn held(&mut self) -> [f64; 3] {
        self.ask("HeapProfiler.collectGarbage", json!({}));
        self.ask("HeapProfiler.collectGarbage", json!({}));
        let metrics = self.ask("Performance.getMetrics", json!({}));
        ["JSHeapUsedSize", "Nodes", "JSEventListeners"].map(|name| {
            let metrics = metrics["metrics"].as_array().unwrap();
            let metric = metrics.iter().find(|metric| metric["name"] == name);
            metric.unwrap()["value"].as_f64().unwrap()
        })
    }
}
