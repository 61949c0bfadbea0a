//! Text with one point per line.
//!
//! Columns stand between blanks, tabs, semicolons or commas. A comma may also be the decimal sign, as spreadsheets of half of
//! Europe write it: what it is, is told by the whole file, and where that is open the file is refused.

use super::CloudError;

/// Meaning of a comma in this file.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Comma {
    Separator,
    Decimal,
}

/// Points of all lines; further columns, blank lines and `#` or `//` comments are skipped.
pub(super) fn parse(bytes: &[u8]) -> Result<Vec<[f64; 3]>, CloudError> {
    let is_binary = |&byte: &u8| byte < 0x20 && !byte.is_ascii_whitespace();
    if let Some(offset) = bytes.iter().position(is_binary) {
        return Err(CloudError::Foreign {
            byte: bytes[offset],
            offset,
        });
    }
    let text = String::from_utf8_lossy(bytes);
    let lines = || {
        let numbered = text.split('\n').enumerate();
        numbered
            .map(|(index, line)| (index + 1, line.trim()))
            .filter(|(_, line)| {
                !(line.is_empty() || line.starts_with('#') || line.starts_with("//"))
            })
    };
    let comma = comma(lines())?;
    let mut points = Vec::new();
    for (line, text) in lines() {
        let is_separator =
            |c: char| c.is_whitespace() || c == ';' || (c == ',' && comma == Comma::Separator);
        let mut numbers = text
            .split(is_separator)
            .filter(|word| !word.is_empty())
            .map(|word| number(word, comma));
        let (Some(Some(x)), Some(Some(y)), Some(Some(z))) =
            (numbers.next(), numbers.next(), numbers.next())
        else {
            return Err(CloudError::Line {
                line,
                text: text.chars().take(40).collect(),
            });
        };
        points.push([x, y, z]);
    }
    Ok(points)
}

fn number(word: &str, comma: Comma) -> Option<f64> {
    let value = match comma {
        Comma::Separator => word.parse(),
        Comma::Decimal => word.replace(',', ".").parse(),
    };
    value.ok().filter(|value: &f64| value.is_finite())
}

/// Meaning of commas by all lines together. A comma within a word of a line that blanks or semicolons divide is a decimal sign;
/// one beside a blank, beside a decimal point, or as the only mark of a line is a separator.
fn comma<'a>(lines: impl Iterator<Item = (usize, &'a str)>) -> Result<Comma, CloudError> {
    let mut decimal = None;
    let mut separator = None;
    let mut open = None;
    for (line, text) in lines.filter(|(_, text)| text.contains(',')) {
        let words: Vec<&str> = text
            .split(|c: char| c.is_whitespace() || c == ';')
            .filter(|word| !word.is_empty())
            .collect();
        let at_an_end = |word: &&str| word.starts_with(',') || word.ends_with(',');
        if text.contains('.') || words.iter().any(at_an_end) {
            separator.get_or_insert((line, text));
        } else if words.len() >= 3 && words.iter().all(|w| w.matches(',').count() <= 1) {
            decimal.get_or_insert((line, text));
        } else if words.len() == 1 && text.matches(',').count() == 2 {
            // Three whole numbers.
            separator.get_or_insert((line, text));
        } else {
            open.get_or_insert((line, text));
        }
    }
    let (told, against) = match (decimal, separator) {
        (Some(_), Some(separator)) => (Comma::Decimal, Some(separator)),
        (Some(_), None) => (Comma::Decimal, open),
        (None, Some(_)) => (Comma::Separator, None),
        (None, None) => (Comma::Separator, open),
    };
    match against {
        Some((line, text)) => Err(CloudError::Comma {
            line,
            text: text.chars().take(40).collect(),
        }),
        None => Ok(told),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(text: &str) -> Vec<[f64; 3]> {
        parse(text.as_bytes()).unwrap()
    }

    #[test]
    fn columns_may_stand_between_whatever_people_write() {
        let expected = [[1.5, -2.0, 3e-2], [4.0, 5.0, 6.0]];
        for text in [
            "1.5 -2 3e-2\n4 5 6",
            "1.5\t-2\t3e-2\r\n4\t5\t6\r\n",
            "# x y z\n1.5,-2,3e-2\n4,5,6",
            "1.5, -2, 3e-2\n4, 5, 6\n",
            "1.5;-2;3e-2\n// end\n4;5;6",
            "1,5 -2 3e-2\n4 5 6",
            "1,5;-2;3e-2\n4;5;6",
            "1,5\t-2,0\t3,0e-2\n4,0\t5,0\t6,0",
            "1.5,-2.0,0.03,255,0,0\n4.0,5.0,6.0,255,0,0",
        ] {
            assert_eq!(points(text), expected, "{text:?}");
        }
        // Whole numbers are no reason to doubt.
        assert_eq!(
            points("153,64,17\n1,2,3"),
            [[153.0, 64.0, 17.0], [1.0, 2.0, 3.0]]
        );
    }

    #[test]
    fn a_comma_that_may_be_either_is_refused_by_line() {
        for (text, line) in [
            ("153,64,17,20,3,10", 1),
            ("1 2 3\n153,64,17,20,3,10", 2),
            ("1,5 2,5 3,5\n1.5, 2.5, 3.5", 2),
            ("1,5 2,5 3,5\n1,2,3,4", 2),
        ] {
            match parse(text.as_bytes()) {
                Err(CloudError::Comma { line: found, .. }) => assert_eq!(found, line, "{text:?}"),
                other => panic!("{text:?}: {other:?}"),
            }
        }
    }

    #[test]
    fn what_is_no_point_is_named_by_line() {
        for (text, at) in [
            ("1 2 3\n1 2", 2),
            ("x y z\n", 1),
            ("1 2 inf", 1),
            ("1,5 2,5 a", 1),
        ] {
            match parse(text.as_bytes()) {
                Err(CloudError::Line { line, .. }) => assert_eq!(line, at, "{text:?}"),
                other => panic!("{text:?}: {other:?}"),
            }
        }
    }
}
