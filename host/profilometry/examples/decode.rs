//! Fringe images of one view to points: `cargo run -p flankscope-profilometry --example decode -- HEAD.toml PLAN.toml IMAGES`.

use std::path::Path;

use flankscope_profilometry::counts::CountRange;
use flankscope_profilometry::plan::Plan;
use flankscope_profilometry::{DecodeOptions, Decoder, HeadModel};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [head, plan, images] = arguments.as_slice() else {
        return Err("usage: decode HEAD.toml PLAN.toml IMAGES".into());
    };
    let mut head = HeadModel::load(Path::new(head))?;
    let plan = Plan::load(Path::new(plan))?;
    let size_px = [head.camera.width_px, head.camera.height_px];
    let mut frames = plan.images(Path::new(images), size_px)?;
    let sensor_bits = plan.sensor.or(head.sensor).map(|sensor| sensor.bits);
    let counts = CountRange::take(&mut frames, sensor_bits);
    let sensor_assumed = head.take_sensor(plan.sensor, &counts);
    let options = DecodeOptions::for_images(&head, plan.dark_frame, sensor_assumed);
    let decoder = Decoder::new(&head, &plan.patterns, &plan.exposures_us, options)?;
    let mut sums = decoder.begin();
    for (kind, image) in &frames {
        sums.add(image.view(), *kind)?;
    }
    let decoded = decoder.finish(&sums)?;
    let cloud = &decoded.cloud;
    println!("{} points of {} cells", cloud.len(), decoded.cells);
    for (point, sigma_mm) in cloud.points_mm.iter().zip(&cloud.sigma_z_mm).take(5) {
        println!("{point:?} mm, standard uncertainty of the depth {sigma_mm} mm");
    }
    Ok(())
}
