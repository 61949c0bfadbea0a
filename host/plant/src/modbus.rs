//! Modbus TCP: what stands for the station, in ten registers. docs/plant.md has the table.

use std::future::{Ready, ready};
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use flankscope_metrology::verdict::Word;
use flankscope_record::origin::OriginKind;
use rustix::net::sockopt;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio_modbus::server::Service;
use tokio_modbus::server::tcp::Server;
use tokio_modbus::{ExceptionCode, Request, Response};

use crate::places::{Place, Places};
use crate::statement::{Moment, Standing, StationStatement, Worth, most_worn};

/// Registers, from address 0.
const REGISTERS: usize = 10;
/// Line controllers that are connected at a time, and those from one address. For one more, the longest silent one is closed.
const MOST_CONNECTIONS: usize = 32;
const MOST_PER_ADDRESS: usize = 24;
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
    let begun = Instant::now();
    let places = Places::new(MOST_CONNECTIONS, MOST_PER_ADDRESS);
    let accepted = |stream: TcpStream, from: SocketAddr| -> io::Result<_> {
        let _ = sockopt::set_socket_keepalive(&stream, true);
        let _ = sockopt::set_tcp_keepidle(&stream, KEEPALIVE);
        let registers = Registers {
            standing: standing.clone(),
            begun,
            place: Arc::new(places.take(&stream, from)?),
        };
        Ok(Some((registers, stream)))
    };
    let on_connected = |stream: TcpStream, from: SocketAddr| ready(accepted(stream, from));
    let on_error = |error: io::Error| tracing::info!(%error, "a Modbus connection broke");
    Ok(Server::new(listener).serve(&on_connected, on_error).await?)
}

struct Registers {
    standing: watch::Receiver<Arc<Standing>>,
    begun: Instant,
    place: Arc<Place>,
}

impl Service for Registers {
    type Request = Request<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = Ready<Result<Response, ExceptionCode>>;

    fn call(&self, request: Self::Request) -> Self::Future {
        self.place.prove();
        let life = self.begun.elapsed().as_secs() as u16;
        let words = words(&self.standing.borrow().statement(&Moment::now()), life);
        ready(match request {
            Request::ReadInputRegisters(from, count) => {
                part(&words, from, count).map(Response::ReadInputRegisters)
            }
            Request::ReadHoldingRegisters(from, count) => {
                part(&words, from, count).map(Response::ReadHoldingRegisters)
            }
            _ => Err(ExceptionCode::IllegalFunction),
        })
    }
}

/// Registers of a request. The specification calls a count of 0 an illegal value.
fn part(words: &[u16], from: u16, count: u16) -> Result<Vec<u16>, ExceptionCode> {
    if count == 0 {
        return Err(ExceptionCode::IllegalDataValue);
    }
    let (from, count) = (usize::from(from), usize::from(count));
    let part = words.get(from..from + count);
    part.map(<[u16]>::to_vec)
        .ok_or(ExceptionCode::IllegalDataAddress)
}

/// The registers' content; `life` counts seconds.
pub fn words(station: &StationStatement, life: u16) -> [u16; REGISTERS] {
    let mut words = [0, life, UNKNOWN, 0, 0, 0, 0, 0, NO_WEAR, UNKNOWN];
    let (bit, number) = match station.verdict {
        None => (0, 0),
        Some(Word::Go) => (GO, 1),
        Some(Word::Warn) => (WARN, 2),
        Some(Word::NoGo) => (NO_GO, 3),
        Some(Word::Indeterminate) => (INDETERMINATE, 4),
    };
    words[0] = bit;
    words[3] = number;
    let mut set = |bit: u16, holds: bool| words[0] |= if holds { bit } else { 0 };
    set(LATCHED, !station.open_no_gos.is_empty());
    set(FAULT, station.fault.is_some());
    // A recording is not the state of the press.
    let die = station.dies.first();
    let Some(die) = die.filter(|die| die.origin != OriginKind::Recording) else {
        return words;
    };
    let last = &die.last;
    set(SIMULATED, last.origin.simulated);
    set(STALE, die.worth == Worth::Stale);
    set(FAULT, die.worth.doubt().is_some());
    let age_s = die.age.map(|age| age.as_secs());
    words[2] = age_s
        .and_then(|age_s| u16::try_from(age_s).ok())
        .unwrap_or(UNKNOWN);
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
    use super::*;
    use crate::freshness_model::{Scene, check, moment, no_go};

    #[test]
    fn go_is_said_only_of_a_fresh_go_that_nothing_stands_against() {
        // Ages of the check, s; the negative one is of a clock that is ahead.
        for (age_s, is_fresh) in [(0, true), (60, true), (61, false), (-31, false)] {
            for verdict in Word::ALL {
                for is_latched in [false, true] {
                    for has_fault in [false, true] {
                        let case = (age_s, verdict, is_latched, has_fault);
                        let now = moment(1000);
                        let mut scene = Scene::new(60);
                        let last = check(70_000, "die", verdict, &moment_of(age_s));
                        scene.facts.tools.push((last, Vec::new()));
                        if is_latched || verdict == Word::NoGo {
                            // The no-go of another die stands for the station.
                            scene.facts.open_no_gos.push(no_go("another die", 69_999));
                        }
                        let mut standing = scene.look(&now);
                        if has_fault {
                            standing = standing.with_fault("broken", &[]);
                        }
                        let words = words(&standing.statement(&now), 9);
                        let counts = is_fresh && !has_fault;
                        let is_open = is_latched || verdict == Word::NoGo;
                        let go = verdict == Word::Go && !is_open && counts;
                        assert_eq!(words[0] & GO != 0, go, "{case:?}");
                        assert_eq!(words[0] & LATCHED != 0, is_open, "{case:?}");
                        assert_eq!(words[0] & (STALE | FAULT) == 0, counts, "{case:?}");
                        assert_eq!(words[3] == 1, go, "{case:?}");
                        assert_eq!(words[3] != 0, counts || is_open, "{case:?}");
                        assert_eq!(words[0] & NO_GO != 0, is_open, "{case:?}");
                        if !has_fault {
                            // 70 000 = 0x1_1170.
                            assert_eq!(words[4..6], [1, 0x1170], "{case:?}");
                        }
                        assert_eq!([words[1], words[8], words[9]], [9, NO_WEAR, UNKNOWN]);
                    }
                }
            }
        }
        let nothing = Standing::unread(Duration::from_secs(60));
        assert_eq!(words(&nothing.statement(&moment(0)), 0)[0], FAULT);
    }

    /// Moment at which a check of this age was exposed, seen from second 1000.
    fn moment_of(age_s: i64) -> Moment {
        moment(1000 - age_s)
    }

    #[test]
    fn a_count_of_none_and_addresses_beyond_the_registers_are_exceptions() {
        let words = [7; REGISTERS];
        assert_eq!(part(&words, 0, 10), Ok(vec![7; 10]));
        assert_eq!(part(&words, 9, 1), Ok(vec![7]));
        for (from, count, code) in [
            (0, 0, ExceptionCode::IllegalDataValue),
            (10, 0, ExceptionCode::IllegalDataValue),
            (5, 6, ExceptionCode::IllegalDataAddress),
            (65_535, 65_535, ExceptionCode::IllegalDataAddress),
        ] {
            assert_eq!(part(&words, from, count), Err(code), "{from}, {count}");
        }
    }
}
