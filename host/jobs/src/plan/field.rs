//! Field of view of a head: its width and distance, by the head file.

use flankscope_profilometry::HeadModel;

/// The head file has no measuring volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("[volume] in the head file is missing; a check needs it (see docs/formats)")]
pub struct NoVolume;

/// Field of view in the middle of a head's measuring volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FieldOfView {
    /// Its diameter, mm, rounded to a tenth, so that the plan of a view does not depend on the last digits of a calibration.
    pub width_mm: f64,
    /// Distance from the camera's pinhole to the middle of the volume, mm: the lever by which a rotation of the head moves the surface.
    pub reach_mm: f64,
    /// Ratio of half its width to the distance.
    pub slope: f64,
    /// Nearest and farthest distance from the pinhole at which a point can be measured, mm: the depths of the volume, the
    /// farthest one at a corner of the field.
    pub range_mm: [f64; 2],
}

impl FieldOfView {
    /// The field of view of a head; there is no default.
    ///
    /// # Errors
    /// The head file has no measuring volume.
    pub fn of(head: &HeadModel) -> Result<Self, NoVolume> {
        let volume = head.volume.ok_or(NoVolume)?;
        let reach_mm = 0.5 * (volume.near_mm + volume.far_mm);
        let slope = slope(head);
        let width_mm = 2.0 * reach_mm * slope;
        Ok(Self {
            width_mm: (10.0 * width_mm).round() / 10.0,
            reach_mm,
            slope,
            range_mm: [
                volume.near_mm,
                volume.far_mm * 1f64.hypot(2f64.sqrt() * slope),
            ],
        })
    }
}

/// Half the field's width per distance, from the camera's image circle or its sensor.
fn slope(head: &HeadModel) -> f64 {
    let camera = &head.camera;
    let radius_px = head.image_circle.map_or(
        0.5 * f64::from(camera.width_px.max(camera.height_px)),
        |circle| circle.radius_px,
    );
    radius_px / camera.focal_px[0].min(camera.focal_px[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_test_requisites::DRAWN_HEAD;

    fn of(volume: &str) -> Result<FieldOfView, NoVolume> {
        let head: HeadModel = toml::from_str(&format!("{DRAWN_HEAD}{volume}")).unwrap();
        FieldOfView::of(&head)
    }

    #[test]
    fn every_head_has_the_field_of_its_own_volume() {
        let far = of("[volume]\nnear_mm = 20.3\nfar_mm = 23.7").unwrap();
        assert_eq!((far.width_mm, far.reach_mm), (10.0, 22.0));
        let near = of("[volume]\nnear_mm = 11.7\nfar_mm = 14.7").unwrap();
        assert_eq!((near.width_mm, near.reach_mm), (6.0, 13.2));
        let unsaid = of("").unwrap_err().to_string();
        assert!(unsaid.contains("[volume]"), "{unsaid}");
    }
}
