//! Change of a registration's pose by deviations that are no motion: wear, thermal expansion, form errors.
//!
//! A fit answers a field of deviations d at its points by the small motion -(H + P)^-1 sum(w J d), with H the information of
//! the points and P that of the prior. What that motion takes away from a deviation is lost to the eye.

use nalgebra::{Matrix6, Vector3, Vector6};

use super::observe::Observability;
use super::{Options, Prior, Registration};

/// One point as a fit saw it.
#[derive(Debug, Clone, Copy)]
pub struct Contact {
    /// Place, tool coordinates, mm.
    pub point: [f64; 3],
    /// Surface normal there.
    pub normal: [f64; 3],
    /// Its weight in the fit, 1/mm2: inverse variance times the robust weight; 0 when the fit did not use it.
    pub weight: f64,
}

impl Contact {
    /// The contact of a point with the surface after `registration`, `used` by it or not.
    pub fn from_closest(
        closest: &crate::surface::Closest,
        registration: &Registration,
        used: bool,
    ) -> Self {
        let noise = registration.noise_mm;
        let x = closest.signed_distance_mm / (3.0 * noise);
        let takes_part = used && closest.is_smooth();
        Self {
            point: closest.point,
            normal: closest.normal,
            weight: if takes_part {
                (-0.5 * x * x).exp() / (noise * noise)
            } else {
                0.0
            },
        }
    }

    fn row(&self, centre: Vector3<f64>, arm: f64) -> Vector6<f64> {
        let normal = Vector3::from(self.normal);
        let turn = (Vector3::from(self.point) - centre).cross(&normal) / arm;
        Vector6::new(turn.x, turn.y, turn.z, normal.x, normal.y, normal.z)
    }
}

/// The linear answer of one registration to deviations.
#[derive(Debug, Clone)]
pub struct Response<'a> {
    contacts: &'a [Contact],
    information: Observability,
    /// Directions weaker than this stay where they are.
    open_above_mm: f64,
    correlated_points: f64,
    centre: Vector3<f64>,
    arm: f64,
}

/// A small motion about the cloud's centre.
#[derive(Debug, Clone, Copy)]
pub struct Answer {
    step: Vector6<f64>,
    centre: Vector3<f64>,
    arm: f64,
}

impl<'a> Response<'a> {
    /// The answer of the fit that `registration` is the result of, over the points it was given and any others.
    pub fn new(
        contacts: &'a [Contact],
        registration: &Registration,
        prior: Option<&Prior>,
        options: &Options,
    ) -> Self {
        let at = (registration.centre_mm, registration.arm_mm);
        Self::of_points(contacts, at, prior, options)
    }

    /// The answer of a fit of these points about a centre, with the length (both mm) that scales turns to shifts.
    pub fn of_points(
        contacts: &'a [Contact],
        (centre_mm, arm): ([f64; 3], f64),
        prior: Option<&Prior>,
        options: &Options,
    ) -> Self {
        let centre = Vector3::from(centre_mm);
        let mut information = Matrix6::zeros();
        for contact in contacts.iter().filter(|c| c.weight > 0.0) {
            let row = contact.row(centre, arm);
            information.syger(contact.weight, &row, &row, 1.0);
        }
        information.fill_upper_triangle_with_lower_triangle();
        information /= options.correlated_points;
        let from_prior = prior.and_then(|prior| prior.scaled(centre, arm));
        if let Some(prior) = &from_prior {
            information += prior.information();
        }
        Self {
            contacts,
            information: Observability::new(&information),
            open_above_mm: if from_prior.is_some() {
                f64::MAX
            } else {
                options.unobserved_mm
            },
            correlated_points: options.correlated_points,
            centre,
            arm,
        }
    }

    /// The motion by which the fit answers deviations of `field_mm(i)` at contact `i`.
    pub fn answer(&self, field_mm: impl Fn(usize) -> f64) -> Answer {
        let [answer] = self.answers(|i| [field_mm(i)]);
        answer
    }

    /// The same for several fields, in one pass over the contacts.
    pub fn answers<const N: usize>(&self, fields_mm: impl Fn(usize) -> [f64; N]) -> [Answer; N] {
        let mut gradients = [Vector6::zeros(); N];
        for (i, contact) in self.contacts.iter().enumerate() {
            if contact.weight > 0.0 {
                let fields = fields_mm(i);
                if fields.iter().all(|deviation| *deviation == 0.0) {
                    continue;
                }
                let row = contact.row(self.centre, self.arm);
                for (gradient, deviation) in gradients.iter_mut().zip(fields) {
                    if deviation != 0.0 {
                        *gradient += row * (contact.weight * deviation);
                    }
                }
            }
        }
        gradients.map(|gradient| Answer {
            step: self.information.step(
                &(gradient / self.correlated_points),
                0.0,
                self.open_above_mm,
            ),
            centre: self.centre,
            arm: self.arm,
        })
    }
}

impl Answer {
    /// Change of a contact's deviation by the motion, mm.
    pub fn at(&self, contact: &Contact) -> f64 {
        contact.row(self.centre, self.arm).dot(&self.step)
    }
}
