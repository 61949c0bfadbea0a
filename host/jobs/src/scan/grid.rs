//! Views of a scan, equally spaced around the bore and over the height.

use flankscope_metrology::gear::GearData;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::HeadModel;

use crate::plan::{PlanningError, ViewPlan};
use flankscope_metrology::view::PlannedView;

/// Number of views around the bore, and of layers over the height.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Views around.
    pub around: u32,
    pub layers: u32,
}

/// Largest number of views in a layer, and of layers.
const MOST: [u32; 2] = [1000, 100];

/// The text is not a grid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "views \"{text}\" are no grid; AROUNDxLAYERS is, such as 84x7, with 3 to {} around and 1 to {} layers", MOST[0], MOST[1]
)]
pub struct GridError {
    text: String,
}

impl std::str::FromStr for Grid {
    type Err = GridError;

    fn from_str(text: &str) -> Result<Self, GridError> {
        let wrong = || GridError { text: text.into() };
        let (around, layers) = text.split_once('x').ok_or_else(wrong)?;
        let grid = Self {
            around: around.parse().map_err(|_| wrong())?,
            layers: layers.parse().map_err(|_| wrong())?,
        };
        let fits = (3..=MOST[0]).contains(&grid.around) && (1..=MOST[1]).contains(&grid.layers);
        fits.then_some(grid).ok_or_else(wrong)
    }
}

impl std::fmt::Display for Grid {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.around, self.layers)
    }
}

impl Grid {
    /// The views in the order of capture: layer by layer from the bottom, in alternating directions to avoid idle rotations.
    ///
    /// # Errors
    /// The tool has no gear, or the head no patterns, exposures or hand-eye.
    pub fn plan(&self, tool: &Tool, head: &HeadModel) -> Result<ViewPlan, PlanningError> {
        let gear = tool.gear.as_ref().ok_or(PlanningError::NoGear)?;
        Ok(ViewPlan {
            further: Vec::new(),
            views: self.views(gear),
            ..ViewPlan::new(tool, head, Some(&[1]))?
        })
    }

    /// Positions of the stages for its views.
    pub(super) fn views(&self, gear: &GearData) -> Vec<PlannedView> {
        let [low, high] = gear.height_mm;
        let turn = std::f64::consts::TAU;
        let mut views = Vec::new();
        for layer in 0..self.layers {
            let share = (f64::from(layer) + 0.5) / f64::from(self.layers);
            for step in 0..self.around {
                let place = if layer % 2 == 0 {
                    step
                } else {
                    self.around - 1 - step
                };
                // Centres a tooth in the first view if there are as many views as teeth; avoids the ends ±π.
                let rotation_rad = turn * ((f64::from(place) + 0.5) / f64::from(self.around) - 0.5);
                views.push(PlannedView {
                    tooth: gear.tooth_at(-rotation_rad),
                    rotation_rad,
                    vertical_mm: low + share * (high - low),
                });
            }
        }
        views
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_are_read_and_wrong_ones_named() {
        let read = |text: &str| text.parse::<Grid>();
        let full = read("84x7").expect("a grid");
        assert_eq!((full.around, full.layers), (84, 7));
        assert_eq!(full.to_string(), "84x7");
        for text in [
            "", "84", "84x", "x7", "2x7", "84x0", "1001x1", "84x101", "8 x 4", "-8x4",
        ] {
            assert!(
                read(text).is_err_and(|e| e.to_string().contains("84x7")),
                "{text}"
            );
        }
    }
}
