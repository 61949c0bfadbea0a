//! Text with one point per line.
//!
//! Columns stand between blanks, tabs, semicolons or commas. A comma may also be the decimal sign, as spreadsheets of half of
//! Europe write it: what it is, is told by the whole file, and where that is open the file is refused.

use super::CloudError;
use crate::io::NonFinite;

/// Meaning of a comma in this file.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Comma {
    Separator,
    Decimal,
}

/// Points of all lines. Further columns, blank lines and `#` or `//` comments are skipped. A heading names the columns, a count of
/// points may come first (PTS), and `v` lines of OBJ are points.
pub(super) fn parse(bytes: &[u8], non_finite: NonFinite) -> Result<Vec<[f64; 3]>, CloudError> {
    if bytes
        .trim_ascii_start()
        .get(..6)
        .is_some_and(|start| start.eq_ignore_ascii_case(b"solid "))
    {
        return Err(CloudError::Mesh);
    }
    let is_binary = |&byte: &u8| byte < 0x20 && !byte.is_ascii_whitespace();
    if let Some(offset) = bytes.iter().position(is_binary) {
        return Err(CloudError::Foreign {
            byte: bytes[offset],
            offset,
        });
    }
    let text = String::from_utf8_lossy(bytes).replace("\r\n", "\n");
    let numbered = text.split(['\n', '\r']).enumerate();
    let mut lines: Vec<(usize, &str)> = numbered
        .map(|(index, line)| (index + 1, line.trim()))
        .filter(|(_, line)| !(line.is_empty() || line.starts_with('#') || line.starts_with("//")))
        .collect();
    let (stated, named) = match container(&mut lines)? {
        Some(container) => (Some(container.points), Some(container.columns)),
        None => (stated_count(&lines), None),
    };
    let in_container = named.is_some();
    let is_obj = lines.iter().any(|(_, line)| obj_vertex(line).is_some());
    if is_obj {
        lines.retain_mut(|(_, line)| obj_vertex(line).map(|rest| *line = rest).is_some());
    }
    lines.drain(..usize::from(stated.is_some() && !in_container));
    let heading = match named {
        Some(columns) => Some(Heading {
            columns,
            comma: Some(Comma::Separator),
        }),
        None => heading(&mut lines)?,
    };
    let comma = match &heading {
        Some(heading) => heading
            .comma
            .map_or_else(|| comma(lines.iter().copied()), Ok),
        None => comma(lines.iter().copied()),
    }?;
    let columns = heading
        .as_ref()
        .map_or([0, 1, 2], |heading| heading.columns);
    let mut points = Vec::with_capacity(lines.len());
    let mut counts_lines = lines.len() >= LEAST_INDEX_LINES && heading.is_none();
    let mut width = 0;
    let mut first_index = None;
    for (row, &(line, text)) in lines.iter().enumerate() {
        let fields = fields(text, comma, heading.is_some());
        let at = |column: usize| {
            let value = number(fields.get(column)?, comma)?;
            (value.is_finite() || non_finite == NonFinite::Drop).then_some(value)
        };
        let [Some(x), Some(y), Some(z)] = columns.map(at) else {
            return Err(CloudError::Line {
                line,
                text: text.chars().take(40).collect(),
            });
        };
        if counts_lines {
            width = fields.len();
            let index = fields[0].parse::<usize>().ok().filter(|_| width >= 4);
            let first = *first_index.get_or_insert(index);
            counts_lines = index.is_some() && index == first.map(|first| first + row);
        }
        points.push([x, y, z]);
    }
    // Coordinates in whole numbers throughout are those of a grid.
    let has_fractions = || {
        points
            .iter()
            .flat_map(|p| &p[1..])
            .any(|c| c.is_finite() && c.fract() != 0.0)
    };
    if counts_lines && has_fractions() {
        return Err(CloudError::IndexColumn { columns: width });
    }
    match stated {
        Some(stated) if stated > points.len() => Err(CloudError::Count {
            stated,
            found: points.len(),
        }),
        _ => Ok(points),
    }
}

/// Fewest lines whose first column can be told to be an index.
const LEAST_INDEX_LINES: usize = 3;

/// Header of a format that states its points.
struct Container {
    points: usize,
    /// Places of x, y and z.
    columns: [usize; 3],
}

/// Takes the header of OFF or of a PCD in text off the lines, and what follows the points.
fn container(lines: &mut Vec<(usize, &str)>) -> Result<Option<Container>, CloudError> {
    let Some(&(line, first)) = lines.first() else {
        return Ok(None);
    };
    let refused = |(line, text): (usize, &str)| CloudError::Line {
        line,
        text: text.chars().take(40).collect(),
    };
    let (points, columns, header_lines) = if ["OFF", "COFF", "NOFF"].contains(&first) {
        let counts = *lines.get(1).ok_or_else(|| refused((line, first)))?;
        let points = counts.1.split_whitespace().next();
        let points = points.and_then(|word| word.parse().ok());
        (points.ok_or_else(|| refused(counts))?, [0, 1, 2], 2)
    } else if first.starts_with("VERSION ") || first.starts_with("FIELDS ") {
        let values = |key: &str| {
            let found = lines
                .iter()
                .take(16)
                .find_map(|(_, line)| line.strip_prefix(key));
            found.map(|rest| rest.split_whitespace().collect::<Vec<_>>())
        };
        let data = lines
            .iter()
            .take(16)
            .position(|(_, line)| *line == "DATA ascii");
        let names = values("FIELDS ").unwrap_or_default();
        let is_plain = values("COUNT ").is_none_or(|counts| counts.iter().all(|n| *n == "1"));
        let place = |axis: &str| names.iter().position(|name| *name == axis);
        let points = values("POINTS ").and_then(|words| words.first()?.parse().ok());
        match (place("x"), place("y"), place("z"), points, data) {
            (Some(x), Some(y), Some(z), Some(points), Some(data)) if is_plain => {
                (points, [x, y, z], data + 1)
            }
            _ => return Err(refused((line, first))),
        }
    } else {
        return Ok(None);
    };
    lines.drain(..header_lines);
    lines.truncate(points);
    Ok(Some(Container { points, columns }))
}

/// Number of points that the first line of a PTS file states.
fn stated_count(lines: &[(usize, &str)]) -> Option<usize> {
    let (_, first) = lines.first()?;
    first.parse().ok()
}

/// Coordinates of a `v` line of OBJ.
fn obj_vertex(line: &str) -> Option<&str> {
    line.strip_prefix('v')
        .filter(|rest| rest.starts_with([' ', '\t']))
        .map(str::trim_start)
}

/// First line of a table, which names its columns.
struct Heading {
    /// Places of x, y and z.
    columns: [usize; 3],
    /// Meaning of a comma, where the heading's separator tells it.
    comma: Option<Comma>,
}

/// Takes the heading off the lines, if they have one.
fn heading(lines: &mut Vec<(usize, &str)>) -> Result<Option<Heading>, CloudError> {
    let Some(&(line, text)) = lines.first() else {
        return Ok(None);
    };
    let comma = match (text.contains([';', '\t']), text.contains(',')) {
        (true, false) => Some(Comma::Decimal),
        (false, true) => Some(Comma::Separator),
        _ => None,
    };
    let names = fields(text, comma.unwrap_or(Comma::Separator), true);
    let is_axis = |name: &&str| {
        ["x", "y", "z"]
            .iter()
            .any(|axis| name.eq_ignore_ascii_case(axis))
    };
    if !names.iter().any(is_axis) {
        return Ok(None);
    }
    let refused = || CloudError::Heading {
        line,
        text: text.chars().take(40).collect(),
    };
    let place = |axis: &str| {
        let mut found = (0..names.len()).filter(|&i| names[i].eq_ignore_ascii_case(axis));
        found
            .next()
            .filter(|_| found.next().is_none())
            .ok_or_else(refused)
    };
    let columns = [place("x")?, place("y")?, place("z")?];
    let width = names.len();
    lines.remove(0);
    let comma_of_rows = comma.filter(|comma| *comma == Comma::Separator || !mixes_points(lines));
    if let Some((_, row)) = lines.first() {
        let row = fields(row, comma_of_rows.unwrap_or(Comma::Separator), true);
        // Row names without a heading of their own would move every column.
        if row.len() != width && row.iter().rposition(|word| !word.is_empty()) >= Some(width) {
            return Err(refused());
        }
    }
    Ok(Some(Heading {
        columns,
        comma: comma_of_rows,
    }))
}

/// Whether decimal points stand beside commas.
fn mixes_points(lines: &[(usize, &str)]) -> bool {
    lines.iter().any(|(_, line)| line.contains('.'))
}

/// Fields of a line, without quotes. Empty ones count where a heading gives every column its place.
fn fields(text: &str, comma: Comma, keep_empty: bool) -> Vec<&str> {
    let is_mark = |c: char| c == ';' || c == '\t' || (c == ',' && comma == Comma::Separator);
    if keep_empty && text.contains(is_mark) {
        return text.split(is_mark).map(unquoted).collect();
    }
    let is_separator = |c: char| c.is_whitespace() || is_mark(c);
    let words = text.split(is_separator).filter(|word| !word.is_empty());
    words.map(unquoted).collect()
}

fn unquoted(word: &str) -> &str {
    word.trim().trim_matches('"')
}

fn number(word: &str, comma: Comma) -> Option<f64> {
    match comma {
        Comma::Separator => crate::io::word::number(word),
        Comma::Decimal => crate::io::word::number(&word.replace(',', ".")),
    }
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
        parse(text.as_bytes(), NonFinite::Refuse).unwrap()
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
            match parse(text.as_bytes(), NonFinite::Refuse) {
                Err(CloudError::Comma { line: found, .. }) => assert_eq!(found, line, "{text:?}"),
                other => panic!("{text:?}: {other:?}"),
            }
        }
    }

    #[test]
    fn headings_counts_and_words_of_other_programs_are_read() {
        let expected = [[1.5, -2.0, 0.5], [4.0, 5.0, 6.25]];
        for text in [
            "x,y,z\n1.5,-2,0.5\n4,5,6.25\n",
            ",x,y,z\n0,1.5,-2,0.5\n1,4,5,6.25\n",
            "index,Z,X,Y\n0,0.5,1.5,-2\n1,6.25,4,5\n",
            "x;y;z;dx\n1,5;-2,0;0,5;0,1\n4,0;5,0;6,25;0,1\n",
            "\"x\",\"y\",\"z\"\n\"1.5\",\"-2\",\"0.5\"\n\"4\",\"5\",\"6.25\"\n",
            "x y z\n1.5 -2 0.5\n4 5 6.25\n",
            "2\n1.5 -2 0.5 120 10 20 30\n4 5 6.25 120 10 20 30\n",
            "v 1.5 -2 0.5\nv 4 5 6.25\n",
            "OFF\n2 1 0\n1.5 -2 0.5\n4 5 6.25\n3 0 1 0\n",
            "# .PCD v0.7\nVERSION 0.7\nFIELDS i x y z\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\n\
                POINTS 2\nDATA ascii\n7 1.5 -2 0.5\n8 4 5 6.25\n",
            "1.5D+00 -2.0D+00 5.0D-01\n4.0D+00 5.0D+00 6.25D+00\n",
            "1.5 -2 0.5\r4 5 6.25\r",
        ] {
            assert_eq!(points(text), expected, "{text:?}");
        }
    }

    #[test]
    fn columns_that_may_be_others_are_refused() {
        type Expect = fn(&CloudError) -> bool;
        let cases: [(&str, Expect); 5] = [
            ("0,1.5,2,3\n1,4,5,6\n2,7,8,9\n", |e| {
                matches!(e, CloudError::IndexColumn { columns: 4 })
            }),
            ("x,y\n1,2\n", |e| {
                matches!(e, CloudError::Heading { line: 1, .. })
            }),
            // Row names, written by `write.table` of R.
            ("x y z\n1 1.5 2 3\n2 4 5 6\n", |e| {
                matches!(e, CloudError::Heading { .. })
            }),
            ("3\n1 2 3\n4 5 6\n", |e| {
                matches!(
                    e,
                    CloudError::Count {
                        stated: 3,
                        found: 2
                    }
                )
            }),
            ("solid box\nfacet normal 0 0 1\n", |e| {
                matches!(e, CloudError::Mesh)
            }),
        ];
        for (text, is_expected) in cases {
            let error = parse(text.as_bytes(), NonFinite::Refuse).unwrap_err();
            assert!(is_expected(&error), "{text:?}: {error}");
        }
        // A grid in whole numbers.
        assert_eq!(points("0 1 2 9\n1 4 5 9\n2 7 8 9\n")[1], [1.0, 4.0, 5.0]);
    }

    #[test]
    fn what_is_no_point_is_named_by_line() {
        for (text, at) in [
            ("1 2 3\n1 2", 2),
            ("a b c\n", 1),
            ("1 2 inf", 1),
            ("1,5 2,5 a", 1),
        ] {
            match parse(text.as_bytes(), NonFinite::Refuse) {
                Err(CloudError::Line { line, .. }) => assert_eq!(line, at, "{text:?}"),
                other => panic!("{text:?}: {other:?}"),
            }
        }
    }
}
