//! The link's two tasks: bytes to commands, replies and events to bytes.

use super::{Mailboxes, Outgoing, Request};
use crate::liveness::Task;
use core::sync::atomic::Ordering;
use embedded_io_async::{Read, Write};
use flankscope_protocol::{Command, Decoder, Header, Kind, MAX_FRAME_BYTES, encode};

/// Reads the port for ever. Damaged frames are counted and dropped: the host, missing its reply, asks again.
pub async fn receive(mut port: impl Read, mail: &Mailboxes) -> ! {
    let mut decoder = Decoder::new();
    let mut bytes = [0u8; 64];
    loop {
        let read = mail.liveness.alive(Task::Receive, port.read(&mut bytes));
        let Ok(count) = read.await else {
            // A line error (framing, overrun): whatever was damaged fails its checksum.
            mail.frames_dropped.fetch_add(1, Ordering::Relaxed);
            continue;
        };
        for &byte in bytes.get(..count).unwrap_or_default() {
            let request = match decoder.push(byte) {
                None => continue,
                Some(Ok(frame)) if frame.kind() == Kind::Command => Request {
                    header: frame.header(),
                    command: frame.message::<Command>().ok(),
                },
                Some(_) => {
                    mail.frames_dropped.fetch_add(1, Ordering::Relaxed);
                    continue;
                }
            };
            let sent = mail.requests.send(request);
            mail.liveness.alive(Task::Receive, sent).await;
        }
    }
}

/// Writes the port for ever.
pub async fn transmit(mut port: impl Write, mail: &Mailboxes) -> ! {
    let mut wire = [0u8; MAX_FRAME_BYTES];
    let (mut session, mut sequence, mut ack) = (0, 0u16, 0);
    loop {
        let next = mail.outgoing.receive();
        let outgoing = mail.liveness.alive(Task::Transmit, next).await;
        // Events of a session count from 1.
        let open = mail.session.load(Ordering::Relaxed);
        if open != session {
            (session, sequence) = (open, 0);
        }
        let length = match outgoing {
            Outgoing::Reply(to, reply) => {
                ack = to.sequence;
                encode(
                    Header {
                        session: to.session,
                        sequence,
                        ack,
                    },
                    &reply,
                    &mut wire,
                )
            }
            Outgoing::Event(event) => {
                sequence = sequence.wrapping_add(1);
                encode(
                    Header {
                        session,
                        sequence,
                        ack,
                    },
                    &event,
                    &mut wire,
                )
            }
        };
        // Every message fits the buffer (a test of the protocol holds it to that); a dead port is noticed by the host.
        if let Some(frame) = length.ok().and_then(|length| wire.get(..length)) {
            let write = async {
                let _dead_port = port.write_all(frame).await;
                let _dead_port = port.flush().await;
            };
            // A host that reads nothing is no reason for a reset.
            mail.liveness.alive(Task::Transmit, write).await;
        }
    }
}
