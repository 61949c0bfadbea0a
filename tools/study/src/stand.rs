//! A calibrated head in front of dies given as meshes, one after another.

use std::sync::Arc;

use flankscope_bench::damage::Rectangle;
use flankscope_bench::world::{CoreTruth, DieMesh, FlankId, World};
use flankscope_bench::zones::{Judged, ZoneTruth, compare};
use flankscope_gear_cad::{Flank, GearSpec, Mesh};
use flankscope_instrument::settings::Stages;
use flankscope_jobs::inspection::ViewOutcome;
use flankscope_metrology::tool::Tool;
use flankscope_metrology::wear::{Approaches, PoseEvidence};
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::decode::GridKind;
use flankscope_record::baseline::Baseline;
use flankscope_tests::die::bore;

use super::calibration::Calibrated;
use super::capture::{Instrument, Trouble};
use super::setup::{Place, Setup, own_seed};
use super::truth;

/// A datum band and the judged zone above it, from the middle of the view, mm.
const BAND_MM: [f64; 2] = [-4.5, -0.2];
const ABOVE_BAND_MM: [f64; 2] = [0.3, 4.0];

/// A head, calibrated on the bench, at one place.
pub(super) struct Stand {
    world: World,
    head: HeadModel,
    tool: Tool,
    instrument: Instrument,
    /// Faults of every capture.
    pub trouble: Trouble,
    pub place: Place,
    /// Seed of all random numbers for this head.
    pub seed: u64,
    /// Judged rectangle of a flank, and the disc's area, mm².
    pub judged: Rectangle,
    pub disc_area_mm2: f64,
}

impl Stand {
    /// Head number `number`; `built`: the tool states the form error of a die as built.
    pub fn new(setup: &Setup, number: u32, seed: u64, built: bool) -> anyhow::Result<Self> {
        Self::of(
            setup,
            &Self::calibrated(setup, number, seed)?,
            number,
            seed,
            built,
        )
    }

    /// Calibrates head number `number`, for [`Self::of`].
    pub fn calibrated(setup: &Setup, number: u32, seed: u64) -> anyhow::Result<Calibrated> {
        Calibrated::first_of(&setup.made, own_seed(number, seed))
    }

    /// As [`Self::new`], of a head that is calibrated.
    pub fn of(
        setup: &Setup,
        Calibrated { rig, head, .. }: &Calibrated,
        number: u32,
        seed: u64,
        built: bool,
    ) -> anyhow::Result<Self> {
        let own = own_seed(number, seed);
        let head = setup.throwing(head.clone());
        let place = Place::of_block(number);
        let tool = setup.tool(place, built);
        let (judged, disc_area_mm2) = truth::judged(&tool)?;
        Ok(Self {
            world: World::new(&setup.world(rig, false, own))?,
            instrument: Instrument::new(&tool, &head, place.tooth, GridKind::Core, None, None)?,
            head,
            tool,
            trouble: Trouble::default(),
            place,
            seed: own,
            judged,
            disc_area_mm2,
        })
    }

    /// Replaces the tool by one whose pose rests on a single band of the flanks below the judged zone.
    pub fn with_datum_band(mut self) -> anyhow::Result<Self> {
        let middle_mm = self.place.height_mm;
        if let Some(inspect) = &mut self.tool.inspect {
            inspect.zone_height_mm = ABOVE_BAND_MM;
            inspect.datum_height_mm = vec![BAND_MM.map(|mm| middle_mm + mm)];
        }
        (self.judged, self.disc_area_mm2) = truth::judged(&self.tool)?;
        let (tool, head) = (&self.tool, &self.head);
        self.instrument =
            Instrument::new(tool, head, self.place.tooth, GridKind::Core, None, None)?;
        Ok(self)
    }

    /// Gives the instrument a baseline of a sound bore by this many approaches.
    pub fn with_baseline(mut self, approaches: u32) -> anyhow::Result<Self> {
        let golden = self.look(bore(|_| 0.0, &[]), 0)?;
        let mut poses: Vec<PoseEvidence> = golden.pose.into_iter().collect();
        for number in 1..approaches {
            poses.extend(self.look(bore(|_| 0.0, &[]), number)?.pose);
        }
        let sigma_rad = Stages::default().approach_sigma().0;
        let baseline = Baseline {
            tool: self.tool.name.clone(),
            hashes: std::collections::BTreeMap::new(),
            simulated: true,
            flanks: golden.fields,
            poses: PoseEvidence::of_approaches(&poses).into_iter().collect(),
            in_view: Vec::new(),
            approaches: Approaches::from_views(&[poses], sigma_rad),
        };
        let tooth = self.place.tooth;
        let (tool, head) = (&self.tool, &self.head);
        self.instrument = Instrument::new(tool, head, tooth, GridKind::Core, None, Some(baseline))?;
        Ok(self)
    }

    pub fn gear(&self) -> &GearSpec {
        self.world.gear()
    }

    /// Both flanks of the judged tooth.
    pub fn flanks(&self) -> [FlankId; 2] {
        let tooth = self.place.tooth;
        [Flank::Left, Flank::Right].map(|flank| FlankId { tooth, flank })
    }

    /// Replaces the die.
    pub fn put(&mut self, die: Mesh) -> anyhow::Result<()> {
        self.world.stand(Some(Arc::new(DieMesh::new(die)?)))?;
        Ok(())
    }

    /// Replaces the die, approaches it again and judges one view; `number` is the seed of stage errors and noise.
    pub fn look(&mut self, die: Mesh, number: u32) -> anyhow::Result<ViewOutcome> {
        Ok(self.look_truly(die, number)?.0)
    }

    /// Like [`Self::look`]; also returns the true points that the view's cores see.
    pub fn look_truly(
        &mut self,
        die: Mesh,
        number: u32,
    ) -> anyhow::Result<(ViewOutcome, Vec<CoreTruth>)> {
        self.put(die)?;
        let draw = (self.seed << 24) | u64::from(number);
        let state = self.instrument.approach(&self.world, draw, self.trouble)?;
        let outcome =
            self.instrument
                .capture_all(&self.world, &state, (number, draw), self.trouble)?;
        Ok((outcome, self.world.truth(&state).to_vec()))
    }

    /// Whether a DMD pixel is inside the projector circle of the head file.
    pub fn is_in_projector_circle(&self, pixel: [f64; 2]) -> bool {
        let circle = self.head.projector_circle.as_ref();
        circle.is_none_or(|circle| circle.contains(pixel))
    }

    /// True values of both flanks of the present die, by exact distances.
    pub fn truths(&self, cad: &Mesh) -> [ZoneTruth; 2] {
        let base_mm = self.gear().base_radius_mm();
        let radius = |profile: f64| (base_mm * base_mm + 2.0 * base_mm * profile).sqrt();
        let zone = Judged {
            cad: cad.clone(),
            gear: self.gear().clone(),
            flanks: self.flanks().to_vec(),
            radius_mm: self.judged.profile_mm.map(radius),
            height_mm: self.judged.height_mm,
            disc_area_mm2: self.disc_area_mm2,
        };
        let truths = compare(&self.world, &zone);
        self.flanks()
            .map(|id| truths.get(&id).copied().unwrap_or_default())
    }
}
