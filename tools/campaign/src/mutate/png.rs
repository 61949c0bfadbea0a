//! Changes to a PNG file, chunk by chunk, with check sums that are right again.

use flate2::Crc;
use rand::RngExt;
use rand_pcg::Pcg64;

const SIGNATURE: usize = 8;

struct Chunk {
    kind: [u8; 4],
    data: Vec<u8>,
}

/// `None`: it has no chunks any more.
pub fn chunks(content: &[u8], random: &mut Pcg64) -> Option<Vec<u8>> {
    let mut chunks = split(content)?;
    let n = random.random_range(0..chunks.len());
    match random.random_range(0..7) {
        0 => {
            chunks.remove(n);
        }
        1 => {
            let Chunk { kind, data } = &chunks[n];
            let again = Chunk {
                kind: *kind,
                data: data.clone(),
            };
            chunks.insert(n, again);
        }
        2 => {
            let other = random.random_range(0..chunks.len());
            chunks.swap(n, other);
        }
        3 => chunks[n].kind[random.random_range(0..4)] ^= 0x20,
        4 => {
            // Width, height, depth, colour, compression, filter, interlace.
            let at = random.random_range(0..13);
            let value = [0, 1, 2, 3, 8, 16, 0x7F, 0xFF][random.random_range(0..8)];
            *chunks.first_mut()?.data.get_mut(at)? = value;
        }
        _ => {
            let data = &mut chunks[n].data;
            let at = random.random_range(0..data.len().max(1));
            match random.random_range(0..3) {
                0 => data.truncate(at),
                1 => *data.get_mut(at)? ^= 1 << random.random_range(0..8),
                _ => data.extend_from_within(at.min(data.len())..),
            }
        }
    }
    Some(joined(&content[..SIGNATURE], &chunks))
}

fn split(content: &[u8]) -> Option<Vec<Chunk>> {
    let mut rest = content.get(SIGNATURE..)?;
    let mut chunks = Vec::new();
    while let Some((length, after)) = rest.split_first_chunk::<4>() {
        let length = u32::from_be_bytes(*length) as usize;
        let (kind, after) = after.split_first_chunk::<4>()?;
        let data = after.get(..length)?.to_vec();
        chunks.push(Chunk { kind: *kind, data });
        rest = after.get(length + 4..)?;
    }
    (!chunks.is_empty()).then_some(chunks)
}

fn joined(signature: &[u8], chunks: &[Chunk]) -> Vec<u8> {
    let mut content = signature.to_vec();
    for Chunk { kind, data } in chunks {
        content.extend((data.len() as u32).to_be_bytes());
        let mut sum = Crc::new();
        sum.update(kind);
        sum.update(data);
        content.extend(kind);
        content.extend(data);
        content.extend(sum.sum().to_be_bytes());
    }
    content
}
