//! The timing diagram `firmware/timing.svg`, drawn from the edges of a capture in stepped time, so that it cannot lie.
//!
//! `FLANKSCOPE_DRAW=1 cargo test -p flankscope-bench --test timing` draws it anew.

mod common;

use common::{Host, Notebook, plan};
use flankscope_bench::devices::{DeviceConfig, spawn_all};
use flankscope_controller::sequence::Config;
use flankscope_protocol::{Command, Event};
use flankscope_sim::{Clock, Controller, Edge, Sim, Wiring, now_us};
use std::cell::Cell;
use std::fmt::Write;
use std::path::Path;
use std::rc::Rc;

const LINES: [(&str, &str); 7] = [
    ("led_enable", "LED enable"),
    ("led_sense", "LED sense"),
    ("dmd_trigger", "DMD trigger"),
    ("dmd_ready", "DMD ready"),
    ("camera_trigger", "camera trigger"),
    ("camera_exposing", "exposing"),
    ("camera_ready", "camera ready"),
];

/// A capture of one view.
fn edges() -> Vec<Edge> {
    let sim = Sim::new(Clock::Stepped);
    let wiring = Rc::new(Wiring::new(&sim));
    spawn_all(&sim, &wiring, &DeviceConfig::default(), Notebook::default());
    let _running = Controller::power_up(&sim, Rc::clone(&wiring), Config::DEFAULT);
    let finished = Rc::new(Cell::new(false));
    let (done, mut host) = (Rc::clone(&finished), Host::new(wiring.host.clone()));
    sim.spawn(async move {
        let mut plan = plan();
        plan.views.truncate(1);
        host.prepare(plan).await;
        host.order(Command::Start { session: 5 }).await;
        host.until(|event| matches!(event, Event::CaptureDone { .. }))
            .await;
        done.set(true);
    });
    sim.run_until(|| finished.get() || now_us() > 60_000_000);
    assert!(finished.get());
    sim.edges()
}

/// Where and what to draw of the edges.
struct Panel {
    title: &'static str,
    top: f64,
    from_us: u64,
    until_us: u64,
    /// Between two ticks of the axis.
    tick_us: u64,
}

const LEFT: f64 = 120.0;
const WIDTH: f64 = 840.0;
const ROW: f64 = 26.0;
const HIGH: f64 = 15.0;

impl Panel {
    fn x(&self, at_us: u64) -> f64 {
        let at = at_us.clamp(self.from_us, self.until_us) - self.from_us;
        LEFT + WIDTH * at as f64 / (self.until_us - self.from_us) as f64
    }

    fn draw(&self, edges: &[Edge], zero_us: u64, svg: &mut String) {
        let bottom = self.top + 24.0 + ROW * LINES.len() as f64;
        writeln!(
            svg,
            "<text x=\"{LEFT}\" y=\"{:.1}\" class=\"title\">{}</text>",
            self.top + 8.0,
            self.title
        )
        .unwrap();
        // The first tick from `from_us` on that is a multiple of the distance away from zero.
        let before = self.from_us % self.tick_us;
        let first = self.from_us + (zero_us + self.tick_us - before) % self.tick_us;
        for at_us in (first..=self.until_us).step_by(self.tick_us as usize) {
            let x = self.x(at_us);
            let ms = (at_us as f64 - zero_us as f64) * 1e-3;
            writeln!(
                svg,
                "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{:.1}\" y2=\"{bottom:.1}\" class=\"grid\"/>\
                 <text x=\"{x:.1}\" y=\"{:.1}\" class=\"tick\">{ms:.0}</text>",
                self.top + 16.0,
                bottom + 13.0,
            )
            .unwrap();
        }
        writeln!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" class=\"tick\">ms</text>",
            LEFT + WIDTH + 16.0,
            bottom + 13.0
        )
        .unwrap();
        for (row, (line, name)) in LINES.into_iter().enumerate() {
            let low = self.top + 24.0 + ROW * (row as f64 + 1.0) - 5.0;
            let y = |level: bool| if level { low - HIGH } else { low };
            let of_line = || edges.iter().filter(|edge| edge.line == line);
            let mut level = of_line()
                .rfind(|edge| edge.at_us <= self.from_us)
                .is_some_and(|edge| edge.level);
            let mut path = format!("M{LEFT:.1} {:.1}", y(level));
            for edge in
                of_line().filter(|edge| edge.at_us > self.from_us && edge.at_us <= self.until_us)
            {
                write!(path, "H{:.1}V{:.1}", self.x(edge.at_us), y(edge.level)).unwrap();
                level = edge.level;
            }
            write!(path, "H{:.1}", LEFT + WIDTH).unwrap();
            writeln!(
                svg,
                "<text x=\"{:.1}\" y=\"{:.1}\" class=\"name\">{name}</text><path d=\"{path}\"/>",
                LEFT - 10.0,
                low - 3.0
            )
            .unwrap();
        }
    }
}

fn picture(edges: &[Edge]) -> String {
    let rises = |line: &str| -> Vec<u64> {
        edges
            .iter()
            .filter(|edge| edge.line == line && edge.level)
            .map(|edge| edge.at_us)
            .collect()
    };
    let zero_us = rises("led_enable")[0];
    let frames = rises("camera_trigger");
    let dark_us = edges
        .iter()
        .rfind(|edge| edge.line == "led_sense")
        .unwrap()
        .at_us;
    let panels = [
        Panel {
            title: "one view: the dark frame, 12 patterns at 10 ms, 12 patterns at 30 ms",
            top: 16.0,
            from_us: zero_us - 10_000,
            until_us: dark_us + 10_000,
            tick_us: 50_000,
        },
        Panel {
            title: "its first frames: at short exposures the readout of the frame before sets the pace",
            top: 256.0,
            from_us: zero_us - 1_000,
            until_us: frames[3],
            tick_us: 5_000,
        },
    ];
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 1000 490\" width=\"1000\" height=\"490\">\n\
         <style>text{font:12px sans-serif;fill:#222}.name{text-anchor:end}.tick{text-anchor:middle;font-size:10px;\
         fill:#666}.title{font-weight:bold}.grid{stroke:#ddd;stroke-width:1}path{fill:none;stroke:#0b5394;\
         stroke-width:1.5}</style>\n<rect width=\"1000\" height=\"490\" fill=\"#fff\"/>\n",
    );
    for panel in panels {
        panel.draw(edges, zero_us, &mut svg);
    }
    svg + "</svg>\n"
}

#[test]
fn the_timing_diagram_shows_what_the_controller_does() {
    let picture = picture(&edges());
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware/timing.svg");
    if std::env::var_os("FLANKSCOPE_DRAW").is_some() {
        std::fs::write(path, picture).unwrap();
    } else {
        let drawn = std::fs::read_to_string(path).unwrap();
        assert!(
            drawn == picture,
            "the timing has changed; draw it anew: \
             FLANKSCOPE_DRAW=1 cargo test -p flankscope-bench --test timing"
        );
    }
}
