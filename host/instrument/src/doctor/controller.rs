//! Findings on the controller: whether it answers, its identity, the stages and the press.

use std::path::Path;
use std::time::Instant;

use flankscope_protocol::message::Boot;
use flankscope_protocol::{
    Command, FaultCode, Identity, Line, Micrometres, Microradians, PROTOCOL_VERSION, StageConfig,
    StageName, State, Status,
};
use serde_json::json;

use super::Finding;
use crate::controller::{Client, ClientError, ClientSettings, LinkError};

const CHECK: &str = "controller";

/// Models that the stages report, rotation and vertical, or why they were not asked.
type StageAnswers = Result<[Result<StageName, FaultCode>; 2], String>;

/// Answers of the controller.
struct Answer {
    identity: Identity,
    status: Status,
    answer_ms: u128,
    stages: StageAnswers,
    /// The fault that was acknowledged, if any.
    acknowledged: Option<FaultCode>,
}

/// Connects, asks for the status and the models of the stages, and acknowledges a fault if requested; nothing moves. The second
/// finding is about the stages, the third about the press.
#[must_use]
pub fn controller(
    port: &Path,
    settings: ClientSettings,
    stage: &StageConfig,
    acknowledge_fault: bool,
) -> [Finding; 3] {
    let unasked = |why: &str| {
        [
            Finding::not_asked("stages", why),
            Finding::not_asked("press", why),
        ]
    };
    match ask(port, settings, stage, acknowledge_fault) {
        Ok(answer) => [
            answered(&answer),
            stages(&answer, stage),
            press(&answer.status),
        ],
        Err(error) => {
            let [stages, press] = unasked(match error {
                ClientError::Link(_) => "there is no link to the controller",
                _ => "the controller does not answer",
            });
            [
                Finding::failed(CHECK, error.to_string(), remedy(&error)),
                stages,
                press,
            ]
        }
    }
}

fn ask(
    port: &Path,
    settings: ClientSettings,
    stage: &StageConfig,
    acknowledge_fault: bool,
) -> Result<Answer, ClientError> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    let runtime = runtime.map_err(|error| LinkError::Gone {
        reason: error.to_string(),
    })?;
    runtime.block_on(async {
        let begun = Instant::now();
        let mut client = Client::connect(port, settings).await?;
        let answer_ms = begun.elapsed().as_millis();
        let mut status = client.status().await?;
        let acknowledged = status.fault.filter(|_| acknowledge_fault);
        if acknowledged.is_some() {
            client.order(&Command::AcknowledgeFault).await?;
            status = client.status().await?;
        }
        // The identity before the stages are configured, because configuring them narrows its limits.
        let identity = *client.identity();
        let stages = match asked(&mut client, stage).await {
            Ok(answers) => Ok(answers),
            Err(ClientError::Refused(refusal)) => Err(refusal.to_string()),
            Err(error) => return Err(error),
        };
        Ok(Answer {
            identity,
            status,
            answer_ms,
            stages,
            acknowledged,
        })
    })
}

/// The models that the stages report over this line and these axes. A later measurement configures them again.
async fn asked(
    client: &mut Client,
    stage: &StageConfig,
) -> Result<[Result<StageName, FaultCode>; 2], ClientError> {
    client.configure(stage).await?;
    client.identify_stages().await
}

fn remedy(error: &ClientError) -> String {
    match error {
        ClientError::Link(LinkError::Open { source, .. }) => match source.kind {
            serialport::ErrorKind::NoDevice
            | serialport::ErrorKind::Io(std::io::ErrorKind::NotFound) => "plug the controller in; ls /dev/tty* names the ports".into(),
            serialport::ErrorKind::Io(std::io::ErrorKind::PermissionDenied) => {
                "let this user open the port: add it to the group dialout (usermod -aG dialout USER), log in again".into()
            }
            _ => "free the port: another program may hold it".into(),
        },
        ClientError::Silent { .. } => format!(
            "flash the board (firmware/README.md), and see that its line is {}",
            Line::HOST
        ),
        ClientError::Noise { .. } => format!(
            "see that this is the controller's port and that its line is {}; look at cable, ground and what runs beside it",
            Line::HOST
        ),
        ClientError::Version { .. } => "install host and firmware of one release".into(),
        _ => "unplug the controller, plug it in again, and look at its power and cable".into(),
    }
}

fn answered(answer: &Answer) -> Finding {
    let Answer {
        identity,
        status,
        answer_ms,
        acknowledged,
        ..
    } = answer;
    let [major, minor, patch] = identity.firmware;
    let boot = match identity.boot {
        Boot::PowerUp => "power-up",
        Boot::Watchdog => "watchdog reset",
        Boot::Panic => "panic",
        Boot::Requested => "requested reset",
    };
    let figures = json!({
        "firmware": format!("{major}.{minor}.{patch}"),
        "protocol": PROTOCOL_VERSION,
        "line": Line::HOST.to_string(),
        "baud": Line::HOST.baud,
        "answer_ms": *answer_ms as u64,
        "boot": boot,
        "lens": identity.lens,
        "projectors": identity.projectors,
        "frames_dropped": status.frames_dropped,
        "events_lost": status.events_lost,
    });
    let lens = if identity.lens { ", drives a lens" } else { "" };
    let projectors = match identity.projectors {
        1 => String::new(),
        several => format!(", switches {several} projectors"),
    };
    let seen = format!(
        "firmware {major}.{minor}.{patch}, protocol {PROTOCOL_VERSION}, {}, answered in {answer_ms} ms, started by {boot}{lens}{projectors}",
        Line::HOST
    );
    let seen = match acknowledged {
        Some(fault) => format!("{seen}; {fault} has been acknowledged"),
        None => seen,
    };
    let finding = match (status.fault, identity.boot) {
        (Some(fault), _) => Finding::failed(
            CHECK,
            format!("{seen}; {fault} is not acknowledged"),
            "remove its cause, then flankscope doctor --acknowledge-fault",
        ),
        (None, Boot::Watchdog | Boot::Panic) => Finding::attention(
            CHECK,
            seen,
            "report it: the controller reset itself because its program had gone wrong",
        ),
        (None, Boot::PowerUp | Boot::Requested) => Finding::ok(CHECK, seen),
    };
    finding.with(figures)
}

/// Finding on the stages: the configuration in the station file, and the models that they report.
fn stages(answer: &Answer, stage: &StageConfig) -> Finding {
    let Answer {
        identity,
        status,
        stages: answers,
        ..
    } = answer;
    let [rotation_deg, vertical_mm] = [
        f64::from(status.rotation.get()).to_degrees() / 1e6,
        f64::from(status.vertical.get()) / 1e3,
    ];
    let (turn, lift) = (&stage.rotation, &stage.vertical);
    let deg = |angle: Microradians| (f64::from(angle.get()).to_degrees() / 1e3).round() / 1e3;
    let mm = |place: Micrometres| f64::from(place.get()) / 1e3;
    let per_s = |thousandths: u32| f64::from(thousandths) / 1e3;
    let [turns_as, raises_as] = match answers {
        Ok(answers) => answers.map(|answer| answer.ok().map(|name| name.to_string())),
        Err(_) => [None, None],
    };
    let figures = json!({
        "homed": status.homed,
        "rotation_deg": rotation_deg,
        "vertical_mm": vertical_mm,
        "line": stage.line.to_string(),
        "rotation": {
            "axis": turn.number,
            "model": turn.model.map(|model| model.to_string()),
            "answers_as": turns_as,
            "travel_deg": [deg(turn.from), deg(turn.to)],
            "speed_deg_s": per_s(turn.speed.get()),
            "acceleration_deg_s2": per_s(turn.acceleration.get()),
            "home_deg": deg(turn.home),
        },
        "vertical": {
            "axis": lift.number,
            "model": lift.model.map(|model| model.to_string()),
            "answers_as": raises_as,
            "travel_mm": [mm(lift.from), mm(lift.to)],
            "speed_mm_s": per_s(lift.speed.get()),
            "acceleration_mm_s2": per_s(lift.acceleration.get()),
            "home_mm": mm(lift.home),
        },
    });
    let stands = match status.homed {
        true => format!("referenced, at {rotation_deg:.3} deg and {vertical_mm:.3} mm"),
        false => {
            "not referenced since the controller started: the next check references them".into()
        }
    };
    let seen = format!(
        "{stands}; axis {} turns {} to {} deg at {} deg/s, axis {} raises {} to {} mm at {} mm/s, line {}",
        turn.number,
        deg(turn.from),
        deg(turn.to),
        per_s(turn.speed.get()),
        lift.number,
        mm(lift.from),
        mm(lift.to),
        per_s(lift.speed.get()),
        stage.line,
    );
    let finding = match stage.validate(&identity.limits) {
        Ok(()) => identified(seen, stage, answers),
        Err(error) => Finding::failed(
            "stages",
            format!("{seen}; the controller would refuse them: {error}"),
            "correct [stages] in station.toml: these limits are compiled into the controller",
        ),
    };
    finding.with(figures)
}

/// Finding `seen`, with a check that the stages are the models in the station file.
fn identified(seen: String, stage: &StageConfig, answers: &StageAnswers) -> Finding {
    const STAGES: &str = "stages";
    let answers = match answers {
        Ok(answers) => answers,
        Err(why) => {
            let seen = format!("{seen}; what they are was not asked: {why}");
            return Finding::attention(STAGES, seen, "let what runs end, then ask again");
        }
    };
    let mut said = seen;
    let (mut other, mut silent, mut unnamed) = (None, false, false);
    for ((axis, model), answer) in stage.models().into_iter().zip(answers) {
        match answer {
            Ok(name) => said += &format!("; axis {axis} answers as {name:?}"),
            Err(fault) => said += &format!("; axis {axis} does not say what it is: {fault}"),
        }
        match (model, answer) {
            (Some(model), Ok(name)) if model.model() != name.model() => {
                other.get_or_insert((axis, model));
            }
            (Some(_), Err(_)) => silent = true,
            (Some(_), Ok(_)) => {}
            (None, _) => unnamed = true,
        }
    }
    if let Some((axis, model)) = other {
        return Finding::failed(
            STAGES,
            format!("{said}; the station names {model:?} for axis {axis}: nothing will move"),
            "connect that stage there, or correct its model in station.toml",
        );
    }
    if silent {
        return Finding::failed(
            STAGES,
            said,
            "see the stage controller's power, cable and [stages.line]; one that cannot say what its stages are needs a station.toml without models",
        );
    }
    if unnamed {
        return Finding::attention(
            STAGES,
            format!("{said}; the station does not name every model: others would be moved as well"),
            "name each in station.toml: model in [stages.rotation] and [stages.vertical]",
        );
    }
    Finding::ok(STAGES, said)
}

fn press(status: &Status) -> Finding {
    let press = status.press;
    let word = |is: bool, yes: &'static str, no: &'static str| if is { yes } else { no };
    let seen = format!(
        "{}, {}, {} cycles since the controller started",
        word(press.open, "open", "closed"),
        word(press.head_clear, "may stroke", "may not stroke"),
        press.cycles
    );
    let figures = json!({
        "open": press.open,
        "head_clear": press.head_clear,
        "cycles": press.cycles,
    });
    let idle = matches!(status.state, State::Unhomed | State::Ready | State::Faulted);
    if idle {
        Finding::ok("press", seen).with(figures)
    } else {
        let busy = format!("{seen}; the controller is {:?}", status.state);
        Finding::attention(
            "press",
            busy,
            "another program may be measuring: let it end",
        )
        .with(figures)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::sync::mpsc::RecvTimeoutError;
    use std::time::Duration;

    use serialport::{SerialPort, TTYPort};

    use super::*;

    /// A line on which bytes come that are no messages is not silent, and is said to be what it is.
    #[test]
    fn noise_is_told_from_silence() {
        for (noisy, words) in [(true, "damaged messages"), (false, "answers nothing")] {
            let (mut far, near) = TTYPort::pair().unwrap();
            let port = near.name().unwrap();
            // It would hold the port's lock.
            drop(near);
            let (done, until) = std::sync::mpsc::channel::<()>();
            let talker = std::thread::spawn(move || {
                let mut state = 9u32;
                // The far end stays open until the near one has been asked.
                while until.recv_timeout(Duration::from_millis(2)) == Err(RecvTimeoutError::Timeout)
                {
                    let mut noise = [0; 64];
                    for byte in &mut noise {
                        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                        *byte = (state >> 24) as u8;
                    }
                    if noisy {
                        // Full while nobody reads.
                        let _full = far.write_all(&noise);
                    }
                }
            });
            let settings = ClientSettings {
                answer: Duration::from_millis(50),
                unanswered: Duration::from_millis(200),
                ..ClientSettings::default()
            };
            let [found, ..] = controller(Path::new(&port), settings, &StageConfig::DEFAULT, false);
            assert!(found.seen.contains(words), "{}", found.seen);
            done.send(()).unwrap();
            talker.join().unwrap();
        }
    }
}
