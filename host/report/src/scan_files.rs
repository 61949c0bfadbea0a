//! A scan's map for other programs: points or a mesh as PLY, with deviation, uncertainty, number of views, normal and colour.

use std::io::{self, Write};

use flankscope_metrology::io::ply::Column;
use flankscope_metrology::io::points::{Format, PointFile};
use flankscope_metrology::multiview::cylinder::{Cell, CylinderMap};

use super::colour;
use super::scan::full_scale_um;
use flankscope_record::document::scan::Scan;

/// Writes every cell of the map as its measured point: normal of the CAD, deviation and standard uncertainty in mm, number of
/// views, and the report's colour.
///
/// # Errors
/// Errors of `out`.
pub fn scan_ply(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    write(scan, &scan.map, (Format::Ply, out), &[])
}

/// Writes the cells of a map of the scan, its own or a finer one, as a mesh of the measured surface, with holes where nothing was measured.
///
/// # Errors
/// Errors of `out`.
pub fn scan_mesh(
    scan: &Scan,
    map: &CylinderMap,
    format: Format,
    out: &mut dyn Write,
) -> io::Result<()> {
    write(scan, map, (format, out), &triangles(map))
}

fn write(
    scan: &Scan,
    map: &CylinderMap,
    (format, out): (Format, &mut dyn Write),
    triangles: &[[u32; 3]],
) -> io::Result<()> {
    let cells: Vec<Cell> = map.cells().collect();
    let full_um = full_scale_um(scan);
    let points: Vec<[f64; 3]> = cells.iter().map(Cell::measured).collect();
    let float = |of: &dyn Fn(&Cell) -> f64| -> Vec<f64> { cells.iter().map(of).collect() };
    let rgb: Vec<[u8; 3]> = cells
        .iter()
        .map(|cell| colour::diverging(cell.deviation_mm * 1e3 / full_um))
        .collect();
    let channel = |k: usize| -> Vec<u8> { rgb.iter().map(|rgb| rgb[k]).collect() };
    let file = PointFile {
        columns: &[
            Column::Float("nx", &float(&|c| c.normal[0])),
            Column::Float("ny", &float(&|c| c.normal[1])),
            Column::Float("nz", &float(&|c| c.normal[2])),
            Column::Byte("red", &channel(0)),
            Column::Byte("green", &channel(1)),
            Column::Byte("blue", &channel(2)),
            Column::Float("deviation", &float(&|c| c.deviation_mm)),
            Column::Float("sigma", &float(&|c| scan.sigma_mm(c))),
            Column::Float("views", &float(&|c| f64::from(c.views))),
        ],
        triangles,
        ..PointFile::from_points(&points)
    };
    file.write(format, out)
}

/// Triangles between neighbouring measured cells: two for a field with four measured corners, one for three. Every edge belongs
/// to one triangle or to two on opposite sides, and all face out of the material. Indices count measured cells.
fn triangles(map: &CylinderMap) -> Vec<[u32; 3]> {
    let layout = map.layout();
    let (mut row_before, mut seen) = (Vec::new(), 0_u32);
    let mut found = Vec::new();
    // Counter-clockwise seen from outside the bore. The majority decides whether this is out of the material, because a sliver
    // may be ambiguous.
    let mut outwards = 0.0;
    for row in 0..layout.rows {
        let here: Vec<Option<(u32, Cell)>> = (0..layout.columns)
            .map(|column| {
                let cell = map.cell(row, column)?;
                seen += 1;
                Some((seen - 1, cell))
            })
            .collect();
        for column in 0..layout.columns {
            let beside = (column + 1) % layout.columns;
            let corner =
                |of: &Vec<Option<(u32, Cell)>>, column: usize| of.get(column).copied().flatten();
            let corners = [
                corner(&row_before, column),
                corner(&row_before, beside),
                corner(&here, beside),
                corner(&here, column),
            ];
            let mut join = |corners: [(u32, Cell); 3]| {
                outwards += outwards_mm2(&corners);
                found.push(corners.map(|(number, _)| number));
            };
            match corners {
                [Some(a), Some(b), Some(c), Some(d)] => {
                    join([a, b, c]);
                    join([a, c, d]);
                }
                [Some(a), Some(b), Some(c), None]
                | [Some(a), Some(b), None, Some(c)]
                | [Some(a), None, Some(b), Some(c)]
                | [None, Some(a), Some(b), Some(c)] => join([a, b, c]),
                _ => {}
            }
        }
        row_before = here;
    }
    if outwards < 0.0 {
        for [_, b, c] in &mut found {
            std::mem::swap(b, c);
        }
    }
    found
}

/// Twice the area of a triangle seen along its first corner's normal, mm².
fn outwards_mm2([(_, first), (_, second), (_, third)]: &[(u32, Cell); 3]) -> f64 {
    let vector = |to: &Cell| {
        nalgebra::Vector3::from(to.measured()) - nalgebra::Vector3::from(first.measured())
    };
    vector(second)
        .cross(&vector(third))
        .dot(&nalgebra::Vector3::from(first.normal))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use flankscope_metrology::multiview::cylinder::{Around, CellObservation, Layout};

    use super::*;

    /// A bore with material outside, measured in some of its cells.
    fn bore(seen: impl Fn(usize) -> bool) -> CylinderMap {
        let layout = Layout {
            columns: 40,
            rows: 25,
            height_mm: [0.0, 25.0],
            around: Around::Angle,
        };
        let mut map = CylinderMap::new(layout);
        let cells = (0..layout.columns * layout.rows).filter(|&cell| seen(cell));
        let view: Vec<CellObservation> = cells
            .map(|cell| {
                let (sin, cos) = layout.angle_rad(cell % layout.columns).sin_cos();
                let z = (cell / layout.columns) as f64 + 0.5;
                CellObservation {
                    cell: cell as u32,
                    weight: 1e6,
                    deviation_mm: 0.0,
                    point: [10.0 * cos, 10.0 * sin, z].map(|c| c as f32),
                    normal: [-cos as f32, -sin as f32, 0.0],
                }
            })
            .collect();
        map.add_view(&view, |_| 0.0);
        map
    }

    /// Directed edges and their number of occurrences.
    fn edges(triangles: &[[u32; 3]]) -> BTreeMap<(u32, u32), usize> {
        let mut edges = BTreeMap::new();
        for &[a, b, c] in triangles {
            for edge in [(a, b), (b, c), (c, a)] {
                *edges.entry(edge).or_default() += 1;
            }
        }
        edges
    }

    #[test]
    fn a_mesh_is_tight_where_everything_was_seen_and_ends_where_it_ends() {
        let edges = edges(&triangles(&bore(|_| true)));
        assert!(edges.values().all(|&times| times == 1));
        let open: Vec<_> = edges
            .keys()
            .filter(|&&(a, b)| !edges.contains_key(&(b, a)))
            .collect();
        // Only the two rims.
        assert_eq!(open.len(), 2 * 40);
        let row = |vertex: u32| vertex / 40;
        assert!(
            open.iter()
                .all(|(a, b)| row(*a) == row(*b) && [0, 24].contains(&row(*a)))
        );
    }

    #[test]
    fn a_mesh_with_holes_covers_no_cell_that_was_not_seen_and_leaves_no_crack() {
        // A third of the cells is unmeasured, scattered.
        let is_seen = |cell: usize| !((cell * 2_654_435_761) >> 7).is_multiple_of(3);
        let map = bore(is_seen);
        let number: Vec<usize> = (0..1000).filter(|&cell| is_seen(cell)).collect();
        let found = triangles(&map);
        let edges = edges(&found);
        let of = |vertex: u32| {
            let cell = number[vertex as usize];
            (cell % 40, cell / 40)
        };
        let beside = |a: usize, b: usize| (a + 1) % 40 == b || (b + 1) % 40 == a || a == b;
        for triangle in &found {
            // Corners are neighbours, so that no triangle spans an unmeasured cell.
            let [a, b, c] = triangle.map(of);
            for (p, q) in [(a, b), (b, c), (c, a)] {
                assert!(beside(p.0, q.0) && p.1.abs_diff(q.1) <= 1, "{p:?} {q:?}");
            }
        }
        for (&(a, b), &times) in &edges {
            assert_eq!(times, 1, "two triangles on one side of an edge");
            if edges.contains_key(&(b, a)) {
                continue;
            }
            // An open edge: one of the adjacent fields lacks a corner, or does not exist.
            let (p, q) = (of(a), of(b));
            let seen = |(column, row): (usize, usize)| row < 25 && is_seen(row * 40 + column);
            let complete = |column: usize, row: usize| {
                let next = (column + 1) % 40;
                [
                    (column, row),
                    (next, row),
                    (column, row + 1),
                    (next, row + 1),
                ]
                .into_iter()
                .all(seen)
            };
            let left = if (p.0 + 1) % 40 == q.0 { p.0 } else { q.0 };
            let low = p.1.min(q.1);
            let whole = if p.1 == q.1 {
                low > 0 && complete(left, low - 1) && complete(left, low)
            } else if p.0 == q.0 {
                complete((p.0 + 39) % 40, low) && complete(p.0, low)
            } else {
                complete(left, low)
            };
            assert!(!whole, "a crack between {p:?} and {q:?}");
        }
        // Every field with three or four corners must be present.
        let corners = |cell: usize| {
            let (column, row) = (cell % 40, cell / 40);
            let next = row * 40 + (column + 1) % 40;
            [cell, next, cell + 40, next + 40]
                .into_iter()
                .filter(|&c| is_seen(c))
                .count()
        };
        let expected: usize = (0..24 * 40)
            .map(|cell| corners(cell).saturating_sub(2))
            .sum();
        assert_eq!(found.len(), expected);
    }
}
