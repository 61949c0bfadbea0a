//! Just enough of ELF (32 bit, little-endian) to judge a firmware image: sections, symbols, and who calls whom.

/// A section that is part of the running image.
pub struct Section {
    pub address: u32,
    pub size: u32,
    /// It comes out of the file, so it takes flash.
    pub stored: bool,
    offset: usize,
}

/// A function or a variable.
pub struct Symbol {
    /// As the compiler mangled it.
    pub name: String,
    address: u32,
    size: u32,
}

pub struct Image {
    bytes: Vec<u8>,
    pub sections: Vec<Section>,
    pub symbols: Vec<Symbol>,
}

const SYMBOL_TABLE: u32 = 2;
const NO_BITS: u32 = 8;
const ALLOCATED: u32 = 2;
const SYMBOL_BYTES: usize = 16;

impl Image {
    /// Reads an executable.
    pub fn read(bytes: Vec<u8>) -> Option<Self> {
        if bytes.get(..6)? != b"\x7fELF\x01\x01" {
            return None;
        }
        let u32_at = |at: usize| -> Option<u32> {
            Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
        };
        let u16_at = |at: usize| -> Option<usize> {
            Some(u16::from_le_bytes(bytes.get(at..at + 2)?.try_into().ok()?).into())
        };
        let (table, entry, count) = (u32_at(32)? as usize, u16_at(46)?, u16_at(48)?);
        let header = |index: usize| table + index * entry;
        let (mut sections, mut symbols) = (Vec::new(), Vec::new());
        for index in 0..count {
            let at = header(index);
            let [kind, flags, address, offset, size, link] = [
                u32_at(at + 4)?,
                u32_at(at + 8)?,
                u32_at(at + 12)?,
                u32_at(at + 16)?,
                u32_at(at + 20)?,
                u32_at(at + 24)?,
            ];
            let offset = offset as usize;
            if flags & ALLOCATED != 0 && size > 0 {
                let stored = kind != NO_BITS;
                sections.push(Section {
                    address,
                    size,
                    stored,
                    offset,
                });
            }
            if kind == SYMBOL_TABLE {
                let names = u32_at(header(link as usize) + 16)? as usize;
                for at in (offset..offset + size as usize).step_by(SYMBOL_BYTES) {
                    let start = names + u32_at(at)? as usize;
                    let name = bytes.get(start..)?.split(|&byte| byte == 0).next()?;
                    symbols.push(Symbol {
                        name: String::from_utf8_lossy(name).into_owned(),
                        address: u32_at(at + 4)? & !1, // the lowest bit of a function says Thumb
                        size: u32_at(at + 8)?,
                    });
                }
            }
        }
        Some(Self {
            bytes,
            sections,
            symbols,
        })
    }

    /// Functions that call or jump to `target` (Arm v7-M, encodings BL and B.W).
    pub fn callers(&self, target: &Symbol) -> Vec<&Symbol> {
        let mut callers = Vec::new();
        for section in self.sections.iter().filter(|section| section.stored) {
            let end = section.offset + section.size as usize;
            let code = self.bytes.get(section.offset..end).unwrap_or_default();
            for at in (0..code.len().saturating_sub(3)).step_by(2) {
                let from = section.address + at as u32;
                let word = |n: usize| u32::from(code[at + n]) | u32::from(code[at + n + 1]) << 8;
                if branch(from, word(0), word(2)) == Some(target.address) {
                    let inside = |s: &&Symbol| (s.address..s.address + s.size).contains(&from);
                    callers.extend(self.symbols.iter().find(inside));
                }
            }
        }
        callers
    }
}

/// Where the two half-words at `from` branch to, if they do.
fn branch(from: u32, first: u32, second: u32) -> Option<u32> {
    let (is_branch, is_long) = (first >> 11 == 0b11110, second & 0x9000 == 0x9000);
    if !(is_branch && is_long) {
        return None;
    }
    let sign = first >> 10 & 1;
    let bit = |n: u32| !(second >> n ^ sign) & 1; // I = NOT(J XOR S)
    let high =
        (bit(13) << 23) | (bit(11) << 22) | ((first & 0x3FF) << 12) | ((second & 0x7FF) << 1);
    let offset = if sign == 1 { high | 0xFF00_0000 } else { high };
    Some(from.wrapping_add(4).wrapping_add(offset))
}

#[cfg(test)]
mod tests {
    use super::branch;

    /// Bytes as the assembler makes them, disassembled by binutils.
    #[test]
    fn branches_are_read_as_the_disassembler_does() {
        // 5d1a: f003 fabf  bl 929c
        assert_eq!(branch(0x5d1a, 0xf003, 0xfabf), Some(0x929c));
        // 62ae: f000 bdee  b.w 6e8e
        assert_eq!(branch(0x62ae, 0xf000, 0xbdee), Some(0x6e8e));
        // 2000: f7ff fffe  bl 2000
        assert_eq!(branch(0x2000, 0xf7ff, 0xfffe), Some(0x2000));
        // ea46 7601  orr.w r6, r6, r1, lsl #28
        assert_eq!(branch(0x62a6, 0xea46, 0x7601), None);
    }
}
