//! The packets that are used, of MQTT 5 and of 3.1.1, in one form.

use std::sync::Arc;

use mqtt_proto::{Error as BadPacket, Pid, QoS, QosPid, TopicFilter, TopicName, v3, v5};

use crate::mqtt::broker::Login;
use crate::settings::MqttVersion;

/// Largest packet that is taken from a broker, bytes: commands and acknowledgements are small.
const MOST_BYTES: usize = 64 << 10;

/// A message to be published.
#[derive(Clone, Debug)]
pub struct Message {
    pub topic: String,
    pub payload: Vec<u8>,
    /// Acknowledged by the broker (QoS 1).
    pub acknowledged: bool,
    pub retained: bool,
}

/// Packet of a broker, as far as it matters here.
#[derive(Debug)]
pub enum BrokerAnswer {
    /// It takes the connection; or why not.
    Connected(Result<(), String>),
    /// It has the message with this number; or why not.
    Published(u16, Result<(), String>),
    /// It will send commands; or why not.
    Subscribed(Result<(), String>),
    /// A message to this client, with its number if it is to be acknowledged.
    Command(Vec<u8>, Option<Pid>),
    /// It lives, and has done what was asked before.
    Pong,
    /// It closes the connection.
    Closed(String),
    /// Nothing that matters here.
    Other,
}

/// Why bytes are no packet.
#[derive(Debug, thiserror::Error)]
pub enum PacketError {
    #[error("the broker sends a packet of {got} bytes; at most {MOST_BYTES} are taken")]
    TooLarge { got: usize },
    #[error("the broker sends what is no MQTT {version} packet: {why}")]
    Malformed { version: MqttVersion, why: String },
    #[error("no MQTT packet can hold this: {0}")]
    Unsendable(#[from] BadPacket),
}

/// Bytes of a request to connect; the message is published by the broker when the connection breaks.
pub fn connect(
    version: MqttVersion,
    client: &str,
    login: Option<&Login>,
    will: Message,
    keep_alive_s: u16,
) -> Result<Vec<u8>, PacketError> {
    let topic = TopicName::try_from(will.topic.as_str())?;
    let client: Arc<str> = client.into();
    let user = login.map(|login| login.user.as_str().into());
    let password = login.map(|login| login.password.clone().into_bytes().into());
    Ok(match version {
        MqttVersion::V5 => {
            let mut connect = v5::Connect::new(client, keep_alive_s);
            let mut last = v5::LastWill::new(QoS::Level1, topic, will.payload.into());
            last.retain = will.retained;
            connect.last_will = Some(last);
            (connect.username, connect.password) = (user, password);
            connect.properties.max_packet_size = Some(MOST_BYTES as u32);
            encoded_5(&connect.into())?
        }
        MqttVersion::V3 => {
            let mut connect = v3::Connect::new(client, keep_alive_s);
            let mut last = v3::LastWill::new(QoS::Level1, topic, will.payload.into());
            last.retain = will.retained;
            connect.last_will = Some(last);
            (connect.username, connect.password) = (user, password);
            encoded_3(&connect.into())?
        }
    })
}

/// Bytes of a message.
pub fn publish(version: MqttVersion, message: &Message, pid: Pid) -> Result<Vec<u8>, PacketError> {
    let topic = TopicName::try_from(message.topic.as_str())?;
    let payload = message.payload.clone().into();
    let pid = match message.acknowledged {
        true => QosPid::Level1(pid),
        false => QosPid::Level0,
    };
    Ok(match version {
        MqttVersion::V5 => {
            let mut publish = v5::Publish::new(pid, topic, payload);
            publish.retain = message.retained;
            encoded_5(&publish.into())?
        }
        MqttVersion::V3 => {
            let mut publish = v3::Publish::new(pid, topic, payload);
            publish.retain = message.retained;
            encoded_3(&publish.into())?
        }
    })
}

/// Bytes of a request to be sent what is published there.
pub fn subscribe(version: MqttVersion, filter: &str, pid: Pid) -> Result<Vec<u8>, PacketError> {
    let filter = TopicFilter::try_from(filter)?;
    Ok(match version {
        MqttVersion::V5 => {
            let options = v5::SubscriptionOptions::new(QoS::Level1);
            encoded_5(&v5::Subscribe::new(pid, vec![(filter, options)]).into())?
        }
        MqttVersion::V3 => encoded_3(&v3::Subscribe::new(pid, vec![(filter, QoS::Level1)]).into())?,
    })
}

/// Bytes of the acknowledgement of a message.
pub fn acknowledge(version: MqttVersion, pid: Pid) -> Result<Vec<u8>, PacketError> {
    Ok(match version {
        MqttVersion::V5 => encoded_5(&v5::Puback::new_success(pid).into())?,
        MqttVersion::V3 => encoded_3(&v3::Packet::Puback(pid))?,
    })
}

/// Bytes of the question whether the broker lives; the same in both versions.
pub fn ping() -> Result<Vec<u8>, PacketError> {
    encoded_3(&v3::Packet::Pingreq)
}

fn encoded_5(packet: &v5::Packet) -> Result<Vec<u8>, PacketError> {
    Ok(packet.encode()?.as_ref().to_vec())
}

fn encoded_3(packet: &v3::Packet) -> Result<Vec<u8>, PacketError> {
    Ok(packet.encode()?.as_ref().to_vec())
}

/// Takes the first packet off the bytes that have arrived, if it is there as a whole.
pub fn take(
    version: MqttVersion,
    arrived: &mut Vec<u8>,
) -> Result<Option<BrokerAnswer>, PacketError> {
    let Some(length) = length(version, arrived)? else {
        return Ok(None);
    };
    if length > MOST_BYTES {
        return Err(PacketError::TooLarge { got: length });
    }
    if arrived.len() < length {
        return Ok(None);
    }
    let packet: Vec<u8> = arrived.drain(..length).collect();
    let malformed = |why: String| PacketError::Malformed { version, why };
    let answer = match version {
        MqttVersion::V5 => v5::Packet::decode(&packet)
            .map_err(|error| malformed(error.to_string()))?
            .map(answer_5),
        MqttVersion::V3 => v3::Packet::decode(&packet)
            .map_err(|error| malformed(error.to_string()))?
            .map(answer_3),
    };
    let too_short = || malformed("it ends too early".into());
    answer.ok_or_else(too_short).map(Some)
}

/// Bytes of the first packet, as its header says (MQTT 5, section 2.1.4; MQTT 3.1.1, section 2.2.3), once the header is there.
fn length(version: MqttVersion, arrived: &[u8]) -> Result<Option<usize>, PacketError> {
    let mut remaining_bytes = 0;
    for (at, byte) in arrived.iter().skip(1).enumerate() {
        if at == 4 {
            let why = "its length has more than four bytes".into();
            return Err(PacketError::Malformed { version, why });
        }
        remaining_bytes |= usize::from(byte & 0x7f) << (7 * at);
        if byte & 0x80 == 0 {
            return Ok(Some(2 + at + remaining_bytes));
        }
    }
    Ok(None)
}

fn unless(holds: bool, code: impl std::fmt::Debug) -> Result<(), String> {
    match holds {
        true => Ok(()),
        false => Err(format!("{code:?}")),
    }
}

fn answer_5(packet: v5::Packet) -> BrokerAnswer {
    use v5::{ConnectReasonCode, PubackReasonCode, SubscribeReasonCode};
    match packet {
        v5::Packet::Connack(packet) => {
            let code = packet.reason_code;
            BrokerAnswer::Connected(unless(code == ConnectReasonCode::Success, code))
        }
        v5::Packet::Puback(packet) => {
            let code = packet.reason_code;
            let has = matches!(
                code,
                PubackReasonCode::Success | PubackReasonCode::NoMatchingSubscribers
            );
            BrokerAnswer::Published(packet.pid.value(), unless(has, code))
        }
        v5::Packet::Suback(packet) => {
            let granted = |code: &SubscribeReasonCode| (*code as u8) < 0x80;
            BrokerAnswer::Subscribed(unless(packet.topics.iter().all(granted), packet.topics))
        }
        v5::Packet::Publish(packet) => {
            BrokerAnswer::Command(packet.payload.to_vec(), packet.qos_pid.pid())
        }
        v5::Packet::Pingresp => BrokerAnswer::Pong,
        v5::Packet::Disconnect(packet) => BrokerAnswer::Closed(format!("{:?}", packet.reason_code)),
        _ => BrokerAnswer::Other,
    }
}

fn answer_3(packet: v3::Packet) -> BrokerAnswer {
    use v3::{ConnectReturnCode, SubscribeReturnCode};
    match packet {
        v3::Packet::Connack(packet) => BrokerAnswer::Connected(unless(
            packet.code == ConnectReturnCode::Accepted,
            packet.code,
        )),
        v3::Packet::Puback(pid) => BrokerAnswer::Published(pid.value(), Ok(())),
        v3::Packet::Suback(packet) => {
            let granted = |code: &SubscribeReturnCode| *code != SubscribeReturnCode::Failure;
            BrokerAnswer::Subscribed(unless(packet.topics.iter().all(granted), packet.topics))
        }
        v3::Packet::Publish(packet) => {
            BrokerAnswer::Command(packet.payload.to_vec(), packet.qos_pid.pid())
        }
        v3::Packet::Pingresp => BrokerAnswer::Pong,
        _ => BrokerAnswer::Other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_packet_is_taken_when_it_is_whole_and_no_larger_than_agreed() {
        for version in [MqttVersion::V5, MqttVersion::V3] {
            // Two packets in pieces: an answer to a ping, and the acknowledgement of message 7 (0x0007).
            let mut arrived = Vec::new();
            let mut answers = Vec::new();
            for byte in [0xd0, 0, 0x40, 2, 0, 7] {
                arrived.push(byte);
                answers.extend(take(version, &mut arrived).unwrap());
            }
            assert!(
                matches!(
                    answers[..],
                    [BrokerAnswer::Pong, BrokerAnswer::Published(7, Ok(()))]
                ),
                "{answers:?}"
            );
            // 0x30: a message; 0x80 0x80 0x04: 65 536 bytes of it.
            let mut large = vec![0x30, 0x80, 0x80, 0x04];
            let refused = take(version, &mut large).unwrap_err();
            assert!(refused.to_string().contains("65540 bytes"), "{refused}");
            let mut endless = vec![0x30, 0xff, 0xff, 0xff, 0xff, 0xff];
            assert!(take(version, &mut endless).is_err());
            let mut short = vec![0x40, 1, 0];
            assert!(take(version, &mut short).is_err());
        }
        // Only MQTT 5 can say no (0x87: not authorized).
        let mut refused = vec![0x40, 3, 0, 7, 0x87];
        let answer = take(MqttVersion::V5, &mut refused).unwrap().unwrap();
        assert!(
            matches!(answer, BrokerAnswer::Published(7, Err(_))),
            "{answer:?}"
        );
    }
}
