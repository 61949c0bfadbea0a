//! The frame of a chart in µm about zero, as SVG.

use std::fmt::{Error, Write as _};

/// The beginning of a drawing of this size, px; the caller appends `</svg>`.
pub(super) fn sheet([width, height]: [f64; 2]) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"system-ui, sans-serif\" font-size=\"12\">\
         <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>"
    )
}

/// Size and the left and lower margins, px of the drawing.
pub(super) struct Frame {
    pub size: [f64; 2],
    pub margin: [f64; 2],
    /// Range up and down, µm.
    pub reach_um: f64,
}

impl Frame {
    /// Vertical position of a value.
    pub fn y(&self, um: f64) -> f64 {
        let half = 0.5 * self.size[1];
        half - (half - self.margin[1]) * um / self.reach_um
    }

    /// The beginning of the drawing and five lines with their values, rounded to `decimals`; the caller appends `</svg>`.
    pub fn begin(&self, decimals: usize) -> Result<String, Error> {
        let ([width, _], left) = (self.size, self.margin[0]);
        let mut svg = sheet(self.size);
        for part in [-1.0, -0.5, 0.0, 0.5, 1.0] {
            let um = part * self.reach_um;
            write!(
                svg,
                "<line x1=\"{left}\" x2=\"{}\" y1=\"{at:.1}\" y2=\"{at:.1}\" stroke=\"#d8dde2\"/>\
                 <text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{um:.decimals$} µm</text>",
                width - left,
                left - 6.0,
                self.y(um) + 4.0,
                at = self.y(um),
            )?;
        }
        Ok(svg)
    }
}
