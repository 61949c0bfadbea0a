//! Arrays for NumPy, as this program writes points: `points_mm`, and one array per further property.

use flankscope_foundation::npz::{self, Array};

use super::{CloudError, UncheckedCloud};
use crate::io::ply::{Extra, Scalar};

/// The points' array, and that of a mesh's triangles, which a cloud has no use for.
const POINTS: &str = "points_mm";
const TRIANGLES: &str = "triangles";

/// Signature of a ZIP archive.
pub(super) const MAGIC: &[u8] = b"PK";

/// Points and properties of an archive.
pub(super) fn parse(bytes: &[u8]) -> Result<UncheckedCloud, CloudError> {
    let arrays = npz::read(bytes)?;
    let bad = |array: &Array<'_>, why: &str| CloudError::Array {
        name: array.name.clone(),
        shape: array.shape.clone(),
        descr: array.descr.clone(),
        why: why.to_owned(),
    };
    let points = arrays.iter().find(|array| array.name == POINTS);
    let points = points.ok_or(CloudError::NoPointsArray)?;
    let (coordinate, &[count, 3]) = (scalar(points), &points.shape[..]) else {
        return Err(bad(points, "(n, 3) would be right"));
    };
    let coordinate = coordinate
        .filter(|kind| matches!(kind, Scalar::F32 | Scalar::F64))
        .ok_or_else(|| bad(points, "<f4 or <f8 would be right"))?;
    let numbers = extra(points, coordinate);
    let numbers: Vec<f64> = numbers.values().collect();
    let each = numbers.chunks_exact(3).map(|p| [p[0], p[1], p[2]]);
    let further = arrays
        .iter()
        .filter(|array| array.name != POINTS && array.name != TRIANGLES);
    let extras = further.map(|array| {
        let kind = scalar(array);
        let kind = kind.ok_or_else(|| bad(array, "a number that a PLY knows would be right"))?;
        if array.shape != [count] {
            return Err(bad(
                array,
                &format!("({count},), one for each point, would be right"),
            ));
        }
        Ok(extra(array, kind))
    });
    Ok(UncheckedCloud {
        points: each.collect(),
        coordinate,
        extras: extras.collect::<Result<_, CloudError>>()?,
    })
}

fn extra(array: &Array<'_>, kind: Scalar) -> Extra {
    Extra {
        name: array.name.clone(),
        kind,
        bytes: array.bytes.to_vec(),
    }
}

fn scalar(array: &Array<'_>) -> Option<Scalar> {
    Some(match array.descr.as_str() {
        "|i1" => Scalar::I8,
        "|u1" => Scalar::U8,
        "<i2" => Scalar::I16,
        "<u2" => Scalar::U16,
        "<i4" => Scalar::I32,
        "<u4" => Scalar::U32,
        "<f4" => Scalar::F32,
        "<f8" => Scalar::F64,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use flankscope_foundation::npz::NpzWriter;

    use crate::io::Unit;
    use crate::io::cloud::{self, Cloud};
    use crate::io::points::Format;

    const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n\
        property float sigma_z\nproperty uchar red\nend_header\n0.125 0 20 0.004 7\n1 0 21 0.005 255\n0 -3.25 19 0.25 0\n";

    /// The contents of a PLY, written as arrays and read again, are the same to the last bit.
    #[test]
    fn a_cloud_written_as_arrays_comes_back() {
        for coordinate in ["double", "float"] {
            let ply = PLY.replace("double", coordinate);
            let cloud = cloud::parse(ply.as_bytes(), Unit::Mm).unwrap();
            let mut archive = Vec::new();
            cloud.write(Format::Npz, &mut archive, &[]).unwrap();
            assert_eq!(cloud::parse(&archive, Unit::Mm).unwrap(), cloud);
        }
    }

    #[test]
    fn what_is_no_cloud_is_named() {
        type Fill = fn(&mut NpzWriter<Vec<u8>>) -> std::io::Result<()>;
        let said = |fill: Fill, unit: Unit| {
            let mut npz = NpzWriter::new(Vec::new());
            fill(&mut npz).unwrap();
            let parsed: Result<Cloud, _> = cloud::parse(&npz.finish().unwrap(), unit);
            parsed.unwrap_err().to_string()
        };
        let cases: [(Fill, Unit, &str); 8] = [
            (
                |npz| npz.array("points", &[1, 3], &[0f64; 3]),
                Unit::Mm,
                "no array points_mm",
            ),
            (
                |npz| npz.array("points_mm", &[3], &[0f64; 3]),
                Unit::Mm,
                "(n, 3)",
            ),
            (
                |npz| npz.array("points_mm", &[1, 2], &[0f64; 2]),
                Unit::Mm,
                "(n, 3)",
            ),
            (
                |npz| npz.array("points_mm", &[1, 3], &[0i32; 3]),
                Unit::Mm,
                "<f4 or <f8",
            ),
            (
                |npz| npz.array("points_mm", &[1, 3], &[0.0, f64::NAN, 1.0]),
                Unit::Mm,
                "coordinate y is NaN",
            ),
            (
                |npz| npz.array::<f64>("points_mm", &[0, 3], &[]),
                Unit::Mm,
                "no points",
            ),
            (
                |npz| {
                    npz.array("points_mm", &[1, 3], &[0.0, 0.0, 20.0])?;
                    npz.array("sigma_z", &[2], &[1f32, 1.0])
                },
                Unit::Mm,
                "array sigma_z",
            ),
            (
                |npz| npz.array("points_mm", &[1, 3], &[0.0, 0.0, 20.0]),
                Unit::Inch,
                "points_mm is in mm",
            ),
        ];
        for (fill, unit, words) in cases {
            let said = said(fill, unit);
            assert!(said.contains(words), "{said}");
        }
    }
}
