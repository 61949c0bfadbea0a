//! Cases of the study: states of die and instrument.

use flankscope_metrology::tool::Datum;
use flankscope_profilometry::decode::GridKind;

use super::capture::Trouble;
use flankscope_bench::world::WearKind;

/// Depth of a damage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Depth {
    /// This, µm.
    Fixed(f64),
    /// Drawn anew for every capture: uniformly, from 0 to this, µm.
    DrawnTo(f64),
}

/// Damage of the die.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Damaged {
    /// None.
    Nothing,
    /// A built-in kind on the left flank (some kinds affect other flanks, too), and its largest depth.
    Wear(WearKind, Depth),
    /// A round hole with a flat bottom on both flanks, somewhere in the zone.
    Spot {
        /// Its area, mm².
        area_mm2: f64,
        /// Its depth, µm.
        depth_um: f64,
    },
    /// A random shape on both flanks, with this largest mean loss over a disc.
    Random(Depth),
}

/// Use of the right flank's result.
#[derive(Clone, Debug, PartialEq)]
pub enum Right {
    /// Not used.
    Ignored,
    /// Counts in the same row.
    Same,
    /// Counts in its own row.
    Row(String),
}

/// One case: a state of die and instrument.
#[derive(Clone, Debug)]
pub struct Case {
    /// Name in the tables.
    pub name: String,
    /// Group of cases that one table shows.
    pub group: Group,
    pub damage: Damaged,
    /// Use of the right flank's result.
    pub right: Right,
    /// Surfaces that determine the pose.
    pub datum: Datum,
    /// Temperature of the die above that of its CAD, K, and whether the instrument knows it.
    pub warm: Option<(f64, bool)>,
    /// Mean thickness of the film on the die, and its largest one as the tool states it, µm.
    pub film_um: [f64; 2],
    /// Of the form as built the tool states no more than the tolerance class of its drawing.
    pub by_class: bool,
    /// How pixels are grouped into points.
    pub grid: GridKind,
    /// Light missing or die turned.
    pub(super) trouble: Trouble,
    /// Captures for each one that is asked for.
    pub(super) times: u32,
    /// Its index among all cases, so that its random numbers do not depend on the selection of cases.
    pub(super) number: u32,
}

/// Topic of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Group {
    /// Depth relative to CAD for a die that follows its drawing.
    Drawn,
    /// Depth relative to CAD for a die as built.
    Built,
    /// Depth since a baseline of the new die, as built.
    Baseline,
    /// Verdict against a depth that is drawn anew for every capture, of a die as built, against CAD.
    Characteristic,
    /// Captures with faults, which must not get a verdict.
    Spoiled,
    /// One safeguard switched off, for a die that follows its drawing.
    Measure,
}

impl Group {
    /// Whether the die has the form errors of its class.
    pub(super) fn is_built(self) -> bool {
        matches!(self, Self::Built | Self::Baseline | Self::Characteristic)
    }
}

/// Depths that are drawn go up to this, µm: more than twice the demo tool's stop limit.
pub(super) const DEEPEST_UM: f64 = 120.0;

/// All cases of the full study.
#[must_use]
pub fn cases() -> Vec<Case> {
    let case = |group, name: &str, damage| Case {
        name: name.into(),
        group,
        right: match damage {
            Damaged::Nothing | Damaged::Spot { .. } | Damaged::Random(_) => Right::Same,
            Damaged::Wear(WearKind::Ring, _) => Right::Same,
            Damaged::Wear(WearKind::Side, Depth::Fixed(um)) => Right::Row(format!(
                "{name}: the sound right flank ({um} µm on the left)"
            )),
            Damaged::Wear(..) => Right::Ignored,
        },
        damage,
        datum: Datum::Neighbours,
        warm: None,
        film_um: [0.0; 2],
        by_class: false,
        grid: GridKind::Core,
        trouble: Trouble::default(),
        times: 1,
        number: 0,
    };
    let mut cases = Vec::new();
    let mut add = |group, name: &str, damage| cases.push(case(group, name, damage));
    let wear = |kind, um| Damaged::Wear(kind, Depth::Fixed(um));
    let even = |um| wear(WearKind::Uniform, um);
    let random = |um| Damaged::Random(Depth::Fixed(um));
    let spot = |area_mm2, depth_um| Damaged::Spot { area_mm2, depth_um };
    add(Group::Drawn, "drawn, undamaged", Damaged::Nothing);
    add(Group::Drawn, "drawn, uniform 20 µm", even(20.0));
    add(Group::Drawn, "drawn, uniform 50 µm", even(50.0));
    for (group, word) in [(Group::Built, "built"), (Group::Baseline, "since new")] {
        let name = |what: &str| format!("{word}, {what}");
        let mut add = |what: &str, damage| add(group, &name(what), damage);
        add("undamaged", Damaged::Nothing);
        add("uniform 20 µm", even(20.0));
        add("uniform 50 µm", even(50.0));
        add("random 20 µm", random(20.0));
        add("random 50 µm", random(50.0));
        add("spot of 0.25 mm², 40 µm", spot(0.25, 40.0));
        add("spot of 0.25 mm², 60 µm", spot(0.25, 60.0));
        let one_side = |um| wear(WearKind::Side, um);
        add("one side of all teeth, 35 µm", one_side(35.0));
        add("one side of all teeth, 55 µm", one_side(55.0));
        add("whole ring, 55 µm", wear(WearKind::Ring, 55.0));
        if group == Group::Built {
            add("uniform 80 µm", even(80.0));
            add("random 80 µm", random(80.0));
            add("tip 80 µm", wear(WearKind::Tip, 80.0));
            add("spot of 0.05 mm², 150 µm", spot(0.05, 150.0));
        }
    }
    for (what, damage) in [
        ("undamaged", Damaged::Nothing),
        ("uniform 20 µm", even(20.0)),
        ("uniform 80 µm", even(80.0)),
    ] {
        cases.push(Case {
            by_class: true,
            ..case(
                Group::Built,
                &format!("built, by its class, {what}"),
                damage,
            )
        });
    }
    let drawn = Depth::DrawnTo(DEEPEST_UM);
    for (what, damage) in [
        ("uniform", Damaged::Wear(WearKind::Uniform, drawn)),
        ("random", Damaged::Random(drawn)),
    ] {
        cases.push(Case {
            times: 4,
            ..case(
                Group::Characteristic,
                &format!("{what}, depth drawn"),
                damage,
            )
        });
    }
    let spoiled = |name: &str, turned_pitches: f64, dimmed| Case {
        trouble: Trouble {
            turned_rad: turned_pitches * std::f64::consts::TAU / 84.0,
            dimmed,
            stages: None,
        },
        ..case(Group::Spoiled, name, Damaged::Nothing)
    };
    cases.push(spoiled("turned by half a pitch", 0.5, 0.0));
    cases.push(spoiled("turned by a pitch and a quarter", 1.25, 0.0));
    cases.push(spoiled("0.5 % of the light", 0.0, 0.995));
    let measure = |name: &str| case(Group::Measure, name, even(20.0));
    // A film varies by 20 % and is thicker at edges: of 12 µm on average hardly anything is thicker than 25.
    for (damage, what) in [
        (Damaged::Nothing, "undamaged"),
        (even(50.0), "uniform 50 µm"),
    ] {
        cases.push(Case {
            film_um: [12.0, 25.0],
            ..case(
                Group::Drawn,
                &format!("{what}, a film of 12 µm, at most 25 stated"),
                damage,
            )
        });
    }
    cases.push(Case {
        film_um: [12.0, 0.0],
        ..measure("20 µm below a film of 12 µm that nobody stated")
    });
    cases.push(Case {
        grid: GridKind::Pixel,
        ..measure("20 µm, pixels instead of cores")
    });
    for (datum, name) in [
        (Datum::All, "20 µm, pose on everything"),
        (Datum::Lands, "20 µm, pose on lands"),
    ] {
        cases.push(Case {
            datum,
            ..measure(name)
        });
    }
    for (known, name) in [
        (true, "20 µm, 40 K warmer, corrected"),
        (false, "20 µm, 40 K warmer, not known"),
    ] {
        cases.push(Case {
            warm: Some((40.0, known)),
            ..measure(name)
        });
    }
    for (number, case) in (0..).zip(&mut cases) {
        case.number = number;
    }
    cases
}
