//! The pages that people keep, drawn by a browser: at three widths nothing lies beyond the edge, on A4 a result takes two sheets,
//! and hovering says what the table beside says.

use std::path::{Path, PathBuf};
use std::process::Command;

use flankscope_test_requisites::browser;
use flankscope_tests::{flankscope, run, with_small_head};

/// A phone, a tablet, a screen, px.
const WIDTHS_PX: [u32; 3] = [400, 800, 1280];

/// A browser that leaves nothing behind.
struct Browser {
    program: PathBuf,
    folder: tempfile::TempDir,
}

impl Browser {
    fn found() -> Option<Self> {
        let program = browser()?;
        let folder = tempfile::tempdir().unwrap();
        Some(Self { program, folder })
    }

    fn command(&self) -> Command {
        let mut command = Command::new(&self.program);
        let profile = self.folder.path().join("profile");
        command.args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
        ]);
        command.arg(format!("--user-data-dir={}", profile.display()));
        // Nothing of a page needs a network, and nobody is asked for updates.
        command.args([
            "--proxy-server=127.0.0.1:9",
            "--no-first-run",
            "--virtual-time-budget=4000",
        ]);
        command
    }

    /// What a script at the end of a page says by `say(text)`, in a frame of this width: a window is never narrower than 500 px.
    fn ask(&self, page: &Path, width_px: u32, script: &str) -> String {
        let text = std::fs::read_to_string(page).unwrap();
        let end = format!(
            "<script>const say = (text) => (parent.document.title = text); {script}</script></body>"
        );
        let asked = text.replace("</body>", &end);
        let asked = asked.replace('&', "&amp;").replace('"', "&quot;");
        let style = format!("width:{width_px}px;height:900px;border:0");
        let around = format!(
            "<!doctype html><title>silent</title><iframe style=\"{style}\" srcdoc=\"{asked}\"></iframe>"
        );
        let copy = self.folder.path().join("asked.html");
        std::fs::write(&copy, around).unwrap();
        let mut command = self.command();
        command
            .arg("--window-size=1500,1000")
            .arg("--dump-dom")
            .arg(&copy);
        let output = command.output().unwrap();
        let dom = String::from_utf8(output.stdout).unwrap();
        let title = dom.split("<title>").nth(1);
        let title = title.and_then(|rest| rest.split("</title>").next());
        title.unwrap_or_else(|| panic!("{dom}")).to_owned()
    }

    fn sheets(&self, page: &Path) -> usize {
        let file = self.folder.path().join("page.pdf");
        let mut command = self.command();
        command
            .arg("--no-pdf-header-footer")
            .arg(format!("--print-to-pdf={}", file.display()));
        assert!(command.arg(page).output().unwrap().status.success());
        let bytes = std::fs::read(file).unwrap();
        // A page of a PDF is an object of this type; the tree of pages is of another, "/Pages".
        let text = String::from_utf8_lossy(&bytes);
        text.matches("/Type /Page\n").count()
    }

    /// Nothing lies beyond the edge at any width, and the page is printed on so many sheets.
    fn fits(&self, page: &Path, sheets: usize) {
        let script = "addEventListener('load', () => say(innerWidth + ' ' + document.documentElement.scrollWidth))";
        for width in WIDTHS_PX {
            let said = self.ask(page, width, script);
            assert_eq!(
                said,
                format!("{width} {width}"),
                "{}: window and page",
                page.display()
            );
        }
        let printed = self.sheets(page);
        assert!(
            (1..=sheets).contains(&printed),
            "{}: {printed} sheets",
            page.display()
        );
    }
}

/// Needs nothing but itself.
fn stands_alone(page: &Path) -> usize {
    let text = std::fs::read_to_string(page).unwrap();
    for outside in [
        "http://",
        "https://",
        "src=\"/",
        "<script src",
        "@import",
        "url(http",
    ] {
        assert!(
            !text.contains(outside),
            "{} holds {outside}",
            page.display()
        );
    }
    text.len()
}

/// The page in space fits, shows its picture or says why not, and its program decodes the cells of `cells.csv`.
fn the_map_in_space_holds_the_table(browser: &Browser, page: &Path, table: &str) {
    assert!(stands_alone(page) < 250_000, "kept small");
    browser.fits(page, 2);
    let script = "addEventListener('load', () => { const { cells } = cellsOf(JSON.parse(by('data').textContent)); \
        const seen = cells.filter((cell) => cell.um !== null).map((cell) => cell.um); \
        say([by('with').hidden !== by('without').hidden, cells.length, seen.length, Math.min(...seen), Math.max(...seen)].join(' ')); })";
    let said = browser.ask(page, 800, script);
    let said: Vec<&str> = said.split(' ').collect();
    let cells = table
        .lines()
        .skip(1)
        .map(|line| line.rsplit(',').next().unwrap());
    let um: Vec<f64> = cells.clone().filter_map(|um| um.parse().ok()).collect();
    let counts = [
        "true".into(),
        cells.count().to_string(),
        um.len().to_string(),
    ];
    assert_eq!(said[..3], counts);
    let ends = [
        um.iter().copied().fold(f64::INFINITY, f64::min),
        um.iter().copied().fold(f64::NEG_INFINITY, f64::max),
    ];
    for (said, told) in said[3..].iter().zip(ends) {
        let said: f64 = said.parse().unwrap();
        assert!((said - told).abs() < 0.02, "{said} and {told}");
    }
}

/// A click on a flank shows the sections through the cell that was clicked; the end of a drag shows no others.
fn sections_go_through_the_cell_that_is_clicked(browser: &Browser, page: &Path) {
    let script = "addEventListener('load', () => setTimeout(() => { \
        if (by('with').hidden) return say('no picture'); \
        const canvas = document.querySelector('canvas'), box = canvas.getBoundingClientRect(); \
        const at = (x, y) => ({ clientX: box.left + x * box.width, clientY: box.top + y * box.height, pointerId: 1 }); \
        const sections = () => [by('height').value, by('along').value].join(' '); \
        const before = sections(); \
        canvas.setPointerCapture = () => {}; \
        canvas.dispatchEvent(new PointerEvent('pointerdown', at(0.4, 0.3))); \
        canvas.dispatchEvent(new MouseEvent('click', at(0.52, 0.6))); \
        const dragged = sections(); \
        canvas.dispatchEvent(new PointerEvent('pointerdown', at(0.52, 0.6))); \
        canvas.dispatchEvent(new MouseEvent('click', at(0.52, 0.6))); \
        const { cells } = cellsOf(JSON.parse(by('data').textContent)); \
        const note = document.querySelector('.note').textContent; \
        const [along, height] = note.split(' at ')[1].match(/[0-9.]+/g).map(Number); \
        const part = +by('part').value, own = cells.filter((cell) => cell.grid.part === part); \
        const off = (cell) => Math.hypot(cell.grid.along_mm[cell.column] - along, cell.grid.height(cell.row) - height); \
        const picked = own.reduce((best, cell) => (off(cell) < off(best) ? cell : best)); \
        const ends = (line) => { const um = line.map((cell) => cell.um).filter((um) => um !== null); return `from ${number(Math.min(...um))} to ${number(Math.max(...um))} µm; ${um.length} of ${line.length} `; }; \
        say(JSON.stringify({ before, dragged, after: sections(), picked: [picked.grid.height(picked.row), picked.grid.along_mm[picked.column]].join(' '), \
          same: by('which').textContent.endsWith(note.split(' · ')[0]), \
          profile: by('profile').textContent.includes(ends(own.filter((cell) => cell.row === picked.row))), \
          lead: by('lead').textContent.includes(ends(own.filter((cell) => cell.column === picked.column))), \
          limits: document.querySelectorAll('.section line.mark').length })); }, 200))";
    let said = browser.ask(page, 800, script);
    if said == "no picture" {
        println!("not tested: this browser has no WebGL2");
        return;
    }
    let said: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(said["dragged"], said["before"], "{said}");
    assert_ne!(said["after"], said["before"], "{said}");
    let numbers = |key: &str| -> Vec<f64> {
        let text = said[key].as_str().unwrap().split(' ');
        text.map(|number| number.parse().unwrap()).collect()
    };
    for (slider, cell) in numbers("after").into_iter().zip(numbers("picked")) {
        // A slider keeps three decimals.
        assert!((slider - cell).abs() < 1e-3, "{said}");
    }
    for holds in ["same", "profile", "lead"] {
        assert_eq!(said[holds], true, "{holds} of {said}");
    }
    assert_eq!(said["limits"], 4, "warn and stop in both");
}

#[test]
fn a_check_is_read_on_a_phone_and_printed_on_two_sheets() {
    let Some(browser) = Browser::found() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let mut check = flankscope();
    let report = folder.path().to_str().unwrap();
    check.args(["inspect", "--speed", "max", "--quiet"]);
    with_small_head(&mut check, &["--wear", "40:left:80", "--report", report]);
    assert_eq!(run(&mut check).code, 1);
    let page = folder.path().join("report.html");
    assert!(stands_alone(&page) < 250_000, "kept small");
    let text = std::fs::read_to_string(&page).unwrap();
    for view in ["tooth 12", "tooth 40", "tooth 68"] {
        let frame = format!("alt=\"camera frame of {view}\"");
        assert_eq!(text.matches(&frame).count(), 1, "{frame}");
    }
    browser.fits(&page, 2);
    browser.fits(&folder.path().join("index.html"), 1);
    let table = std::fs::read_to_string(folder.path().join("cells.csv")).unwrap();
    the_map_in_space_holds_the_table(&browser, &folder.path().join("map3d.html"), &table);
    sections_go_through_the_cell_that_is_clicked(&browser, &folder.path().join("map3d.html"));
    let index = std::fs::read_to_string(folder.path().join("index.html")).unwrap();
    let flanks = std::fs::read_to_string(folder.path().join("flanks.csv")).unwrap();
    let worn = flanks.lines().find(|line| line.starts_with("40,left,"));
    let worn: Vec<f64> = worn
        .unwrap()
        .split(',')
        .skip(2)
        .take(2)
        .map(|um| um.parse().unwrap())
        .collect();
    let most_wear = format!("tooth 40 left: {:.1} ± {:.1} µm", worn[0], worn[1]);
    assert!(
        index.contains("demo die") && index.contains(&most_wear),
        "{index}"
    );

    // In the middle of the first map, against the table.
    let script = "addEventListener('load', () => { const map = document.querySelector('[data-scale]'); \
        const box = map.getBoundingClientRect(); const at = { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2 }; \
        map.dispatchEvent(new PointerEvent('pointermove', at)); say(document.querySelector('.note').textContent); })";
    let said = browser.ask(&page, 800, script);
    let shown: f64 = said
        .split(' ')
        .next()
        .unwrap()
        .replace('\u{2212}', "-")
        .parse()
        .unwrap();
    let at: Vec<f64> = said
        .split(" at ")
        .nth(1)
        .unwrap()
        .split(", ")
        .map(|place| place.split(' ').next().unwrap().parse().unwrap())
        .collect();
    let nearest = table
        .lines()
        .skip(1)
        .filter_map(|line| line.strip_prefix("12,left,"))
        .map(|line| {
            line.split(',')
                .map(|n| n.parse().unwrap_or(f64::NAN))
                .collect::<Vec<f64>>()
        })
        .filter(|cell| (cell[0] - at[0]).abs() < 0.11 && (cell[1] - at[1]).abs() < 0.11);
    // A hundred shades for the root of 0 to 100 µm: a hundredth of the root, at most 0.2 µm near 1 µm. Four cells meet there.
    let off = nearest
        .map(|cell| (cell[2] - shown).abs())
        .fold(f64::INFINITY, f64::min);
    assert!(
        off < 0.1 + 0.02 * (100.0 * shown.abs()).sqrt(),
        "{said}, off by {off}"
    );
}

#[test]
fn a_scan_is_read_on_a_phone_and_printed_on_two_sheets() {
    let Some(browser) = Browser::found() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let mut scan = flankscope();
    let report = folder.path().to_str().unwrap();
    scan.args(["scan", "--views", "12x2", "--speed", "max", "--quiet"]);
    with_small_head(&mut scan, &["--report", report]);
    // The small head shows teeth one by one, so that no view is held by a neighbour.
    assert_eq!(run(&mut scan).code, 2);
    let page = folder.path().join("report.html");
    stands_alone(&page);
    browser.fits(&page, 2);
    let text = std::fs::read_to_string(&page).unwrap();
    assert_eq!(
        text.matches("class=\"flank-bar").count(),
        168,
        "two of each of 84 teeth"
    );
}

#[test]
fn a_history_is_read_on_a_phone() {
    let Some(browser) = Browser::found() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let history = folder.path().join("bench.db");
    for _ in 0..2 {
        let mut check = flankscope();
        check.args(["inspect", "--speed", "max", "--quiet", "--teeth", "40"]);
        with_small_head(&mut check, &["--history", history.to_str().unwrap()]);
        assert_eq!(run(&mut check).code, 0);
    }
    let mut shown = flankscope();
    shown
        .arg("history")
        .arg(&history)
        .arg("--quiet")
        .arg("--report")
        .arg(folder.path());
    assert_eq!(run(&mut shown).code, 0);
    let page = folder.path().join("history.html");
    stands_alone(&page);
    browser.fits(&page, 2);
}

/// An L-shaped prism, which looks like itself in one pose only.
const PART: &str = "v 0 0 0\nv 20 0 0\nv 20 6 0\nv 8 6 0\nv 8 14 0\nv 0 14 0\n\
    v 0 0 10\nv 20 0 10\nv 20 6 10\nv 8 6 10\nv 8 14 10\nv 0 14 10\n\
    f 1 3 2\nf 1 4 3\nf 1 5 4\nf 1 6 5\nf 7 8 9\nf 7 9 10\nf 7 10 11\nf 7 11 12\n\
    f 1 2 8 7\nf 2 3 9 8\nf 3 4 10 9\nf 4 5 11 10\nf 5 6 12 11\nf 6 1 7 12\n";

/// Clicks all over both pictures, then takes four pairs of places that belong together, far apart from each other.
const PICKING: &str = "addEventListener('load', () => setTimeout(() => {
  const click = (side, x, y) => {
    const canvas = by(side), own = canvas.getBoundingClientRect();
    canvas.dispatchEvent(new MouseEvent('click', { clientX: own.left + x, clientY: own.top + y }));
    return by(`${side}-at`).textContent.split(',').map(Number);
  };
  const places = (side) => {
    const found = [];
    for (let y = 10; y < by(side).clientHeight; y += 22) for (let x = 10; x < by(side).clientWidth; x += 22) {
      const at = click(side, x, y);
      if (at.length === 3) found.push({ x, y, at });
    }
    return found;
  };
  const [cloud, cad] = ['cloud', 'cad'].map(places);
  const [s, c] = [Math.sin(0.4), Math.cos(0.4)];
  const laid = ([x, y, z]) => [c * x - s * y + 3, s * x + c * y - 2, z + 7];
  const apart = (a, b) => Math.hypot(...a.map((value, k) => value - b[k]));
  const couples = cloud.flatMap((a) => cad.map((b) => [apart(laid(a.at), b.at), a, b])).sort((a, b) => a[0] - b[0]);
  const chosen = [];
  for (const [off, a, b] of couples) if (off < 1 && chosen.length < 4 && chosen.every((of) => apart(of[0].at, a.at) > 4)) chosen.push([a, b]);
  for (const [a, b] of chosen) { click('cloud', a.x, a.y); click('cad', b.x, b.y); by('add').click(); }
  say(by('pairs').value.trim().split('\\n').join(';'));
}, 0))";

/// Whoever does not know where a cloud lies clicks the same places of both, and registers with what the page wrote.
#[test]
fn pairs_are_picked_by_clicks_and_start_a_registration() {
    let Some(browser) = Browser::found() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (part, sampled, cloud) = (at("part.obj"), at("sampled.xyz"), at("cloud.xyz"));
    std::fs::write(&part, PART).unwrap();
    let command = |args: &[&str]| {
        let done = run(flankscope().args(args));
        assert_eq!(done.code, 0, "{args:?}: {}", done.stderr);
        done
    };
    let count = ["--count", "4000", "--seed", "3"];
    command(&[&["sample", "--cad", &part][..], &count, &["-o", &sampled]].concat());
    // The cloud lies elsewhere: turned by 0.4 rad, moved by 3, -2 and 7 mm it is the CAD's.
    let (sin, cos) = 0.4_f64.sin_cos();
    let text = std::fs::read_to_string(&sampled).unwrap();
    let moved = text
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| {
            let p: Vec<f64> = line
                .split_whitespace()
                .map(|c| c.parse().unwrap())
                .collect();
            let [x, y, z] = [p[0] - 3.0, p[1] + 2.0, p[2] - 7.0];
            format!("{} {} {z}\n", cos * x + sin * y, cos * y - sin * x)
        });
    std::fs::write(&cloud, moved.collect::<String>()).unwrap();

    let page = at("pick.html");
    let on = ["register", "--cad", &part, "--cloud", &cloud];
    command(&[&on[..], &["--pick", &page]].concat());
    let page = std::path::Path::new(&page);
    let picked = browser.ask(page, 1280, PICKING);
    let pairs: Vec<&str> = picked.split(';').collect();
    assert_eq!(pairs.len(), 4, "{picked}");
    // What was picked are points of the file, to the 0.1 um that the page writes.
    let text = std::fs::read_to_string(&cloud).unwrap();
    let numbers =
        |line: &str, by: char| -> Vec<f64> { line.split(by).map(|c| c.parse().unwrap()).collect() };
    let known: Vec<Vec<f64>> = text.lines().map(|line| numbers(line, ' ')).collect();
    for pair in &pairs {
        let pair = numbers(pair, ',');
        assert_eq!(pair.len(), 6, "{pair:?}");
        let is_near = |point: &Vec<f64>| (0..3).all(|k| (point[k] - pair[k]).abs() < 1e-4);
        assert!(known.iter().any(is_near), "{pair:?}");
    }
    let file = at("pairs.csv");
    std::fs::write(&file, pairs.join("\n") + "\n").unwrap();
    let found = command(&[&on[..], &["--pairs", &file, "--json", "-"]].concat());
    assert_eq!(found.json["status"], "registered", "{}", found.json);
    let rows: [[f64; 4]; 4] =
        serde_json::from_value(found.json["tool_from_cloud"].clone()).unwrap();
    for (row, expected) in rows
        .iter()
        .zip([[cos, -sin, 0.0, 3.0], [sin, cos, 0.0, -2.0]])
    {
        for (got, expected) in row.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-3, "{rows:?}");
        }
    }
    browser.fits(page, 1);
}
