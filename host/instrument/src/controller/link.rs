//! Converts bytes to messages and back, on two threads, so that neither a slow port nor a slow host blocks the other.

use std::io::{Read, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use flankscope_protocol::frame::Kind;
use flankscope_protocol::{
    Command, DecodeError, Decoder, Event, FlowControl, Header, Line, MAX_FRAME_BYTES, Parity,
    Reply, encode,
};
use serialport::{DataBits, StopBits};
use tokio::sync::mpsc;

/// How long the reader waits for bytes before it checks whether the link was closed.
const POLL: Duration = Duration::from_millis(20);

/// How long closing waits for the threads: ten polls.
const LETTING_GO: Duration = Duration::from_millis(200);

/// Why there is no link.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    #[error(
        "cannot open the port {port}: {source} (is the controller plugged in, and the port free?)"
    )]
    Open {
        port: String,
        /// The driver's reason.
        source: serialport::Error,
    },
    /// The port was disconnected.
    #[error("the link is gone: {reason}")]
    Gone {
        /// The driver's reason.
        reason: String,
    },
    /// The message does not fit a frame.
    #[error(transparent)]
    Encode(#[from] flankscope_protocol::EncodeError),
}

/// One thing that came over the link.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Incoming {
    /// An answer.
    Reply(Header, Reply),
    /// Something that happened.
    Event(Header, Event),
    /// Bytes that could not be decoded.
    Dropped(DecodeError),
    /// The port was disconnected; nothing follows.
    Gone(String),
}

/// An open port.
#[derive(Debug)]
pub struct Link {
    /// `None` once the link closes, which ends the writer.
    outgoing: Option<std::sync::mpsc::Sender<Vec<u8>>>,
    incoming: mpsc::UnboundedReceiver<Incoming>,
    open: Arc<AtomicBool>,
    /// Writer and reader; each holds the port.
    threads: Vec<JoinHandle<()>>,
}

impl Link {
    /// Opens a serial port with the settings of [`Line::HOST`]; a pseudo-terminal ignores the speed.
    ///
    /// # Errors
    /// The port does not exist, or another program holds it.
    pub fn open(port: &Path) -> Result<Self, LinkError> {
        let name = port.to_string_lossy().into_owned();
        let opened = set(&name, Line::HOST).timeout(POLL).open();
        let mut reader = opened.map_err(|source| LinkError::Open {
            port: name.clone(),
            source,
        })?;
        let mut writer = reader
            .try_clone()
            .map_err(|source| LinkError::Open { port: name, source })?;
        let (outgoing, to_write) = std::sync::mpsc::channel::<Vec<u8>>();
        let (to_host, incoming) = mpsc::unbounded_channel();
        let open = Arc::new(AtomicBool::new(true));
        let still_open = Arc::clone(&open);
        let gone = to_host.clone();
        let writing = std::thread::spawn(move || {
            while let Ok(frame) = to_write.recv() {
                if let Err(error) = writer.write_all(&frame).and_then(|()| writer.flush()) {
                    let _ = gone.send(Incoming::Gone(error.to_string()));
                    return;
                }
            }
        });
        let reading = std::thread::spawn(move || {
            let mut decoder = Decoder::new();
            let mut bytes = [0_u8; 512];
            while still_open.load(Ordering::Relaxed) {
                let count = match reader.read(&mut bytes) {
                    Ok(0) => {
                        let _ = to_host.send(Incoming::Gone("the port was closed".into()));
                        return;
                    }
                    Ok(count) => count,
                    Err(error) if error.kind() == std::io::ErrorKind::TimedOut => continue,
                    Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
                    Err(error) => {
                        let _ = to_host.send(Incoming::Gone(error.to_string()));
                        return;
                    }
                };
                for &byte in bytes.get(..count).unwrap_or_default() {
                    let Some(frame) = decoder.push(byte) else {
                        continue;
                    };
                    let message = match frame {
                        Ok(frame) => match frame.kind() {
                            Kind::Reply => frame
                                .message()
                                .map(|reply| Incoming::Reply(frame.header(), reply)),
                            Kind::Event => frame
                                .message()
                                .map(|event| Incoming::Event(frame.header(), event)),
                            Kind::Command => Err(DecodeError::WrongKind {
                                got: Kind::Command,
                                want: Kind::Reply,
                            }),
                        },
                        Err(error) => Err(error),
                    };
                    if to_host
                        .send(message.unwrap_or_else(Incoming::Dropped))
                        .is_err()
                    {
                        return;
                    }
                }
            }
        });
        Ok(Self {
            outgoing: Some(outgoing),
            incoming,
            open,
            threads: vec![writing, reading],
        })
    }

    /// Queues a command for the writer.
    ///
    /// # Errors
    /// The message does not fit a frame, or the port is gone.
    pub fn send(&self, header: Header, command: &Command) -> Result<(), LinkError> {
        let mut frame = vec![0; MAX_FRAME_BYTES];
        let length = encode(header, command, &mut frame)?;
        frame.truncate(length);
        let sent = self.outgoing.as_ref().map(|writer| writer.send(frame));
        match sent {
            Some(Ok(())) => Ok(()),
            _ => Err(LinkError::Gone {
                reason: "the writer has ended".into(),
            }),
        }
    }

    /// The next message, event or error that arrives.
    ///
    /// # Errors
    /// The port is gone.
    pub async fn receive(&mut self) -> Result<Incoming, LinkError> {
        match self.incoming.recv().await {
            Some(Incoming::Gone(reason)) => Err(LinkError::Gone { reason }),
            Some(message) => Ok(message),
            None => Err(LinkError::Gone {
                reason: "the reader has ended".into(),
            }),
        }
    }
}

/// A builder for a port with a line's settings.
fn set(name: &str, line: Line) -> serialport::SerialPortBuilder {
    serialport::new(name, line.baud)
        .data_bits(match line.data_bits {
            7 => DataBits::Seven,
            _ => DataBits::Eight,
        })
        .parity(match line.parity {
            Parity::None => serialport::Parity::None,
            Parity::Even => serialport::Parity::Even,
            Parity::Odd => serialport::Parity::Odd,
        })
        .stop_bits(match line.stop_bits {
            2 => StopBits::Two,
            _ => StopBits::One,
        })
        .flow_control(match line.flow {
            FlowControl::None => serialport::FlowControl::None,
            FlowControl::RtsCts => serialport::FlowControl::Hardware,
        })
}

impl Drop for Link {
    /// Waits for the threads, so that the next program finds the port free. The wait is limited, because a device that takes no
    /// more bytes can block the writer for ever.
    fn drop(&mut self) {
        self.open.store(false, Ordering::Relaxed);
        self.outgoing = None;
        let end = Instant::now() + LETTING_GO;
        while !self.threads.iter().all(JoinHandle::is_finished) && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}
