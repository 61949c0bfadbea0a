//! Binary point files of the Point Cloud Library (PCD 0.7, `DATA binary`). Those in text are read as text.

use super::{CloudError, UncheckedCloud};
use crate::io::ply::{Extra, Scalar};

/// Bytes in which a header ends.
const MOST_HEADER_BYTES: usize = 1 << 13;

/// Header of a PCD, without its kind of data.
struct Header<'a> {
    lines: Vec<(&'a str, Vec<&'a str>)>,
    /// Word after `DATA`.
    data: &'a str,
    /// Start of the points.
    body_offset: usize,
}

/// Field of a point.
struct Field<'a> {
    name: &'a str,
    /// Type, where a PLY knows it and the field holds one number.
    kind: Option<Scalar>,
    offset: usize,
}

fn header(bytes: &[u8]) -> Option<Header<'_>> {
    let mut lines = Vec::new();
    let mut at = 0;
    loop {
        let unread = &bytes[at..bytes.len().min(MOST_HEADER_BYTES)];
        let end = at + unread.iter().position(|&byte| byte == b'\n')?;
        let line = std::str::from_utf8(&bytes[at..end]).ok()?.trim();
        at = end + 1;
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let mut words = line.split_whitespace();
        let key = words.next()?;
        if lines.is_empty() && key != "VERSION" && key != "FIELDS" {
            return None;
        }
        let values: Vec<&str> = words.collect();
        if key == "DATA" {
            return Some(Header {
                lines,
                data: values.first()?,
                body_offset: at,
            });
        }
        lines.push((key, values));
    }
}

/// Points and further numbers of a binary PCD; `None` for a file that is not one.
pub(super) fn parse(bytes: &[u8]) -> Option<Result<UncheckedCloud, CloudError>> {
    let header = header(bytes)?;
    match header.data {
        "binary" => Some(header.points(&bytes[header.body_offset..])),
        "binary_compressed" => Some(Err(CloudError::PcdCompressed)),
        _ => None,
    }
}

impl Header<'_> {
    fn values(&self, key: &'static str) -> Result<&[&str], CloudError> {
        let line = self.lines.iter().find(|(name, _)| *name == key);
        let line = line.ok_or(CloudError::PcdHeader { key })?;
        Ok(&line.1)
    }

    fn count(&self, key: &'static str) -> Result<usize, CloudError> {
        let word = self.values(key)?.first();
        word.and_then(|word| word.parse().ok())
            .ok_or(CloudError::PcdHeader { key })
    }

    /// Fields, and the bytes of a point.
    fn fields(&self) -> Result<(Vec<Field<'_>>, usize), CloudError> {
        let names = self.values("FIELDS")?;
        let sizes = self.values("SIZE")?;
        let types = self.values("TYPE")?;
        let counts = self.values("COUNT").unwrap_or(&[]);
        for (key, values) in [("SIZE", sizes), ("TYPE", types), ("COUNT", counts)] {
            let is_absent = key == "COUNT" && values.is_empty();
            if values.len() != names.len() && !is_absent {
                return Err(CloudError::PcdHeader { key });
            }
        }
        let mut offset = 0_usize;
        let mut fields = Vec::new();
        for (i, &name) in names.iter().enumerate() {
            let number = |key, word: &str| {
                let number = word.parse::<usize>().ok().filter(|n| *n <= 1 << 16);
                number.ok_or(CloudError::PcdHeader { key })
            };
            let size = number("SIZE", sizes[i])?;
            let count = counts.get(i).map_or(Ok(1), |word| number("COUNT", word))?;
            let kind = match (types[i], size) {
                ("F", 4) => Some(Scalar::F32),
                ("F", 8) => Some(Scalar::F64),
                ("I", 1) => Some(Scalar::I8),
                ("I", 2) => Some(Scalar::I16),
                ("I", 4) => Some(Scalar::I32),
                ("U", 1) => Some(Scalar::U8),
                ("U", 2) => Some(Scalar::U16),
                ("U", 4) => Some(Scalar::U32),
                // Whole numbers of 64 bits.
                ("I" | "U", 8) => None,
                _ => return Err(CloudError::PcdHeader { key: "TYPE" }),
            };
            fields.push(Field {
                name,
                kind: kind.filter(|_| count == 1),
                offset,
            });
            offset += size * count;
        }
        Ok((fields, offset))
    }

    fn points(&self, body: &[u8]) -> Result<UncheckedCloud, CloudError> {
        let (fields, stride) = self.fields()?;
        let axis = |name: &str| {
            let mut found = fields.iter().filter(|field| field.name == name);
            let field = found.next().filter(|_| found.next().is_none());
            let place = field.and_then(|field| Some((field.kind?, field.offset)));
            place.ok_or(CloudError::PcdHeader { key: "FIELDS" })
        };
        let axes = [axis("x")?, axis("y")?, axis("z")?];
        let stated = match self.values("POINTS") {
            Ok(_) => self.count("POINTS")?,
            Err(_) => self.count("WIDTH")?.saturating_mul(self.count("HEIGHT")?),
        };
        let found = body.len() / stride;
        if stated > found {
            return Err(CloudError::Count { stated, found });
        }
        let records = || body.chunks_exact(stride).take(stated);
        let point = |record: &[u8]| axes.map(|(kind, at)| kind.decode(&record[at..], false));
        let is_further = |field: &&Field<'_>| {
            !["x", "y", "z", "_"].contains(&field.name) && field.kind.is_some()
        };
        let extra = |field: &Field<'_>| {
            let kind = field.kind?;
            let range = field.offset..field.offset + kind.size();
            Some(Extra {
                name: field.name.to_owned(),
                kind,
                bytes: records()
                    .flat_map(|record| &record[range.clone()])
                    .copied()
                    .collect(),
            })
        };
        Ok(UncheckedCloud {
            points: records().map(point).collect(),
            coordinate: axes[0].0,
            extras: fields.iter().filter(is_further).filter_map(extra).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::{parse as parse_strict, parse_finite};
    use super::*;
    use crate::io::Unit;

    const HEADER: &str = "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x _ y z intensity t\nSIZE 4 1 4 4 2 8\n\
        TYPE F U F F U U\nCOUNT 1 3 1 1 1 1\nWIDTH 2\nHEIGHT 2\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4\nDATA binary\n";

    const POINTS: [[f32; 3]; 4] = [
        [1.5, -2.0, 0.5],
        [4.0, 5.0, 6.25],
        [f32::NAN; 3],
        [7.0, 8.0, 9.0],
    ];

    fn file(header: &str) -> Vec<u8> {
        let mut bytes = header.as_bytes().to_vec();
        for (i, [x, y, z]) in POINTS.into_iter().enumerate() {
            bytes.extend(x.to_le_bytes());
            bytes.extend([9; 3]);
            bytes.extend(y.to_le_bytes());
            bytes.extend(z.to_le_bytes());
            bytes.extend((100 * i as u16).to_le_bytes());
            bytes.extend([1; 8]);
        }
        bytes
    }

    #[test]
    fn binary_points_are_read_with_their_further_numbers() {
        let (cloud, dropped) = parse_finite(&file(HEADER), Unit::Mm).unwrap();
        assert_eq!(dropped, 1);
        let expected = [[1.5, -2.0, 0.5], [4.0, 5.0, 6.25], [7.0, 8.0, 9.0]];
        assert_eq!(
            (&cloud.points[..], cloud.coordinate),
            (&expected[..], Scalar::F32)
        );
        let [intensity] = &cloud.extras[..] else {
            panic!("{:?}", cloud.extras);
        };
        assert_eq!(intensity.name, "intensity");
        assert_eq!(intensity.values().collect::<Vec<_>>(), [0.0, 100.0, 300.0]);
        assert!(matches!(
            parse_strict(&file(HEADER), Unit::Mm),
            Err(CloudError::NonFinite { index: 2, .. })
        ));
        // Without the key, the points of all rows.
        let without = HEADER.replace("POINTS 4\n", "");
        assert_eq!(parse_finite(&file(&without), Unit::Mm).unwrap(), (cloud, 1));
    }

    #[test]
    fn a_header_that_does_not_fit_is_named() {
        let key =
            |from: &str, to: &str| match parse_finite(&file(&HEADER.replace(from, to)), Unit::Mm) {
                Err(CloudError::PcdHeader { key }) => key,
                other => panic!("{other:?}"),
            };
        assert_eq!(key("FIELDS x", "FIELDS u"), "FIELDS");
        assert_eq!(key("FIELDS x _ y z", "FIELDS x x y z"), "FIELDS");
        assert_eq!(key("SIZE 4 1", "SIZE 4"), "SIZE");
        assert_eq!(key("SIZE 4 1 4 4 2", "SIZE 4 1 4 4 3"), "TYPE");
        assert_eq!(key("COUNT 1 3", "COUNT 1 many"), "COUNT");
        assert_eq!(key("POINTS 4\n", "POINTS many\n"), "POINTS");
        let all = file(HEADER);
        assert!(matches!(
            parse_finite(&all[..all.len() - 1], Unit::Mm),
            Err(CloudError::Count {
                stated: 4,
                found: 3
            })
        ));
        let compressed = HEADER.replace("binary", "binary_compressed");
        assert!(matches!(
            parse_finite(&file(&compressed), Unit::Mm),
            Err(CloudError::PcdCompressed)
        ));
    }
}
