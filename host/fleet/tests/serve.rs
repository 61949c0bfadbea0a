//! The page of all presses, asked as a browser asks it.
#![cfg(feature = "serve")]

mod histories;
mod made_up;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use flankscope_fleet::lake::Lake;
use flankscope_fleet::rows::LakeCheck;
use jiff::Timestamp;
use made_up::{MadeUp, Maker};

/// Longer than anything takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// A server that ends with its test.
struct Server {
    process: Child,
    /// Host and port.
    address: String,
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Server {
    fn start(lake: &Path, more: &[&str]) -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_flankscope-fleet"))
            .args(["serve", "--listen", "127.0.0.1:0", "--lake"])
            .arg(lake)
            .args(more)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let mut told = BufReader::new(process.stdout.take().unwrap());
        told.read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("http://").unwrap().to_owned();
        Self { process, address }
    }

    /// Status and text of an answer, for a request to this name.
    fn asked_as(&self, host: &str, path: &str) -> (u16, String) {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        write!(
            stream,
            "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
        )
        .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let status = answer.split(' ').nth(1).unwrap().parse().unwrap();
        (status, answer)
    }

    fn page(&self, path: &str) -> String {
        let (status, answer) = self.asked_as(&self.address, path);
        assert_eq!(status, 200, "{path}: {answer}");
        answer
    }

    /// The page as soon as it is so.
    fn page_that(&self, path: &str, is_so: impl Fn(&str) -> bool) -> String {
        let begun = Instant::now();
        loop {
            let page = self.page(path);
            if is_so(&page) {
                return page;
            }
            assert!(begun.elapsed() < PATIENCE, "{path}: {page}");
            std::thread::sleep(Duration::from_millis(100));
        }
    }
}

/// Minutes of now, as [`MadeUp`] counts them.
fn now() -> i64 {
    (Timestamp::now().as_millisecond() - 983_404_800_000).div_euclid(60_000)
}

fn made_up(station: &str, minute: i64, wear_um: &[f64]) -> MadeUp {
    MadeUp {
        station: station.into(),
        serial: Some("A 1".into()),
        head: "h1".into(),
        minute,
        strokes: minute,
        wear_um: wear_um.iter().copied().map(Some).collect(),
    }
}

fn lake() -> (tempfile::TempDir, Lake) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lake");
    std::fs::create_dir(&path).unwrap();
    let lake = Lake::open(path.to_str().unwrap()).unwrap();
    (folder, lake)
}

/// The tile of a station on a board.
fn tile<'a>(board: &'a str, station: &str) -> &'a str {
    let name = board.find(&format!("<strong>{station}</strong>"));
    let name = name.unwrap_or_else(|| panic!("no {station}: {board}"));
    let from = board[..name].rfind("<a ").unwrap();
    let to = from + board[from..].find("</a>").unwrap();
    &board[from..to]
}

#[test]
fn every_press_stands_where_it_is_with_what_is_known_of_it_now() {
    let (folder, lake) = lake();
    let mut maker = Maker::new();
    let strange = "press <b>&\"7\"/ä";
    for (station, minutes_ago, verdict) in [
        ("press 1", 1, "go"),
        ("press 2", 1, "no-go"),
        ("press 3", 90, "go"),
        ("press 4", -10, "go"),
        ("press 5", 1, "indeterminate"),
        (strange, 1, "warn"),
    ] {
        maker.verdict = verdict;
        let check = made_up(station, now() - minutes_ago, &[12.0, 31.5, 7.0]);
        maker.put(&lake, &[check]);
    }
    // Frames that are evaluated again, in the history of one press and in another one of a second press.
    maker.verdict = "go";
    let recorded = |_: usize, check: &mut LakeCheck| check.set("link", "recorded frames".into());
    let again = made_up("press 6", now(), &[12.0]);
    maker.put(&lake, std::slice::from_ref(&again));
    maker.put_changed(&lake, &[again], recorded);
    maker.history = 2;
    maker.put_changed(&lake, &[made_up("press 2", now(), &[12.0])], recorded);
    let map = folder.path().join("hall.csv");
    std::fs::write(&map, "press 1;;press 3\r\n;press 9;press 2\r\n").unwrap();
    let path = folder.path().join("lake");
    let server = Server::start(&path, &["--hall", map.to_str().unwrap()]);
    let board = server.page_that("/board", |page| page.contains("SIMULATED"));

    for (station, class, place) in [
        ("press 1", "go", Some((1, 1))),
        ("press 2", "no-go", Some((2, 3))),
        ("press 3", "old", Some((1, 3))),
        ("press 4", "old", None),
        ("press 5", "indeterminate", None),
        ("press 6", "old", None),
        ("press 9", "old", Some((2, 2))),
        ("press &#60;b&#62;&#38;&#34;7&#34;/ä", "warn", None),
    ] {
        let tile = tile(&board, station);
        assert!(tile.contains(&format!("class=\"badge {class}\"")), "{tile}");
        let style = place.map(|(row, column)| format!("grid-row:{row};grid-column:{column}"));
        assert_eq!(tile.contains("grid-row"), style.is_some(), "{tile}");
        assert!(tile.contains(&style.unwrap_or_default()), "{tile}");
    }
    assert!(!board.contains("<b>"), "{board}");
    assert!(tile(&board, "press 2").contains("tooth 2 left: 31.5 ± 4.0 µm of 50.0"));
    assert!(tile(&board, "press 3").contains("was go"));
    assert!(tile(&board, "press 6").contains("a recording"));
    assert!(tile(&board, "press 4").contains("clock is ahead"));
    // Off the map the worst comes first.
    let at = |station: &str| board.find(&format!("<strong>{station}")).unwrap();
    assert!(at("press 5") < at("press &#60;") && at("press &#60;") < at("press 4"));
    // All of it is made up on a bench.
    assert!(tile(&board, "press 1").contains("SIMULATED"));

    // From the tile to the press, from the press to the check, by its links.
    let link = |page: &str, from: &str| {
        let from = page.find(from).unwrap() + from.len();
        let to = from + page[from..].find('"').unwrap();
        page[from..to].replace("&#38;", "&")
    };
    let press = server.page(&link(
        tile(&board, "press &#60;b&#62;&#38;&#34;7&#34;/ä"),
        "href=\"",
    ));
    assert!(
        press.contains("warn") && !press.contains("press 1"),
        "{press}"
    );
    let check = server.page(&link(&press, "<td><a href=\""));
    for wear in [
        "12.0 ± 4.0 µm",
        "31.5 ± 4.0 µm",
        "7.0 ± 4.0 µm",
        "tooth 3 left",
    ] {
        assert!(check.contains(wear), "{wear}: {check}");
    }
    for missing in [
        "/press?station=press%2012",
        "/nothing",
        "/check?station=press%201&date=2001-01-01&history=h&epoch=e&number=1",
    ] {
        assert_eq!(
            server.asked_as(&server.address, missing).0,
            404,
            "{missing}"
        );
    }
    // Another site's name that was pointed here.
    assert_eq!(server.asked_as("example.com", "/board").0, 421);
    let headers = server.page("/");
    assert!(
        headers.contains("content-security-policy: default-src 'none'"),
        "{headers}"
    );
}

#[test]
fn a_new_check_changes_its_tile_and_a_lake_that_cannot_be_read_leaves_nothing_green() {
    let (folder, lake) = lake();
    let path = folder.path().join("lake");
    let mut maker = Maker::new();
    maker.put(&lake, &[made_up("press 1", now(), &[1.0])]);
    let server = Server::start(&path, &[]);
    let is = |class: &'static str| {
        move |page: &str| {
            page.contains("<strong>")
                && tile(page, "press 1").contains(&format!("class=\"badge {class}\""))
        }
    };
    server.page_that("/board", is("go"));
    maker.verdict = "no-go";
    maker.put(&lake, &[made_up("press 1", now(), &[60.0])]);
    server.page_that("/board", is("no-go"));
    maker.verdict = "go";
    let file = maker.put(&lake, &[made_up("press 1", now(), &[1.0])]);
    server.page_that("/board", is("go"));
    // The file with a press's last check is cut short, and another press checks: what stands cannot be told from the rest.
    let cut = path.join(file.name().to_string());
    let bytes = std::fs::read(&cut).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    maker.put(&lake, &[made_up("press 2", now(), &[1.0])]);
    let board = server.page_that("/board", is("old"));
    assert!(
        board.contains("class=\"alarm\"") && !board.contains("badge go"),
        "{board}"
    );
    assert!(board.contains("no whole Parquet file"), "{board}");
    // Mended, it is believed again; without the lake it is not.
    std::fs::write(&cut, &bytes).unwrap();
    server.page_that("/board", is("go"));
    let elsewhere = folder.path().join("elsewhere");
    std::fs::rename(&path, &elsewhere).unwrap();
    let board = server.page_that("/board", is("old"));
    assert!(
        board.contains("class=\"alarm\"") && !board.contains("badge go"),
        "{board}"
    );
    // So does a folder whose disk is not mounted; mounted again, its presses are back.
    std::fs::create_dir(&path).unwrap();
    let board = server.page_that("/board", |page| page.contains("has nothing of it any more"));
    assert!(!board.contains("badge go"), "{board}");
    std::fs::remove_dir(&path).unwrap();
    std::fs::rename(&elsewhere, &path).unwrap();
    server.page_that("/board", is("go"));
}

#[test]
fn dies_and_stations_are_those_of_the_named_questions_and_a_press_is_read_page_by_page() {
    let (folder, lake) = lake();
    let mut maker = Maker::new();
    let day = now() - 1440;
    for (station, offset_um) in [("press 1", 0.0), ("press 2", 3.0)] {
        // 120 checks of one die in one day: its wear grows by 0.05 µm a check, and one station reads 3 µm more.
        let begin = day - day.rem_euclid(1440);
        let check = |n: i64| {
            let wear_um = offset_um + 0.05 * n as f64;
            made_up(station, begin + 10 * n, &[wear_um, 0.5 * wear_um])
        };
        maker.put(&lake, &(0..120).map(check).collect::<Vec<_>>());
    }
    let server = Server::start(&folder.path().join("lake"), &[]);
    let dies = server.page_that("/dies", |page| page.contains("class=\"band\""));
    assert!(dies.contains("tooth 1 left"), "{dies}");
    let stations = server.page("/stations");
    // 3 µm on one flank and 1.5 on the other: 2.25 ± 1.5.
    assert!(
        stations.contains("<td>2.2") || stations.contains("<td>2.3"),
        "{stations}"
    );
    assert!(
        stations.contains("unlike the others, within its values&#39; U95"),
        "{stations}"
    );

    let mut link = "/press?station=press%201".to_owned();
    let mut numbers: Vec<i64> = Vec::new();
    for _ in 0..3 {
        let page = server.page(&link);
        let mut rest = &page[..];
        while let Some(from) = rest.find("&#38;number=") {
            rest = &rest[from + "&#38;number=".len()..];
            numbers.push(rest[..rest.find('"').unwrap()].parse().unwrap());
        }
        let older = page.rfind("href=\"").unwrap() + "href=\"".len();
        link = page[older..older + page[older..].find('"').unwrap()].replace("&#38;", "&");
    }
    assert_eq!(numbers, (1..=120).rev().collect::<Vec<_>>());
}

#[test]
fn nobody_elses_machine_is_served_and_a_map_without_stations_is_refused() {
    let (folder, _lake) = lake();
    let path = folder.path().join("lake");
    let map = folder.path().join("hall.csv");
    std::fs::write(&map, " ; \n").unwrap();
    for (more, code, why) in [
        (
            ["--listen", "0.0.0.0:8090"],
            2,
            "only addresses of this machine",
        ),
        (["--listen", "localhost"], 2, "no address such as"),
        (["--stale-after", "0"], 2, "stale-after"),
        (["--hall", map.to_str().unwrap()], 3, "names no station"),
    ] {
        let refused = Command::new(env!("CARGO_BIN_EXE_flankscope-fleet"))
            .args(["serve", "--lake"])
            .arg(&path)
            .args(more)
            .output()
            .unwrap();
        let words = String::from_utf8_lossy(&refused.stderr);
        assert_eq!(refused.status.code(), Some(code), "{words}");
        assert!(words.contains(why), "{words}");
    }
}
