//! OpenCV FileStorage text (XML, and the YAML that it writes): named nodes of numbers, each with its line.

use std::path::Path;

use flankscope_foundation::textfile::{TextFileError, line_of_offset};

/// One named node: its numbers, in row order, and the line it starts on.
struct Node {
    name: String,
    shape: Option<[String; 2]>,
    numbers: Result<Vec<f64>, String>,
    line: usize,
}

/// The nodes of a file.
pub(crate) struct Storage<'a> {
    path: &'a Path,
    nodes: Vec<Node>,
}

/// Whether a text is an OpenCV FileStorage: XML, or YAML with its directive.
pub fn is_file_storage(text: &str) -> bool {
    let start = start_of(text);
    start.starts_with('<') || start.starts_with("%YAML")
}

fn start_of(text: &str) -> &str {
    text.trim_start_matches('\u{feff}').trim_start()
}

impl<'a> Storage<'a> {
    /// Reads a file's text.
    pub fn parse(path: &'a Path, text: &str) -> Result<Self, TextFileError> {
        let nodes = if start_of(text).starts_with('<') {
            xml_nodes(path, text)?
        } else {
            yaml_nodes(text)
        };
        Ok(Self { path, nodes })
    }

    fn node(&self, name: &str) -> Result<&Node, TextFileError> {
        self.nodes.iter().find(|node| node.name == name).ok_or_else(|| TextFileError::Value {
            path: self.path.to_owned(),
            line: 1,
            key: name.to_owned(),
            got: "nothing".to_owned(),
            expected: "must be present: a calibration has Kc, kc, Kp, kp, Rp, Tp, frameWidth, frameHeight, screenResX and screenResY, \
                       or the other names in docs/formats/head.md"
                .into(),
        })
    }

    /// The name, out of several synonyms, that the file uses; the first of them, if it has none.
    ///
    /// # Errors
    /// [`TextFileError::Value`]: the file has two of them.
    pub fn which<'n>(&self, names: &[&'n str]) -> Result<&'n str, TextFileError> {
        let has = |name: &&&str| self.nodes.iter().any(|node| node.name == **name);
        let mut used = names.iter().filter(has);
        match (used.next(), used.next()) {
            (Some(first), Some(second)) => Err(self.wrong(
                second,
                format!("a second value beside {first}"),
                "must be the only name of this in the file",
            )),
            (Some(name), None) => Ok(name),
            _ => Ok(names.first().copied().unwrap_or_default()),
        }
    }

    /// A complaint about a node, with its line.
    pub fn wrong(&self, name: &str, got: String, expected: &'static str) -> TextFileError {
        let line = self
            .nodes
            .iter()
            .find(|node| node.name == name)
            .map_or(1, |node| node.line);
        TextFileError::Value {
            path: self.path.to_owned(),
            line,
            key: name.to_owned(),
            got,
            expected: expected.into(),
        }
    }

    fn numbers(&self, name: &str) -> Result<&[f64], TextFileError> {
        let node = self.node(name)?;
        let numbers = node
            .numbers
            .as_ref()
            .map_err(|bad| self.wrong(name, bad.clone(), "must be numbers"))?;
        if let Some(bad) = numbers.iter().find(|value| !value.is_finite()) {
            return Err(self.wrong(name, bad.to_string(), "must be finite"));
        }
        if let Some([rows, columns]) = &node.shape {
            let sides = [rows, columns].map(|side| side.parse::<usize>().ok());
            let fits =
                matches!(sides, [Some(a), Some(b)] if a.checked_mul(b) == Some(numbers.len()));
            if fits {
                return Ok(numbers);
            }
            let got = format!(
                "{} numbers for {rows} rows x {columns} columns",
                numbers.len()
            );
            return Err(self.wrong(name, got, "must have rows x cols numbers"));
        }
        Ok(numbers)
    }

    /// The `N` numbers of a node.
    pub fn matrix<const N: usize>(
        &self,
        name: &str,
        expected: &'static str,
    ) -> Result<[f64; N], TextFileError> {
        let numbers = self.numbers(name)?;
        numbers
            .try_into()
            .map_err(|_| self.wrong(name, format!("{} numbers", numbers.len()), expected))
    }

    /// Four or five coefficients of distortion, in OpenCV's order.
    pub fn distortion(&self, name: &str) -> Result<[f64; 5], TextFileError> {
        match *self.numbers(name)? {
            [k1, k2, p1, p2] => Ok([k1, k2, p1, p2, 0.0]),
            [k1, k2, p1, p2, k3] => Ok([k1, k2, p1, p2, k3]),
            ref other => Err(self.wrong(
                name,
                format!("{} numbers", other.len()),
                "must be 4 or 5: k1, k2, p1, p2 and k3",
            )),
        }
    }

    /// One whole number of pixels.
    pub fn pixels(&self, name: &str) -> Result<u32, TextFileError> {
        let [value] = self.matrix::<1>(name, "one whole number of pixels")?;
        if value.fract() != 0.0 || !(1.0..=1e6).contains(&value) {
            return Err(self.wrong(name, value.to_string(), "must be a whole number of pixels"));
        }
        Ok(value as u32)
    }
}

fn parse_numbers<'a>(words: impl Iterator<Item = &'a str>) -> Result<Vec<f64>, String> {
    words
        .map(|word| word.parse().map_err(|_| format!("{word:?}")))
        .collect()
}

fn xml_nodes(path: &Path, text: &str) -> Result<Vec<Node>, TextFileError> {
    let syntax = |line: usize, message: String| TextFileError::Syntax {
        path: path.to_owned(),
        line,
        message,
    };
    let document = roxmltree::Document::parse(text).map_err(|error| {
        syntax(
            error.pos().row as usize,
            format!("{error}; expected an OpenCV FileStorage document"),
        )
    })?;
    let root = document.root_element();
    if !root.has_tag_name("opencv_storage") {
        return Err(syntax(
            1,
            format!(
                "<{}> is not an OpenCV calibration: expected <opencv_storage>",
                root.tag_name().name()
            ),
        ));
    }
    let child_text = |node: roxmltree::Node<'_, '_>, name: &str| {
        node.children()
            .find(|child| child.has_tag_name(name))
            .and_then(|child| child.text().map(str::to_owned))
    };
    let nodes = root
        .children()
        .filter(roxmltree::Node::is_element)
        .map(|element| {
            let line = line_of_offset(text, element.range().start);
            let sides = ["rows", "cols"].map(|name| child_text(element, name));
            let shape = sides.iter().any(Option::is_some).then(|| {
                sides.map(|side| side.map_or_else(String::new, |words| words.trim().to_owned()))
            });
            let words = child_text(element, "data")
                .or_else(|| element.text().map(str::to_owned))
                .unwrap_or_default();
            Node {
                name: element.tag_name().name().to_owned(),
                shape,
                numbers: parse_numbers(words.split_ascii_whitespace()),
                line,
            }
        });
    Ok(nodes.collect())
}

/// The subset of YAML that FileStorage writes: `name: number`, and `name: !!opencv-matrix` with indented rows, cols, dt
/// and `data: [ ... ]` over one or more lines.
fn yaml_nodes(text: &str) -> Vec<Node> {
    let mut nodes: Vec<Node> = Vec::new();
    let mut data: Option<String> = None;
    for (number, line) in text.lines().enumerate() {
        let indented = line.starts_with([' ', '\t']);
        if let Some(open) = &mut data {
            open.push(' ');
            open.push_str(line.trim());
        } else if let Some((key, value)) = line.split_once(':') {
            let (key, value) = (key.trim(), value.trim());
            if !indented && !line.starts_with(['%', '-', '#']) {
                nodes.push(Node {
                    name: key.to_owned(),
                    shape: None,
                    numbers: parse_numbers(value.split_ascii_whitespace()),
                    line: number + 1,
                });
            } else if indented && let Some(node) = nodes.last_mut() {
                match key {
                    "rows" => node.shape.get_or_insert_default()[0] = value.to_owned(),
                    "cols" => node.shape.get_or_insert_default()[1] = value.to_owned(),
                    "data" => data = Some(value.to_owned()),
                    _ => {}
                }
            }
        }
        // A list ends with its bracket, wherever that stands.
        if let Some(open) = data.take() {
            if !open.contains(']') {
                data = Some(open);
            } else if let Some(node) = nodes.last_mut() {
                let inside = open.trim_start_matches('[').split(']').next().unwrap_or("");
                node.numbers = parse_numbers(
                    inside
                        .split(',')
                        .map(str::trim)
                        .filter(|word| !word.is_empty()),
                );
            }
        }
    }
    nodes
}
