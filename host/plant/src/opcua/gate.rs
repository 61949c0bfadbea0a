//! Connections from the network, carried to the server behind them: how many there may be, how long they may be silent, and that
//! nothing but discovery passes without encryption. The server itself limits neither, and lets anybody open a session without
//! security, which then occupies a place until it times out.

use std::collections::HashMap;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::timeout;

/// Connections at a time, and from one address.
const MOST_CONNECTIONS: usize = 64;
const MOST_PER_ADDRESS: usize = 16;
/// Time within which a connection must be encrypted; discovery must be done by then.
const UNSECURED_TIME: Duration = Duration::from_secs(10);
/// Silence after which a connection is closed. A session that lives says something within its timeout, at most a minute.
const SILENCE: Duration = Duration::from_secs(120);
/// Largest chunk, bytes, as the server announces it; and largest one of a request without encryption.
pub const MOST_CHUNK: usize = 65_535;
const MOST_UNSECURED_CHUNK: usize = 8_192;
/// Pause after a connection could not be accepted, for example for want of file descriptors.
const PAUSE: Duration = Duration::from_millis(100);

const HEADER: usize = 8;
/// Policies that may be asked for, as a request to open a channel spells them: without security for discovery, and those of the
/// endpoints.
const UNSECURED: &[u8] = b"http://opcfoundation.org/UA/SecurityPolicy#None";
const SECURED: [&[u8]; 2] = [
    b"http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256",
    b"http://opcfoundation.org/UA/SecurityPolicy#Aes256_Sha256_RsaPss",
];
/// Requests of discovery by the numbers of their binary encodings: FindServers and GetEndpoints.
const DISCOVERY: [u16; 2] = [422, 428];
/// Status with which a connection is refused: BadSecurityPolicyRejected.
const REFUSED: u32 = 0x8055_0000;

/// Carries connections until the process ends.
pub async fn serve(listener: &TcpListener, server: SocketAddr) -> anyhow::Result<()> {
    let room = Arc::new(Semaphore::new(MOST_CONNECTIONS));
    let addresses = Arc::new(Addresses::default());
    loop {
        let permit = Arc::clone(&room).acquire_owned().await?;
        let (stream, from) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::warn!(%error, "an OPC UA connection was not accepted");
                tokio::time::sleep(PAUSE).await;
                continue;
            }
        };
        let Some(place) = Addresses::enter(&addresses, from.ip()) else {
            continue;
        };
        tokio::spawn(async move {
            let _held = (permit, place);
            // A connection that breaks is its client's affair.
            let _ = carry(stream, server).await;
        });
    }
}

/// Connections by address.
#[derive(Default)]
struct Addresses(Mutex<HashMap<IpAddr, usize>>);

/// A connection's place among those of its address.
struct Place {
    addresses: Arc<Addresses>,
    address: IpAddr,
}

impl Addresses {
    fn enter(addresses: &Arc<Self>, address: IpAddr) -> Option<Place> {
        let mut counts = addresses.0.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(address).or_default();
        if *count >= MOST_PER_ADDRESS {
            return None;
        }
        *count += 1;
        Some(Place {
            addresses: Arc::clone(addresses),
            address,
        })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let counts = &self.addresses.0;
        let mut counts = counts.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = counts.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.address);
            }
        }
    }
}

async fn carry(client: TcpStream, server: SocketAddr) -> io::Result<()> {
    let server = TcpStream::connect(server).await?;
    for stream in [&client, &server] {
        stream.set_nodelay(true)?;
    }
    let (mut from_client, mut to_client) = client.into_split();
    let (mut from_server, mut to_server) = server.into_split();
    let ended = tokio::select! {
        ended = requests(&mut from_client, &mut to_server) => ended,
        ended = tokio::io::copy(&mut from_server, &mut to_client) => ended.map(|_| Ended::Closed),
    };
    if let Ended::Refused(why) = ended? {
        to_client.write_all(&refusal(why)).await?;
    }
    Ok(())
}

/// Why a connection's requests end.
enum Ended {
    Closed,
    Refused(&'static str),
}

/// Carries requests as long as they may pass.
async fn requests(
    from: &mut (impl AsyncRead + Unpin),
    to: &mut (impl AsyncWrite + Unpin),
) -> io::Result<Ended> {
    let mut checker = Checker { secured: None };
    let begin = async {
        while checker.secured != Some(true) {
            let chunk = chunk(from).await?;
            if let Err(why) = checker.check(&chunk) {
                return Ok(Ended::Refused(why));
            }
            to.write_all(&chunk).await?;
        }
        Ok::<_, io::Error>(Ended::Closed)
    };
    if let Ended::Refused(why) = timeout(UNSECURED_TIME, begin).await?? {
        return Ok(Ended::Refused(why));
    }
    loop {
        let chunk = timeout(SILENCE, chunk(from)).await??;
        if let Err(why) = checker.check(&chunk) {
            return Ok(Ended::Refused(why));
        }
        to.write_all(&chunk).await?;
    }
}

/// The next chunk, with its header.
async fn chunk(from: &mut (impl AsyncRead + Unpin)) -> io::Result<Vec<u8>> {
    let mut header = [0; HEADER];
    from.read_exact(&mut header).await?;
    let size = number(&header, 4).map_or(0, |size| size as usize);
    if !(HEADER..=MOST_CHUNK).contains(&size) {
        let why = format!("a chunk of {size} bytes; {HEADER} to {MOST_CHUNK} are allowed");
        return Err(io::Error::new(io::ErrorKind::InvalidData, why));
    }
    let mut chunk = vec![0; size];
    chunk[..HEADER].copy_from_slice(&header);
    from.read_exact(&mut chunk[HEADER..]).await?;
    Ok(chunk)
}

/// What a connection has asked for so far.
struct Checker {
    /// Whether its channel is encrypted; none before a channel was asked for.
    secured: Option<bool>,
}

impl Checker {
    /// Whether a chunk may pass.
    fn check(&mut self, chunk: &[u8]) -> Result<(), &'static str> {
        const ONLY_DISCOVERY: &str =
            "only FindServers and GetEndpoints are served without security";
        let kind = chunk.get(..4).unwrap_or_default();
        match (kind, self.secured) {
            (b"HELF", None) => Ok(()),
            (b"OPNF", before) => {
                let policy = policy(chunk).unwrap_or_default();
                let secured = SECURED.contains(&policy);
                if !secured && policy != UNSECURED {
                    return Err("this security policy is not offered");
                }
                // An encrypted channel is renewed as what it was.
                if before.is_some_and(|before| before != secured) {
                    return Err("a channel cannot change its security policy");
                }
                self.secured = Some(secured);
                Ok(())
            }
            (b"MSGF" | b"MSGC" | b"MSGA" | b"CLOF", Some(true)) => Ok(()),
            (b"CLOF", Some(false)) => Ok(()),
            (b"MSGF", Some(false)) => {
                let is_discovery = request(chunk).is_some_and(|it| DISCOVERY.contains(&it));
                match is_discovery && chunk.len() <= MOST_UNSECURED_CHUNK {
                    true => Ok(()),
                    false => Err(ONLY_DISCOVERY),
                }
            }
            (_, Some(false)) => Err(ONLY_DISCOVERY),
            _ => Err("a message out of order"),
        }
    }
}

/// The little-endian number at a place in a chunk.
fn number(bytes: &[u8], at: usize) -> Option<u32> {
    let bytes = bytes.get(at..at + 4)?;
    bytes.try_into().ok().map(u32::from_le_bytes)
}

/// The policy that a request to open a channel names, after the channel's number.
fn policy(chunk: &[u8]) -> Option<&[u8]> {
    let at = HEADER + 4;
    let length = number(chunk, at)? as usize;
    chunk.get(at + 4..)?.get(..length)
}

/// Number of a request's type where nothing is encrypted: after the channel, its token, the sequence number and the request's number
/// follows a node of the standard's namespace, with one or two bytes for its number.
fn request(chunk: &[u8]) -> Option<u16> {
    match chunk.get(HEADER + 16..)? {
        [0, id, ..] => Some(u16::from(*id)),
        [1, 0, low, high, ..] => Some(u16::from_le_bytes([*low, *high])),
        _ => None,
    }
}

/// An error message of the protocol.
fn refusal(why: &str) -> Vec<u8> {
    let size = (HEADER + 8 + why.len()) as u32;
    let mut message = b"ERRF".to_vec();
    for number in [size, REFUSED, why.len() as u32] {
        message.extend(number.to_le_bytes());
    }
    message.extend(why.as_bytes());
    message
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(kind: &[u8], body: &[u8]) -> Vec<u8> {
        let mut chunk = kind.to_vec();
        chunk.extend(((HEADER + body.len()) as u32).to_le_bytes());
        chunk.extend(body);
        chunk
    }

    fn open(policy: &[u8]) -> Vec<u8> {
        let mut body = vec![0; 4];
        body.extend((policy.len() as u32).to_le_bytes());
        body.extend(policy);
        message(b"OPNF", &body)
    }

    fn ask(number: u16) -> Vec<u8> {
        let mut body = vec![0; 16];
        body.extend([1, 0]);
        body.extend(number.to_le_bytes());
        message(b"MSGF", &body)
    }

    #[test]
    fn nothing_but_discovery_passes_without_encryption() {
        let passes = |chunks: &[Vec<u8>]| {
            let mut checker = Checker { secured: None };
            chunks.iter().all(|chunk| checker.check(chunk).is_ok())
        };
        let hello = message(b"HELF", &[0; 20]);
        let [create_session, read] = [461, 631].map(ask);
        for discovery in DISCOVERY.map(ask) {
            assert!(passes(&[hello.clone(), open(UNSECURED), discovery]));
        }
        for request in [&create_session, &read] {
            assert!(!passes(&[hello.clone(), open(UNSECURED), request.clone()]));
            assert!(!passes(&[hello.clone(), request.clone()]));
            for policy in SECURED {
                assert!(passes(&[hello.clone(), open(policy), request.clone()]));
                // Neither is an encrypted channel renewed as another one, nor the other way.
                assert!(!passes(&[open(policy), open(UNSECURED), request.clone()]));
                assert!(!passes(&[open(UNSECURED), open(policy)]));
            }
        }
        let weak = b"http://opcfoundation.org/UA/SecurityPolicy#Basic128Rsa15";
        assert!(!passes(&[hello.clone(), open(weak)]));
        let mut parts = ask(428);
        parts[3] = b'C';
        assert!(!passes(&[hello, open(UNSECURED), parts]));
        // Lengths that lie.
        assert!(!passes(&[message(
            b"OPNF",
            &[0, 0, 0, 0, 255, 255, 255, 255]
        )]));
        assert!(!passes(&[message(b"OPNF", &[])]));
        assert!(!passes(&[open(UNSECURED), message(b"MSGF", &[0; 3])]));
    }

    #[test]
    fn an_address_has_so_many_places() {
        let addresses = Arc::new(Addresses::default());
        let [one, other] = ["192.0.2.1", "192.0.2.2"].map(|ip| ip.parse::<IpAddr>().unwrap());
        let mut places: Vec<_> = (0..MOST_PER_ADDRESS)
            .map(|_| Addresses::enter(&addresses, one).unwrap())
            .collect();
        assert!(Addresses::enter(&addresses, one).is_none());
        assert!(Addresses::enter(&addresses, other).is_some());
        places.pop();
        places.push(Addresses::enter(&addresses, one).unwrap());
        drop(places);
        assert!(addresses.0.lock().unwrap().is_empty());
    }
}
