//! Signed distance of a cloud to its CAD: `cargo run -p flankscope-metrology --example distance -- CAD.stl CLOUD.ply` (both in mm).

use std::path::Path;

use flankscope_metrology::deviation::{deviations, statistics};
use flankscope_metrology::io::{Unit, cloud, mesh};
use flankscope_metrology::surface::Surface;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(cad), Some(points)) = (arguments.next(), arguments.next()) else {
        return Err("usage: distance CAD.stl CLOUD.ply".into());
    };
    let surface = Surface::new(&mesh::load(Path::new(&cad), Unit::Mm)?)?;
    let cloud = cloud::load(Path::new(&points), Unit::Mm)?;
    let distances_mm = deviations(&surface, &cloud.points);
    let spread = statistics(&distances_mm).ok_or("the cloud is empty")?;
    println!(
        "{} points: mean {:+.4} mm, standard deviation {:.4} mm",
        distances_mm.len(),
        spread.mean_mm,
        spread.std_mm
    );
    Ok(())
}
