//! All figures and tables of one scan: the document.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use flankscope_foundation::date;
use flankscope_foundation::rigid::Rigid;
use flankscope_metrology::deviation::SampleTree;
use flankscope_metrology::multiview::adjustment::Stages;
use flankscope_metrology::multiview::cylinder::{Around, CylinderMap, Layout};
use flankscope_metrology::tool::Tool;
use flankscope_metrology::view::PlannedView;
use nalgebra::Isometry3;
use serde::Serialize;

use crate::comparison::{JointSolve, MethodResult};
use crate::drawn::{Drawn, coordinates, laid};
use crate::method::{self, ArticleSettings, Drawing};
use crate::{
    Alignment, ArticleError, InSpace, InitialTransformation, Left, MaskPicture, Merging, Overlay,
    Sections, SerialLayer, ViewPoints, alignment, merging, overlay, serial, threshold,
};

/// Views of which every point is compared with the surface, for the threshold curves: at most so many, evenly among all.
const RATED_VIEWS: usize = 12;
/// Views of figure 17.
const OVERLAID: usize = 3;
/// Cells of the maps: per tooth, and their height, mm.
const COLUMNS_PER_TOOTH: usize = 12;
const ROW_MM: f64 = 0.5;

/// How many points of a view each step leaves.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct DrawingSteps {
    /// View, by its number.
    pub view: usize,
    /// Kept of the scan: without those that stood alone.
    pub measured: usize,
    /// That the mask left.
    pub masked: usize,
    /// That denoising left.
    pub denoised: usize,
    /// That were drawn.
    pub drawn: usize,
}

/// The whole: serialised as article.json.
#[derive(Clone, Debug, Serialize)]
pub struct Article {
    /// Tool name.
    pub tool: String,
    /// When it was made: ISO 8601, UTC.
    pub date: String,
    /// Whose views these are: grid, hashes, and what stood on a simulated bench.
    pub of: BTreeMap<String, String>,
    /// What the article's method was told.
    pub settings: ArticleSettings,
    /// Ours and the article's, as in a scan's document.
    pub methods: Vec<MethodResult>,
    /// Mean number of steps of the article's registrations.
    pub mean_iterations: Option<f64>,
    /// What each step leaves of every view.
    pub steps: Vec<DrawingSteps>,
    /// What thresholds of the mask leave.
    pub threshold: Vec<Left>,
    /// Where the article's method laid its first view before registering it (figure 10).
    pub initial_transformation: Option<InitialTransformation>,
    /// The views by positions alone, one on the other, the article's way, ours.
    pub alignments: Vec<Alignment>,
    /// One view laid on the one before, layer by layer; empty where views of a layer do not overlap.
    pub serial: Vec<SerialLayer>,
    /// Why there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serial_refused: Option<String>,
    /// One point per voxel, at the article's poses and at ours.
    pub merging: Vec<Merging>,
    /// Cross-sections of the finest fringes; absent without recorded frames.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sections: Option<Sections>,
    /// Where the time went, ms.
    pub elapsed_ms: BTreeMap<&'static str, f64>,
    /// The first view that the article's method laid: for picking pairs.
    #[serde(skip)]
    pub first_view: FirstView,
    /// The mask over a view.
    #[serde(skip)]
    pub mask: MaskPicture,
    /// Measured points on reference points.
    #[serde(skip)]
    pub overlays: Vec<Overlay>,
    /// What the pictures in space show.
    #[serde(skip)]
    pub in_space: Option<InSpace>,
    /// Distances of the first view's points to the nearest reference point of its window, µm.
    #[serde(skip)]
    pub one_view_um: Vec<f64>,
    /// Cells of the maps.
    #[serde(skip)]
    pub layout: Layout,
    /// Views around, and layers.
    #[serde(skip)]
    pub grid: [u32; 2],
}

impl Article {
    /// Key of [`Article::of`] that says what stood on the simulated bench.
    pub const BENCH: &'static str = "bench";

    /// Whether the views are a simulated bench's.
    pub fn is_simulated(&self) -> bool {
        self.of.contains_key(Self::BENCH)
    }
}

/// A view in its camera's frame, mm.
#[derive(Clone, Debug)]
pub struct FirstView {
    /// Its number.
    pub view: usize,
    pub points: Vec<[f64; 3]>,
    /// How much the fringes oscillate around each, counts.
    pub fringes_dn: Vec<f64>,
}

/// A scan whose views were laid on the CAD by the joint solve.
pub struct StitchedScan<'a, P> {
    pub points: &'a P,
    pub tool: &'a Tool,
    /// Its views, layer by layer.
    pub planned: &'a [PlannedView],
    /// Views around, and layers.
    pub grid: [u32; 2],
    /// Whose views these are: grid, hashes, and what stood on a simulated bench.
    pub of: BTreeMap<String, String>,
    /// Die, head and stages as drawn.
    pub nominal: &'a Stages,
    /// Cells that the views are laid on each other in.
    pub layout: Layout,
    pub joint: JointSolve<'a>,
    /// The same in figures.
    pub ours: MethodResult,
    /// Where the time went so far, ms.
    pub elapsed_ms: BTreeMap<&'static str, f64>,
}

impl<P: ViewPoints> StitchedScan<'_, P> {
    /// Makes the article's figures, told `settings`, and which share of the pairs counts where a view is laid on the one before;
    /// without that, nine tenths of what neighbours have in common. `progress` is told of the views that are laid the article's way.
    ///
    /// # Errors
    /// No view lies on the CAD, or points cannot be read.
    pub fn article(
        self,
        settings: &ArticleSettings,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Article, ArticleError<P::Error>> {
        let Self {
            points: scanned,
            tool,
            planned,
            layout: cells,
            joint,
            mut elapsed_ms,
            ..
        } = self;
        let mut clock = Instant::now();
        let mut lap = |what| -> Duration {
            let took = clock.elapsed();
            elapsed_ms.insert(what, took.as_secs_f64() * 1e3);
            clock = Instant::now();
            took
        };
        let map = CylinderMap::new(cells);
        let stitched = method::stitch(
            scanned,
            tool,
            planned,
            self.nominal,
            map,
            settings,
            progress,
        )?;
        let took = lap("article");
        let shared = &joint.adjustment.stages;
        let theirs = MethodResult::of_article(&stitched, shared, settings, planned, took);

        let joint_poses: BTreeMap<usize, Isometry3<f64>> = joint
            .views
            .iter()
            .zip(&joint.adjustment.poses)
            .map(|((view, _), pose)| (*view, *pose.isometry()))
            .collect();
        let article_poses: BTreeMap<usize, Isometry3<f64>> = stitched
            .views
            .iter()
            .map(|of| (of.view, of.tool_from_camera))
            .collect();
        let Some((&first_view, &first_pose)) = article_poses.first_key_value() else {
            return Err(ArticleError::NothingLaid {
                views: joint_poses.len(),
            });
        };

        let mut steps = Vec::new();
        let mut views = BTreeMap::new();
        let mut rated = Vec::new();
        let middle = joint.views.get(joint.views.len() / 2).map(|of| of.0);
        let mut mask = None;
        let every = joint_poses.len().div_ceil(RATED_VIEWS).max(1);
        let mut first_points = None;
        for (at, (&view, pose)) in joint_poses.iter().enumerate() {
            let kept = scanned.view_points(view).map_err(ArticleError::Points)?;
            let drawing = Drawing::of_view(&kept, settings, view);
            steps.push(DrawingSteps {
                view,
                measured: kept.len(),
                masked: drawing.masked,
                denoised: drawing.denoised,
                drawn: drawing.points.len(),
            });
            views.extend(Drawn::of(&drawing.points).map(|drawn| (view, drawn)));
            if at % every == 0 {
                let laid = laid(&coordinates(&kept), pose);
                let closest = tool.surface.closest_many(&laid);
                rated.extend(threshold::rated(&kept, &closest, &cells));
            }
            if Some(view) == middle {
                mask = Some(threshold::picture(view, &kept));
            }
            if view == first_view {
                first_points = Some(FirstView {
                    view,
                    points: coordinates(&kept),
                    fringes_dn: kept.iter().map(|point| f64::from(point[4])).collect(),
                });
            }
        }
        let (Some(mask), Some(first_view)) = (mask, first_points) else {
            return Err(ArticleError::NothingLaid {
                views: joint_poses.len(),
            });
        };
        let threshold = threshold::curve(rated);
        lap("threshold");

        let stages = Stages::nominal(Rigid::from_isometry(Isometry3::identity()));
        let moved = |view: usize| *stages.tool_from_camera((&planned[view]).into()).isometry();
        let camera = moved(first_view.view).inverse() * first_pose;
        let by_positions: BTreeMap<usize, Isometry3<f64>> = joint_poses
            .keys()
            .map(|&view| (view, moved(view) * camera))
            .collect();
        let laid_on_each_other = serial::serial(
            &views,
            &joint_poses,
            planned,
            &settings.registration,
            settings.serial_inlier_ratio,
        );
        let (serial, serial_refused) = match laid_on_each_other {
            Ok(serial) => (serial, None),
            Err(why) => (serial::Serial::default(), Some(why)),
        };
        lap("serial");

        let reference = method::whole_reference(tool, settings);
        let reference = SampleTree::new(&reference)?;
        let layout = Layout {
            columns: COLUMNS_PER_TOOTH * tool.gear.as_ref().map_or(1, |gear| gear.teeth as usize),
            rows: ((cells.height_mm[1] - cells.height_mm[0]) / ROW_MM)
                .ceil()
                .clamp(1.0, 1e4) as usize,
            height_mm: cells.height_mm,
            around: Around::Angle,
        };
        let by = alignment::Yardstick {
            surface: &tool.surface,
            reference: &reference,
            order: settings.order,
            layout,
        };
        let (mut alignments, mut in_space) = (Vec::new(), None);
        for (name, poses) in [
            ("positions", &by_positions),
            ("serial", &serial.poses),
            ("article", &article_poses),
            ("surface", &joint_poses),
        ] {
            if poses.is_empty() {
                continue;
            }
            let (of, points) = Alignment::of(name, &views, poses, planned.len(), &by);
            if let ("article", Some(initial)) = (name, &stitched.initial) {
                let cloud = points.into_iter().zip(of.nearest_um.iter().copied());
                let (mesh, options) = (&tool.mesh, &settings.registration);
                in_space = InSpace::of(mesh, &views, poses, initial, options, cloud.collect());
            }
            alignments.push(of);
        }
        lap("alignments");
        let mut merging = Vec::new();
        for (name, poses) in [("article", &article_poses), ("surface", &joint_poses)] {
            merging.extend(merging::ways(
                name,
                &views,
                poses,
                settings.voxel_mm,
                &tool.surface,
            )?);
        }
        lap("merging");
        let (overlays, one_view_um) =
            overlay::overlays(&views, &article_poses, &tool.mesh, settings, OVERLAID);
        lap("overlays");
        Ok(Article {
            tool: tool.name.clone(),
            date: date::now(),
            of: self.of,
            settings: settings.clone(),
            mean_iterations: mean_of(&theirs),
            methods: vec![self.ours, theirs],
            steps,
            threshold,
            initial_transformation: stitched.initial,
            alignments,
            serial: serial.layers,
            serial_refused,
            merging,
            sections: None,
            elapsed_ms,
            first_view,
            mask,
            overlays,
            in_space,
            one_view_um,
            layout,
            grid: self.grid,
        })
    }
}

fn mean_of(theirs: &MethodResult) -> Option<f64> {
    let steps: Vec<usize> = theirs
        .iterations
        .iter()
        .flatten()
        .flatten()
        .copied()
        .collect();
    (!steps.is_empty()).then(|| steps.iter().sum::<usize>() as f64 / steps.len() as f64)
}
