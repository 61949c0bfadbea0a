//! The interlock's rules tried on every state with every input, and each rule missed when it is switched off.
//!
//! The requirements here are written from the outside (what went in, what came out), not from the rules' code.

extern crate std;

use super::rules::{Expired, Inputs, Orders, Phase, Position, Rule, State, decide, outputs};
use crate::diagrams;
use flankscope_protocol::Fault;
use std::{collections::BTreeMap, println, vec::Vec};

/// Every cause that a phase can carry.
const CAUSES: [Option<Fault>; 10] = [
    None,
    Some(Fault::PressNotOpen),
    Some(Fault::PressCycled),
    Some(Fault::DieNotClear),
    Some(Fault::GuardOpen),
    Some(Fault::PositionLost),
    Some(Fault::HostSilent),
    Some(Fault::PressSignal),
    Some(Fault::HeadSwitch),
    Some(Fault::RetractFailed),
];

fn states() -> Vec<State> {
    let mut phases = std::vec![Phase::Armed, Phase::Clear, Phase::Claiming, Phase::Entered];
    phases.extend(CAUSES.map(Phase::Locked));
    phases.extend(CAUSES.map(Phase::Withdrawing));
    let mut states = Vec::new();
    for phase in phases {
        for flags in 0..8 {
            states.push(State {
                phase,
                disagrees: flags & 1 != 0,
                contradicts: flags & 2 != 0,
                cycling: flags & 4 != 0,
            });
        }
    }
    states
}

fn inputs() -> impl Iterator<Item = Inputs> {
    let positions = [Position::Unknown, Position::Retracted, Position::Away];
    (0..1u32 << 14).flat_map(move |bits| {
        let bit = move |n: u32| bits & (1 << n) != 0;
        positions.into_iter().map(move |position| Inputs {
            press_open_a: bit(0),
            press_open_b: bit(1),
            die_clear: bit(2),
            guard_closed: bit(3),
            cycle_began: bit(4),
            retract_switch: bit(5),
            position,
            host_alive: bit(6),
            orders: Orders {
                release: bit(7),
                enter: bit(8),
                retract: bit(9),
            },
            expired: Expired {
                disagreement: bit(10),
                contradiction: bit(11),
                phase: bit(12),
                stay: bit(13),
            },
        })
    })
}

/// Where the cause holds, the effect must.
fn implies(cause: bool, effect: bool) -> bool {
    !cause || effect
}

/// Requirements that the step breaks.
fn broken(before: State, input: &Inputs, after: State) -> Option<&'static str> {
    let (was, is) = (outputs(before), outputs(after));
    let proven_out = input.retract_switch && input.position == Position::Retracted;
    let all_well = input.press_open_a
        && !input.press_open_b
        && input.die_clear
        && input.guard_closed
        && !input.cycle_began
        && !before.cycling
        && input.host_alive
        && input.position != Position::Unknown;
    let signal_dead = before.disagrees && input.expired.disagreement;
    let switch_dead = before.contradicts && input.expired.contradiction;
    let was_in = matches!(before.phase, Phase::Claiming | Phase::Entered);
    let locked = |state: State| matches!(state.phase, Phase::Locked(_));
    let cause = |state: State| match state.phase {
        Phase::Locked(cause) | Phase::Withdrawing(cause) => cause,
        _ => None,
    };
    let checks = [
        (
            "head-clear only with the switch made at a known, retracted position",
            !is.head_clear || proven_out,
        ),
        (
            "never head-clear while the head may enter or retracts",
            !(is.head_clear && (is.may_enter || is.retract)),
        ),
        (
            "the head may enter only while all is well",
            !is.may_enter || all_well,
        ),
        (
            "the head may enter only after the press had its time to obey",
            !is.may_enter
                || was.may_enter
                || (before.phase == Phase::Claiming && input.expired.phase),
        ),
        (
            "the press is claimed only by an order, from clear",
            after.phase != Phase::Claiming
                || before.phase == Phase::Claiming
                || (before.phase == Phase::Clear && input.orders.enter),
        ),
        (
            "any loss while the head is in starts the retract in the same step",
            !was_in || all_well || is.retract,
        ),
        (
            "retract wins: it ends every claim and stay, and lets none begin",
            !input.orders.retract || (!is.may_enter && after.phase != Phase::Claiming),
        ),
        (
            "a retract order while the head is in starts the retract in the same step",
            !(was_in && input.orders.retract) || is.retract,
        ),
        (
            "nothing leaves the locked state without an order",
            !locked(before) || input.orders.release || after.phase == before.phase,
        ),
        (
            "leaving the locked state lets neither the press nor the head go",
            !locked(before) || !(is.head_clear || is.may_enter || is.retract),
        ),
        (
            "channels that disagree for too long allow nothing",
            !signal_dead
                || locked(before)
                || input.orders.release
                || !(is.head_clear || is.may_enter),
        ),
        (
            "switch and position that contradict each other for too long allow nothing",
            !switch_dead
                || locked(before)
                || input.orders.release
                || !(is.head_clear || is.may_enter),
        ),
        (
            "dead signals end in a cause",
            !(signal_dead || switch_dead)
                || locked(before)
                || (input.orders.release && before.phase == Phase::Clear)
                || cause(after).is_some(),
        ),
        (
            "a cause is forgotten by a release only",
            cause(before).is_none()
                || cause(after) == cause(before)
                || (locked(before) && input.orders.release),
        ),
        (
            "a retract goes on until the head is proven out or its time is over",
            !was.retract || is.retract || proven_out || input.expired.phase,
        ),
        (
            "a retract that is not done in time locks",
            !(was.retract && input.expired.phase && !proven_out) || locked(after),
        ),
        (
            "head-clear ends in the step in which its proof does",
            !was.head_clear || proven_out || !is.head_clear,
        ),
        (
            "a head that leaves by itself is called back",
            !(was.head_clear && !proven_out && !input.orders.release) || is.retract,
        ),
        (
            "a cycle is remembered until the press is seen not open",
            !(before.cycling || input.cycle_began)
                || after.cycling
                || !input.press_open_a
                || input.press_open_b,
        ),
        (
            "the press is not held beyond its limit: the retract starts in the same step",
            !(was_in && input.expired.stay) || is.retract,
        ),
        (
            "the limit alone does not lock: the press is let go once the head is out",
            !(was_in && input.expired.stay && all_well && !signal_dead && !switch_dead)
                || after.phase == Phase::Withdrawing(None),
        ),
        // The rest keeps the rules from being safe by never allowing anything.
        (
            "a retract without a cause ends clear",
            implies(
                before.phase == Phase::Withdrawing(None)
                    && proven_out
                    && !signal_dead
                    && !switch_dead,
                is.head_clear,
            ),
        ),
        (
            "an armed interlock clears as soon as the head is proven out",
            implies(
                before.phase == Phase::Armed && proven_out && !signal_dead && !switch_dead,
                is.head_clear,
            ),
        ),
        (
            "an entry is granted when all is well",
            !(before.phase == Phase::Clear
                && input.orders
                    == Orders {
                        enter: true,
                        ..Orders::default()
                    }
                && all_well
                && proven_out
                && !signal_dead
                && !switch_dead)
                || after.phase == Phase::Claiming,
        ),
        (
            "a stay is not ended without a reason",
            !(was.may_enter
                && all_well
                && !input.orders.retract
                && !input.expired.stay
                && !signal_dead
                && !switch_dead)
                || is.may_enter,
        ),
    ];
    checks
        .into_iter()
        .find_map(|(name, holds)| (!holds).then_some(name))
}

/// Steps tried, and how often each requirement was broken.
fn check<const OFF: u32>() -> (u64, BTreeMap<&'static str, u64>) {
    let (mut tried, mut found) = (0, BTreeMap::new());
    let vectors: Vec<Inputs> = inputs().collect();
    for before in states() {
        for input in &vectors {
            tried += 1;
            if let Some(name) = broken(before, input, decide::<OFF>(before, input)) {
                *found.entry(name).or_default() += 1;
            }
        }
    }
    (tried, found)
}

#[test]
fn no_state_with_any_input_breaks_a_requirement() {
    let (tried, found) = check::<0>();
    println!(
        "{} states x {} input vectors = {tried} steps",
        states().len(),
        tried / states().len() as u64
    );
    assert_eq!(tried, 192 * 49_152);
    assert_eq!(found, BTreeMap::new());
}

#[test]
fn power_up_allows_nothing_whatever_comes_in() {
    let mut reached = std::collections::HashSet::from([State::POWER_UP]);
    let vectors: Vec<Inputs> = inputs().filter(|input| !input.orders.release).collect();
    loop {
        let next: Vec<State> = reached
            .iter()
            .flat_map(|&state| vectors.iter().map(move |input| decide::<0>(state, input)))
            .filter(|state| !reached.contains(state))
            .collect();
        if next.is_empty() {
            break;
        }
        reached.extend(next);
    }
    for state in reached {
        assert_eq!(outputs(state), Default::default(), "{state:?}");
    }
}

macro_rules! without_each {
    ($($number:literal)*) => {
        [$((Rule::ALL[$number], check::<{ 1 << $number }>())),*]
    };
}

#[test]
fn every_rule_is_missed_when_it_is_switched_off() {
    let runs = without_each!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20);
    assert_eq!(runs.len(), Rule::ALL.len());
    for (number, (rule, (_, found))) in runs.into_iter().enumerate() {
        assert_eq!(rule as usize, number);
        println!(
            "without {rule:?}: {} steps break a requirement: {:?}",
            found.values().sum::<u64>(),
            found.keys().collect::<Vec<_>>()
        );
        assert!(!found.is_empty(), "nobody misses {rule:?}");
    }
}

/// What a change of phase stands for; the model says which changes there are.
fn meaning(from: &str, to: &str) -> &'static str {
    match (from, to) {
        ("Locked", "Armed") => "home, acknowledge",
        ("Armed", "Clear") => "switch made and retracted",
        ("Clear", "Armed") => "home",
        ("Clear", "Claiming") => "start",
        ("Claiming", "Entered") => "the press had its time to obey",
        ("Claiming", "Withdrawing") => "retract, any loss, held too long",
        ("Entered", "Withdrawing") => "retract, any loss, held too long",
        ("Clear", "Withdrawing") => "the head is not proven out any more",
        ("Withdrawing", "Clear") => "out, without a fault",
        ("Withdrawing", "Locked") => "out after a fault, or not out in time",
        (_, "Locked") => "signals dead for too long",
        _ => "?",
    }
}

#[test]
fn every_change_of_phase_is_drawn_in_the_readme_and_no_other() {
    let name = |phase: Phase| match phase {
        Phase::Locked(_) => "Locked",
        Phase::Armed => "Armed",
        Phase::Clear => "Clear",
        Phase::Claiming => "Claiming",
        Phase::Entered => "Entered",
        Phase::Withdrawing(_) => "Withdrawing",
    };
    let vectors: Vec<Inputs> = inputs().collect();
    let mut changes = diagrams::Changes::new();
    for before in states() {
        for input in &vectors {
            let (from, to) = (name(before.phase), name(decide::<0>(before, input).phase));
            if from != to {
                let causes = changes.entry((from.into(), to.into())).or_default();
                causes.insert(meaning(from, to).into());
            }
        }
    }
    diagrams::assert_drawn(
        "interlock",
        &diagrams::mermaid("Locked", ("", &[]), &changes),
    );
}
