//! Capabilities of the terminal: colours, and the letter µ.

use std::io::IsTerminal;

use flankscope_foundation::display::plain;
use flankscope_metrology::verdict::Word;
use flankscope_report::with_micro;

/// Colour codes of go, warn, no-go and indeterminate, and the reset code.
const COLOURS: [&str; 5] = ["\x1b[32m", "\x1b[33m", "\x1b[1;31m", "\x1b[35m", "\x1b[0m"];

/// Capabilities of standard output or standard error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Terminal {
    colours: bool,
    unicode: bool,
    /// Width of a terminal; `None` for a file or pipe, for which text is not wrapped.
    columns: Option<usize>,
}

impl Terminal {
    /// For standard output.
    pub fn of_stdout() -> Self {
        Self::of(std::io::stdout().is_terminal(), &variable)
    }

    /// For standard error.
    pub fn of_stderr() -> Self {
        Self::of(std::io::stderr().is_terminal(), &variable)
    }

    /// Colours on a terminal unless <https://no-color.org> or a dumb terminal forbids them; µ if the locale is UTF-8, by the
    /// first of LC_ALL, LC_CTYPE and LANG that is set (POSIX.1-2017, 8.2).
    fn of(is_terminal: bool, variable: &dyn Fn(&str) -> Option<String>) -> Self {
        let locale = ["LC_ALL", "LC_CTYPE", "LANG"]
            .into_iter()
            .find_map(variable)
            .unwrap_or_default()
            .to_ascii_lowercase();
        let dumb = variable("TERM").is_some_and(|term| term == "dumb");
        Self {
            colours: is_terminal && !dumb && variable("NO_COLOR").is_none(),
            unicode: locale.contains("utf-8") || locale.contains("utf8"),
            // 80 if the terminal does not report its width.
            columns: is_terminal.then(textwrap::termwidth),
        }
    }

    /// Converts micrometres and symbols to what this terminal can display, and removes control codes other than our colours.
    pub fn text(self, text: &str) -> String {
        let text = &self.harmless(text);
        if self.unicode {
            with_micro(text)
        } else {
            text.replace('µ', "u")
                .replace('–', "-")
                .replace('±', "+-")
                .replace('°', " deg")
        }
    }

    fn harmless(self, text: &str) -> String {
        let mut shown = String::with_capacity(text.len());
        let mut rest = text;
        while let Some(first) = rest.chars().next() {
            let own = COLOURS
                .iter()
                .find(|own| self.colours && rest.starts_with(**own));
            let length = own.map_or(first.len_utf8(), |own| own.len());
            let (now, later) = rest.split_at(length);
            if own.is_some() || first == '\n' {
                shown += now;
            } else {
                shown += &plain(now);
            }
            rest = later;
        }
        shown
    }

    /// A sentence as this terminal can display it, wrapped at its width between words.
    pub fn sentence(self, text: &str) -> String {
        let text = self.text(text);
        match self.columns {
            Some(columns) => textwrap::fill(&text, columns),
            None => text,
        }
    }

    /// Shares from 0 to 1 as one line of bars, by blocks where they can be displayed.
    pub fn bars(self, shares: impl Iterator<Item = f64>) -> String {
        let steps = match self.unicode {
            true => [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'],
            false => [' ', '.', ':', '-', '=', '+', '*', '#', '@'],
        };
        let last = steps.len() - 1;
        // What is not empty is at least the lowest bar. Casts of NaN and of negative numbers give 0.
        let step = |share: f64| ((share * last as f64).ceil() as usize).min(last);
        shares.map(|share| steps[step(share)]).collect()
    }

    /// A text in the colour of a verdict. The words differ as well, so colour is not needed.
    pub fn in_colour(self, verdict: Word, text: &str) -> String {
        if !self.colours {
            return text.to_owned();
        }
        let [go, warn, no_go, indeterminate, end] = COLOURS;
        let begin = match verdict {
            Word::Go => go,
            Word::Warn => warn,
            Word::NoGo => no_go,
            Word::Indeterminate => indeterminate,
        };
        format!("{begin}{text}{end}")
    }
}

fn variable(name: &str) -> Option<String> {
    std::env::var(name).ok().filter(|value| !value.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn terminal(is_terminal: bool, said: &[(&str, &str)]) -> Terminal {
        let said = said.to_vec();
        Terminal::of(is_terminal, &move |name| {
            said.iter()
                .find(|(key, _)| *key == name)
                .map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn micrometres_are_shown_where_they_can_be() {
        let utf8 = terminal(false, &[("LANG", "de_DE.UTF-8")]);
        assert_eq!(
            utf8.text("80.0 um of the drum, wear/um, limit_um, --taper-um 15 um"),
            "80.0 µm of the drum, wear/µm, limit_um, --taper-um 15 µm"
        );
        // Names of files and values of options stay as they are typed.
        for typed in [
            "cannot read 10um.ply",
            "say so with --cad-unit um (tool file: unit = \"um\")",
        ] {
            assert_eq!(utf8.text(typed), typed);
        }
        let c = terminal(false, &[("LANG", "de_DE.UTF-8"), ("LC_ALL", "C")]);
        assert_eq!(c.text("±4.5 µm, –"), "+-4.5 um, -");
    }

    #[test]
    fn shares_are_bars_of_their_height() {
        let shares = [0.0, 0.01, 0.5, 1.0, 2.0, -1.0, f64::NAN];
        let utf8 = terminal(false, &[("LANG", "de_DE.UTF-8")]);
        assert_eq!(utf8.bars(shares.into_iter()), " ▁▄██  ");
        let c = terminal(false, &[("LANG", "C")]);
        assert_eq!(c.bars(shares.into_iter()), " .=@@  ");
    }

    #[test]
    fn names_paint_no_verdict() {
        let forged = "die\r\x1b[2K\x1b[32mGO\x1b[0m";
        for plain in [terminal(false, &[]), terminal(true, &[("NO_COLOR", "1")])] {
            let shown = plain.text(forged);
            assert_eq!(shown, "die\\r\\u{1b}[2K\\u{1b}[32mGO\\u{1b}[0m");
        }
        let coloured = terminal(true, &[]);
        let own = coloured.in_colour(Word::Go, "GO");
        assert_eq!(coloured.text(&own), own);
        assert!(coloured.text(forged).starts_with("die\\r\\u{1b}[2K"));
    }

    #[test]
    fn sentences_are_wrapped_on_terminals_alone() {
        let reason =
            "tooth 40 left (wear 80.0 um is beyond the stop limit of 50.0 um); look at the die";
        let narrow = Terminal {
            columns: Some(40),
            ..terminal(true, &[("LANG", "C")])
        };
        let shown = narrow.sentence(reason);
        assert!(
            shown.lines().count() >= 3 && shown.lines().all(|line| line.len() <= 40),
            "{shown}"
        );
        assert_eq!(shown.replace('\n', " "), reason);
        assert_eq!(terminal(false, &[]).sentence(reason), reason);
    }

    #[test]
    fn colours_are_for_terminals_that_want_them() {
        let shown = |on: Terminal| on.in_colour(Word::NoGo, "NO-GO");
        assert_eq!(shown(terminal(true, &[])), "\x1b[1;31mNO-GO\x1b[0m");
        for plain in [
            terminal(false, &[]),
            terminal(true, &[("NO_COLOR", "1")]),
            terminal(true, &[("TERM", "dumb")]),
        ] {
            assert_eq!(shown(plain), "NO-GO");
        }
    }
}
