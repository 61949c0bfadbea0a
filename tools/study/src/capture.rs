//! One capture of one view, from the bench's light to a judged flank, without separate processes.

use std::sync::Arc;

use anyhow::Context;
use flankscope_jobs::inspection::{Evaluator, ViewOutcome};
use flankscope_jobs::plan::ViewPlan;
use flankscope_jobs::subject::Subject;
use flankscope_metrology::gear::Flank;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::decode::GridKind;
use flankscope_profilometry::{
    Accumulator, DecodeOptions, Decoder, FrameKind, FrameView, HeadModel,
};
use flankscope_record::baseline::Baseline;
use flankscope_record::document::Feature;

use flankscope_bench::damage::Random;
use flankscope_bench::world::{PatternSpec, ViewState, World};

/// Half the range of the stages' errors: rotation, rad; vertical, mm.
const ROTATION_ERROR_RAD: f64 = 15e-3 * std::f64::consts::PI / 180.0;
const VERTICAL_ERROR_MM: f64 = 5e-3;
/// The host's data: tool, head, decoder and evaluator.
pub(super) struct Instrument {
    decoder: Arc<Decoder>,
    evaluator: Evaluator,
    plan: Arc<ViewPlan>,
}

/// Pattern number of a frame, 0 for none, and index of its exposure; `sets` are periods and steps.
pub(super) fn shown(kind: FrameKind, sets: &[(f64, u32)]) -> (u32, usize) {
    match kind {
        FrameKind::Dark => (0, 0),
        FrameKind::Fringe {
            exposure,
            set,
            step,
        } => {
            let before: u32 = sets[..set].iter().map(|s| s.1).sum();
            (1 + before + step, exposure)
        }
        FrameKind::Code { .. } => unreachable!("the bench shows no code"),
    }
}

/// Adds all frames of a view to its sums: the dark one and all patterns by the first projector, then all by the second, if there
/// is one. `photograph` renders one frame; its arguments are the pattern of each projector, the index of the exposure, and the
/// index of the frame.
pub(super) fn add_all(
    sums: &mut Accumulator,
    decoder: &Decoder,
    sets: &[(f64, u32)],
    mut photograph: impl FnMut([Option<u16>; 2], usize, u32, &mut [u16]) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let [width, height] = decoder.size_px().map(|px| px as usize);
    let mut pixels = vec![0; width * height];
    let mut second = sums.take_second();
    let mut numbers = 0..;
    let mut photograph = |by_second: bool, kind: FrameKind, pixels: &mut [u16]| {
        let (pattern, exposure) = shown(kind, sets);
        let pattern = Some(u16::try_from(pattern)?);
        let light = match by_second {
            false => [pattern, None],
            true => [None, pattern],
        };
        photograph(light, exposure, numbers.next().unwrap_or_default(), pixels)
    };
    for kind in decoder.capture_order() {
        photograph(false, kind, &mut pixels)?;
        let frame = FrameView::packed(&pixels, width, height);
        sums.add(frame, kind).context("a rendered frame")?;
        if let (FrameKind::Dark, Some(second)) = (kind, &mut second) {
            second.add(frame, kind).context("a rendered frame")?;
        }
    }
    if let Some(mut second) = second {
        let lit = |kind: &FrameKind| *kind != FrameKind::Dark;
        for kind in decoder.capture_order().filter(lit) {
            photograph(true, kind, &mut pixels)?;
            let frame = FrameView::packed(&pixels, width, height);
            second.add(frame, kind).context("a rendered frame")?;
        }
        sums.put_second(second);
    }
    Ok(())
}

/// Faults of one capture, besides the stages' errors.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Trouble {
    /// Rotation of the die relative to the stage's reading, rad.
    pub turned_rad: f64,
    /// Fraction of the light that is missing.
    pub dimmed: f64,
    /// Repeating errors of the stages; none: all are drawn anew at each approach.
    pub stages: Option<Repeating>,
}

/// Stages whose errors repeat but for a part.
#[derive(Clone, Copy, Debug)]
pub(super) struct Repeating {
    /// Seed of what repeats.
    pub seed: u64,
    /// Share of the largest error that each approach draws anew.
    pub share: f64,
}

impl Instrument {
    pub fn new(
        tool: &Tool,
        head: &HeadModel,
        tooth: u32,
        grid: GridKind,
        degc: Option<f64>,
        baseline: Option<Baseline>,
    ) -> anyhow::Result<Self> {
        let subject = Subject {
            tool: Arc::new(tool.clone()),
            head: Arc::new(head.clone()),
            temperature_degc: degc,
            station: Arc::default(),
            baseline: baseline.map(Arc::new),
            head_seal: "unsigned".into(),
            seals: flankscope_record::seal::Seals::passing()?,
            hashes: std::collections::BTreeMap::new(),
        };
        let plan = Arc::new(ViewPlan::new(tool, head, Some(&[tooth]))?);
        let decoder = Arc::new(Decoder::new(
            head,
            &plan.patterns,
            &plan.exposures_us,
            DecodeOptions {
                grid,
                ..DecodeOptions::for_head(head)
            },
        )?);
        let evaluator = Evaluator::new(&subject, Arc::clone(&decoder), &plan)?;
        Ok(Self {
            decoder,
            evaluator,
            plan,
        })
    }

    /// Moves die and head to the view's position; `draw` draws the stages' errors.
    pub fn approach(
        &self,
        world: &World,
        draw: u64,
        trouble: Trouble,
    ) -> anyhow::Result<ViewState> {
        self.approach_view(0, world, draw, trouble)
    }

    fn approach_view(
        &self,
        number: usize,
        world: &World,
        draw: u64,
        trouble: Trouble,
    ) -> anyhow::Result<ViewState> {
        let anew = Random::new(draw, 1 + number as u64);
        let mut random =
            trouble
                .stages
                .map_or([(1.0, anew.clone()), (0.0, anew.clone())], |stages| {
                    let repeated = Random::new(stages.seed, 1 + number as u64);
                    [(stages.share, anew), (1.0 - stages.share, repeated)]
                });
        let mut error = || -> f64 {
            let part =
                |(share, random): &mut (f64, Random)| *share * (2.0 * random.uniform() - 1.0);
            random.iter_mut().map(part).sum()
        };
        let view = self.plan.all_views().nth(number);
        let view = view.context("a view of the plan")?;
        let rotation = view.rotation_rad + ROTATION_ERROR_RAD * error() + trouble.turned_rad;
        let vertical = view.vertical_mm + VERTICAL_ERROR_MM * error();
        Ok(world.prepare(rotation, vertical, &PatternSpec::sequence(&self.sets()))?)
    }

    /// Captures and judges one view; then, as a check does, the further views that could decide what it leaves open. `number` is
    /// the seed of the frames' noise, `draw` that of the stages' errors.
    pub fn capture_all(
        &self,
        world: &World,
        state: &ViewState,
        (number, draw): (u32, u64),
        trouble: Trouble,
    ) -> anyhow::Result<ViewOutcome> {
        let mut outcome = self.capture(world, state, number, trouble)?;
        for view in outcome.further_wanted(&self.plan) {
            let state = self.approach_view(view, world, draw, trouble)?;
            // Noise of its own.
            let number = number.wrapping_add((view as u32) << 20);
            let further = self.capture_view(view, world, &state, number, trouble)?;
            outcome = outcome.with_further(view, further);
        }
        Ok(outcome)
    }

    /// Captures and judges one view; `number` is the seed of the frames' noise.
    pub fn capture(
        &self,
        world: &World,
        state: &ViewState,
        number: u32,
        trouble: Trouble,
    ) -> anyhow::Result<ViewOutcome> {
        self.capture_view(0, world, state, number, trouble)
    }

    fn capture_view(
        &self,
        view: usize,
        world: &World,
        state: &ViewState,
        number: u32,
        trouble: Trouble,
    ) -> anyhow::Result<ViewOutcome> {
        let mut accumulator = self.decoder.begin();
        let photograph = |light: [Option<u16>; 2], exposure: usize, i: u32, pixels: &mut [u16]| {
            let lit_us = f64::from(self.plan.exposures_us[exposure]) * (1.0 - trouble.dimmed);
            let counter = number.wrapping_mul(64).wrapping_add(i);
            Ok(world.expose(state, light, lit_us as u32, counter, pixels)?)
        };
        add_all(&mut accumulator, &self.decoder, &self.sets(), photograph)?;
        Ok(self.evaluator.evaluate(view, &accumulator))
    }

    fn sets(&self) -> Vec<(f64, u32)> {
        let sets = self.plan.patterns.sets.iter();
        sets.map(|s| (s.periods, s.steps)).collect()
    }
}

/// The result for one flank of the tooth.
pub(super) fn judged(outcome: &ViewOutcome, flank: Flank) -> anyhow::Result<Feature> {
    outcome
        .flanks
        .iter()
        .cloned()
        .map(Feature::from)
        .find(|f| f.id.flank == flank)
        .with_context(|| format!("the {flank} flank is missing"))
}
