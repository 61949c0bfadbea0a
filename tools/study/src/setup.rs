//! Heads, dies and places of the study.

use anyhow::Context;
use flankscope_gear_cad::Flank as CadFlank;
use flankscope_metrology::gear::Flank;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::HeadModel;

use super::calibration::Rig;
use flankscope_bench::config::SurfaceKind;
use flankscope_bench::files::MadeHead;
use flankscope_bench::specimen::Specimen;
use flankscope_bench::world::{Form, HeadDesign, WorldConfig};

/// Teeth and heights that blocks use in turn; their numbers have no common divisor, so that all combinations occur.
const TEETH: [u32; 8] = [40, 12, 68, 5, 27, 55, 77, 84];
const HEIGHTS_MM: [f64; 3] = [33.0, 24.0, 42.0];
/// Tolerance class of the dies.
const CLASS: u32 = 7;
/// Single pitch tolerance of ISO 1328-1:2013 in this class, of module 0.987 mm on 82.9 mm, µm: twice the value of the class 5 formula
/// 0.001 d + 0.4 m + 5.
const PITCH_TOLERANCE_UM: f64 = 10.96;
/// Standard deviation of the flanks of a die whose single pitch, the difference of two flanks, keeps that tolerance at three
/// standard deviations.
pub(super) const FLANKS_UM: f64 = PITCH_TOLERANCE_UM / (3.0 * std::f64::consts::SQRT_2);

/// The demo tool, and a head by its drawing.
pub(super) struct Setup {
    tool: Tool,
    head: HeadModel,
    /// World of the die and the head.
    die: WorldConfig,
    /// What the tool makes of the tolerance class of its drawing, µm.
    class_um: f64,
    /// Name of the pattern set.
    patterns: String,
    /// Design of the head; each head has its own cores and lenses in addition.
    pub made: HeadDesign,
}

/// Tooth and height that a block views.
#[derive(Clone, Copy, Debug, serde::Serialize, serde::Deserialize)]
pub(super) struct Place {
    pub tooth: u32,
    pub height_mm: f64,
}

impl Place {
    pub fn of_block(block: u32) -> Self {
        let block = block as usize;
        Self {
            tooth: TEETH[block % TEETH.len()],
            height_mm: HEIGHTS_MM[block % HEIGHTS_MM.len()],
        }
    }
}

impl Setup {
    pub fn load(made: Option<&MadeHead>) -> anyhow::Result<Self> {
        let folder = tempfile::tempdir()?;
        flankscope_demo::write_tool(folder.path(), made)?;
        let mut tool = Tool::load(folder.path())?;
        // The bench makes the die from the facets of its CAD, so there is no chord error.
        tool.cad.chord_error_um = 0.0;
        let head = HeadModel::load(&folder.path().join("head.toml"))?;
        let die = Specimen::tool(folder.path(), None)?.config;
        let file = folder.path().join("tool.toml");
        let inspect = format!("[inspect]\nas_built_class = {CLASS}\n");
        let by_class = std::fs::read_to_string(&file)?.replace("[inspect]\n", &inspect);
        std::fs::write(&file, by_class)?;
        let class_um = Tool::load(folder.path())?.as_built_um;
        let class_um = class_um.context("the demo tool does not take a tolerance class")?;
        let patterns = head
            .pattern_set
            .clone()
            .context("the demo head names no patterns")?;
        Ok(Self {
            tool,
            head,
            die,
            class_um,
            patterns,
            made: made.map_or_else(HeadDesign::demo, |made| HeadDesign::clone(&made.optics)),
        })
    }

    /// The same setup with dies of another surface, and another pattern set than the head's.
    pub fn with_surface(mut self, surface: SurfaceKind, patterns: Option<&str>) -> Self {
        self.die.surface = surface.surface();
        self.die.bounces = surface.bounces();
        if let Some(patterns) = patterns {
            patterns.clone_into(&mut self.patterns);
        }
        self
    }

    /// The head with this setup's patterns.
    pub fn throwing(&self, head: HeadModel) -> HeadModel {
        let own = head.pattern_set.as_ref() == Some(&self.patterns);
        HeadModel {
            pattern_set: Some(self.patterns.clone()),
            fringes: if own { head.fringes } else { Vec::new() },
            ..head
        }
    }

    /// Form as built by the tolerance class alone, as the tool file's `as_built_class` has it, µm.
    pub fn class_um(&self) -> f64 {
        self.class_um
    }

    /// Name of the pattern set that is thrown on the dies.
    pub fn patterns(&self) -> &str {
        &self.patterns
    }

    /// The drawing of the die.
    pub fn cad(&self) -> flankscope_gear_cad::Mesh {
        self.die.cad.clone()
    }

    /// The head with its cores.
    pub fn head(&self) -> &HeadModel {
        &self.head
    }

    /// The tool with its head at a place; it states the form error of a die as built, or assumes that the die agrees with the CAD.
    pub fn tool(&self, place: Place, built: bool) -> Tool {
        let mut tool = self.tool.clone();
        let pressure_angle_deg = tool.gear.as_ref().map_or(0.0, |g| g.pressure_angle_deg);
        if let Some(inspect) = &mut tool.inspect {
            inspect.height_mm = place.height_mm;
        }
        // Errors along the pitch circle act along the normal with the cosine of the pressure angle.
        let normal_um = FLANKS_UM * pressure_angle_deg.to_radians().cos();
        tool.as_built_um = built.then_some(normal_um);
        tool
    }

    /// World of the die and the head; `run` is the seed of surface grain and noise, and of a die as built.
    pub fn world(&self, rig: &Rig, built: bool, run: u64) -> WorldConfig {
        let mut config = self.die.clone();
        config.optics = rig.optics.clone();
        config.head_seed = rig.head_seed;
        config.run_seed = run;
        if built {
            config.form = Form {
                flanks_um: FLANKS_UM,
                flanks_seed: run,
                ..Form::default()
            };
        }
        config
    }
}

pub(super) fn flank(of_cad: CadFlank) -> Flank {
    match of_cad {
        CadFlank::Left => Flank::Left,
        CadFlank::Right => Flank::Right,
    }
}

/// Seed of all random numbers of a head.
pub(super) fn own_seed(number: u32, seed: u64) -> u64 {
    (seed << 16) | u64::from(number)
}

/// Calls `each` for all numbers below `count` on all cores that this process may use, each call on one core; results in order.
pub(super) fn on_all_cores<T: Send>(
    count: u32,
    each: impl Fn(u32) -> anyhow::Result<T> + Sync,
) -> anyhow::Result<Vec<T>> {
    use std::sync::atomic::{AtomicU32, Ordering};
    let next = AtomicU32::new(0);
    let worker = || {
        let mut done = Vec::new();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= count {
                return Ok(done);
            }
            done.push((number, each(number)?));
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let found: Vec<anyhow::Result<Vec<(u32, T)>>> = std::thread::scope(|scope| {
        let running: Vec<_> = (0..threads).map(|_| scope.spawn(worker)).collect();
        let joined = running.into_iter().map(|thread| thread.join());
        joined
            .map(|found| found.unwrap_or_else(|_| Err(anyhow::anyhow!("a block panicked"))))
            .collect()
    });
    let mut all = Vec::new();
    for found in found {
        all.extend(found?);
    }
    all.sort_by_key(|(number, _)| *number);
    Ok(all.into_iter().map(|(_, found)| found).collect())
}

/// Name of a surface.
pub(super) fn word(surface: SurfaceKind) -> &'static str {
    match surface {
        SurfaceKind::Sprayed => "sprayed",
        SurfaceKind::Ground => "ground",
        SurfaceKind::Polished => "polished",
        SurfaceKind::Oiled => "oiled",
    }
}
