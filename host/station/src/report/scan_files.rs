//! A scan's map for other people's programs: points or a mesh as PLY, with deviation, uncertainty, views, normal and colour.

use std::io::{self, Write};

use flankscope_metrology::io::cloud::UNIT_COMMENT;
use flankscope_metrology::io::ply::{Column, Scalar, write_mesh};
use flankscope_metrology::multiview::cylinder::{Cell, CylinderMap};

use super::colour;
use super::scan::full_scale_um;
use crate::scan::Scan;

/// Writes every cell of the map as the point that was measured: normal on the CAD, deviation and standard uncertainty in mm,
/// number of views, and the report's colour.
///
/// # Errors
/// Those of `out`.
pub fn scan_ply(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    write(scan, out, &[])
}

/// Writes the same points joined to a mesh of the measured surface, with holes where nothing was seen.
///
/// # Errors
/// Those of `out`.
pub fn scan_mesh(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    write(scan, out, &triangles(&scan.map))
}

fn write(scan: &Scan, out: &mut dyn Write, triangles: &[[u32; 3]]) -> io::Result<()> {
    let cells: Vec<Cell> = scan.map.cells().collect();
    let full_um = full_scale_um(scan);
    let points: Vec<[f64; 3]> = cells.iter().map(Cell::measured).collect();
    let float = |of: &dyn Fn(&Cell) -> f64| -> Vec<f64> { cells.iter().map(of).collect() };
    let rgb: Vec<[u8; 3]> = cells
        .iter()
        .map(|cell| colour::diverging(cell.deviation_mm * 1e3 / full_um))
        .collect();
    let channel = |k: usize| -> Vec<u8> { rgb.iter().map(|rgb| rgb[k]).collect() };
    write_mesh(
        out,
        UNIT_COMMENT,
        (&points, Scalar::F64),
        &[
            Column::Float("nx", &float(&|c| c.normal[0])),
            Column::Float("ny", &float(&|c| c.normal[1])),
            Column::Float("nz", &float(&|c| c.normal[2])),
            Column::Byte("red", &channel(0)),
            Column::Byte("green", &channel(1)),
            Column::Byte("blue", &channel(2)),
            Column::Float("deviation", &float(&|c| c.deviation_mm)),
            Column::Float("sigma", &float(&|c| c.sigma_mm)),
            Column::Float("views", &float(&|c| f64::from(c.views))),
        ],
        triangles,
    )
}

/// Two triangles between every four neighbouring cells that were all seen, facing out of the material. Numbers count the
/// cells that were seen.
fn triangles(map: &CylinderMap) -> Vec<[u32; 3]> {
    let layout = map.layout();
    let (mut row_before, mut seen) = (Vec::new(), 0_u32);
    let mut found = Vec::new();
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
            let (Some(a), Some(b), Some(c), Some(d)) = (
                corner(&row_before, column),
                corner(&row_before, beside),
                corner(&here, beside),
                corner(&here, column),
            ) else {
                continue;
            };
            found.push(facing_out([a, b, c]));
            found.push(facing_out([a, c, d]));
        }
        row_before = here;
    }
    found
}

fn facing_out([(a, first), (b, second), (c, third)]: [(u32, Cell); 3]) -> [u32; 3] {
    let vector = |from: &Cell, to: &Cell| {
        nalgebra::Vector3::from(to.measured()) - nalgebra::Vector3::from(from.measured())
    };
    let across = vector(&first, &second).cross(&vector(&first, &third));
    if across.dot(&nalgebra::Vector3::from(first.normal)) < 0.0 {
        [a, c, b]
    } else {
        [a, b, c]
    }
}
