//! Binary STL whose length is not that of its triangle count: spare bytes at the end, payload behind every facet, a count that was
//! never filled in, several solids one after the other.

use super::stl::{HEADER_BYTES, RECORD_BYTES, declared};

/// Deviation of a binary STL from its format that leaves its triangles certain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StlIrregularity {
    /// Bytes after the last triangle. They are ignored.
    SpareBytes {
        /// Triangles that the file states, all of which are read.
        triangles: usize,
        /// Bytes after them.
        bytes: usize,
    },
    /// Bytes after every facet, as many as its attribute word states. They are ignored.
    Payload {
        /// Triangles of the file, all of which are read.
        triangles: usize,
        /// Sum of the payload's bytes.
        bytes: usize,
    },
    /// A count of 0 or 2^32 - 1, which writers put there before they know it. The number of triangles follows from the length.
    Count {
        /// The count in the file.
        declared: u32,
        /// Triangles by the length.
        triangles: usize,
    },
    /// Several solids, each with a header of its own. All are read.
    Solids {
        /// Number of solids.
        solids: usize,
        /// Triangles of all.
        triangles: usize,
    },
}

impl std::fmt::Display for StlIrregularity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match *self {
            Self::SpareBytes { triangles, bytes } => write!(
                f,
                "binary STL: {bytes} bytes after its {triangles} triangles are ignored"
            ),
            Self::Payload { triangles, bytes } => write!(
                f,
                "binary STL: {bytes} bytes of attributes behind its {triangles} triangles are ignored"
            ),
            Self::Count {
                declared,
                triangles,
            } => write!(
                f,
                "binary STL: it declares {declared} triangles, which cannot be; {triangles} are read, by its length"
            ),
            Self::Solids { solids, triangles } => write!(
                f,
                "binary STL: it holds {solids} solids one after the other; all {triangles} triangles are read"
            ),
        }
    }
}

/// Facets of an irregular file.
pub(in crate::io) struct IrregularStl<'a> {
    /// Records of [`RECORD_BYTES`], one per triangle.
    pub records: Vec<&'a [u8]>,
    pub irregularity: StlIrregularity,
}

/// Facets of a file that is longer than its count, or whose count is a placeholder. Returns `None` if it is not such an STL: it ends
/// within a facet, or its numbers are not those of a surface.
pub(in crate::io) fn read(bytes: &[u8]) -> Option<IrregularStl<'_>> {
    let count = declared(bytes)?;
    let found = match count {
        0 | u32::MAX => by_length(bytes, count),
        _ => solids(bytes)
            .or_else(|| with_payload(bytes, count))
            .or_else(|| with_spare_bytes(bytes)),
    }?;
    found
        .records
        .iter()
        .all(|record| is_plausible(record))
        .then_some(found)
}

fn by_length(bytes: &[u8], declared: u32) -> Option<IrregularStl<'_>> {
    let (records, rest) = bytes[HEADER_BYTES..].as_chunks::<RECORD_BYTES>();
    (rest.is_empty() && !records.is_empty()).then(|| IrregularStl {
        records: records.iter().map(<[u8; RECORD_BYTES]>::as_slice).collect(),
        irregularity: StlIrregularity::Count {
            declared,
            triangles: records.len(),
        },
    })
}

/// Records of one solid, and the bytes after it.
fn solid(bytes: &[u8]) -> Option<(&[[u8; RECORD_BYTES]], &[u8])> {
    let count = usize::try_from(declared(bytes)?).ok()?;
    let (records, _) = bytes[HEADER_BYTES..].as_chunks::<RECORD_BYTES>();
    let records = records.get(..count)?;
    Some((records, &bytes[HEADER_BYTES + count * RECORD_BYTES..]))
}

fn solids(bytes: &[u8]) -> Option<IrregularStl<'_>> {
    let mut remaining = bytes;
    let mut records: Vec<&[u8]> = Vec::new();
    let mut count = 0;
    while !remaining.is_empty() {
        let (facets, after) = solid(remaining)?;
        records.extend(facets.iter().map(<[u8; RECORD_BYTES]>::as_slice));
        remaining = after;
        count += 1;
    }
    let triangles = records.len();
    (count > 1).then_some(IrregularStl {
        records,
        irregularity: StlIrregularity::Solids {
            solids: count,
            triangles,
        },
    })
}

fn with_payload(bytes: &[u8], declared: u32) -> Option<IrregularStl<'_>> {
    let mut remaining = &bytes[HEADER_BYTES..];
    let mut records = Vec::new();
    let mut payload = 0;
    for _ in 0..declared {
        let (record, after) = remaining.split_at_checked(RECORD_BYTES)?;
        let attribute = usize::from(u16::from_le_bytes([record[48], record[49]]));
        remaining = after.get(attribute..)?;
        records.push(record);
        payload += attribute;
    }
    let triangles = records.len();
    remaining.is_empty().then_some(IrregularStl {
        records,
        irregularity: StlIrregularity::Payload {
            triangles,
            bytes: payload,
        },
    })
}

fn with_spare_bytes(bytes: &[u8]) -> Option<IrregularStl<'_>> {
    let (records, rest) = solid(bytes)?;
    (!rest.is_empty()).then(|| IrregularStl {
        records: records.iter().map(<[u8; RECORD_BYTES]>::as_slice).collect(),
        irregularity: StlIrregularity::SpareBytes {
            triangles: records.len(),
            bytes: rest.len(),
        },
    })
}

/// Largest coordinate of a mesh in any unit.
const MOST_COORDINATE: f32 = 1e9;
/// Smallest coordinate that is not zero. Bytes of other data are often smaller.
const LEAST_COORDINATE: f32 = 1e-30;

/// Whether the numbers of a record can be those of a facet. Some writers leave the normal out.
fn is_plausible(record: &[u8]) -> bool {
    record[12..48].as_chunks::<4>().0.iter().all(|&bytes| {
        let size = f32::from_le_bytes(bytes).abs();
        size == 0.0 || (LEAST_COORDINATE..=MOST_COORDINATE).contains(&size)
    })
}

#[cfg(test)]
mod tests {
    use super::super::{MeshError, TriMesh, parse, parse_tolerant, write_stl};
    use super::*;
    use crate::io::Unit;

    fn tetrahedron() -> TriMesh {
        TriMesh {
            vertices: vec![
                [0.0, 0.0, 0.0],
                [10.0, 0.0, 0.0],
                [0.0, 10.0, 0.0],
                [0.0, 0.0, 10.0],
            ],
            triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        }
    }

    fn stl() -> Vec<u8> {
        let mut bytes = Vec::new();
        write_stl(&mut bytes, &tetrahedron()).unwrap();
        bytes
    }

    fn with_count(count: u32) -> Vec<u8> {
        let mut bytes = stl();
        bytes[80..84].copy_from_slice(&count.to_le_bytes());
        bytes
    }

    fn with_payload() -> Vec<u8> {
        let plain = stl();
        let mut bytes = plain[..HEADER_BYTES].to_vec();
        for (i, record) in plain[HEADER_BYTES..].chunks(RECORD_BYTES).enumerate() {
            bytes.extend(&record[..48]);
            bytes.extend((i as u16).to_le_bytes());
            bytes.extend(vec![0xab; i]);
        }
        bytes
    }

    fn with_header(header: &[u8], mut bytes: Vec<u8>) -> Vec<u8> {
        bytes[..80].fill(0);
        bytes[..header.len()].copy_from_slice(header);
        bytes
    }

    #[test]
    fn triangles_that_are_certain_are_read_and_the_rest_is_named() {
        use StlIrregularity::{Count, Payload, Solids, SpareBytes};
        let spare = |bytes: usize| [stl(), vec![7; bytes]].concat();
        let (triangles, first) = (4, with_count(0));
        for (bytes, expected) in [
            (
                spare(2),
                SpareBytes {
                    triangles,
                    bytes: 2,
                },
            ),
            (
                spare(50),
                SpareBytes {
                    triangles,
                    bytes: 50,
                },
            ),
            (
                with_header(b"solid base", spare(16)),
                SpareBytes {
                    triangles,
                    bytes: 16,
                },
            ),
            (
                with_header(b"COLOR=\xff\x80\x00\xff", spare(1)),
                SpareBytes {
                    triangles,
                    bytes: 1,
                },
            ),
            (
                with_payload(),
                Payload {
                    triangles,
                    bytes: 6,
                },
            ),
            (
                first,
                Count {
                    declared: 0,
                    triangles,
                },
            ),
            (
                with_count(u32::MAX),
                Count {
                    declared: u32::MAX,
                    triangles,
                },
            ),
        ] {
            let (mesh, irregularity) = parse_tolerant(&bytes, Unit::Mm).unwrap();
            assert_eq!(irregularity, Some(expected));
            assert_eq!(mesh, parse(&stl(), Unit::Mm).unwrap(), "{expected:?}");
            assert!(matches!(
                parse(&bytes, Unit::Mm),
                Err(MeshError::StlIrregular { .. })
            ));
        }
        let twice = [stl(), stl()].concat();
        let (mesh, irregularity) = parse_tolerant(&twice, Unit::Mm).unwrap();
        let expected = Solids {
            solids: 2,
            triangles: 8,
        };
        assert_eq!((mesh.triangles.len(), irregularity), (8, Some(expected)));
        assert_eq!(parse_tolerant(&stl(), Unit::Mm).unwrap().1, None);
    }

    #[test]
    fn files_that_are_cut_or_hold_other_numbers_are_refused() {
        let noise: Vec<u8> = (0..1000_u32).map(|i| ((i * i) >> 3) as u8).collect();
        for bytes in [
            stl()[..stl().len() - 30].to_vec(),
            with_count(5),
            with_count(0)[..150].to_vec(),
            // Attribute words that fit no length.
            [&with_payload()[..], &[0; 3]].concat(),
            [&with_count(3)[..HEADER_BYTES], &noise[..]].concat(),
        ] {
            let refused = parse_tolerant(&bytes, Unit::Mm);
            assert!(refused.is_err(), "{refused:?}");
        }
    }
}
