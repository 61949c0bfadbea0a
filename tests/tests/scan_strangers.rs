//! A die that is not the CAD's, or that was put down turned: named, and no map that looks right.

use flankscope_tests::{Run, flankscope, run};

fn scan_of(die: &[&str]) -> Run {
    let common = [
        "scan", "--quiet", "--json", "-", "--speed", "max", "--views", "12x1",
    ];
    run(flankscope().args(common).args(die))
}

fn refused(run: &Run) -> &str {
    let reason = run.json["reason"].as_str().unwrap_or_default();
    assert_eq!(run.code, 2, "{reason} {}", run.stderr);
    assert_eq!(run.json["verdict"], "indeterminate");
    assert!(run.json["form"].is_null(), "{reason}: {}", run.json["form"]);
    reason
}

#[test]
fn another_module_is_named_though_every_view_lies_on_the_cad_almost_well() {
    // 0.7 % less than the CAD's 0.9869 mm, with as many teeth.
    let smaller = scan_of(&["--die", "84x0.98"]);
    let reason = refused(&smaller);
    assert!(
        reason.contains("another die") || reason.contains("other teeth"),
        "{reason}"
    );
    assert_eq!(smaller.json["features"].as_array().map(Vec::len), Some(0));
}

#[test]
fn a_tooth_less_on_the_same_circle_is_named() {
    let coarser = scan_of(&["--die", "83x0.998795"]);
    let reason = refused(&coarser);
    assert!(
        reason.contains("83 teeth") || reason.contains("other teeth"),
        "{reason}"
    );
}

#[test]
fn a_die_turned_by_about_half_a_tooth_is_ambiguous() {
    let turned = scan_of(&["--turned-deg", "2.1"]);
    let reason = refused(&turned);
    assert!(
        reason.contains("put down turned") && reason.contains("ambiguous tooth"),
        "{reason}"
    );
}

#[test]
fn a_text_that_is_no_die_is_refused() {
    let wrong = scan_of(&["--die", "eighty"]);
    assert_eq!(wrong.code, 3);
    assert!(wrong.stderr.contains("83x0.9869"), "{}", wrong.stderr);
}
