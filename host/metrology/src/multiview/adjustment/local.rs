//! Deviation of a single view's pose from the model that all views share.

use nalgebra::{Matrix6, SMatrix, Vector3, Vector6};

use super::view::ViewInformation;

/// Prior of a single view's deviation from the shared model, and of the local form of the piece that looks like one: standard
/// deviations.
#[derive(Debug, Clone, Copy)]
pub struct Local {
    /// Turn of the rotary stage, rad.
    pub rotation_rad: f64,
    /// Height of the vertical stage, mm.
    pub vertical_mm: f64,
    /// Run-out: shift in any direction, mm.
    pub runout_mm: f64,
    /// Wobble: turn about any axis, rad.
    pub wobble_rad: f64,
    /// Form of the piece: its wall stands nearer to or farther from the axis over a whole view, mm. It looks like a shift
    /// of the view and is none: however many points say so, the view stays where it is and the form in its deviations.
    pub form_mm: f64,
    /// Form of the piece: its wall leans over a whole view, rad.
    pub form_rad: f64,
}

impl Default for Local {
    /// ±15 mdeg and ±5 µm, evenly distributed (data sheets); run-out and wobble of an air or cross-roller bearing stage; a
    /// form of 5 µm, and that over the half height of a die.
    fn default() -> Self {
        let even = 1.0 / 3f64.sqrt();
        Self {
            rotation_rad: 15e-3 * std::f64::consts::PI / 180.0 * even,
            vertical_mm: 5e-3 * even,
            runout_mm: 0.3e-3,
            wobble_rad: 5e-6,
            form_mm: 5e-3,
            form_rad: 5e-3 / 33.0,
        }
    }
}

impl Local {
    /// Covariance of the pose residual (rotation about `centre`, translation), tool frame.
    pub(super) fn covariance(&self, centre: Vector3<f64>) -> Matrix6<f64> {
        let mut covariance = Matrix6::from_diagonal(&Vector6::new(
            self.wobble_rad.powi(2),
            self.wobble_rad.powi(2),
            self.wobble_rad.powi(2),
            self.runout_mm.powi(2),
            self.runout_mm.powi(2),
            self.runout_mm.powi(2) + self.vertical_mm.powi(2),
        ));
        let turn = Vector6::new(0.0, 0.0, 1.0, -centre.y, centre.x, 0.0) * self.rotation_rad;
        covariance += turn * turn.transpose();
        covariance
    }

    /// Root of the covariance of the motion that the form of the piece under one view looks like, beyond ovality and taper of
    /// the whole: three leans, and outwards.
    fn form_root(&self, centre: Vector3<f64>) -> SMatrix<f64, 6, 4> {
        let mut root = SMatrix::zeros();
        for turn in 0..3 {
            root[(turn, turn)] = self.form_rad;
        }
        let radius_mm = centre.x.hypot(centre.y);
        if radius_mm > 0.0 {
            root[(3, 3)] = centre.x / radius_mm * self.form_mm;
            root[(4, 3)] = centre.y / radius_mm * self.form_mm;
        }
        root
    }

    /// Information of a view about its pose on the CAD with the form of the piece under it eliminated: its matrix and
    /// gradient. `None` when its information is not positive.
    pub(super) fn without_form(&self, view: &ViewInformation) -> Option<Believed> {
        let root = self.form_root(view.centre_mm.into());
        let seen = view.information * root;
        let inner = SMatrix::<f64, 4, 4>::identity() + root.transpose() * seen;
        let kept = Matrix6::identity() - seen * inner.cholesky()?.solve(&root.transpose());
        let information = kept * view.information;
        Some(Believed {
            information: 0.5 * (information + information.transpose()),
            gradient: kept * view.gradient,
        })
    }
}

/// Normal equations of a view's motion d: its cost is dᵀHd/2 + gᵀd.
#[derive(Debug, Clone)]
pub(super) struct Believed {
    /// H.
    pub information: Matrix6<f64>,
    /// g.
    pub gradient: Vector6<f64>,
}
