//! Deviation maps in space: one page to turn, with a section of every flank, drawn by the browser (WebGL2) from data in the page.
//!
//! ```text
//!  Map3d  parts (flanks, patches) and grids of cells in tool coordinates
//!    │ data()   JSON; positions and deviations as base64 of i16, little-endian
//!    │ page()   map3d.html with this JSON and map3d.js
//! ```

use askama::Template;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flankscope_metrology::verdict::Word;
use serde::Serialize;

use super::{Fact, chart, colour};

/// Most cells of a page; more are joined to larger ones.
const MOST_CELLS: usize = 200_000;
/// Joined cells are at most this many times more rows than columns: rows follow the axis, along which a flank changes slowly.
const ROWS_PER_COLUMN: usize = 4;
/// Place of a cell whose position or deviation is unknown, in the arrays.
const ABSENT: i16 = i16::MIN;
/// Entries of the colour table over the whole scale, so many that the colour of one differs little from the next.
const COLOURS: usize = 1001;

/// A flank or patch, as the page names it.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Part {
    /// Name in a sentence: `tooth 40 left`.
    pub name: String,
    /// Label in the picture, common to parts that belong together: the number of a tooth.
    pub mark: String,
    /// Its wear with U95, or what is known instead.
    pub wear: String,
    /// Its verdict; none if it was not judged.
    pub verdict: Option<Word>,
    /// Unit normal out of the material: the picture is first seen from there.
    pub outward: [f64; 3],
}

/// Cells on a surface, row by row.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    /// Index of its part; none between the flanks.
    pub part: Option<usize>,
    /// Middle of every column along the surface, mm.
    pub along_mm: Vec<f64>,
    /// Height of the first row's middle, and of every next row relative to the one before, mm.
    pub up_mm: [f64; 2],
    /// Middles of the cells, tool coordinates, mm; not finite where unknown.
    pub middles_mm: Vec<[f64; 3]>,
    /// Deviation from the CAD, positive where material stands proud, µm; not finite where a cell was not seen.
    pub deviation_um: Vec<f64>,
}

/// Everything that the page shows.
#[derive(Clone, Debug)]
pub(super) struct Map3d {
    /// What was measured: `In-situ check`.
    pub what: &'static str,
    pub tool: String,
    pub date: String,
    pub verdict: Word,
    pub reason: String,
    pub simulated: bool,
    /// Entries below the title.
    pub facts: Vec<Fact>,
    /// Half of the colour scale's range, µm.
    pub full_um: f64,
    /// Warn and stop limit of the loss, µm.
    pub limits_um: Option<[f64; 2]>,
    /// Names of the lengths along and up, with unit.
    pub axes: [&'static str; 2],
    /// Whether the cells enclose a bore, whose near half is left out of the picture.
    pub bore: bool,
    pub parts: Vec<Part>,
    pub grids: Vec<Grid>,
    /// Outlines of the die, as lines through points in tool coordinates, mm.
    pub lines_mm: Vec<Vec<[f64; 3]>>,
}

#[derive(Template)]
#[template(path = "map3d.html")]
struct Page<'a> {
    of: &'a Map3d,
    simulated: bool,
    facts: &'a [Fact],
    colour_bar: String,
    joined: Option<[usize; 2]>,
    data: String,
}

/// The JSON of the page.
#[derive(Serialize)]
struct Data<'a> {
    full_um: f64,
    limits_um: Option<[f64; 2]>,
    axes: [&'static str; 2],
    bore: bool,
    /// Red, green and blue of the scale from its lower to its upper end, a byte each.
    colours: String,
    unmeasured: [[u8; 3]; 2],
    parts: &'a [Part],
    grids: Vec<GridData>,
    /// A stored position times the step plus the origin is the position, mm.
    origin_mm: [f64; 3],
    step_mm: f64,
    /// Positions of all cells, grid by grid: x, y, z.
    middles: String,
    /// A stored deviation times this is the deviation, µm.
    step_um: f64,
    deviations: String,
    /// Number of points of every line, and their positions.
    line_points: Vec<usize>,
    lines: String,
}

#[derive(Serialize)]
struct GridData {
    part: Option<usize>,
    along_mm: Vec<f64>,
    up_mm: [f64; 2],
    rows: usize,
}

impl Grid {
    fn rows(&self) -> usize {
        self.deviation_um.len() / self.along_mm.len().max(1)
    }

    fn cells_joined_by(&self, [columns, rows]: [usize; 2]) -> usize {
        self.along_mm.len().div_ceil(columns) * self.rows().div_ceil(rows)
    }

    /// The grid with so many columns and rows joined to one: a cell is the mean of those that were seen.
    fn joined_by(&self, [columns, rows]: [usize; 2]) -> Self {
        let width = self.along_mm.len();
        let (mut middles_mm, mut deviation_um) = (Vec::new(), Vec::new());
        for top in (0..self.rows()).step_by(rows) {
            for left in (0..width).step_by(columns) {
                let lines = top..(top + rows).min(self.rows());
                let block: Vec<usize> = lines
                    .flat_map(|row| {
                        (left..(left + columns).min(width)).map(move |c| row * width + c)
                    })
                    .collect();
                let of_axis =
                    |axis: usize| mean(block.iter().map(|&cell| self.middles_mm[cell][axis]));
                middles_mm.push([0, 1, 2].map(of_axis));
                deviation_um.push(mean(block.iter().map(|&cell| self.deviation_um[cell])));
            }
        }
        let [first_mm, step_mm] = self.up_mm;
        let lengths = self.along_mm.chunks(columns);
        Self {
            part: self.part,
            along_mm: lengths.map(|of| mean(of.iter().copied())).collect(),
            up_mm: [
                first_mm + 0.5 * (rows as f64 - 1.0) * step_mm,
                rows as f64 * step_mm,
            ],
            middles_mm,
            deviation_um,
        }
    }
}

/// Mean of the finite values; NaN without any.
fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let finite = values.filter(|value| value.is_finite());
    let (sum, count) = finite.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}

/// The value in steps; [`ABSENT`] if it is not finite.
fn in_steps(value: f64, step: f64) -> i16 {
    let most = f64::from(i16::MAX);
    match value.is_finite() {
        true => (value / step).round().clamp(-most, most) as i16,
        false => ABSENT,
    }
}

fn base64_of(values: impl Iterator<Item = i16>) -> String {
    STANDARD.encode(values.flat_map(i16::to_le_bytes).collect::<Vec<u8>>())
}

/// JSON that may stand in a `<script>`: nothing in it ends the element or begins a comment.
fn for_script(json: &str) -> String {
    // These characters occur in strings only, where JSON allows their numbers instead.
    json.replace('&', "\\u0026")
        .replace('<', "\\u003c")
        .replace('>', "\\u003e")
}

impl Map3d {
    /// Number of columns and rows that are joined so that the page has no more cells than `most`.
    fn joined(&self, most: usize) -> [usize; 2] {
        let cells = |by: [usize; 2]| {
            self.grids
                .iter()
                .map(|grid| grid.cells_joined_by(by))
                .sum::<usize>()
        };
        // A single cell per grid is as few as it can be.
        let steps = (1..)
            .flat_map(|columns| (1..=ROWS_PER_COLUMN * columns).map(move |rows| [columns, rows]));
        let fits = |by: &[usize; 2]| cells(*by) <= most.max(self.grids.len());
        steps.into_iter().find(fits).unwrap_or([1, 1])
    }

    /// The data of the page as JSON, for a `<script>` element; cells are joined as told by [`Self::joined`].
    ///
    /// # Errors
    /// Errors of the JSON writer; none occur, because all keys are strings.
    pub(super) fn data(&self, joined: [usize; 2]) -> Result<String, serde_json::Error> {
        let grids: Vec<Grid> = self
            .grids
            .iter()
            .map(|grid| grid.joined_by(joined))
            .collect();
        let cells = || grids.iter().flat_map(|grid| &grid.middles_mm);
        let outline = || self.lines_mm.iter().flatten();
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for point in cells()
            .chain(outline())
            .filter(|point| point.iter().all(|c| c.is_finite()))
        {
            low = [0, 1, 2].map(|k| low[k].min(point[k]));
            high = [0, 1, 2].map(|k| high[k].max(point[k]));
        }
        let origin_mm = [0, 1, 2].map(|k| match low[k].is_finite() {
            true => 0.5 * (low[k] + high[k]),
            false => 0.0,
        });
        let reach_mm = [0, 1, 2]
            .map(|k| high[k] - origin_mm[k])
            .into_iter()
            .fold(1e-3, f64::max);
        let most_um = grids.iter().flat_map(|grid| &grid.deviation_um);
        let most_um = most_um
            .filter(|um| um.is_finite())
            .fold(1.0, |most: f64, um| most.max(um.abs()));
        let [step_mm, step_um] = [reach_mm, most_um].map(|most| most / f64::from(i16::MAX));
        let stored =
            |point: &[f64; 3]| [0, 1, 2].map(|k| in_steps(point[k] - origin_mm[k], step_mm));
        let full = (COLOURS - 1) as f64;
        let colours = (0..COLOURS).flat_map(|i| colour::diverging(2.0 * i as f64 / full - 1.0));
        let data = Data {
            full_um: self.full_um,
            limits_um: self.limits_um,
            axes: self.axes,
            bore: self.bore,
            colours: STANDARD.encode(colours.collect::<Vec<u8>>()),
            unmeasured: colour::UNMEASURED,
            parts: &self.parts,
            origin_mm,
            step_mm,
            middles: base64_of(cells().flat_map(stored)),
            step_um,
            deviations: base64_of(
                grids
                    .iter()
                    .flat_map(|g| &g.deviation_um)
                    .map(|um| in_steps(*um, step_um)),
            ),
            line_points: self.lines_mm.iter().map(Vec::len).collect(),
            lines: base64_of(outline().flat_map(stored)),
            grids: grids
                .iter()
                .map(|grid| GridData {
                    part: grid.part,
                    // To a micrometre, which keeps the numbers short.
                    along_mm: grid
                        .along_mm
                        .iter()
                        .map(|mm| (mm * 1e3).round() / 1e3)
                        .collect(),
                    up_mm: grid.up_mm,
                    rows: grid.rows(),
                })
                .collect(),
        };
        Ok(for_script(&serde_json::to_string(&data)?))
    }

    /// The page.
    ///
    /// # Errors
    /// Errors of the template engine; none occur when formatting to memory.
    pub(super) fn page(&self) -> Result<String, askama::Error> {
        let joined = self.joined(MOST_CELLS);
        let page = Page {
            of: self,
            simulated: self.simulated,
            facts: &self.facts,
            colour_bar: chart::colour_bar(self.full_um, self.limits_um),
            joined: (joined != [1, 1]).then_some(joined),
            data: self
                .data(joined)
                .map_err(|error| askama::Error::Custom(Box::new(error)))?,
        };
        page.render()
    }
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;

    const GAP: [f64; 3] = [f64::NAN; 3];

    /// Two parts and a land: 3 × 2 cells, one of them unseen; 1 × 2 cells, one of them without a place.
    fn map() -> Map3d {
        let part = |name: &str| Part {
            name: name.into(),
            mark: "40".into(),
            wear: "wear 80.5 ± 4.2 µm (U95)".into(),
            verdict: Some(Word::NoGo),
            outward: [1.0, 0.0, 0.0],
        };
        let place = |i: usize| {
            [
                41.0 + 0.1 * i as f64,
                -0.037 * i as f64,
                30.0 + 0.3 * i as f64,
            ]
        };
        Map3d {
            what: "In-situ check",
            tool: "die".into(),
            date: "2026-01-31T12:00:05Z".into(),
            verdict: Word::NoGo,
            reason: "worn".into(),
            simulated: true,
            facts: vec![(crate::DATE, "2026-01-31T12:00:05Z".into())],
            full_um: 100.0,
            limits_um: Some([30.0, 50.0]),
            axes: ["along / mm", "mm up"],
            bore: false,
            parts: vec![part("tooth 40 left"), part("tooth 40 right")],
            grids: vec![
                Grid {
                    part: Some(0),
                    along_mm: vec![0.05, 0.15, 0.25],
                    up_mm: [33.0, -0.1],
                    middles_mm: (0..6).map(place).collect(),
                    deviation_um: vec![-80.5, -0.1, f64::NAN, 0.0, 3.25, 12.0],
                },
                Grid {
                    part: None,
                    along_mm: vec![0.0],
                    up_mm: [0.0, 0.25],
                    middles_mm: vec![[-41.0, 7.0, 66.0], GAP],
                    deviation_um: vec![1.5, f64::NAN],
                },
            ],
            lines_mm: vec![vec![[-43.25, 0.0, 33.0], [43.25, 1.0, 33.0]]],
        }
    }

    /// The JSON of a page, as a browser finds it.
    fn data_of(page: &str) -> Value {
        let (_, after) = page
            .split_once(r#"<script type="application/json" id="data">"#)
            .unwrap();
        serde_json::from_str(after.split_once("</script>").unwrap().0).unwrap()
    }

    fn shorts(of: &Value) -> Vec<i16> {
        let bytes = STANDARD.decode(of.as_str().unwrap()).unwrap();
        bytes
            .chunks(2)
            .map(|two| i16::from_le_bytes([two[0], two[1]]))
            .collect()
    }

    /// Positions and deviations of all cells as the page holds them; none where absent.
    fn cells_of(data: &Value) -> Vec<(Option<[f64; 3]>, Option<f64>)> {
        let step = |key: &str| data[key].as_f64().unwrap();
        let origin = [0, 1, 2].map(|k| data["origin_mm"][k].as_f64().unwrap());
        let (middles, deviations) = (shorts(&data["middles"]), shorts(&data["deviations"]));
        assert_eq!(middles.len(), 3 * deviations.len());
        let place = |of: &[i16]| [0, 1, 2].map(|k| origin[k] + f64::from(of[k]) * step("step_mm"));
        let seen = |stored: i16| (stored != ABSENT).then(|| f64::from(stored) * step("step_um"));
        let places = middles
            .chunks(3)
            .map(|of| (of[0] != ABSENT).then(|| place(of)));
        places.zip(deviations.into_iter().map(seen)).collect()
    }

    #[test]
    fn the_page_holds_every_position_and_deviation_and_no_value_where_nothing_was_seen() {
        let map = map();
        let data = data_of(&map.page().unwrap());
        let stored = cells_of(&data);
        let told: Vec<_> = map
            .grids
            .iter()
            .flat_map(|grid| grid.middles_mm.iter().zip(&grid.deviation_um))
            .collect();
        assert_eq!(stored.len(), told.len());
        for ((place, um), (&told_place, &told_um)) in stored.into_iter().zip(told) {
            assert_eq!(place.is_some(), told_place[0].is_finite());
            assert_eq!(um.is_some(), told_um.is_finite());
            let off_um = um.map_or(0.0, |um| (um - told_um).abs());
            assert!(off_um < 0.01, "{um:?} {told_um}");
            let off_mm = place.map_or(0.0, |place| {
                (0..3)
                    .map(|k| (place[k] - told_place[k]).abs())
                    .fold(0.0, f64::max)
            });
            // The die is 87 mm wide.
            assert!(off_mm < 0.001, "{place:?} {told_place:?}");
        }
        let first = &data["grids"][0];
        assert_eq!(
            (first["rows"].as_u64(), first["part"].as_u64()),
            (Some(2), Some(0))
        );
        assert_eq!(first["along_mm"][1].as_f64(), Some(0.15));
        assert!(data["grids"][1]["part"].is_null());
        assert_eq!(data["line_points"][0].as_u64(), Some(2));
        assert_eq!(shorts(&data["lines"]).len(), 6);
    }

    #[test]
    fn the_colours_are_those_of_the_report() {
        let data = data_of(&map().page().unwrap());
        let colours = STANDARD.decode(data["colours"].as_str().unwrap()).unwrap();
        let of = |share: f64| {
            let entry = ((share + 1.0) * 0.5 * (COLOURS - 1) as f64).round() as usize;
            [0, 1, 2].map(|k| colours[3 * entry + k])
        };
        for share in [-1.0, -0.5, 0.0, 0.1, 1.0] {
            assert_eq!(of(share), colour::diverging(share));
        }
    }

    #[test]
    fn names_from_files_stay_text() {
        let hostile = "</script><b>&\"'<!--";
        let mut map = map();
        (map.tool, map.reason) = (hostile.into(), hostile.into());
        map.facts.push(("tool", hostile.into()));
        map.parts[1].name = hostile.into();
        map.parts[1].mark = hostile.into();
        let page = map.page().unwrap();
        assert!(!page.contains("<b>") && !page.contains("<!--"), "{page}");
        // The data, the program, and the local time of every page, each with its end.
        assert_eq!(page.matches("</script>").count(), 3);
        assert_eq!(data_of(&page)["parts"][1]["name"].as_str(), Some(hostile));
    }

    #[test]
    fn the_page_needs_no_network_and_says_where_it_is_from() {
        let page = map().page().unwrap();
        for address in ["http", "//cdn", "import(", "fetch(", "url(", " src="] {
            assert!(!page.contains(address), "{address}");
        }
        let title = page
            .split_once("<title>")
            .unwrap()
            .1
            .split_once("</title>")
            .unwrap()
            .0;
        for word in ["SIMULATED BENCH", "no-go", "die", "2026-01-31"] {
            assert!(title.contains(word), "{title}");
        }
        let real = Map3d {
            simulated: false,
            ..map()
        };
        assert!(!real.page().unwrap().contains("SIMULATED"));
    }

    #[test]
    fn a_large_map_is_joined_to_cells_that_are_means_of_what_was_seen() {
        let mut map = map();
        map.grids.truncate(1);
        assert_eq!(map.joined(6), [1, 1]);
        // Two rows become one.
        assert_eq!(map.joined(3), [1, 2]);
        let joined = map.grids[0].joined_by([1, 2]);
        let expected = [-40.25, 1.575, 12.0];
        for (got, expected) in joined.deviation_um.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-9, "{got} {expected}");
        }
        assert!((joined.up_mm[0] - 32.95).abs() < 1e-9 && (joined.up_mm[1] + 0.2).abs() < 1e-9);
        assert!((joined.middles_mm[0][0] - 41.15).abs() < 1e-9);
        // The last column is joined with none.
        let joined = map.grids[0].joined_by([2, 2]);
        assert_eq!((joined.along_mm.len(), joined.deviation_um.len()), (2, 2));
        map.grids[0].deviation_um = vec![f64::NAN; 6];
        assert!(map.grids[0].joined_by([3, 2]).deviation_um[0].is_nan());
        // No fewer cells than grids, however few are asked for.
        assert!(map.grids[0].cells_joined_by(map.joined(0)) == 1);
    }

    #[test]
    fn a_check_without_maps_has_a_page() {
        let map = Map3d {
            parts: Vec::new(),
            grids: Vec::new(),
            lines_mm: Vec::new(),
            ..map()
        };
        let page = map.page().unwrap();
        assert!(page.contains("Nothing was measured"));
        assert!(cells_of(&data_of(&page)).is_empty());
    }
}
