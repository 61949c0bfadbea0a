//! The recipe of a check: the settings of a plan that tool and head file do not contain, so that a replay makes the same plan.

use flankscope_profilometry::DecodeOptions;
use flankscope_record::document::{Recipe, RecordedRecipe};

use crate::plan::ViewPlan;
use crate::subject::Subject;

/// Recipe of a check of `subject` by `plan`.
pub(crate) fn recipe(subject: &Subject, plan: &ViewPlan) -> Recipe {
    let teeth: Vec<u32> = plan.views.iter().map(|view| view.tooth).collect();
    let by_files = ViewPlan::new(&subject.tool, &subject.head, Some(&teeth));
    let light = plan.light();
    let by_files = by_files.is_ok_and(|by_files| by_files.lit(light.clone()) == *plan);
    let recorded = (!by_files).then(|| RecordedRecipe {
        views: plan.views.clone(),
        further: plan.further.clone(),
        patterns: plan.patterns.clone(),
        dark_frame: plan.dark_frame,
        sensor: plan.sensor,
        poses: plan.stated.all(),
    });
    Recipe {
        teeth,
        recorded,
        pattern_set: plan.patterns.name.clone(),
        lit_ratios: light.lit_ratios,
        exposures_us: plan.exposures_us.clone(),
        grid: DecodeOptions::for_head(&subject.head).grid,
        temperature_degc: subject.temperature_degc,
    }
}
