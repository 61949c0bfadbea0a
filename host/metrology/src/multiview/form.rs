//! Form of the bore as documents state it: micrometres and degrees, with expanded uncertainties.

use serde::Serialize;

use super::cylinder::BoreForm;

/// Form of the bore as a whole, µm.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Form {
    /// Mean growth of the radius in the map, whose poses have taken up what all views share of it.
    pub size_um: f64,
    /// Expanded uncertainty (95 %) of the mean radius, by the pitch that the views saw and the calibration's lateral scale; absent
    /// where none is claimed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_u95_um: Option<f64>,
    /// Largest minus smallest radius.
    pub ovality_um: f64,
    /// Its expanded uncertainty (95 %); absent where none is claimed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ovality_u95_um: Option<f64>,
    /// Where the radius is largest, degrees, 0 to 180.
    pub ovality_deg: f64,
    /// Growth of the radius from bottom to top.
    pub taper_um: f64,
    /// Its expanded uncertainty (95 %), how far the vertical axis leans towards the wall included; absent where none is
    /// claimed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taper_u95_um: Option<f64>,
}

impl From<BoreForm> for Form {
    fn from(form: BoreForm) -> Self {
        Self {
            size_um: form.size_mm * 1e3,
            size_u95_um: None,
            ovality_um: form.ovality_mm * 1e3,
            ovality_u95_um: None,
            ovality_deg: form.ovality_rad.to_degrees(),
            taper_um: form.taper_mm * 1e3,
            taper_u95_um: None,
        }
    }
}

impl Form {
    /// With the standard uncertainties of ovality and taper, mm.
    #[must_use]
    pub fn with_sigma(form: BoreForm, [ovality_mm, taper_mm]: [f64; 2]) -> Self {
        Self {
            ovality_u95_um: Some(1.96e3 * ovality_mm),
            taper_u95_um: Some(1.96e3 * taper_mm),
            ..form.into()
        }
    }
}
