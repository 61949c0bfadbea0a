//! Common parts of all charts: inline SVG without a font file, axes with round numbers, a symbol for each verdict.

use std::fmt::Write as _;

use flankscope_metrology::verdict::Word;

/// The opening tag of a picture.
pub(super) fn open(width: f64, height: f64, title: &str) -> String {
    let title = escaped(title);
    format!(
        r#"<svg viewBox="0 0 {width} {height}" role="img" aria-label="{title}"><title>{title}</title>"#
    )
}

/// Text as it may stand in a tag's content and in a quoted attribute: names of patches are the user's.
pub(super) fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('"', "&quot;");
    text.replace('<', "&lt;").replace('>', "&gt;")
}

/// About eight round numbers between two ends.
pub(super) fn ticks(from: f64, to: f64) -> Vec<f64> {
    about(8.0, from, to)
}

/// About `count` round numbers between two ends.
pub(super) fn about(count: f64, from: f64, to: f64) -> Vec<f64> {
    let raw = (to - from) / count;
    let magnitude = 10_f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|m| m * magnitude)
        .find(|&s| s >= raw)
        .unwrap_or(raw);
    let first = (from / step).ceil() as i64;
    let last = (to / step).floor() as i64;
    (first..=last)
        .map(|i| (i as f64 * step * 1e6).round() / 1e6)
        .collect()
}

/// The symbol of a verdict, which differs in shape as well as in colour. `title` is its tooltip.
pub(super) fn sign(svg: &mut String, verdict: Word, [x, y]: [f64; 2], radius: f64, title: &str) {
    let r = radius;
    let _ = match verdict {
        Word::Go => write!(
            svg,
            r#"<circle cx="{x:.1}" cy="{y:.1}" r="{:.1}" class="v-go">"#,
            0.8 * r
        ),
        Word::Warn => write!(
            svg,
            r#"<path d="M{:.1} {:.1}h{:.1}l{:.1} {:.1}z" class="v-warn">"#,
            x - 1.1 * r,
            y + 0.8 * r,
            2.2 * r,
            -1.1 * r,
            -1.9 * r
        ),
        Word::NoGo => write!(
            svg,
            r#"<path d="M{:.1} {:.1}l{d:.1} {d:.1}m0 {:.1}l{:.1} {d:.1}" class="v-no-go cross">"#,
            x - r,
            y - r,
            -2.0 * r,
            -2.0 * r,
            d = 2.0 * r
        ),
        Word::Indeterminate => write!(
            svg,
            r#"<path d="M{x:.1} {:.1}l{r:.1} {r:.1}l{:.1} {r:.1}l{:.1} {:.1}z" class="v-indeterminate hollow">"#,
            y - r,
            -r,
            -r,
            -r
        ),
    };
    let _ = write!(
        svg,
        "<title>{title}</title></{}>",
        if verdict == Word::Go {
            "circle"
        } else {
            "path"
        }
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(
            ticks(0.0, 4000.0),
            [
                0.0, 500.0, 1000.0, 1500.0, 2000.0, 2500.0, 3000.0, 3500.0, 4000.0
            ]
        );
        assert_eq!(ticks(-100.0, 100.0), [-100.0, -50.0, 0.0, 50.0, 100.0]);
    }

    /// Without its colour class, every symbol is still different.
    #[test]
    fn verdicts_differ_by_shape_alone() {
        let words = [Word::Go, Word::Warn, Word::NoGo, Word::Indeterminate];
        let shapes = words.map(|word| {
            let mut svg = String::new();
            sign(&mut svg, word, [10.0, 10.0], 5.0, "");
            svg.replace(&format!("v-{word}"), "")
        });
        for (i, shape) in shapes.iter().enumerate() {
            assert!(!shapes[..i].contains(shape), "{shape}");
        }
    }
}
