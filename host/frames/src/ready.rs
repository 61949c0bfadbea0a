//! What the camera process tells the host: who it is, and that it is armed and drained.

use iceoryx2::prelude::*;

/// Said once when the camera process has come, with session 0, and once after each [`Arm`](crate::Arm): from here on every
/// frame carries that session, and no frame of an earlier one is still to come from the camera's own buffers.
///
/// The host moves nothing before it has heard this.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[type_name("flankscope/Ready/1")]
pub struct Ready {
    /// The session armed, 0 at the start.
    pub session: u32,
    /// Number of the next frame.
    pub counter: u32,
    /// Image width, px.
    pub width_px: u32,
    /// Image height, px.
    pub height_px: u32,
    /// Bits of a sample; 0 where nobody knows.
    pub bits: u32,
    /// Reserved, 0.
    pub reserved: u32,
    /// Counts without light; not a number where nobody knows.
    pub offset_dn: f64,
    /// Electrons per count; not a number where nobody knows.
    pub gain_e_per_dn: f64,
    /// Maker and model, UTF-8, filled up with zeros.
    pub model: [u8; 64],
    /// By what it is connected, and as which serial number, UTF-8, filled up with zeros.
    pub link: [u8; 64],
}

impl Default for Ready {
    /// Of a camera that says nothing of itself.
    fn default() -> Self {
        Self {
            session: 0,
            counter: 0,
            width_px: 0,
            height_px: 0,
            bits: 0,
            reserved: 0,
            offset_dn: f64::NAN,
            gain_e_per_dn: f64::NAN,
            model: [0; 64],
            link: [0; 64],
        }
    }
}

impl Ready {
    /// Text as it lies in [`Ready::model`] and [`Ready::link`]: what does not fit is cut off at a character.
    #[must_use]
    pub fn text(text: &str) -> [u8; 64] {
        let mut bytes = [0; 64];
        let mut length = text.len().min(bytes.len());
        while !text.is_char_boundary(length) {
            length -= 1;
        }
        bytes[..length].copy_from_slice(&text.as_bytes()[..length]);
        bytes
    }

    /// Maker and model.
    #[must_use]
    pub fn model(&self) -> String {
        read(&self.model)
    }

    /// By what it is connected.
    #[must_use]
    pub fn link(&self) -> String {
        read(&self.link)
    }
}

fn read(bytes: &[u8]) -> String {
    let text = bytes.split(|&byte| byte == 0).next().unwrap_or_default();
    String::from_utf8_lossy(text).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_come_back_and_are_cut_at_a_character() {
        for text in ["", "FLIR Blackfly S", "Kamera \u{e4}"] {
            assert_eq!(read(&Ready::text(text)), text);
        }
        let long = "\u{e4}".repeat(40);
        assert_eq!(read(&Ready::text(&long)), "\u{e4}".repeat(32));
        let odd = format!("x{long}");
        assert_eq!(read(&Ready::text(&odd)).chars().count(), 32);
    }
}
