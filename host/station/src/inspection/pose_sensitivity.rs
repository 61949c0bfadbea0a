//! Effect of the pose and the temperature on a flank's figures: computed in metrology, from a view after its fit.

pub(super) use flankscope_metrology::wear::sensitivity::{FittedView, LEAST_POINTS};
