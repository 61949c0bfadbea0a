//! Conformity of a gear with an accuracy class: every quantity against its tolerance, with the same guard bands as wear.

use super::{Code, Reason, Rule, Verdict, Word, combine, decide};
use crate::gear::GearData;
use crate::gear::evaluation::{EvaluationSettings, GearEvaluation, Rating};

/// Verdict on the conformity of every quantity of an evaluation with `class`, at this probability, and its reason.
pub fn holds_class(
    gear: &GearData,
    evaluation: &GearEvaluation,
    settings: &EvaluationSettings,
    class: u32,
    probability: f64,
) -> (Verdict, String) {
    let ratings = &evaluation.ratings;
    let judged: Vec<(Verdict, String)> = ratings
        .iter()
        .map(|rating| of_rating(rating, gear, settings, class, probability))
        .collect();
    let verdict = combine(judged.iter().map(|(verdict, _)| verdict.clone()));
    if verdict == Verdict::Go {
        let seen = ratings.iter().map(|rating| rating.flanks).min();
        let why = format!(
            "every quantity holds class {class} on at least {} of {} flanks",
            seen.unwrap_or(0),
            2 * gear.teeth
        );
        return (verdict, why);
    }
    let alike = judged
        .into_iter()
        .filter(|(of, _)| of.word() == verdict.word());
    let why: Vec<String> = alike.map(|(_, why)| why).collect();
    (verdict, why.join("; "))
}

/// Only clearly beyond its tolerance a quantity breaks a class, only clearly within it holds it.
fn of_rating(
    rating: &Rating,
    gear: &GearData,
    settings: &EvaluationSettings,
    class: u32,
    probability: f64,
) -> (Verdict, String) {
    let open = |code, why: String| {
        let reason = Reason::instrument(code, &why);
        (Verdict::Indeterminate { reason }, why)
    };
    let symbol = rating.symbol;
    let tolerance_um = rating.quantity.tolerance_um(gear, class);
    let Some(value_um) = rating.value_um else {
        return open(
            Code::NotTold,
            format!("{symbol} is not told: {}", rating.why_not_told()),
        );
    };
    let rule = Rule {
        probability,
        ..Rule::new(tolerance_um, tolerance_um)
    };
    let settings = settings.of_quantity(rating.quantity);
    let verdict = decide(value_um, settings.u_um(), &rule);
    let capable = rating
        .best_stateable_class
        .is_some_and(|least| class >= least);
    match verdict.word() {
        Word::NoGo => {
            let why = format!("{symbol} = {value_um:.1} um, tolerance {tolerance_um} um");
            (verdict, why)
        }
        _ if !capable => {
            let ratio = settings.u95_um / tolerance_um;
            let why = format!("{symbol}: not capable for class {class}, U/T = {ratio:.2}");
            open(Code::NotCapable, why)
        }
        Word::Go | Word::Warn => (verdict, String::new()),
        Word::Indeterminate => {
            let guard_um = settings.guard_um(probability);
            let why = format!(
                "{symbol} = {value_um:.1} um is within {guard_um:.1} um of its tolerance {tolerance_um} um"
            );
            (verdict, why)
        }
    }
}
