//! Poses from a program: one request and one answer per view, each a line of JSON, with a time limit.

use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tokio::sync::mpsc;
use tokio::time::{Instant, timeout};

use super::{PoseError, Wanted};
use crate::controller::Interrupt;
use flankscope_metrology::view::StatedPose;

/// Longest line of an answer, bytes.
const LINE_BYTES: u64 = 16 * 1024;
/// Interval at which an interruption by the operator is checked.
const LOOK: Duration = Duration::from_millis(50);

/// Request to the program, one line of JSON.
#[derive(Serialize)]
struct Request {
    view: usize,
    tooth: u32,
    /// Row-major, mm.
    tool_from_camera: [[f64; 4]; 4],
    limit_s: f64,
}

/// Answer of the program, one line of JSON: a pose, or why there is none.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Answer {
    view: usize,
    tool_from_camera: Option<[[f64; 4]; 4]>,
    u_mm: Option<f64>,
    u_mrad: Option<f64>,
    error: Option<String>,
}

/// A running program that states camera poses.
#[derive(Debug)]
pub struct PoseProgram {
    child: Child,
    stdin: Option<ChildStdin>,
    lines: mpsc::UnboundedReceiver<String>,
    limit: Duration,
    /// Numbers that questions of earlier checks had; those of this check go on from there.
    asked_before: usize,
    /// Largest number of a question so far.
    asked: usize,
}

impl PoseProgram {
    /// Starts the program; views are requested later.
    ///
    /// # Errors
    /// [`PoseError::Start`].
    pub fn start(command: &[String], limit: Duration) -> Result<Self, PoseError> {
        let (program, arguments) = match command {
            [program, arguments @ ..] => (program.clone(), arguments),
            [] => (String::new(), &[][..]),
        };
        let failed = |source| PoseError::Start {
            program: program.clone(),
            source,
        };
        let mut child = Command::new(&program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(failed)?;
        let (stdin, stdout) = (child.stdin.take(), child.stdout.take());
        let (sender, lines) = mpsc::unbounded_channel();
        let read = move || {
            let Some(stdout) = stdout else { return };
            let mut reader = BufReader::new(stdout);
            let mut line = String::new();
            // A line longer than the limit is cut and then rejected as an answer.
            while matches!(
                reader.by_ref().take(LINE_BYTES).read_line(&mut line),
                Ok(1..)
            ) {
                if sender.send(std::mem::take(&mut line)).is_err() {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("poses".into());
        let reading = thread.spawn(read);
        let program = Self {
            child,
            stdin,
            lines,
            limit,
            asked_before: 0,
            asked: 0,
        };
        // If the reader thread cannot be started, dropping the value ends the program.
        reading.map_err(failed)?;
        Ok(program)
    }

    /// Begins a check: its views are numbered on from those of earlier checks, so that no answer of then is taken for one of now.
    pub fn begin_check(&mut self) {
        self.asked_before = self.asked;
    }

    /// Requests one view and waits for its pose up to the time limit; meanwhile events of the controller are handled. A late answer
    /// to a question of an earlier check is passed over.
    ///
    /// # Errors
    /// There is no pose, or none that can be used.
    pub async fn reach(
        &mut self,
        wanted: &Wanted,
        interrupt: &Interrupt,
    ) -> Result<StatedPose, PoseError> {
        let view = self.asked_before + wanted.view;
        self.asked = self.asked.max(view);
        let wanted = &Wanted {
            view,
            ..wanted.clone()
        };
        let request = Request {
            view,
            tooth: wanted.tooth,
            tool_from_camera: wanted.tool_from_camera.to_rows(),
            limit_s: self.limit.as_secs_f64(),
        };
        let asked = serde_json::to_string(&request).unwrap_or_default();
        let stdin = self.stdin.as_mut().ok_or(PoseError::Ended { view })?;
        let told = writeln!(stdin, "{asked}").and_then(|()| stdin.flush());
        told.map_err(|_| PoseError::Ended { view })?;
        let end = Instant::now() + self.limit;
        let line = loop {
            let left = end.saturating_duration_since(Instant::now());
            if interrupt.is_requested() {
                return Err(PoseError::Interrupted { view });
            }
            match timeout(left.min(LOOK), self.lines.recv()).await {
                Ok(Some(line)) if self.is_of_earlier_check(&line) => {
                    tracing::warn!(
                        view,
                        "a late answer of the pose program to a question of an earlier check"
                    );
                }
                Ok(Some(line)) => break line,
                Ok(None) => return Err(PoseError::Ended { view }),
                Err(_) if left.is_zero() => {
                    let limit_s = self.limit.as_secs_f64();
                    return Err(PoseError::Late { view, limit_s });
                }
                Err(_) => {}
            }
        };
        understood(wanted, &line)
    }

    fn is_of_earlier_check(&self, line: &str) -> bool {
        let answer: Option<Answer> = serde_json::from_str(line).ok();
        answer.is_some_and(|answer| (1..=self.asked_before).contains(&answer.view))
    }
}

/// The pose in an answer.
fn understood(wanted: &Wanted, line: &str) -> Result<StatedPose, PoseError> {
    let view = wanted.view;
    let unreadable = |why: String| PoseError::Unreadable { view, why };
    let answer: Answer = serde_json::from_str(line).map_err(|e| unreadable(e.to_string()))?;
    if answer.view != view {
        let got = answer.view;
        return Err(PoseError::OtherView { view, got });
    }
    if let Some(why) = answer.error {
        return Err(PoseError::Refused { view, why });
    }
    let missing = |key| unreadable(format!("missing {key}"));
    let rows = answer
        .tool_from_camera
        .ok_or_else(|| missing("tool_from_camera"))?;
    wanted.checked(StatedPose {
        tool_from_camera: rows,
        u_mm: answer.u_mm.ok_or_else(|| missing("u_mm"))?,
        u_mrad: answer.u_mrad.ok_or_else(|| missing("u_mrad"))?,
    })
}

impl Drop for PoseProgram {
    /// Closes the program's input, which asks it to end, and kills it if it still runs after 500 ms.
    fn drop(&mut self) {
        drop(self.stdin.take());
        let end = Instant::now() + Duration::from_millis(500);
        while Instant::now() < end {
            if let Ok(Some(_)) = self.child.try_wait() {
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        let _gone_already = self.child.kill();
        let _status = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::super::wanted;
    use super::*;

    fn reach(program: &mut PoseProgram, view: usize) -> Result<StatedPose, PoseError> {
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = runtime.enable_time().build().unwrap();
        runtime.block_on(program.reach(&wanted(view), &Interrupt::never()))
    }

    fn ask(script: &str, limit_ms: u64) -> Result<StatedPose, PoseError> {
        let command = ["sh", "-c", script].map(String::from);
        let mut program = PoseProgram::start(&command, Duration::from_millis(limit_ms))?;
        reach(&mut program, 1)
    }

    const ROWS: &str = "[[1,0,0,0.1],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";

    #[test]
    fn a_program_answers_with_the_pose_reached() {
        let script = format!(
            r#"read asked; echo '{{"view":1,"tool_from_camera":{ROWS},"u_mm":0.02,"u_mrad":0.1}}'"#
        );
        let stated = ask(&script, 10_000).unwrap();
        assert_eq!(stated.tool_from_camera[0][3], 0.1);
        assert_eq!((stated.u_mm, stated.u_mrad), (0.02, 0.1));
    }

    /// Every kind of invalid answer is refused by name.
    #[test]
    fn what_is_late_foreign_or_no_pose_is_refused_by_name() {
        let answer = |view: &str, rows: &str, u_mm: &str| {
            format!(
                r#"read asked; echo '{{"view":{view},"tool_from_camera":{rows},"u_mm":{u_mm},"u_mrad":0.1}}'"#
            )
        };
        let moved = ROWS.replace("0.1", "1.5");
        let bent = ROWS.replace("[[1,", "[[2,");
        for (script, words) in [
            (
                "read asked; exec sleep 30".to_owned(),
                "did not answer for view 1 within 0.3 s",
            ),
            (
                "read asked; exit 1".into(),
                "ended before it answered for view 1",
            ),
            ("read asked; echo soon; exec sleep 30".into(), "no answer"),
            (
                "read asked; head -c 100000 /dev/zero | tr '\\0' x; exec sleep 30".into(),
                "no answer",
            ),
            (
                answer("2", ROWS, "0.02"),
                "answered for view 2 when it was asked for view 1",
            ),
            (answer("1", &bent, "0.02"), "the pose of view 1 is none"),
            (
                answer("1", &ROWS.replace("0.1", "1e999"), "0.02"),
                "no answer",
            ),
            (
                answer("1", &ROWS.replace("0.1", "NaN"), "0.02"),
                "no answer",
            ),
            (
                answer("1", &moved, "0.02"),
                "is 1.500 mm and 0.0 mrad from where it was asked for",
            ),
            (
                answer("1", ROWS, "0"),
                "u_mm = 0; right is more than 0 and at most 1",
            ),
            (answer("1", ROWS, "-1"), "u_mm = -1"),
            (answer("1", ROWS, "null"), "missing u_mm"),
            (
                r#"read asked; echo '{"view":1,"error":"arm is locked"}'"#.into(),
                "refuses view 1: arm is locked",
            ),
        ] {
            let patience_ms = if script.contains("sleep") {
                300
            } else {
                10_000
            };
            let error = ask(&script, patience_ms).unwrap_err().to_string();
            assert!(error.contains(words), "{script}: {error}");
        }
        let nobody = PoseProgram::start(&["/nowhere/robot".into()], LOOK).unwrap_err();
        assert!(nobody.to_string().contains("/nowhere/robot"), "{nobody}");
    }

    /// A late answer for one view is not taken as the pose of the next.
    #[test]
    fn a_late_answer_is_none_to_a_later_question() {
        let command = [
            "sh",
            "-c",
            &format!(
                r#"read a; read b; echo '{{"view":1,"tool_from_camera":{ROWS},"u_mm":0.02,"u_mrad":0.1}}'"#
            ),
        ]
        .map(String::from);
        let mut program = PoseProgram::start(&command, Duration::from_millis(200)).unwrap();
        let late = reach(&mut program, 1).unwrap_err();
        assert!(matches!(late, PoseError::Late { view: 1, .. }), "{late}");
        let other = reach(&mut program, 2).unwrap_err();
        assert!(
            matches!(other, PoseError::OtherView { view: 2, got: 1 }),
            "{other}"
        );
    }

    /// The next check of a watch asks for its first view by another number, and passes over the late answer to the check before.
    #[test]
    fn a_late_answer_is_none_to_the_next_check() {
        let answer = |view: usize, x: &str| {
            let rows = ROWS.replace("0.1", x);
            format!(
                r#"echo '{{"view":{view},"tool_from_camera":{rows},"u_mm":0.02,"u_mrad":0.1}}'"#
            )
        };
        let script = format!(
            "read a; read b; {}; {}; read c",
            answer(1, "0.1"),
            answer(2, "0.2")
        );
        let command = ["sh", "-c", &script].map(String::from);
        let mut program = PoseProgram::start(&command, Duration::from_millis(400)).unwrap();
        program.begin_check();
        let late = reach(&mut program, 1).unwrap_err();
        assert!(matches!(late, PoseError::Late { view: 1, .. }), "{late}");
        program.begin_check();
        let stated = reach(&mut program, 1).unwrap();
        assert_eq!(stated.tool_from_camera[0][3], 0.2);
    }
}
