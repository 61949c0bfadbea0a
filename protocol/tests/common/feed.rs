//! What must hold for any bytes; the fuzz target includes this very file.

use flankscope_protocol::{Command, Decoder, Event, Kind, MAX_FRAME_BYTES, Message, Reply, encode};

/// Feeds bytes and one delimiter; every message accepted must come out again as the bytes it came from.
pub fn feed(bytes: &[u8]) -> (usize, usize) {
    let mut decoder = Decoder::new();
    let (mut accepted, mut refused) = (0, 0);
    let mut since_delimiter = Vec::new();
    for &byte in bytes.iter().chain(&[0]) {
        if byte != 0 {
            since_delimiter.push(byte);
        }
        let outcome = decoder.push(byte);
        match outcome {
            None => {}
            Some(Err(_)) => refused += 1,
            Some(Ok(whole)) => {
                let again = match whole.kind() {
                    Kind::Command => whole.message::<Command>().map(|m| seal(whole.header(), &m)),
                    Kind::Reply => whole.message::<Reply>().map(|m| seal(whole.header(), &m)),
                    Kind::Event => whole.message::<Event>().map(|m| seal(whole.header(), &m)),
                };
                match again {
                    Ok(again) => {
                        accepted += 1;
                        let inside = &again[1..again.len() - 1];
                        assert_eq!(inside, since_delimiter, "other bytes mean the same message");
                    }
                    // A whole frame around nonsense is refused by its message.
                    Err(_) => refused += 1,
                }
            }
        }
        if byte == 0 {
            since_delimiter.clear();
        }
    }
    (accepted, refused)
}

fn seal<M: Message>(header: flankscope_protocol::Header, message: &M) -> Vec<u8> {
    let mut wire = [0; MAX_FRAME_BYTES];
    let length = encode(header, message, &mut wire).expect("it came in a frame");
    wire[..length].to_vec()
}
