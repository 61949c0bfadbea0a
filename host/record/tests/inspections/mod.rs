//! Results of checks that nobody made.

use flankscope_metrology::gear::Flank;
use flankscope_metrology::verdict::Word;
use flankscope_record::die::DieKey;
use flankscope_record::document::{
    Evidence, Feature, FeatureId, FrameCount, Inspection, Phasors, Pictures, Recipe, Timing,
};
use flankscope_record::origin::{HeadId, Origin};
use flankscope_record::seal::Seals;

/// A station that was there before this test: the same for the whole process, gone with its build folder.
pub fn seals() -> Seals {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("station");
    Seals::open(&folder).unwrap()
}

/// A check of six flanks after `press_cycles`, with a verdict and a reason.
pub fn inspection(press_cycles: u32, verdict: Word, reason: &str) -> Inspection {
    let feature = |tooth, flank: Flank| Feature {
        id: FeatureId {
            tooth,
            flank,
            patch: None,
        },
        wear_um: Some(f64::from(press_cycles) / 8.0),
        u95_um: Some(4.0),
        at_least_um: None,
        mean_um: Some(0.0),
        coverage_ratio: 1.0,
        warn_um: 30.0,
        limit_um: 50.0,
        conformity: Some(1.0),
        detail: None,
        measurements: Vec::new(),
        verdict,
        reason: None,
        code: None,
    };
    let bytes: Vec<u8> = (0..1024)
        .flat_map(|i| (i ^ press_cycles).to_le_bytes())
        .collect();
    let phasors = Phasors {
        blake3: flankscope_foundation::files::hash(&bytes),
        bytes,
    };
    Inspection {
        id: None,
        origin: Origin {
            link: "sim".into(),
            simulated: true,
            head: HeadId {
                name: "demo, 20 mm".into(),
                blake3: "ab".repeat(32),
                seal: "signed".into(),
            },
            station: "press 7".into(),
            operator: None,
            recording: None,
        },
        date: "2026-01-31T12:00:00Z".into(),
        last_exposure: None,
        verdict,
        reason: reason.into(),
        features: [12, 40, 68]
            .into_iter()
            .flat_map(|tooth| [feature(tooth, Flank::Left), feature(tooth, Flank::Right)])
            .collect(),
        in_view: Vec::new(),
        missing_teeth: Vec::new(),
        tooth_identity: None,
        timing_ms: Timing::default(),
        frames: FrameCount::default(),
        press_cycles,
        peak_memory_mb: None,
        registration: Vec::new(),
        tool: "die".into(),
        die: DieKey {
            tool: "die".into(),
            geometry: "geometry of die".into(),
            serial: None,
        },
        temperature_degc: None,
        versions: [("host", "0.1.0".to_owned())].into(),
        hashes: [("cad", "0".repeat(64))].into(),
        recipe: Recipe::default(),
        evidence: vec![Evidence {
            further: Vec::new(),
            tooth: 12,
            phasors: vec![phasors.blake3.clone()],
            problem: None,
        }],
        stopped: None,
        stopped_code: None,
        truth: None,
        phasors: vec![phasors],
        fields: Vec::new(),
        neighbours: Vec::new(),
        poses: Vec::new(),
        approaches: None,
        pictures: Pictures::default(),
    }
}
