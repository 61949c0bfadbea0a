//! Motion of one axis in closed form: braking from the present speed, then a trapezoidal profile from rest to the target.

/// Velocity and acceleration limits, in units of the axis per second and per second squared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dynamics {
    /// Largest speed.
    pub speed: f64,
    pub acceleration: f64,
    pub deceleration: f64,
}

/// A motion from an initial speed to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Profile {
    start_s: f64,
    from: f64,
    from_speed: f64,
    brake_s: f64,
    /// Position at which braking ends and the trapezoid begins.
    turn: f64,
    target: f64,
    dynamics: Dynamics,
}

/// Seconds of acceleration, of full speed and of deceleration.
#[derive(Debug, Clone, Copy)]
struct Trapezoid {
    up_s: f64,
    cruise_s: f64,
    down_s: f64,
}

impl Trapezoid {
    fn total_s(self) -> f64 {
        self.up_s + self.cruise_s + self.down_s
    }
}

impl Profile {
    /// Permanently at rest.
    #[must_use]
    pub fn rest(at: f64) -> Self {
        let dynamics = Dynamics {
            speed: 1.0,
            acceleration: 1.0,
            deceleration: 1.0,
        };
        Self {
            start_s: 0.0,
            from: at,
            from_speed: 0.0,
            brake_s: 0.0,
            turn: at,
            target: at,
            dynamics,
        }
    }

    /// Motion from the present state at `now_s` to `target`.
    #[must_use]
    pub fn redirect(&self, now_s: f64, target: f64, dynamics: Dynamics) -> Self {
        Self {
            target,
            ..self.brake(now_s, dynamics)
        }
    }

    /// Motion from the present state at `now_s` to rest as soon as possible.
    #[must_use]
    pub fn brake(&self, now_s: f64, dynamics: Dynamics) -> Self {
        let (from, from_speed) = (self.position(now_s), self.speed(now_s));
        let brake_s = from_speed.abs() / dynamics.deceleration;
        let turn = from + 0.5 * from_speed * brake_s;
        Self {
            start_s: now_s,
            from,
            from_speed,
            brake_s,
            turn,
            target: turn,
            dynamics,
        }
    }

    /// Final position.
    pub fn target(&self) -> f64 {
        self.target
    }

    /// Time at which it comes to rest.
    pub fn end_s(&self) -> f64 {
        self.start_s + self.brake_s + self.trapezoid().total_s()
    }

    /// The profile from rest at the end of braking to rest at the target.
    fn trapezoid(&self) -> Trapezoid {
        let Dynamics {
            speed,
            acceleration,
            deceleration,
        } = self.dynamics;
        let distance = (self.target - self.turn).abs();
        // Distance of both ramps at full speed.
        let ramps = 0.5 * speed * speed * (1.0 / acceleration + 1.0 / deceleration);
        let (peak, cruise_s) = if distance >= ramps {
            (speed, (distance - ramps) / speed)
        } else {
            let together = acceleration * deceleration / (acceleration + deceleration);
            ((2.0 * distance * together).sqrt(), 0.0)
        };
        Trapezoid {
            up_s: peak / acceleration,
            cruise_s,
            down_s: peak / deceleration,
        }
    }

    /// Position at `now_s`.
    #[must_use]
    pub fn position(&self, now_s: f64) -> f64 {
        let t = (now_s - self.start_s).max(0.0);
        if t < self.brake_s {
            let deceleration = self.from_speed / self.brake_s;
            return self.from + self.from_speed * t - 0.5 * deceleration * t * t;
        }
        let t = t - self.brake_s;
        let trapezoid = self.trapezoid();
        let Trapezoid { up_s, cruise_s, .. } = trapezoid;
        let a = self.dynamics.acceleration;
        let left_s = trapezoid.total_s() - t;
        if left_s <= 0.0 {
            return self.target;
        }
        let sign = (self.target - self.turn).signum();
        if t < up_s {
            self.turn + sign * 0.5 * a * t * t
        } else if t < up_s + cruise_s {
            self.turn + sign * (0.5 * a * up_s * up_s + a * up_s * (t - up_s))
        } else {
            self.target - sign * 0.5 * self.dynamics.deceleration * left_s * left_s
        }
    }

    /// Signed speed at `now_s`.
    #[must_use]
    pub fn speed(&self, now_s: f64) -> f64 {
        let t = (now_s - self.start_s).max(0.0);
        if t < self.brake_s {
            return self.from_speed * (1.0 - t / self.brake_s);
        }
        let t = t - self.brake_s;
        let trapezoid = self.trapezoid();
        let left_s = (trapezoid.total_s() - t).max(0.0);
        let rising = self.dynamics.acceleration * t.min(trapezoid.up_s);
        let falling = self.dynamics.deceleration * left_s.min(trapezoid.down_s);
        (self.target - self.turn).signum() * rising.min(falling)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DYNAMICS: Dynamics = Dynamics {
        speed: 100.0,
        acceleration: 800.0,
        deceleration: 800.0,
    };

    #[test]
    fn a_long_move_takes_distance_over_speed_plus_one_ramp() {
        let profile = Profile::rest(10.0).redirect(5.0, 110.0, DYNAMICS);
        assert!((profile.end_s() - (5.0 + 1.0 + 0.125)).abs() < 1e-12);
        assert_eq!(profile.position(4.0), 10.0);
        assert_eq!(profile.position(profile.end_s()), 110.0);
    }

    #[test]
    fn ramps_of_their_own_take_their_own_time() {
        let gentle = Dynamics {
            deceleration: 200.0,
            ..DYNAMICS
        };
        // 6.25 mm up within 0.125 s, 25 mm down within 0.5 s, the rest at full speed.
        let long = Profile::rest(0.0).redirect(0.0, 131.25, gentle);
        assert!((long.end_s() - (0.125 + 1.0 + 0.5)).abs() < 1e-12);
        assert!((long.position(1.125) - 106.25).abs() < 1e-9 && long.speed(1.125) == 100.0);
        // On a short distance, both ramps meet: v² (1/800 + 1/200) / 2 = 5.
        let short = Profile::rest(0.0).redirect(0.0, 5.0, gentle);
        let peak = (10.0f64 / (1.0 / 800.0 + 1.0 / 200.0)).sqrt();
        assert!((short.speed(peak / 800.0) - peak).abs() < 1e-9);
        assert!((short.end_s() - peak / 800.0 - peak / 200.0).abs() < 1e-12);
    }

    #[test]
    fn a_short_move_never_reaches_full_speed() {
        let profile = Profile::rest(0.0).redirect(0.0, -2.0, DYNAMICS);
        assert!((profile.end_s() - 2.0 * (2.0f64 / 800.0).sqrt()).abs() < 1e-12);
    }

    /// Position is the integral of speed, and speed is continuous across interruptions: checked by small steps.
    #[test]
    fn position_is_the_integral_of_speed_through_redirects_and_stops() {
        let step_s = 1e-5;
        let mut profile = Profile::rest(0.0).redirect(0.0, 50.0, DYNAMICS);
        let (mut position, mut speed) = (0.0, 0.0);
        for n in 0..150_000 {
            let now_s = f64::from(n) * step_s;
            match n {
                20_000 => profile = profile.redirect(now_s, -30.0, DYNAMICS),
                60_000 => profile = profile.brake(now_s, DYNAMICS),
                90_000 => profile = profile.redirect(now_s, 1.0, DYNAMICS),
                _ => {}
            }
            let next = profile.speed(now_s + step_s);
            assert!(
                (next - speed).abs() <= 800.0 * step_s * 1.001,
                "speed jumps at {now_s} s"
            );
            assert!(next.abs() <= 100.0 + 1e-9);
            position += 0.5 * (speed + next) * step_s;
            speed = next;
            // The trapezoidal rule is exact on piecewise linear speed, except in the few steps across a kink, 1e-6 at most each.
            assert!(
                (profile.position(now_s + step_s) - position).abs() < 2e-5,
                "at {now_s} s"
            );
        }
        assert_eq!((profile.position(2.0), profile.speed(2.0)), (1.0, 0.0));
    }
}
