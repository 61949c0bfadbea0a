//! Modbus TCP: what stands for the tool that was checked last, in ten registers. docs/plant.md has the table.

use std::future::{Ready, ready};
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use flankscope_metrology::verdict::Word;
use jiff::Timestamp;
use rustix::net::sockopt;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio_modbus::server::Service;
use tokio_modbus::server::tcp::Server;
use tokio_modbus::{ExceptionCode, Request, Response};

use crate::standing::{Standing, Worth, most_worn};

/// Registers, from address 0.
const REGISTERS: usize = 10;
/// Line controllers that are connected at a time.
const MOST_CONNECTIONS: usize = 32;
/// Silence after which the system asks whether a peer is still there.
const KEEPALIVE: Duration = Duration::from_secs(30);

const GO: u16 = 1 << 0;
const WARN: u16 = 1 << 1;
const NO_GO: u16 = 1 << 2;
const INDETERMINATE: u16 = 1 << 3;
const LATCHED: u16 = 1 << 4;
const SIMULATED: u16 = 1 << 5;
const STALE: u16 = 1 << 6;
const FAULT: u16 = 1 << 7;

/// Wear that was not measured.
const NO_WEAR: u16 = 0x8000;
/// Age or uncertainty that is unknown, or too large for a register.
const UNKNOWN: u16 = 0xffff;

/// Serves the registers until the process ends.
pub async fn serve(
    listener: TcpListener,
    standing: watch::Receiver<Arc<Standing>>,
) -> anyhow::Result<()> {
    let registers = Registers {
        standing,
        begun: Instant::now(),
        connections: Arc::new(()),
    };
    let on_connected = |stream: TcpStream, _: SocketAddr| ready(Ok(accepted(stream, &registers)));
    let on_error = |error: io::Error| tracing::info!(%error, "a Modbus connection broke");
    Ok(Server::new(listener).serve(&on_connected, on_error).await?)
}

fn accepted(stream: TcpStream, registers: &Registers) -> Option<(Registers, TcpStream)> {
    if Arc::strong_count(&registers.connections) > MOST_CONNECTIONS {
        tracing::warn!("more than {MOST_CONNECTIONS} Modbus connections: another one is refused");
        return None;
    }
    let _ = sockopt::set_socket_keepalive(&stream, true);
    let _ = sockopt::set_tcp_keepidle(&stream, KEEPALIVE);
    Some((registers.clone(), stream))
}

#[derive(Clone)]
struct Registers {
    standing: watch::Receiver<Arc<Standing>>,
    begun: Instant,
    /// Counts the connections by its clones.
    connections: Arc<()>,
}

impl Service for Registers {
    type Request = Request<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = Ready<Result<Response, ExceptionCode>>;

    fn call(&self, request: Self::Request) -> Self::Future {
        let life = self.begun.elapsed().as_secs() as u16;
        let words = words(&self.standing.borrow(), Timestamp::now(), life);
        let part = |from: u16, count: u16| {
            let (from, count) = (usize::from(from), usize::from(count));
            let part = words.get(from..from + count);
            part.map(<[u16]>::to_vec)
                .ok_or(ExceptionCode::IllegalDataAddress)
        };
        ready(match request {
            Request::ReadInputRegisters(from, count) => {
                part(from, count).map(Response::ReadInputRegisters)
            }
            Request::ReadHoldingRegisters(from, count) => {
                part(from, count).map(Response::ReadHoldingRegisters)
            }
            _ => Err(ExceptionCode::IllegalFunction),
        })
    }
}

/// The registers' content; `life` counts seconds.
fn words(standing: &Standing, now: Timestamp, life: u16) -> [u16; REGISTERS] {
    let mut words = [0, life, UNKNOWN, 0, 0, 0, 0, 0, NO_WEAR, UNKNOWN];
    if standing.fault.is_some() {
        words[0] = FAULT;
    }
    let Some(tool) = standing.tools.first() else {
        return words;
    };
    let last = &tool.last;
    let worth = standing.worth(tool, now);
    let bit_and_number = |word| match word {
        Word::Go => (GO, 1),
        Word::Warn => (WARN, 2),
        Word::NoGo => (NO_GO, 3),
        Word::Indeterminate => (INDETERMINATE, 4),
    };
    if worth == Worth::Counts {
        words[3] = bit_and_number(last.verdict).1;
    }
    let stands = standing.verdict(tool, now);
    words[0] |= stands.map_or(0, |word| bit_and_number(word).0);
    for (bit, holds) in [
        (LATCHED, tool.latched.is_some()),
        (SIMULATED, last.origin.simulated),
        (STALE, worth == Worth::Stale),
        (FAULT, worth == Worth::Unknown),
    ] {
        words[0] |= if holds { bit } else { 0 };
    }
    let register = |value: Option<u64>| value.and_then(|value| u16::try_from(value).ok());
    words[2] = register(standing.age_s(tool, now)).unwrap_or(UNKNOWN);
    for (at, number) in [(4, last.id), (6, last.tool_cycles)] {
        let number = u32::try_from(number).unwrap_or(u32::MAX);
        words[at] = (number >> 16) as u16;
        words[at + 1] = number as u16;
    }
    if let Some(flank) = most_worn(last) {
        let tenths = |um: f64, from: f64, to: f64| (10.0 * um).round().clamp(from, to);
        if let Some(wear_um) = flank.wear_um {
            // Two's complement; the smallest value means none.
            words[8] = (tenths(wear_um, -32767.0, 32767.0) as i16) as u16;
        }
        if let Some(u95_um) = flank.u95_um {
            words[9] = tenths(u95_um, 0.0, 65534.0) as u16;
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use flankscope_record::die::DieKey;
    use flankscope_record::history::Check;
    use flankscope_record::origin::{HeadId, Origin};
    use flankscope_record::seal::StandingNoGo;

    use super::*;
    use crate::standing::ToolStanding;

    fn standing(verdict: Word, latched: bool, at: &str, fault: bool) -> Standing {
        let last = Check {
            id: 70_000,
            at: at.into(),
            tool: "die".into(),
            tool_cycles: 5,
            press_cycles: 5,
            baseline: None,
            verdict,
            reason: String::new(),
            origin: Origin {
                link: "/dev/ttyACM0".into(),
                simulated: false,
                head: HeadId {
                    name: "head".into(),
                    blake3: String::new(),
                    seal: "signed".into(),
                },
                station: "press 7".into(),
                operator: None,
                recording: None,
            },
            serial: None,
            flanks: Vec::new(),
        };
        Standing {
            tools: vec![ToolStanding {
                last: Arc::new(last),
                latched: latched.then(|| StandingNoGo {
                    die: DieKey {
                        tool: "die".into(),
                        geometry: String::new(),
                        serial: None,
                    },
                    check: 70_000,
                    at: at.into(),
                }),
                counts: Vec::new(),
            }],
            fault: fault.then(|| "broken".into()),
            stale_after_s: 60,
        }
    }

    #[test]
    fn go_is_said_only_of_a_fresh_go_that_nothing_stands_against() {
        let now: Timestamp = "2026-01-31T12:00:30Z".parse().unwrap();
        let dates = [
            ("2026-01-31T12:00:00Z", true),
            ("2026-01-31T11:59:30Z", true),
            ("2026-01-31T11:59:29Z", false),
            // The other clock is ahead, or no date at all.
            ("2026-01-31T12:01:00Z", false),
            ("yesterday", false),
        ];
        for verdict in Word::ALL {
            for latched in [false, true] {
                for (at, fresh) in dates {
                    for fault in [false, true] {
                        let words = words(&standing(verdict, latched, at, fault), now, 9);
                        let counts = fresh && !fault;
                        let go = verdict == Word::Go && !latched && counts;
                        let of = (verdict, latched, at, fault);
                        assert_eq!(words[0] & GO != 0, go, "{of:?}");
                        assert_eq!(words[0] & LATCHED != 0, latched, "{of:?}");
                        assert_eq!(words[0] & (STALE | FAULT) == 0, counts, "{of:?}");
                        assert_eq!(words[3] != 0, counts, "{of:?}");
                        let no_go = latched || verdict == Word::NoGo;
                        assert_eq!(words[0] & NO_GO != 0, no_go, "{of:?}");
                        // 70 000 = 0x1_1170.
                        assert_eq!(words[4..6], [1, 0x1170], "{of:?}");
                        assert_eq!([words[1], words[8], words[9]], [9, NO_WEAR, UNKNOWN]);
                    }
                }
            }
        }
        let nothing = Standing::default();
        assert_eq!(super::words(&nothing, now, 0)[0] & GO, 0);
    }
}
