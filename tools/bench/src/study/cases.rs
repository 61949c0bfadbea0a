//! What is captured: states of die and instrument.

use flankscope_gear_cad::Flank;
use flankscope_metrology::tool::Datum;
use flankscope_profilometry::decode::GridKind;

use super::capture::Trouble;
use crate::world::WearKind;

/// One cell of the study: a state of die and instrument.
#[derive(Clone, Debug)]
pub struct Case {
    /// Name in the tables.
    pub name: String,
    /// Group of cells that one table shows.
    pub group: Group,
    /// Damage of the flank, and its largest depth in µm.
    pub wear: Option<(WearKind, f64)>,
    /// The flank that is looked at.
    pub flank: Flank,
    /// What the pose rests on.
    pub datum: Datum,
    /// Temperature of the die above that of its CAD, K, and whether the instrument knows it.
    pub warm: Option<(f64, bool)>,
    /// What a point is made of.
    pub grid: GridKind,
    /// Whether the undamaged die was captured before by the same instrument.
    pub baseline: bool,
    /// Light missing or die turned.
    pub(super) trouble: Trouble,
    /// Its place among all cases: what is drawn for it does not depend on which others are looked at.
    pub(super) number: u32,
}

/// What a cell is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// Depth against truth.
    Wear,
    /// Captures that deserve no verdict.
    Spoiled,
    /// One measure taken away.
    Measure,
}

/// All cells of the full study.
#[must_use]
pub fn cases() -> Vec<Case> {
    let worn = |kind: WearKind, um: f64, word: &str| Case {
        name: if um == 0.0 {
            "undamaged".into()
        } else {
            format!("{word} {um} µm")
        },
        group: Group::Wear,
        flank: match kind {
            WearKind::Tip | WearKind::Buildup => Flank::Right,
            _ => Flank::Left,
        },
        number: 0,
        wear: (um > 0.0).then_some((kind, um)),
        datum: Datum::Neighbours,
        warm: None,
        grid: GridKind::Core,
        baseline: false,
        trouble: Trouble::default(),
    };
    let mut cases = Vec::new();
    for um in [0.0, 3.0, 5.0, 10.0, 20.0, 50.0, 50.2, 80.0] {
        cases.push(worn(WearKind::Uniform, um, "uniform"));
    }
    cases.push(Case {
        name: "undamaged, other flank".into(),
        ..worn(WearKind::Tip, 0.0, "")
    });
    for (kind, word) in [
        (WearKind::Tip, "tip"),
        (WearKind::Pit, "pit"),
        (WearKind::Buildup, "built-up"),
    ] {
        for um in [3.0, 5.0, 10.0, 20.0, 50.0, 80.0] {
            cases.push(worn(kind, um, word));
        }
    }
    let spoiled = |name: &str, trouble| Case {
        name: name.into(),
        group: Group::Spoiled,
        trouble,
        ..worn(WearKind::Uniform, 0.0, "")
    };
    cases.push(spoiled(
        "turned by half a pitch",
        Trouble {
            turned_rad: std::f64::consts::PI / 84.0,
            dimmed: 0.0,
        },
    ));
    cases.push(spoiled(
        "turned by a pitch and a quarter",
        Trouble {
            turned_rad: 2.5 * std::f64::consts::PI / 84.0,
            dimmed: 0.0,
        },
    ));
    cases.push(spoiled(
        "0.5 % of the light",
        Trouble {
            turned_rad: 0.0,
            dimmed: 0.995,
        },
    ));
    let measure = |name: &str, datum, warm| Case {
        name: name.into(),
        group: Group::Measure,
        datum,
        warm,
        ..worn(WearKind::Uniform, 20.0, "uniform")
    };
    cases.push(measure(
        "20 µm, pose on neighbours",
        Datum::Neighbours,
        None,
    ));
    cases.push(Case {
        grid: GridKind::Pixel,
        ..measure("20 µm, pixels instead of cores", Datum::Neighbours, None)
    });
    cases.push(measure("20 µm, pose on everything", Datum::All, None));
    cases.push(measure("20 µm, pose on lands", Datum::Lands, None));
    cases.push(measure(
        "20 µm, 40 K warmer, corrected",
        Datum::Neighbours,
        Some((40.0, true)),
    ));
    cases.push(measure(
        "20 µm, 40 K warmer, not known",
        Datum::Neighbours,
        Some((40.0, false)),
    ));
    cases.push(measure(
        "20 µm, lands, 40 K warmer, corrected",
        Datum::Lands,
        Some((40.0, true)),
    ));
    cases.push(measure(
        "20 µm, lands, 40 K warmer, not known",
        Datum::Lands,
        Some((40.0, false)),
    ));
    for um in [0.0, 3.0, 5.0, 20.0] {
        cases.push(Case {
            name: format!("{um} µm, since a baseline"),
            group: Group::Measure,
            baseline: true,
            ..worn(WearKind::Uniform, um, "uniform")
        });
    }
    for (number, case) in (0..).zip(&mut cases) {
        case.number = number;
    }
    cases
}

impl Case {
    /// Captures of it in a study of `whole` captures per row: what each measure does takes a fifth, the differences to a
    /// baseline half.
    pub(super) fn captures(&self, whole: u32) -> u32 {
        match self.group {
            Group::Wear | Group::Spoiled => whole,
            Group::Measure if self.baseline => whole.div_ceil(2),
            Group::Measure => whole.div_ceil(5),
        }
    }

    /// Whether both can be seen in the same captures: on the two flanks of one die.
    pub(super) fn goes_with(&self, other: &Self) -> bool {
        let depth = |case: &Self| case.wear.map(|wear| wear.1);
        (self.group, other.group) == (Group::Wear, Group::Wear)
            && self.flank != other.flank
            && depth(self) == depth(other)
    }
}
