//! The plant's process against histories that the instrument writes: who gets in, what is shown, and what it shows when it knows
//! nothing.

#[allow(dead_code)]
mod station;

use std::fs::Permissions;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use flankscope_tests::{Killed, flankscope, run, with_small_head};
use station::{Plant, Printed, Station, plant, printed};

const ROUTES: [&str; 11] = [
    "/",
    "/board",
    "/now",
    "/events",
    "/checks",
    "/checks/1",
    "/checks/1/document",
    "/trend?tool=demo%20die",
    "/reports/a.html",
    "/metrics",
    "/users",
];

#[test]
fn a_verdict_is_shown_on_the_page_in_registers_and_in_metrics() {
    let station = Station::new(3600);
    let plant = station.serve();
    // Before the first check: a fault, and nothing that could be taken for a go.
    plant.board_with("cannot be read");
    assert_eq!(plant.registers()[0], 1 << 7);
    assert_eq!(station.check(&[]), 0);
    let board = plant.board_with("verdict go");
    assert!(
        board.contains("SIMULATED") && board.contains("40 "),
        "{board}"
    );
    let registers = plant.registers();
    // go, simulated.
    assert_eq!(
        (registers[0], registers[3]),
        (0b10_0001, 1),
        "{registers:?}"
    );
    assert!(registers[2] < 60, "age: {registers:?}");
    assert_eq!(registers[4..6], [0, 1], "check 1: {registers:?}");
    let again = plant.registers();
    std::thread::sleep(Duration::from_millis(1500));
    assert_ne!(plant.registers()[1], again[1], "it lives");

    assert_eq!(station.check(&["--wear", "40:left:80"]), 1);
    let board = plant.board_with("verdict no-go");
    assert!(
        board.contains("is not acknowledged") && !board.contains("verdict go"),
        "{board}"
    );
    let registers = plant.registers();
    // no-go, latched, simulated.
    assert_eq!(
        (registers[0], registers[3]),
        (0b11_0100, 3),
        "{registers:?}"
    );
    let wear_um = f64::from(registers[8] as i16) / 10.0;
    let u95_um = f64::from(registers[9]) / 10.0;
    assert!(
        // The small head, which sees no neighbour, states an even wear of 80 µm with 20 to 26 µm.
        (wear_um - 80.0).abs() < 10.0 && (0.1..30.0).contains(&u95_um),
        "{registers:?}"
    );

    // In the browser's language, but what the history stores as it was stored.
    for (path, wanted) in [
        ("/", "<html lang=\"de\">"),
        ("/board", "ihr NO-GO ist nicht quittiert"),
        ("/checks", "größter Verschleiß"),
        ("/checks/2", "is beyond the stop limit"),
        ("/now", "keine Überwachung"),
    ] {
        let token = &station.token;
        let page = plant.get(
            path,
            &format!("Authorization: Bearer {token}\r\nAccept-Language: de-CH, en;q=0.5\r\n"),
        );
        assert!(page.text.contains(wanted), "no {wanted} in {}", page.text);
    }

    let metrics = plant.with_token("/metrics").text;
    for line in [
        "flankscope_history_readable 1.0",
        "flankscope_no_go_latched{tool=\"demo die\",station=",
        "verdict=\"no-go\"} 1.0",
        "# EOF",
    ] {
        assert!(metrics.contains(line), "no {line} in {metrics}");
    }
    let list = plant.with_token("/checks?verdict=no-go&tool=").text;
    assert!(
        list.contains("/checks/2\"") && !list.contains("/checks/1\""),
        "{list}"
    );
    let check = plant.with_token("/checks/2").text;
    let report = check
        .split("/reports/")
        .nth(1)
        .and_then(|link| link.split('"').next());
    let report = plant
        .with_token(&format!("/reports/{}", report.unwrap()))
        .text;
    assert!(report.contains("How the deviations of the inspected zones are spread"));
    assert!(plant.with_token("/").text.contains("/reports/map3d.html"));
    let map3d = plant.with_token("/reports/map3d.html").text;
    assert!(map3d.contains("webgl2"));
    let trend = plant.with_token("/trend?tool=demo%20die").text;
    assert!(trend.contains("40 left"), "{trend}");
    let document = plant.with_token("/checks/2/document").text;
    assert!(document.contains("\"no-go\""), "{document}");
    assert_eq!(plant.with_token("/checks/3").status, 404);
}

#[test]
fn a_no_go_is_acknowledged_by_name_and_reason_and_the_watch_obeys() {
    let station = Station::new(3600);
    let plant = station.serve();
    plant.page_with("/now", "No watch is running");
    let mut watch = flankscope();
    watch.args([
        "watch", "--speed", "10", "--every", "12", "--cycles", "5000",
    ]);
    with_small_head(&mut watch, &["--teeth", "40"])
        .args(["--wear-rate", "40:left:40", "--history"])
        .arg(station.history());
    let watch = watch
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut watch = Killed(watch);
    let mut lines = BufReader::new(watch.0.stderr.take().unwrap()).lines();
    let mut heard = |wanted: &str| {
        let found = lines.any(|line| line.unwrap().contains(wanted));
        assert!(found, "the watch ended without: {wanted}");
    };
    heard("no-go stays until it is acknowledged");
    // What the watch does, its last steps and pictures.
    for part in [
        "demo die",
        "shown <strong>no-go<",
        "head moves to",
        "tooth 40 left ±",
        "Camera: lost 0 of",
        "Free for the history:",
        "camera frame",
        "data:image/png;base64,",
    ] {
        plant.page_with("/now", part);
    }
    let metrics = plant.with_token("/metrics").text;
    let lost = "flankscope_watch_frames_lost_total{tool=\"demo die\",station=";
    assert!(metrics.contains(lost), "{metrics}");
    let standing = |plant: &Plant| -> u32 {
        let board = plant.board_with("is not acknowledged");
        let check = board.split("name=\"check\" value=\"").nth(1).unwrap();
        check.split('"').next().unwrap().parse().unwrap()
    };
    let check = standing(&plant);
    let form = |check: u32| format!("check={check}&reason=insert+changed");
    let bearer = format!("Authorization: Bearer {}\r\n", plant.token);
    // Without a token, for another check, without a reason, from another site's page.
    assert_eq!(plant.post("/acknowledge", "", &form(check)).status, 401);
    assert_eq!(
        plant
            .post("/acknowledge", &bearer, &form(check + 1000))
            .status,
        409
    );
    let no_reason = format!("check={check}&reason=+");
    assert_eq!(plant.post("/acknowledge", &bearer, &no_reason).status, 422);
    let elsewhere = format!("{bearer}Origin: https://evil.example\r\n");
    assert_eq!(
        plant.post("/acknowledge", &elsewhere, &form(check)).status,
        403
    );
    // A check that began meanwhile makes a newer no-go, which then stands.
    let accepted = (0..20).any(|_| {
        let newest = form(standing(&plant));
        plant.post("/acknowledge", &bearer, &newest).status == 303
    });
    assert!(accepted);
    heard("acknowledged: the next check decides anew");
    drop(watch);
    plant.page_with("/now", "No watch is running");
    let history = run(flankscope()
        .arg("history")
        .arg(station.history())
        .args(["--json", "-"]));
    let who = &history.json["acknowledgements"][0]["who"];
    assert_eq!(who, "Anna: insert changed");
}

#[test]
fn a_check_is_started_by_who_may_and_only_where_a_watch_runs() {
    let station = Station::new(3600);
    let users = station.folder.path().join("users.toml");
    let screen = printed(&["token", "screen", "--users"], &users);
    let plant = station.serve();
    let bearer = |token: &str| format!("Authorization: Bearer {token}\r\n");
    let anna = bearer(&station.token);
    assert_eq!(plant.post("/start-check", "", "").status, 401);
    let nobody = plant.post("/start-check", &anna, "");
    assert!(
        nobody.status == 409 && nobody.text.contains("no watch runs"),
        "{}",
        nobody.text
    );
    let mut watch = flankscope();
    // Due at its beginning, and then not for months.
    watch.args(["watch", "--speed", "10", "--every", "1000000"]);
    with_small_head(&mut watch, &["--teeth", "40"]);
    watch.arg("--history").arg(station.history());
    let watch = watch.stdin(Stdio::null()).stderr(Stdio::piped()).spawn();
    let mut watch = Killed(watch.unwrap());
    let mut lines = BufReader::new(watch.0.stderr.take().unwrap()).lines();
    plant.page_with("/checks", "/checks/1\"");
    assert_eq!(plant.post("/start-check", &bearer(&screen), "").status, 403);
    let elsewhere = format!("{anna}Origin: https://evil.example\r\n");
    assert_eq!(plant.post("/start-check", &elsewhere, "").status, 403);
    assert_eq!(plant.post("/start-check", &anna, "").status, 303);
    let wanted = "Anna wants a check";
    assert!(lines.any(|line| line.unwrap().contains(wanted)));
    plant.page_with("/checks", "/checks/2\"");
    // One request is one check, however often the press opens afterwards.
    std::thread::sleep(Duration::from_secs(3));
    assert!(!plant.with_token("/checks").text.contains("/checks/3\""));
    assert!(
        plant
            .with_token("/")
            .text
            .contains("action=\"/start-check\"")
    );
    assert!(
        !plant
            .get("/", &bearer(&screen))
            .text
            .contains("action=\"/start-check\"")
    );
}

/// A line to show, what it prints further, its token and its folder.
fn demo_line() -> (Child, Printed, String, PathBuf) {
    let mut child = plant()
        .arg("demo-line")
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut printed = Printed::by_child(&mut child);
    let token = printed.after("token");
    let folder = PathBuf::from(printed.after("folder"));
    (child, printed, token, folder)
}

#[test]
fn a_line_to_show_runs_by_itself_and_leaves_nothing() {
    let (child, mut printed, token, folder) = demo_line();
    let mut line = Plant {
        page: printed.address("page     http://"),
        modbus: printed.address("modbus"),
        token,
        process: Killed(child),
    };
    line.page_with("/now", "the press is shown <strong>go<");
    line.board_with("verdict go");
    let pid = rustix::process::Pid::from_child(&line.process.0);
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    assert!(line.process.0.wait().unwrap().success());
    assert!(!folder.exists());
}

/// Processes that this one started, and theirs.
fn descendants(ancestor: u32) -> Vec<u32> {
    let entries = std::fs::read_dir("/proc").unwrap().flatten();
    let parents = entries.filter_map(|entry| {
        let id: u32 = entry.file_name().to_str()?.parse().ok()?;
        Some((id, stat(id)?.1))
    });
    let parents: Vec<(u32, u32)> = parents.collect();
    let mut found = vec![ancestor];
    let mut at = 0;
    while let Some(&parent) = found.get(at) {
        found.extend(
            parents
                .iter()
                .filter(|process| process.1 == parent)
                .map(|process| process.0),
        );
        at += 1;
    }
    found.split_off(1)
}

/// State and parent of a process (proc_pid_stat(5)).
fn stat(process: u32) -> Option<(char, u32)> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    let (_, fields) = stat.rsplit_once(") ")?;
    let mut fields = fields.split(' ');
    Some((fields.next()?.chars().next()?, fields.next()?.parse().ok()?))
}

#[test]
fn a_line_that_is_killed_outright_leaves_nothing_that_runs() {
    let (child, _printed, _, folder) = demo_line();
    let mut line = Killed(child);
    let end = Instant::now() + Duration::from_secs(60);
    // The watch and the bench that it started.
    let started = loop {
        let started = descendants(line.0.id());
        if started.len() >= 2 {
            break started;
        }
        assert!(Instant::now() < end, "{started:?}");
        std::thread::sleep(Duration::from_millis(100));
    };
    line.0.kill().unwrap();
    line.0.wait().unwrap();
    let end = Instant::now() + Duration::from_secs(20);
    let runs = |process: &u32| stat(*process).is_some_and(|(state, _)| state != 'Z');
    while started.iter().any(runs) {
        assert!(Instant::now() < end, "{started:?}");
        std::thread::sleep(Duration::from_millis(100));
    }
    // No process of its own was left that could have removed it.
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn an_admin_gives_and_revokes_tokens_which_count_at_once() {
    let station = Station::new(3600);
    assert_eq!(station.check(&["--wear", "40:left:80"]), 1);
    let users = station.folder.path().join("users.toml");
    let chief = printed(&["token", "Chief", "--role", "admin", "--users"], &users);
    let screen = printed(&["token", "screen", "--users"], &users);
    let plant = station.serve();
    let bearer = |token: &str| format!("Authorization: Bearer {token}\r\n");
    let admin = bearer(&chief);
    // Who only looks or acknowledges neither sees nor changes anything here.
    for token in [&screen, &station.token] {
        let other = bearer(token);
        assert_eq!(plant.get("/users", &other).status, 403);
        assert_eq!(
            plant.post("/users", &other, "name=a&role=admin").status,
            403
        );
        assert_eq!(
            plant.post("/users/revoke", &other, "name=Chief").status,
            403
        );
    }
    // Neither does another site's page with an admin's cookie.
    let elsewhere = format!("{admin}Origin: https://evil.example\r\n");
    assert_eq!(
        plant.post("/users", &elsewhere, "name=a&role=admin").status,
        403
    );
    assert_eq!(
        plant
            .post("/users/revoke", &elsewhere, "name=screen")
            .status,
        403
    );
    let text = || std::fs::read_to_string(&users).unwrap();
    assert!(text().contains("\"screen\"") && !text().contains("\"a\""));

    let page = plant.get("/users", &admin).text;
    for part in [
        "Chief (you)",
        "<td class=\"text\">acknowledge</td>",
        "Anna",
        "20",
    ] {
        assert!(page.contains(part), "no {part} in {page}");
    }
    assert!(!page.contains(&chief) && !page.contains("token_blake3"));
    let german = plant.get("/users", &format!("{admin}Accept-Language: de\r\n"));
    assert!(german.text.contains("Token ausstellen"), "{}", german.text);
    assert!(plant.get("/", &admin).text.contains("href=\"/users\""));
    assert!(!plant.with_token("/").text.contains("href=\"/users\""));

    // Given: shown once, good at once, and only its hash is kept.
    let given = plant.post("/users", &admin, "name=Bert&role=acknowledge");
    assert_eq!(given.status, 200);
    let token = given.text.split("<code>").nth(1).unwrap();
    let token = token.split('<').next().unwrap().to_owned();
    assert_eq!(token.len(), 64);
    assert!(!plant.get("/users", &admin).text.contains(&token));
    assert!(text().contains("\"Bert\"") && !text().contains(&token));
    let mode = std::fs::metadata(&users).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    assert_eq!(plant.get("/board", &bearer(&token)).status, 200);
    plant.board_with("is not acknowledged");
    let form = "check=1&reason=a";
    assert_eq!(
        plant.post("/acknowledge", &bearer(&token), form).status,
        303
    );
    for (form, status) in [
        ("name=Bert&role=view", 409),
        ("name=+&role=view", 422),
        ("name=a%2Fb&role=view", 422),
        ("name=c&role=king", 422),
    ] {
        assert_eq!(plant.post("/users", &admin, form).status, status, "{form}");
    }

    // Revoked: good for nothing at once.
    assert_eq!(plant.post("/users/revoke", &admin, "name=Bert").status, 303);
    assert_eq!(plant.get("/board", &bearer(&token)).status, 401);
    assert_eq!(plant.post("/users/revoke", &admin, "name=Bert").status, 404);
    let last = plant.post("/users/revoke", &admin, "name=Chief");
    assert!(
        last.status == 409 && last.text.contains("last one"),
        "{}",
        last.text
    );
    assert_eq!(plant.get("/users", &admin).status, 200);

    // So does what the command line gives and what somebody takes out of the file, with the page running.
    let guest = printed(&["token", "guest", "--users"], &users);
    assert_eq!(plant.get("/board", &bearer(&guest)).status, 200);
    let without = text().replace("name = \"guest\"", "name = \"other\"");
    let without = without.split("[[user]]\nname = \"other\"").next().unwrap();
    std::fs::write(&users, without).unwrap();
    assert_eq!(plant.get("/board", &bearer(&guest)).status, 401);
    assert_eq!(plant.get("/board", &admin).status, 200);
    // A file that others can read lets nobody in.
    std::fs::set_permissions(&users, Permissions::from_mode(0o644)).unwrap();
    assert_eq!(plant.get("/board", &admin).status, 401);
    std::fs::set_permissions(&users, Permissions::from_mode(0o600)).unwrap();

    // A file that was made read-only, and an admin whose line somebody took out of it.
    let writable = std::fs::metadata(&users).unwrap().permissions();
    std::fs::set_permissions(&users, Permissions::from_mode(0o400)).unwrap();
    let refused = plant.post("/users/revoke", &admin, "name=screen");
    assert!(
        refused.status == 503 && refused.text.contains("read-only"),
        "{}",
        refused.text
    );
    std::fs::set_permissions(&users, writable).unwrap();
    assert_eq!(plant.get("/board", &bearer(&screen)).status, 200);
    std::fs::write(
        &users,
        text().replace("role = \"admin\"", "role = \"view\""),
    )
    .unwrap();
    assert_eq!(
        plant.post("/users/revoke", &admin, "name=screen").status,
        403
    );
    assert_eq!(plant.get("/users", &admin).status, 403);
}

#[cfg(feature = "tls")]
fn openssl(folder: &Path, arguments: &str) {
    let mut command = Command::new("openssl");
    command.args(arguments.split(' ')).current_dir(folder);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{output:?}");
}

#[cfg(feature = "tls")]
#[test]
fn a_page_with_a_certificate_speaks_tls_alone_to_clients_that_verify_it() {
    if flankscope_test_requisites::openssl().is_none() {
        return;
    }
    let station = Station::new(3600);
    assert_eq!(station.check(&[]), 0);
    let folder = station.folder.path();
    let new = "-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2";
    for name in ["plant", "other"] {
        openssl(
            folder,
            &format!("req -x509 {new} -keyout {name}.key -out {name}.pem -subj /CN={name}"),
        );
    }
    openssl(
        folder,
        &format!("req {new} -keyout press7.key -out press7.csr -subj /CN=press7"),
    );
    std::fs::write(
        folder.join("names"),
        "subjectAltName=DNS:press7.example.org\n",
    )
    .unwrap();
    let sign =
        "x509 -req -in press7.csr -CA plant.pem -CAkey plant.key -CAcreateserial -extfile names";
    openssl(folder, &format!("{sign} -out press7.pem -days 2"));
    // Valid for this second.
    openssl(folder, &format!("{sign} -out old.pem -days 0"));
    let settings = |listen: &str, more: &str| {
        let text = format!(
            "history = \"press.db\"\nstale_after_s = 3600\n\n[page]\nlisten = \"{listen}\"\nusers = \"users.toml\"\n{more}\n\n\
             [modbus]\nlisten = \"127.0.0.1:0\"\n"
        );
        std::fs::write(folder.join("plant.toml"), text).unwrap();
    };
    let refused = |message: &str| {
        let output = plant()
            .arg("serve")
            .arg(folder.join("plant.toml"))
            .output()
            .unwrap();
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            output.status.code() == Some(3) && error.contains(message),
            "{error}"
        );
    };
    let name = "name = \"press7.example.org\"";
    let both = "certificate = \"press7.pem\"\nkey = \"press7.key\"";
    settings("0.0.0.0:0", name);
    refused("tokens would cross the network in clear");
    settings("127.0.0.1:0", "certificate = \"press7.pem\"");
    refused("a certificate needs its `key`");
    settings("0.0.0.0:0", both);
    refused("in `name`");
    let mode = |mode| {
        std::fs::set_permissions(folder.join("press7.key"), Permissions::from_mode(mode)).unwrap();
    };
    settings("0.0.0.0:0", &format!("{name}\n{both}"));
    mode(0o644);
    refused("press7.key: mode 644");
    mode(0o600);
    settings(
        "0.0.0.0:0",
        &format!("{name}\ncertificate = \"other.pem\"\nkey = \"press7.key\""),
    );
    refused("do not belong together");

    settings("0.0.0.0:0", &format!("{name}\n{both}"));
    let plant = station.serve();
    let port = plant.page.port();
    // What a client of others gets that asks by name, and verifies what it is shown.
    let asked = |ca: &str, version: &str, request: &str| {
        let mut client = Command::new("openssl")
            .args([
                "s_client",
                "-quiet",
                "-verify_return_error",
                "-verify_hostname",
                "press7.example.org",
            ])
            .args(["-servername", "press7.example.org", version, "-CAfile", ca])
            .arg("-connect")
            .arg(format!("127.0.0.1:{port}"))
            .current_dir(folder)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let _may_have_ended = client.stdin.take().unwrap().write_all(request.as_bytes());
        let output = client.wait_with_output().unwrap();
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let request = |path: &str, host: &str, more: &str| {
        format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n")
    };
    let bearer = format!("Authorization: Bearer {}\r\n", station.token);
    // The history is read soon.
    let end = Instant::now() + Duration::from_secs(60);
    let checks = request("/checks", "press7.example.org", &bearer);
    while asked("plant.pem", "-tls1_3", &checks).starts_with("HTTP/1.1 503") {
        assert!(Instant::now() < end);
        std::thread::sleep(Duration::from_millis(100));
    }
    for version in ["-tls1_2", "-tls1_3"] {
        for host in [
            "press7.example.org".to_owned(),
            format!("press7.example.org:{port}"),
        ] {
            let answer = asked("plant.pem", version, &request("/checks", &host, &bearer));
            assert!(
                answer.starts_with("HTTP/1.1 200") && answer.contains("/checks/1"),
                "{answer}"
            );
        }
    }
    let healthz = request("/healthz", "press7.example.org", "");
    assert_eq!(
        asked("other.pem", "-tls1_3", &healthz),
        "",
        "a stranger's certificate"
    );
    assert_eq!(
        asked("plant.pem", "-tls1_1", &healthz),
        "",
        "an old version"
    );
    let form = format!("token={}&to=%2F", station.token);
    let login = format!(
        "POST /login HTTP/1.1\r\nHost: press7.example.org\r\nConnection: close\r\nContent-Type: application/x-www-form-urlencoded\r\n\
         Content-Length: {}\r\n\r\n{form}",
        form.len()
    );
    let answer = asked("plant.pem", "-tls1_3", &login);
    assert!(
        answer.contains("HttpOnly; SameSite=Strict; Secure"),
        "{answer}"
    );
    // In clear there is no answer in HTTP.
    let mut plain = TcpStream::connect(("127.0.0.1", port)).unwrap();
    plain
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    plain.write_all(healthz.as_bytes()).unwrap();
    let mut answer = Vec::new();
    let _closed = plain.read_to_end(&mut answer);
    assert!(!answer.starts_with(b"HTTP"), "{answer:?}");
    // One that says nothing is closed in time.
    let mut silent = TcpStream::connect(("127.0.0.1", port)).unwrap();
    silent
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    let begin = Instant::now();
    assert_eq!(silent.read(&mut [0]).unwrap_or(0), 0);
    assert!(
        begin.elapsed() < Duration::from_secs(15),
        "{:?}",
        begin.elapsed()
    );
    drop(plant);

    // An expired certificate is served, and named.
    settings(
        "127.0.0.1:0",
        &format!("{name}\ncertificate = \"old.pem\"\nkey = \"press7.key\""),
    );
    let mut command = self::plant();
    command
        .arg("serve")
        .arg(folder.join("plant.toml"))
        .stdout(Stdio::null());
    let mut old = Killed(command.stderr(Stdio::piped()).spawn().unwrap());
    let mut lines = BufReader::new(old.0.stderr.take().unwrap()).lines();
    let warning = lines
        .find(|line| line.as_ref().unwrap().contains("old.pem"))
        .unwrap()
        .unwrap();
    assert!(
        warning.contains("this certificate expired at 20"),
        "{warning}"
    );
}

#[cfg(not(feature = "tls"))]
#[test]
fn a_certificate_is_refused_by_a_program_without_tls() {
    let station = Station::new(3600);
    let file = station.folder.path().join("plant.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let users = "users = \"users.toml\"";
    let both = format!("{users}\ncertificate = \"a.pem\"\nkey = \"a.key\"");
    std::fs::write(&file, text.replace(users, &both)).unwrap();
    let output = plant().arg("serve").arg(file).output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        output.status.code() == Some(3) && error.contains("--features tls"),
        "{error}"
    );
}

#[test]
fn a_token_that_may_look_does_not_acknowledge() {
    let station = Station::new(3600);
    assert_eq!(station.check(&["--wear", "40:left:80"]), 1);
    let users = station.folder.path().join("users.toml");
    let plant = station.serve();
    assert!(plant.board_with("is not acknowledged").contains("<form"));
    drop(plant);
    let token = printed(&["token", "screen", "--users"], &users);
    let station = Station { token, ..station };
    let plant = station.serve();
    let board = plant.board_with("is not acknowledged");
    assert!(!board.contains("<form"), "{board}");
    let bearer = format!("Authorization: Bearer {}\r\n", plant.token);
    assert_eq!(
        plant
            .post("/acknowledge", &bearer, "check=1&reason=a")
            .status,
        403
    );
}

#[test]
fn nobody_comes_in_without_a_token() {
    let station = Station::new(3600);
    assert_eq!(station.check(&[]), 0);
    let plant = station.serve();
    plant.board_with("verdict go");
    for path in ROUTES {
        assert_eq!(plant.get(path, "").status, 401, "{path}");
        let other = "Authorization: Bearer 0000\r\n";
        assert_eq!(plant.get(path, other).status, 401, "{path}");
    }
    assert_eq!(plant.get("/healthz", "").status, 200);
    let answer = plant.post("/login", "", "token=0000&to=%2F");
    assert_eq!(answer.status, 401);
    // A browser: token in, cookie out, and on to where it wanted to go.
    let form = |to: &str| format!("token={}&to={to}", plant.token);
    let answer = plant.post("/login", "", &form("%2Fchecks"));
    assert_eq!(answer.status, 303);
    let text = answer.text.to_ascii_lowercase();
    assert!(
        text.contains("httponly; samesite=strict") && text.contains("location: /checks"),
        "{text}"
    );
    let cookie = format!("Cookie: a=b; flankscope_token={}\r\n", plant.token);
    assert_eq!(plant.get("/checks", &cookie).status, 200);
    // Nowhere else.
    for to in [
        "%2F%2Fevil.example%2F",
        "https%3A%2F%2Fevil.example",
        "%2F%5Cevil.example",
    ] {
        let text = plant
            .post("/login", "", &form(to))
            .text
            .to_ascii_lowercase();
        assert!(text.contains("location: /\r\n"), "{to}: {text}");
    }
    // Another site's page, and another site's name for this address.
    let elsewhere = "Origin: https://evil.example\r\n";
    assert_eq!(plant.post("/logout", elsewhere, "").status, 403);
    let host = "GET /healthz HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n";
    assert_eq!(plant.send(host).status, 421);
    // Nothing leads out of the folder of reports.
    std::fs::write(station.folder.path().join("secret.html"), "secret").unwrap();
    for path in [
        "/reports/..%2Fsecret.html",
        "/reports/%2e%2e%2fsecret.html",
        "/reports/../secret.html",
    ] {
        let answer = plant.with_token(path);
        assert!(
            answer.status == 404 && !answer.text.contains("secret"),
            "{path}: {}",
            answer.text
        );
    }
    // A body beyond any token.
    assert_eq!(plant.post("/login", "", &"a".repeat(1 << 20)).status, 413);
}

#[test]
fn what_is_old_or_cannot_be_believed_is_no_go_ahead() {
    let station = Station::new(2);
    assert_eq!(station.check(&[]), 0);
    let plant = station.serve();
    let board = plant.board_with("verdict old");
    assert!(board.contains("no longer counts"), "{board}");
    let registers = plant.registers();
    // simulated, stale.
    assert_eq!(
        (registers[0], registers[3]),
        (0b110_0000, 0),
        "{registers:?}"
    );
    // Somebody turns the stored verdict.
    let mut bytes = std::fs::read(station.history()).unwrap();
    let word = b"verdict";
    let places: Vec<_> = (0..bytes.len() - word.len())
        .filter(|&at| &bytes[at..at + word.len()] == word)
        .collect();
    for at in places {
        bytes[at] = b'w';
    }
    let edited = station.folder.path().join("edited.db");
    std::fs::write(&edited, bytes).unwrap();
    std::fs::rename(&edited, station.history()).unwrap();
    let board = plant.board_with("cannot be read");
    assert!(!board.contains("verdict go"), "{board}");
    assert_eq!(plant.registers()[0] & 0b1000_0001, 0b1000_0000);
}

#[test]
fn connections_that_say_nothing_hold_up_nobody() {
    let station = Station::new(3600);
    let plant = station.serve();
    let silent: Vec<_> = (0..500)
        .map(|_| TcpStream::connect(plant.page).unwrap())
        .collect();
    assert_eq!(plant.get("/healthz", "").status, 200);
    // Of Modbus at most 32; the others are closed, and these answer.
    let held: Vec<_> = (0..20)
        .map(|_| TcpStream::connect(plant.modbus).unwrap())
        .collect();
    assert_eq!(plant.registers().len(), 10);
    // Beyond the registers, and an order to write.
    assert_eq!(plant.ask_registers([4, 0, 5, 0, 6]), [0x84, 2]);
    assert_eq!(plant.ask_registers([6, 0, 0, 0, 1]), [0x86, 1]);
    drop((silent, held));
}

fn refused(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(3), "{output:?}");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn settings_that_would_serve_nothing_or_everybody_are_refused() {
    let station = Station::new(3600);
    let folder = station.folder.path();
    let file = folder.join("plant.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let serve = |text: &str| -> String {
        std::fs::write(&file, text).unwrap();
        refused(&plant().arg("serve").arg(&file).output().unwrap())
    };
    let no_listener = "history = \"press.db\"\nstale_after_s = 60\n";
    assert!(serve(no_listener).contains("nothing would listen"));
    #[cfg(not(feature = "mqtt"))]
    {
        let keys =
            "broker = \"localhost:1883\"\nname = \"press7\"\ndelivered = \"delivered.toml\"\n";
        assert!(serve(&format!("{text}[mqtt]\n{keys}")).contains("--features mqtt"));
    }
    let open = text.replacen("127.0.0.1:0", "0.0.0.0:0", 1);
    assert!(serve(&open).contains("proxy with TLS"));
    assert!(serve(&text.replace("3600", "0")).contains("stale_after_s = 0"));
    assert!(serve(&text.replace("reports", "report")).contains("report"));
    assert!(serve(&text.replace("users.toml", "nobody.toml")).contains("nobody.toml"));
    let users = folder.join("users.toml");
    let chmod = |mode: &str| {
        let done = Command::new("chmod")
            .arg(mode)
            .arg(&users)
            .status()
            .unwrap();
        assert!(done.success());
    };
    chmod("644");
    assert!(serve(&text).contains("chmod 600"));
    chmod("600");
    let token = |name: &str, users: &Path| {
        let mut command = plant();
        command
            .args(["token", name, "--users"])
            .arg(users)
            .output()
            .unwrap()
    };
    assert!(refused(&token("Anna", &users)).contains("has a token already"));
    assert!(refused(&token("a\"b", &users)).contains("is no name"));
    let kept = std::fs::read_to_string(&users).unwrap();
    assert!(!kept.contains(&station.token), "the file keeps no token");
}

/// What another's server answers to a question about the metrics that it scraped; none while it has no answer.
fn asked(server: SocketAddr, question: &str) -> Option<Vec<serde_json::Value>> {
    let spelled: String = question
        .bytes()
        .map(|byte| format!("%{byte:02X}"))
        .collect();
    let mut stream = TcpStream::connect(server).ok()?;
    stream
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    let request = format!("GET /api/v1/query?query={spelled} HTTP/1.0\r\nHost: {server}\r\n\r\n");
    stream.write_all(request.as_bytes()).ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    let (_, body) = answer.split_once("\r\n\r\n")?;
    let body: serde_json::Value = serde_json::from_str(body).ok()?;
    // A server that begins says 503 in words; a question that it does not understand is an error.
    assert_ne!(body["status"], "error", "{question}: {body}");
    let found = body["data"]["result"].as_array()?.clone();
    (!found.is_empty()).then_some(found)
}

#[test]
fn every_panel_of_the_dashboard_is_answered_by_a_server_that_scraped_the_metrics() {
    let Some(program) = flankscope_test_requisites::prometheus() else {
        return;
    };
    let station = Station::new(3600);
    assert_eq!(station.check(&["--wear", "40:left:80"]), 1);
    let plant = station.serve();
    plant.board_with("verdict no-go");
    let folder = station.folder.path();
    std::fs::write(folder.join("token"), &station.token).unwrap();
    let settings = format!(
        "global: {{scrape_interval: 1s}}\nscrape_configs:\n- job_name: station\n  authorization: {{credentials_file: token}}\n  \
         static_configs: [{{targets: [\"{}\"]}}]\n",
        plant.page
    );
    std::fs::write(folder.join("prometheus.yml"), settings).unwrap();
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let server = free.local_addr().unwrap();
    drop(free);
    let mut command = Command::new(program);
    command
        .arg("--config.file=prometheus.yml")
        .arg("--storage.tsdb.path=metrics")
        .arg(format!("--web.listen-address={server}"))
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    let _scraping = Killed(command.spawn().unwrap());

    let dashboard = flankscope_test_requisites::workspace().join("docs/plant-grafana.json");
    let dashboard: serde_json::Value =
        serde_json::from_slice(&std::fs::read(dashboard).unwrap()).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    let questions: Vec<(&str, &str)> = panels
        .iter()
        .flat_map(|panel| {
            let title = panel["title"].as_str().unwrap();
            let targets = panel["targets"].as_array().unwrap().iter();
            targets.map(move |target| (title, target["expr"].as_str().unwrap()))
        })
        .collect();
    let end = Instant::now() + Duration::from_secs(60);
    for (title, question) in questions {
        let found = loop {
            if let Some(found) = asked(server, question) {
                break found;
            }
            assert!(Instant::now() < end, "{title}: no answer to {question}");
            std::thread::sleep(Duration::from_millis(200));
        };
        if title == "Verdict that stands" {
            // 3: no-go, as the panel's mapping says.
            assert_eq!(found[0]["value"][1], "3", "{found:?}");
            assert_eq!(found[0]["metric"]["tool"], "demo die", "{found:?}");
        }
    }
}
