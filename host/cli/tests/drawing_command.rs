//! `calibrate --drawing` as a user runs it: the drawing is the file's plate, in millimetres.

mod support;

use std::path::Path;

use support::{assert_refused, flankscope, json};

/// The numbers of an attribute in every element that begins so.
fn attribute(svg: &str, element: &str, name: &str) -> Vec<f64> {
    let lines = svg.lines().filter(|line| line.starts_with(element));
    let value = |line: &str| -> f64 {
        let from = line.split_once(&format!(" {name}=\"")).unwrap().1;
        from.split('"').next().unwrap().parse().unwrap()
    };
    lines.map(value).collect()
}

/// Width and height are in millimetres, and the coordinates are these millimetres.
fn assert_true_to_scale(svg: &str) {
    let text = |before: &str| svg.split_once(before).unwrap().1.split('"').next().unwrap();
    let [width, height] = [" width=\"", " height=\""].map(|name| text(name).to_owned());
    let [w, h] = [&width, &height].map(|length| length.strip_suffix("mm").unwrap());
    assert_eq!(text("viewBox=\""), format!("0 0 {w} {h}"));
    // No mark is moved or scaled by anything else.
    let marks = svg.split_once("<g id=\"marks\"").unwrap().1;
    let marks = marks.split("</g>").next().unwrap();
    assert!(!marks.contains("transform") && !marks.contains("px"));
    // The ruler is 100 mm long, and its eleven long strokes are 10 mm apart.
    let ruler = svg.split_once("<g id=\"ruler\">").unwrap().1;
    let path = ruler.split("d=\"").nth(1).unwrap();
    let number = |text: &str| -> f64 { text.split(' ').next().unwrap().parse().unwrap() };
    let from = number(&path[1..]);
    let to: f64 = path
        .split('H')
        .nth(1)
        .unwrap()
        .split('M')
        .next()
        .unwrap()
        .parse()
        .unwrap();
    assert!((to - from - 100.0).abs() < 1e-9);
    let strokes: Vec<f64> = path
        .split('M')
        .filter(|stroke| stroke.contains("v3"))
        .map(number)
        .collect();
    assert_eq!(strokes.len(), 11);
    for (n, at) in strokes.iter().enumerate() {
        assert!((at - from - 10.0 * n as f64).abs() < 1e-9);
    }
}

fn draw(folder: &Path, of: [&str; 2]) -> (String, serde_json::Value) {
    let args = ["calibrate", "--drawing", "out.svg", "--json", "-"];
    let output = flankscope(folder, &[&args, &of[..]].concat());
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let svg = std::fs::read_to_string(folder.join("out.svg")).unwrap();
    assert_true_to_scale(&svg);
    (svg, json(&output))
}

/// The dots of a plate lie where target.toml says, the three larger ones not mirrored, and reach beyond the field in every view.
#[test]
fn the_dots_of_a_plate_are_drawn_where_the_target_file_has_them() {
    let folder = tempfile::tempdir().unwrap();
    for head in ["20mm", "10mm"] {
        let args = ["bench", "demo-target", "--head", head, "--out", head];
        assert_eq!(flankscope(folder.path(), &args).status.code(), Some(0));
        let (svg, report) = draw(folder.path(), ["--target", head]);
        let target = std::fs::read_to_string(folder.path().join(head).join("target.toml")).unwrap();
        let value = |key: &str| -> f64 {
            let line = target
                .lines()
                .find(|line| line.starts_with(&format!("{key} = ")));
            let value = line.unwrap().split_once(" = ").unwrap().1;
            value.split(' ').next().unwrap().parse().unwrap()
        };
        let pitch = value("pitch_mm");
        let [x, y, r] = ["cx", "cy", "r"].map(|name| attribute(&svg, "<circle", name));
        assert_eq!(report["marks"], x.len());
        let side = (x.len() as f64).sqrt() as usize;
        assert_eq!(side * side, x.len());
        assert!(side % 2 == 1, "one dot is in the middle");
        let low = |of: &[f64]| of.iter().copied().fold(f64::INFINITY, f64::min);
        let high = |of: &[f64]| of.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let middle = [&x, &y].map(|of| 0.5 * (low(of) + high(of)));
        let mut places = std::collections::BTreeSet::new();
        for ((x, y), r) in x.iter().zip(&y).zip(&r) {
            // y points up on the plate and down in an SVG.
            let at = [x - middle[0], middle[1] - y].map(|mm| mm / pitch);
            let place = at.map(|of| of.round() as i64);
            for (at, place) in at.iter().zip(place) {
                assert!((at - place as f64).abs() * pitch < 1e-9, "{at}");
            }
            let is_key = [[0, 0], [2, 0], [0, 1]].contains(&place);
            let diameter = value(if is_key {
                "key_diameter_mm"
            } else {
                "diameter_mm"
            });
            assert!((2.0 * r - diameter).abs() < 1e-9, "{place:?}: {r}");
            places.insert(place);
        }
        assert_eq!(places.len(), x.len(), "no place twice");
        // As far as half the field and the stages' way, on either side.
        let field = if head == "20mm" { 10.0 } else { 6.0 };
        let raised: Vec<f64> = target
            .lines()
            .filter_map(|line| line.strip_prefix("raised_mm = ")?.parse().ok())
            .collect();
        assert!(!raised.is_empty());
        let half = 0.5 * field + raised.iter().fold(0.0, |most: f64, mm| most.max(mm.abs()));
        assert!(0.5 * (high(&x) - low(&x)) >= half, "{head}");
        assert_eq!(report["tolerance_mm"], value("pose_sigma_mm"));
        let said = format!(
            " × {pitch} = {:.3} ±{}",
            (side - 1) as f64 * pitch,
            value("pose_sigma_mm")
        );
        assert_eq!(svg.matches(&said).count(), 2, "{said}");
        assert!(svg.contains("6 pieces with this print"));
    }
}

/// Circles and squares of a board, whose plans need not exist yet.
#[test]
fn the_points_of_a_board_are_drawn_where_the_board_file_has_them() {
    let folder = tempfile::tempdir().unwrap();
    let write = |text: &str| std::fs::write(folder.path().join("board.toml"), text).unwrap();
    let of_board = ["--board", "board.toml"];
    write(
        "kind = \"circles\"\ncolumns = 7\nrows = 5\npitch_mm = 3.0\npitch_sigma_mm = 0.003\ndiameter_mm = 1.2\nbright = true\n",
    );
    let (svg, report) = draw(folder.path(), of_board);
    let [x, y, r] = ["cx", "cy", "r"].map(|name| attribute(&svg, "<circle", name));
    assert_eq!(x.len(), 35);
    assert_eq!(report["size_mm"], serde_json::json!([27.0, 21.0]));
    for (n, ((x, y), r)) in x.iter().zip(&y).zip(&r).enumerate() {
        let first = [
            attribute(&svg, "<circle", "cx")[0],
            attribute(&svg, "<circle", "cy")[0],
        ];
        assert!((x - first[0] - 3.0 * (n % 7) as f64).abs() < 1e-9);
        assert!((first[1] - y - 3.0 * (n / 7) as f64).abs() < 1e-9);
        assert_eq!(*r, 0.6);
    }
    assert!(svg.contains("6 × 3 = 18.000 ±0.003") && svg.contains("every length to 0.10 %"));
    assert!(
        svg.contains("fill=\"black\" stroke=\"grey\"")
            && svg.contains("id=\"marks\" fill=\"white\"")
    );

    // A checkerboard of 9 x 6 inner crossings has 10 x 7 squares, and every second one is black.
    write("kind = \"checkerboard\"\ncolumns = 9\nrows = 6\npitch_mm = 10.0\n");
    let (svg, _) = draw(folder.path(), of_board);
    let marks = svg
        .split_once("<g id=\"marks\"")
        .unwrap()
        .1
        .split("</g>")
        .next()
        .unwrap();
    let [x, y, width] = ["x", "y", "width"].map(|name| attribute(marks, "<rect", name));
    assert_eq!(x.len(), 35);
    assert!(width.iter().all(|mm| *mm == 10.0));
    // Corners of black squares that meet: 9 x 6 of them lie in the middle of two.
    let mut corners = std::collections::BTreeMap::new();
    for (x, y) in x.iter().zip(&y) {
        for corner in [
            [*x, *y],
            [x + 10.0, *y],
            [*x, y + 10.0],
            [x + 10.0, y + 10.0],
        ] {
            *corners
                .entry(corner.map(|mm| (1e6 * mm).round() as i64))
                .or_insert(0) += 1;
        }
    }
    assert_eq!(corners.values().filter(|count| **count == 2).count(), 54);
    assert!(svg.contains("measure it over many points"));
    std::fs::remove_file(folder.path().join("out.svg")).unwrap();

    // What is drawn is named, and known.
    let refused = |args: &[&str]| {
        flankscope(
            folder.path(),
            &[&["calibrate", "--drawing", "out.svg"], args].concat(),
        )
    };
    let nothing = refused(&[]);
    assert_eq!(nothing.status.code(), Some(3));
    let said = String::from_utf8_lossy(&nothing.stderr).into_owned();
    assert!(
        said.contains("--target DIR") && said.contains("--board BOARD.toml"),
        "{said}"
    );
    write("kind = \"circles\"\ncolumns = 2\nrows = 6\npitch_mm = 10.0\n");
    let output = refused(&of_board);
    assert_eq!(output.status.code(), Some(3));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    for words in [
        "board.toml",
        "columns = 2: must be 3 to 200 points",
        "diameter_mm = 10.0",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let missing = refused(&["--target", "nowhere"]);
    assert_refused(
        folder.path(),
        "nowhere",
        &missing,
        &["nowhere", "target.toml"],
    );
}
