//! The page as people use it, in a browser: typed token, clicks, what is seen at a distance and on a phone, and a day of checks.

mod press;
mod screen;
#[allow(dead_code)]
mod station;

use flankscope_metrology::verdict::Word;
use press::Press;
use screen::Screen;
use serde_json::json;
use station::{Plant, Station};

/// Checks of a day at one every three minutes.
const CHECKS_OF_A_DAY: u32 = 480;
/// Boards that a page asks for here: of the 17 760 of a day (at every check and every five seconds) as many as show whether any stays.
const BOARDS: u32 = 2000;

/// The station's page after somebody typed the token and clicked.
fn logged_in(plant: &Plant) -> Option<Screen> {
    let mut screen = Screen::open(1280, 800)?;
    screen.go_to(&format!("http://{}/", plant.page));
    screen.until("document.activeElement?.name === \"token\"");
    screen.type_text("wrong");
    screen.click("button");
    screen.until_shown(".alarm", "not known");
    screen.until("document.activeElement?.name === \"token\"");
    screen.type_text(&plant.token);
    screen.click("button");
    screen.until("typeof events === \"object\" && events.readyState === EventSource.OPEN");
    Some(screen)
}

/// A station whose press made one check, with go, and its page on a screen; none where there is no browser.
fn page_of_a_sound_die() -> Option<(Station, Press, Plant, Screen)> {
    let station = Station::new(3600);
    let mut press = Press::new(&station.history());
    press.check_now("die", 40, Word::Go);
    let plant = station.serve();
    plant.board_with("verdict go");
    let screen = logged_in(&plant)?;
    Some((station, press, plant, screen))
}

/// Whether something of the page lies beyond its right edge.
fn is_too_wide(screen: &mut Screen) -> bool {
    let widths = "[document.documentElement.scrollWidth, document.documentElement.clientWidth]";
    let widths = screen.value(widths);
    widths[0].as_f64() > widths[1].as_f64()
}

/// The part of the picture that has this colour.
fn part_of(picture: &(usize, Vec<[u8; 3]>), colour: [u8; 3]) -> f64 {
    let of_it = picture.1.iter().filter(|px| **px == colour).count();
    of_it as f64 / picture.1.len() as f64
}

const GO: [u8; 3] = [0x1b, 0x7f, 0x5c];
const NO_GO: [u8; 3] = [0xa3, 0x14, 0x2a];

#[test]
fn a_no_go_appears_by_itself_and_is_cleared_by_clicks() {
    let Some((_station, mut press, plant, mut screen)) = page_of_a_sound_die() else {
        return;
    };
    screen.until_shown(".verdict", "GO");
    // As large as a hand on a screen of 24 inches, and nothing else has its colour.
    let go = screen.picture();
    let share = part_of(&go, GO);
    assert!(share > 0.1, "the verdict takes {share} of the screen");
    assert_eq!(part_of(&go, NO_GO), 0.0);
    // The age below it changes from second to second.
    let verdict = |screen: &mut Screen| {
        let rows = "(() => { const box = document.querySelector(\".verdict\").getBoundingClientRect(); \
             return [box.top, box.bottom]; })()";
        let rows = screen.value(rows);
        let (width, pixels) = screen.picture();
        let [from, to] = [0, 1].map(|k| rows[k].as_f64().unwrap() as usize * width);
        pixels[from..to].to_vec()
    };
    let shown = verdict(&mut screen);
    assert!(
        shown == verdict(&mut screen),
        "the same verdict looks different the second time"
    );

    press.check_now("die", 40, Word::NoGo);
    screen.until_shown(".verdict", "NO-GO");
    let no_go = screen.picture();
    assert!(part_of(&no_go, NO_GO) > 0.1 && part_of(&no_go, GO) == 0.0);
    assert!(shown != verdict(&mut screen));
    for (width_px, scheme) in [(400, "dark"), (400, "light"), (1280, "dark")] {
        screen.resize(width_px, 800);
        let features = json!([{ "name": "prefers-color-scheme", "value": scheme }]);
        screen.ask(
            "Emulation.setEmulatedMedia",
            json!({ "features": features }),
        );
        assert!(!is_too_wide(&mut screen), "{width_px} px, {scheme}");
        // The lightness of the paper, by its corner.
        let corner = screen.picture().1[0];
        let is_light = corner.iter().all(|part| *part > 127);
        assert_eq!(is_light, scheme == "light", "{corner:?}");
    }
    screen.ask("Emulation.setEmulatedMedia", json!({ "features": [] }));
    screen.resize(1280, 800);

    // A reason that is being typed survives the board's renewal.
    screen.click("input[name=reason]");
    screen.value("events.onmessage({ data: \"changed\" })");
    assert_eq!(screen.value("document.activeElement.name"), "reason");
    screen.type_text("insert changed");
    screen.value("events.onmessage({ data: \"changed\" })");
    assert_eq!(
        screen.value("document.querySelector(\"input[name=reason]\").value"),
        "insert changed"
    );
    screen.click("main form button");
    screen.until("!document.querySelector(\"input[name=reason]\")");
    // It was a no-go, and stays one until the next check.
    screen.until_shown(".verdict", "NO-GO");
    press.check_now("die", 40, Word::Go);
    screen.until("document.querySelector(\".verdict\").classList.contains(\"go\")");

    // From the tile to the list, to a check of it.
    screen.click(".tile a[href^=\"/checks?\"]");
    screen.until(
        "location.pathname === \"/checks\" && document.querySelectorAll(\"tbody tr\").length === 3",
    );
    screen.click("tbody tr:last-child a");
    screen.until("location.pathname === \"/checks/1\"");
    screen.until_shown("body", "40 left");

    // Without a server every verdict is grey before long.
    screen.go_to(&format!("http://{}/", plant.page));
    screen.until("document.querySelector(\".verdict.go\") !== null");
    drop(plant);
    screen.until("document.body.classList.contains(\"lost\")");
    assert!(part_of(&screen.picture(), GO) == 0.0);
}

#[test]
fn one_field_in_use_spares_its_own_tile_alone() {
    let station = Station::new(3600);
    let mut press = Press::new(&station.history());
    press.check_now("other", 40, Word::Go);
    press.check_now("die", 40, Word::NoGo);
    let plant = station.serve();
    plant.board_with("verdict no-go");
    let Some(mut screen) = logged_in(&plant) else {
        return;
    };
    let tile = |tool: &str, what: &str| format!(".tile[data-tool={tool}]{what}");
    let has = |selector: &str| format!("document.querySelector(\"{selector}\") !== null");
    screen.until(&has(&tile("other", " .verdict.go")));
    screen.click("input[name=reason]");
    screen.type_text("insert changed");
    // A no-go of the other die appears although the field is in use.
    press.check_now("other", 40, Word::NoGo);
    screen.until(&has(&tile("other", " .verdict.no-go")));
    let field = "document.querySelector(\".tile[data-tool=die] input[name=reason]\")";
    assert_eq!(screen.value(&format!("{field}.value")), "insert changed");
    assert_eq!(
        screen.value(&format!("document.activeElement === {field}")),
        true
    );
    assert_eq!(
        screen.value("document.querySelectorAll(\".tile\").length"),
        2
    );
    // The spared tile greys by itself, the renewed one does not; a wall clock that is set back keeps neither.
    screen.value("void (Date.now = () => 0)");
    screen.until(&has(&tile("die", ".expired")));
    assert_eq!(screen.value(&has(&tile("other", ".expired"))), false);
    // A history that is gone takes the renewed tile away, and the spared one is not believed.
    std::fs::rename(station.history(), station.folder.path().join("away.db")).unwrap();
    screen.until("document.querySelectorAll(\".tile:not(.expired)\").length === 0");
    screen.until_shown("main", "cannot be read");
    assert_eq!(screen.value(&format!("{field}.value")), "insert changed");
}

#[test]
fn a_go_that_becomes_too_old_is_grey_without_a_word_from_the_server() {
    let station = Station::new(6);
    let mut press = Press::new(&station.history());
    press.check_now("die", 40, Word::Go);
    let plant = station.serve();
    plant.board_with("verdict");
    let Some(mut screen) = logged_in(&plant) else {
        return;
    };
    press.check_now("die", 40, Word::Go);
    screen.until("document.querySelector(\".tile:not(.expired) .verdict.go\") !== null");
    // Nothing that the server sends arrives any more.
    screen.value("events.close()");
    screen.until("document.querySelector(\".tile.expired .verdict.go\") !== null");
    assert!(part_of(&screen.picture(), GO) == 0.0);
}

#[test]
fn a_page_that_is_open_for_a_day_of_checks_does_not_grow() {
    let Some((_station, mut press, plant, mut screen)) = page_of_a_sound_die() else {
        return;
    };
    screen.ask("Performance.enable", json!({}));
    // As often as the server would have called it, with the server's answers.
    let mut look = |times: u32| {
        let done = screen.value(&format!(
            "(async () => {{ for (let i = 0; i < {times}; i++) {{ await events.onmessage({{ data: \"tick\" }}); \
             if (i % 36 === 0) await events.onmessage({{ data: \"live\" }}); }} return {times}; }})()"
        ));
        assert_eq!(done, times);
        screen.held()
    };
    let tenth = |press: &mut Press| {
        for made in 0..CHECKS_OF_A_DAY / 10 {
            let verdict = if made % 7 == 0 { Word::Warn } else { Word::Go };
            press.check_now("die", 40, verdict);
        }
    };
    // The first tenth fills caches.
    tenth(&mut press);
    let before = look(BOARDS / 10);
    let server_before_kb = plant.resident_kb();
    for _ in 0..9 {
        tenth(&mut press);
        look(BOARDS / 10);
    }
    // A board that is on its way while elements are counted is gone a moment later; one that stayed is not.
    let mut after = look(1);
    for _ in 0..10 {
        if after[1] - before[1] < 20.0 {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(500));
        after = look(1);
    }
    let server_kb = plant.resident_kb();
    // A board that stayed would be more than a kilobyte in either, and a dozen elements.
    let boards_bytes = 1000.0 * f64::from(BOARDS * 9 / 10);
    let [bytes, elements, listeners] = [0, 1, 2].map(|counter| after[counter] - before[counter]);
    assert!(bytes < boards_bytes / 4.0, "{before:?} {after:?}");
    assert!(elements < 20.0 && listeners <= 0.0, "{before:?} {after:?}");
    assert!(
        1000.0 * (server_kb - server_before_kb) < boards_bytes,
        "the server: {server_before_kb} kB, then {server_kb} kB"
    );
}
