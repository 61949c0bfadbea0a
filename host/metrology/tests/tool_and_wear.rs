//! From a tool file with a gear of another CAD kernel to wear figures and verdicts.

mod support;

use std::path::{Path, PathBuf};

use flankscope_metrology::gear::Flank;
use flankscope_metrology::io::mesh::{self, TriMesh};
use flankscope_metrology::registration::{Contact, Options, Response, register};
use flankscope_metrology::surface::sampling;
use flankscope_metrology::tool::{Tool, ToolError};
use flankscope_metrology::verdict::{Code, Verdict, combine, decide};
use flankscope_metrology::wear::leakage;
use flankscope_metrology::wear::{self, Figure, FlankWear, Measured, evaluate};
use support::{Random, on_every_ring84_file};

const FILE: &str = r#"
name = "ring84"
[cad]
file = "CAD"
unit = "mm"
chord_error_um = 4.3
[gear]
kind = "internal"
teeth = 84
module_mm = 1.0
pressure_angle_deg = 20.0
tip_radius_mm = 41.0
root_radius_mm = 43.25
first_tooth_centre_deg = 2.142857142857143
height_mm = [0.0, 66.0]
[inspect]
teeth = [1, 84]
height_mm = 33.0
warn_um = 30.0
limit_um = 50.0
"#;

fn load(folder: &Path, text: &str, cad: &Path) -> Result<Tool, ToolError> {
    let text = text.replace("CAD", cad.to_str().unwrap());
    std::fs::write(folder.join("tool.toml"), text).unwrap();
    Tool::load(folder)
}

/// A view of a few teeth about +x with noise; `wear_mm` says how much is lost where.
fn view(tool: &Tool, seed: u64, wear_mm: impl Fn(u32, Flank, f64, f64) -> f64) -> Vec<[f64; 3]> {
    let gear = tool.gear.as_ref().unwrap();
    let mut random = Random::new(seed);
    let mut points = Vec::new();
    for round in 0.. {
        for p in sampling::sample(&tool.mesh, 2_000_000, 77 * seed + round).unwrap() {
            let seen = p[1].atan2(p[0]).abs() < 0.13 && (p[2] - 33.0).abs() < 5.0 && p[0] < 44.0;
            if !seen {
                continue;
            }
            let closest = tool.surface.closest(p);
            let lost = gear.place(closest.point, closest.normal).map_or(0.0, |at| {
                wear_mm(at.tooth, at.flank, at.radius_mm, at.height_mm)
            });
            points.push(std::array::from_fn(|k| {
                p[k] - lost * closest.normal[k] + 0.010 * random.normal()
            }));
        }
        if points.len() > 60_000 {
            break;
        }
    }
    points
}

fn measure(tool: &Tool, points: &[[f64; 3]]) -> Vec<FlankWear> {
    let found = register(
        &tool.surface,
        points,
        None,
        &Options {
            teeth: Some(84),
            ..Options::default()
        },
    );
    assert!(found.is_registered(), "{:?}", found.status);
    let laid: Vec<[f64; 3]> = points
        .iter()
        .map(|&p| found.tool_from_cloud.apply(p))
        .collect();
    let closest = tool.surface.closest_many(&laid);
    let measured = Measured {
        points: &laid,
        closest: &closest,
        sigma_mm: None,
        sight: None,
    };
    evaluate(
        tool.gear.as_ref().unwrap(),
        &tool.zone().unwrap(),
        &tool.inspect.as_ref().unwrap().teeth,
        measured,
        Some(&found),
        &tool.wear_settings(),
    )
}

fn verdict(tool: &Tool, wear: &FlankWear) -> Verdict {
    let inspect = tool.inspect.as_ref().unwrap();
    let unknown = Figure {
        value: f64::NAN,
        u: f64::NAN,
    };
    let Figure { value, u } = wear.wear_mm().unwrap_or(unknown);
    decide(1e3 * value, 1e3 * u, &inspect.rule())
}

#[test]
fn an_undamaged_gear_is_go_and_wear_is_no_go_on_exactly_its_flank() {
    on_every_ring84_file(run_an_undamaged_gear_is_go);
}

fn run_an_undamaged_gear_is_go(cad: PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let tool = load(folder.path(), FILE, &cad).unwrap();

    let good = measure(&tool, &view(&tool, 1, |_, _, _, _| 0.0));
    assert_eq!(good.len(), 4);
    for wear in &good {
        println!("{wear:?}");
        assert_eq!(verdict(&tool, wear), Verdict::Go);
        // Points fall at random: of cells that expect n of them, exp(-n) have none.
        let cells = wear.field.wear_mm.len() as f64;
        let depth_mm = wear.wear_mm().unwrap();
        let expected = 1.0 - (-(wear.points as f64) / cells).exp();
        assert!((wear.coverage - expected).abs() < 0.02, "{}", wear.coverage);
        assert!(
            depth_mm.value.abs() < 3.0 * depth_mm.u && depth_mm.u < 6e-3,
            "{wear:?}"
        );
        let figures = wear.judged.unwrap().read;
        assert_eq!(figures.worn_area_mm2.value, 0.0);
        assert_eq!(figures.lost_volume_mm3.value, 0.0);
    }

    // 80 um off one flank.
    let worn = measure(
        &tool,
        &view(&tool, 2, |tooth, flank, _, _| {
            if (tooth, flank) == (1, Flank::Right) {
                0.080
            } else {
                0.0
            }
        }),
    );
    for wear in &worn {
        println!("{wear:?}");
        let is_worn = (wear.tooth, wear.flank) == (1, Flank::Right);
        assert_eq!(
            verdict(&tool, wear),
            if is_worn { Verdict::NoGo } else { Verdict::Go },
            "{wear:?}"
        );
        if is_worn {
            let depth_mm = wear.wear_mm().unwrap();
            assert!(
                (depth_mm.value - 0.080).abs() < 3.0 * depth_mm.u,
                "{wear:?}"
            );
        }
    }
    assert_eq!(
        combine(worn.iter().map(|w| verdict(&tool, w))),
        Verdict::NoGo
    );
}

#[test]
fn a_pit_counts_by_its_depth_and_not_by_its_mean() {
    on_every_ring84_file(run_a_pit_counts_by_its_depth);
}

fn run_a_pit_counts_by_its_depth(cad: PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let tool = load(folder.path(), FILE, &cad).unwrap();
    let pit = |tooth, flank, radius: f64, height: f64| {
        let inside = (tooth, flank) == (84, Flank::Left)
            && (radius - 42.0).abs() < 0.45
            && (height - 33.0).abs() < 0.55;
        if inside { 0.080 } else { 0.0 }
    };
    for wear in measure(&tool, &view(&tool, 3, pit)) {
        println!("{wear:?}");
        if (wear.tooth, wear.flank) == (84, Flank::Left) {
            let judged = wear.judged.unwrap();
            assert!((judged.wear_mm.value - 0.080).abs() < 0.012, "{wear:?}");
            assert!(judged.mean_mm.value < 0.02, "{wear:?}");
            // About 0.95 x 1.1 mm, 80 um deep; cells of the rim count half or not at all.
            let figures = judged.read;
            assert!(
                (figures.worn_area_mm2.value - 1.05).abs() < 0.45,
                "{figures:?}"
            );
            let u = figures.lost_volume_mm3.u;
            assert!(
                (figures.lost_volume_mm3.value - 0.084).abs() < 0.008 + 2.0 * u,
                "{figures:?}"
            );
            assert_eq!(verdict(&tool, &wear), Verdict::NoGo);
        } else {
            assert_eq!(verdict(&tool, &wear), Verdict::Go);
        }
    }
}

#[test]
fn a_flank_that_was_not_seen_is_indeterminate() {
    on_every_ring84_file(run_a_flank_that_was_not_seen);
}

fn run_a_flank_that_was_not_seen(cad: PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let tool = load(folder.path(), FILE, &cad).unwrap();
    let measured = Measured {
        points: &[],
        closest: &[],
        sigma_mm: None,
        sight: None,
    };
    let wear = evaluate(
        tool.gear.as_ref().unwrap(),
        &tool.zone().unwrap(),
        &[40],
        measured,
        None,
        &tool.wear_settings(),
    );
    assert_eq!(wear.len(), 2);
    for flank in &wear {
        assert_eq!(flank.coverage, 0.0);
        assert!(matches!(
            verdict(&tool, flank),
            Verdict::Indeterminate { .. }
        ));
    }
}

#[test]
fn wrong_tool_files_are_named() {
    on_every_ring84_file(run_wrong_tool_files_are_named);
}

fn run_wrong_tool_files_are_named(cad: PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let refused = |from: &str, to: &str| {
        assert!(FILE.contains(from));
        load(folder.path(), &FILE.replace(from, to), &cad).unwrap_err()
    };
    // An unknown key: the line of the key, and the keys that are known.
    let error = refused("teeth = 84", "tooth_count = 84");
    assert!(
        matches!(
            error,
            ToolError::Syntax {
                line: 9,
                column: 1,
                ..
            }
        ),
        "{error}"
    );
    let text = error.to_string();
    assert!(
        text.contains("tooth_count") && text.contains("expected") && !text.contains('\n'),
        "{text}"
    );

    assert!(matches!(
        refused("teeth = 84", "teeth = 83"),
        ToolError::Gear { .. } | ToolError::Teeth { .. } | ToolError::Value { .. }
    ));
    let error = refused("teeth = [1, 84]", "teeth = [1, 85]");
    assert!(
        matches!(
            error,
            ToolError::Value {
                key: "inspect.teeth",
                ..
            }
        ),
        "{error}"
    );
    let error = refused(
        "first_tooth_centre_deg = 2.142857142857143",
        "first_tooth_centre_deg = 0.0",
    );
    assert!(matches!(error, ToolError::Disagree { .. }), "{error}");
    let error = refused("module_mm = 1.0\n", "module_mm = 0.99\n");
    assert!(matches!(error, ToolError::Disagree { .. }), "{error}");
    let error = refused("unit = \"mm\"", "unit = \"m\"");
    assert!(matches!(error, ToolError::Mesh { .. }), "{error}");
    let error = refused("warn_um = 30.0", "warn_um = 60.0");
    assert!(
        matches!(
            error,
            ToolError::Value {
                key: "inspect.warn_um",
                ..
            }
        ),
        "{error}"
    );
    // No limit that no damage can reach, no zone beside the toothing, no verdict on what was not seen.
    for (from, to, named) in [
        (
            "limit_um = 50.0",
            "limit_um = 10000.0",
            "inspect.limit_um = 10000",
        ),
        ("limit_um = 50.0", "limit_um = 800.0", "at most 785.3982"),
        (
            "limit_um = 50.0",
            "limit_um = inf",
            "inspect.limit_um = inf",
        ),
        (
            "limit_um = 50.0",
            "limit_um = 50.0\ncell_limit_um = 2000.0",
            "inspect.cell_limit_um",
        ),
        (
            "limit_um = 50.0",
            "limit_um = 50.0\nproud_limit_um = 2000.0",
            "inspect.proud_limit_um",
        ),
        (
            "limit_um = 50.0",
            "limit_um = 50.0\ntip_limit_mm = 2.0",
            "inspect.tip_limit_mm",
        ),
        (
            "limit_um = 50.0",
            "limit_um = 50.0\nhidden_depth_um = 0.0",
            "inspect.hidden_depth_um = 0",
        ),
        (
            "limit_um = 50.0",
            "limit_um = 50.0\nleast_coverage = 0.0",
            "0.5 to 1",
        ),
        (
            "limit_um = 50.0",
            "limit_um = 50.0\nleast_coverage = nan",
            "0.5 to 1",
        ),
        (
            "limit_um = 50.0",
            "limit_um = 50.0\nzone_height_mm = [40.0, 60.0]",
            "gear.height_mm",
        ),
        (
            "limit_um = 50.0",
            "limit_um = 50.0\nzone_height_mm = [-40.0, 4.0]",
            "gear.height_mm",
        ),
        (
            "limit_um = 50.0",
            "limit_um = 50.0\nwear_area_mm2 = 60.0",
            "fits into the judged zone",
        ),
        (
            "height_mm = 33.0",
            "height_mm = 64.0",
            "zone_height_mm[1] = 4",
        ),
        (
            "root_radius_mm = 43.25",
            "root_radius_mm = 1024.0",
            "gear.root_radius_mm = 1024",
        ),
        ("root_radius_mm = 43.25", "root_radius_mm = 43.55", "mm off"),
        (
            "tip_radius_mm = 41.0",
            "tip_radius_mm = 40.88",
            "gear.tip_radius_mm",
        ),
        (
            "height_mm = [0.0, 66.0]",
            "height_mm = [0.0, 90.0]",
            "gear.height_mm[1] = 90",
        ),
        (
            "height_mm = [0.0, 66.0]",
            "height_mm = [-5.0, 66.0]",
            "gear.height_mm[0] = -5",
        ),
    ] {
        let error = refused(from, to).to_string();
        assert!(error.contains(named), "{to}: {error}");
        assert!(!error.contains("NaN, "), "{error}");
    }
    let error = refused("\"CAD\"", "\"missing.stl\"");
    assert!(error.to_string().contains("missing.stl"), "{error}");
    let error = Tool::load(&folder.path().join("nowhere")).unwrap_err();
    assert!(matches!(error, ToolError::Read { .. }), "{error}");
}

/// The predicted leakage against what the fit really hides: the same noisy points laid on CAD without and with wear.
#[test]
fn leakage_is_what_the_fit_takes_away() {
    on_every_ring84_file(run_leakage_is_what_the_fit_takes_away);
}

fn run_leakage_is_what_the_fit_takes_away(cad: PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let tool = load(folder.path(), FILE, &cad).unwrap();
    let (gear, zone) = (tool.gear.as_ref().unwrap(), tool.zone().unwrap());
    let depth_mm = 0.004;
    let judged = (1, Flank::Right);
    let worn = |tooth, flank, _: f64, _: f64| {
        if (tooth, flank) == judged {
            depth_mm
        } else {
            0.0
        }
    };
    let (fresh, worn) = (view(&tool, 5, |_, _, _, _| 0.0), view(&tool, 5, worn));
    let options = Options {
        teeth: Some(84),
        ..Options::default()
    };
    // Of the judged tooth nothing is used by the first fit, everything by the second.
    for use_judged in [false, true] {
        let near = |p: &[f64; 3]| gear.tooth_at(p[1].atan2(p[0])) == judged.0;
        let fit = |points: &[[f64; 3]]| {
            // Chosen by the fresh points: wear must not change who takes part.
            let used: Vec<[f64; 3]> = points
                .iter()
                .zip(&fresh)
                .filter(|(_, f)| use_judged || !near(f))
                .map(|(p, _)| *p)
                .collect();
            register(&tool.surface, &used, None, &options)
        };
        let (before, after) = (fit(&fresh), fit(&worn));
        let laid: Vec<[f64; 3]> = worn
            .iter()
            .map(|&p| after.tool_from_cloud.apply(p))
            .collect();
        let closest = tool.surface.closest_many(&laid);
        let contacts: Vec<Contact> = closest
            .iter()
            .zip(&fresh)
            .map(|(c, f)| Contact::from_closest(c, &after, use_judged || !near(f)))
            .collect();
        let places = wear::places(gear, &closest);
        let response = Response::new(&contacts, &after, None, &options);
        let both = leakage::of_feature(gear, &zone, judged.0, &response, &contacts, &places);
        let leakage = both[usize::from(judged.1 == Flank::Right)];
        // How far the second pose moved each judged point along its normal, against the first.
        let (mut hidden, mut count) = (0.0_f64, 0.0_f64);
        for ((point, closest), place) in worn.iter().zip(&closest).zip(&places) {
            let inside = place.is_some_and(|p| {
                (p.tooth, p.flank) == judged && zone.holds(p.radius_mm, p.height_mm)
            });
            if inside {
                let (a, b) = (
                    before.tool_from_cloud.apply(*point),
                    after.tool_from_cloud.apply(*point),
                );
                let moved: f64 = (0..3).map(|k| (b[k] - a[k]) * closest.normal[k]).sum();
                hidden += moved * moved;
                count += 1.0;
            }
        }
        let seen = (hidden / count).sqrt() / depth_mm;
        println!("{use_judged}: predicted {leakage:?}, seen {seen}");
        // Welsch weights answer to the wear itself, a second-order effect: (4 um / 30 um)2.
        assert!(
            (leakage.uniform - seen).abs() < 0.02 + 0.05 * seen,
            "{leakage:?} against {seen}"
        );
        if use_judged {
            assert!(leakage.uniform > 0.1, "{leakage:?}");
        } else {
            assert!(leakage.worst() < 0.02, "{leakage:?}");
        }
        assert!(leakage.side > 0.3, "{leakage:?}");
    }
}

#[test]
fn temperature_is_asked_for_and_kept_to_its_range() {
    on_every_ring84_file(run_temperature_is_asked_for);
}

fn run_temperature_is_asked_for(cad: PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(load(folder.path(), FILE, &cad).unwrap().temperature, None);
    let text = format!("{FILE}\n[temperature]\nrange_degc = [10.0, 80.0]\n");
    let tool = load(folder.path(), &text, &cad).unwrap();
    let temperature = tool.temperature.unwrap();
    assert_eq!(temperature.scale(Some(20.0)), Ok(1.0));
    // Steel: 11.5 um per metre and kelvin.
    let warm = temperature.scale(Some(60.0)).unwrap();
    assert!((warm - 1.000_46).abs() < 1e-12, "{warm}");
    for degc in [9.9, 80.1, f64::NAN, f64::INFINITY] {
        let refused = temperature.scale(Some(degc)).unwrap_err();
        assert_eq!(refused.code(), Code::TemperatureRange);
    }
    assert_eq!(
        temperature.scale(None).unwrap_err().code(),
        Code::TemperatureMissing
    );
    let wrong = text.replace("[10.0, 80.0]", "[80.0, 10.0]");
    assert!(load(folder.path(), &wrong, &cad).is_err());
}

/// A bore without its outer wall is open: only the gear data say on which side of it the die is.
#[test]
fn the_cad_of_a_tool_is_wound_as_its_gear_says() {
    let folder = tempfile::tempdir().unwrap();
    let solid = support::mesh_of(&support::ring84_spec(), 4e-3);
    let is_bore = |triangle: &[u32; 3]| {
        triangle.iter().all(|&i| {
            let [x, y, _] = solid.vertices[i as usize];
            x.hypot(y) < 44.0
        })
    };
    let bore = TriMesh {
        vertices: solid.vertices.clone(),
        triangles: solid.triangles.iter().copied().filter(is_bore).collect(),
    };
    let inverted = |mesh: &TriMesh| {
        let mut mesh = mesh.clone();
        mesh.turn_inside_out();
        mesh
    };
    let halved = TriMesh {
        triangles: bore
            .triangles
            .iter()
            .enumerate()
            .map(|(i, &[a, b, c])| if i % 2 == 0 { [a, b, c] } else { [a, c, b] })
            .collect(),
        ..bore.clone()
    };
    let load = |mesh: &TriMesh| {
        let path = folder.path().join("cad.stl");
        mesh::write_stl(&mut std::fs::File::create(&path).unwrap(), mesh).unwrap();
        load(folder.path(), FILE, &path)
    };
    // In the gap between two teeth, 0.1 mm from a flank.
    let gear = load(&solid).unwrap().gear.unwrap();
    let foot = gear.flank_point(5, Flank::Left, 42.0, 33.0).unwrap();
    let normal = gear.flank_normal(Flank::Left, foot);
    let proud: [f64; 3] = std::array::from_fn(|k| foot[k] + 0.1 * normal[k]);
    for mesh in [&solid, &inverted(&solid), &bore, &inverted(&bore)] {
        let tool = load(mesh).unwrap();
        let found = tool.surface.closest(proud).signed_distance_mm;
        assert!((found - 0.1).abs() < 5e-3, "{found}");
    }
    assert!(matches!(load(&halved), Err(ToolError::Unsigned { .. })));
    // Without the facets of one flank there is nothing to compare it with, open or not outside of it.
    for mesh in [&solid, &bore] {
        let is_flank = |triangle: &[u32; 3]| {
            let corners = triangle.map(|i| mesh.vertices[i as usize]);
            let near = |[x, y, _]: &[f64; 3]| (x - foot[0]).hypot(y - foot[1]) < 0.2;
            corners.iter().any(near)
        };
        let kept = mesh.triangles.iter().copied();
        let with_hole = TriMesh {
            triangles: kept.filter(|triangle| !is_flank(triangle)).collect(),
            ..mesh.clone()
        };
        assert!(with_hole.triangles.len() < mesh.triangles.len());
        let refused = load(&with_hole).unwrap_err();
        let ToolError::Open { hole_mm, .. } = refused else {
            panic!("{refused}");
        };
        assert!(
            (hole_mm[0] - foot[0]).hypot(hole_mm[1] - foot[1]) < 1.0,
            "{hole_mm:?}"
        );
    }
}
