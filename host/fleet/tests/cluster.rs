//! A cluster on the loopback, of Ballista's scheduler and executors as they are published, answers as this program alone does.
#![cfg(feature = "cluster")]

mod histories;
mod made_up;
mod same_rows;

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use flankscope_fleet::compact::{Compaction, compact};
use flankscope_fleet::lake::Lake;
use flankscope_fleet::query::questions;
#[cfg(feature = "s3")]
use flankscope_test_requisites::lake_readers;
use flankscope_test_requisites::{Random, ballista};
use histories::run;
use made_up::{MadeUp, Maker};
use serde_json::{Value, json};

/// Every pair of checks of a flank: some seconds of work behind the first exchange of rows between executors.
const PAIRS: &str = "SELECT a.station, count(*) AS pairs, sum(a.check_number * b.tool_cycles) AS mixed FROM checks a JOIN checks b \
    ON a.tooth = b.tooth AND sin(a.wear_um) * cos(b.wear_um) < 0.9 GROUP BY a.station ORDER BY a.station";

const TABLES: &str = "SELECT table_name FROM information_schema.tables ORDER BY table_name";

/// Processes that end with the test, and the folder in which they work.
struct Cluster {
    folder: tempfile::TempDir,
    port: u16,
    scheduler: Child,
    executors: Vec<Child>,
}

impl Drop for Cluster {
    fn drop(&mut self) {
        for child in self.executors.iter_mut().chain([&mut self.scheduler]) {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().port()
}

fn start(command: &mut Command, log: &Path) -> Child {
    let log = std::fs::File::create(log).unwrap();
    command.stdin(Stdio::null()).stderr(Stdio::null());
    command.stdout(log).spawn().unwrap()
}

impl Cluster {
    /// A scheduler, which gives up executors that are silent for five seconds; `None` where the programs are missing.
    fn new() -> Option<Self> {
        let [scheduler, _] = ballista()?;
        let (folder, port) = (tempfile::tempdir().unwrap(), free_port());
        let mut command = Command::new(scheduler);
        command
            .args(["--bind-host", "127.0.0.1", "--bind-port"])
            .arg(port.to_string())
            .args(["--task-distribution", "round-robin"])
            .args(["--executor-timeout-seconds", "5"])
            .args(["--expire-dead-executor-interval-seconds", "1"]);
        let scheduler = start(&mut command, &folder.path().join("scheduler"));
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            std::thread::sleep(Duration::from_millis(50));
        }
        Some(Self {
            folder,
            port,
            scheduler,
            executors: Vec::new(),
        })
    }

    /// An executor, by a command that starts its program in an environment of its own, or the program.
    fn executor(&mut self, before: &[&str], environment: &[(&str, String)]) {
        let [_, program] = ballista().unwrap();
        let name = format!("executor{}", self.executors.len());
        let work = self.folder.path().join(&name);
        std::fs::create_dir(&work).unwrap();
        let mut words = before.iter().map(Into::into).chain([program]);
        let mut command = Command::new(words.next().unwrap());
        command
            .args(words)
            .args(["--bind-host", "127.0.0.1", "--external-host", "127.0.0.1"])
            .args(["--scheduler-host", "127.0.0.1", "--vcores", "2"])
            .args(["--executor-heartbeat-interval-seconds", "1"])
            .arg("--work-dir")
            .arg(&work)
            .envs(environment.iter().cloned());
        for (option, port) in [
            ("--scheduler-port", self.port),
            ("--bind-port", free_port()),
            ("--bind-grpc-port", free_port()),
            ("--bind-health-port", free_port()),
        ] {
            command.args([option, &port.to_string()]);
        }
        let child = start(&mut command, &self.folder.path().join(name + ".log"));
        self.executors.push(child);
    }

    fn of_two() -> Option<Self> {
        let mut cluster = Self::new()?;
        cluster.executor(&[], &[]);
        cluster.executor(&[], &[]);
        Some(cluster)
    }

    fn url(&self) -> String {
        format!("df://127.0.0.1:{}", self.port)
    }
}

/// Asks by the program: rows, or the exit code and what it said.
fn asked(
    lake: &str,
    question: &str,
    cluster: Option<&str>,
    environment: &[(&str, String)],
) -> Result<Value, (Option<i32>, String)> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_flankscope-fleet"));
    command.args(["query", "--lake", lake, question, "--as", "json"]);
    command.args(cluster.iter().flat_map(|url| ["--cluster", url]));
    let output = command.envs(environment.iter().cloned()).output().unwrap();
    match output.status.code() {
        Some(0) => Ok(serde_json::from_slice(&output.stdout).unwrap()),
        code => {
            assert!(output.stdout.is_empty(), "a part of an answer");
            Err((code, String::from_utf8(output.stderr).unwrap()))
        }
    }
}

/// Three dies that three stations had one after the other, each with another head from the middle on: every question has an answer.
fn fill(lake: &Lake) {
    let (mut maker, mut random) = (Maker::new(), Random(31));
    for visit in 0..9 {
        let (die, station) = (visit / 3, visit % 3);
        for day in 0..4 {
            let check = |n: i64| MadeUp {
                station: format!("press {station}/ä"),
                serial: (die != 2).then(|| format!("R {die}")),
                head: format!("h{}", day / 2),
                minute: (4 * visit + day) * 1440 + n * 20,
                strokes: ((4 * station + day) * 70 + n) * 20,
                wear_um: (0..3)
                    .map(|_| Some(0.3 * (day * 70 + n) as f64 / 70.0 + random.normal()))
                    .collect(),
            };
            let checks: Vec<MadeUp> = (0..70).map(check).collect();
            maker.put(lake, &checks[..30]);
            maker.put(lake, &checks[30..]);
        }
    }
}

/// Rates are small numbers, and executors add up in another order each time.
fn assert_same(found: &Value, expected: &Value, what: &str) {
    same_rows::assert_same(found, expected, |value| 1e-7 * value.abs().max(1e-3), what);
}

#[test]
fn a_cluster_answers_as_one_machine_does() {
    let Some(cluster) = Cluster::of_two() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().to_str().unwrap();
    let lake = Lake::open(place).unwrap();
    let empty = "SELECT count(*) AS n, max(station) AS station FROM checks";
    let none = asked(place, empty, Some(&cluster.url()), &[]).unwrap();
    assert_eq!(none, json!([{ "n": 0, "station": null }]));
    fill(&lake);
    // Joined files stand beside their parts: each check counts once. Sums of days are there for who answers alone.
    let what = Compaction::of_days(1, None, Duration::from_secs(3600), jiff::Timestamp::now());
    assert_eq!(run(compact(&lake, &what)).unwrap().summed, 36);
    let free = "SELECT station, date, stored_at, check_number, tooth, wear_um, chain_digest, simulated FROM checks \
        WHERE date >= '2001-03-05' AND station LIKE '%1/ä' ORDER BY check_number, tooth LIMIT 100";
    let count =
        "SELECT count(*) AS rows, count(DISTINCT station || check_number) AS checks FROM checks";
    let not = "SELECT count(*) AS n FROM checks WHERE serial NOT IN (SELECT serial FROM checks WHERE date > '2001-03-20')";
    let nowhere = "SELECT * FROM checks WHERE station = 'press 8'";
    let named = questions().map(|question| question.name);
    for question in named.chain([free, count, not, PAIRS, nowhere, TABLES, "DESCRIBE days"]) {
        let expected = asked(place, question, None, &[]).unwrap();
        assert_eq!(expected == json!([]), question == nowhere, "{question}");
        let found = asked(place, question, Some(&cluster.url()), &[]);
        let found = found.unwrap_or_else(|error| panic!("{question}: {error:?}"));
        match question {
            // Text is of another type there.
            "DESCRIBE days" => assert_eq!(found[0]["column_name"], expected[0]["column_name"]),
            _ => assert_same(&found, &expected, question),
        }
    }
    let expected = json!([{ "rows": 9 * 4 * 70 * 3, "checks": 9 * 4 * 70 }]);
    assert_eq!(
        asked(place, count, Some(&cluster.url()), &[]).unwrap(),
        expected
    );
}

#[test]
fn an_executor_that_is_killed_in_the_middle_changes_no_answer() {
    let Some(mut cluster) = Cluster::of_two() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().to_str().unwrap();
    fill(&Lake::open(place).unwrap());
    let expected = asked(place, PAIRS, None, &[]).unwrap();
    let (url, folder) = (cluster.url(), cluster.folder.path().to_owned());
    let jobs = |executor: usize| -> BTreeSet<OsString> {
        let folders = std::fs::read_dir(folder.join(format!("executor{executor}")));
        folders
            .unwrap()
            .map(|job| job.unwrap().file_name())
            .collect()
    };
    std::thread::scope(|scope| {
        let answer = scope.spawn(|| asked(place, PAIRS, Some(&url), &[]));
        // Whoever has begun to write rows that others need. The first job only looks for executors; names of jobs go up.
        let victim = loop {
            let (one, other) = (jobs(0), jobs(1));
            let second = one.union(&other).nth(1);
            match second {
                Some(second) => break usize::from(other.contains(second)),
                None if answer.is_finished() => panic!("{:?}", answer.join()),
                None => std::thread::sleep(Duration::from_millis(5)),
            }
        };
        cluster.executors[victim].kill().unwrap();
        std::fs::remove_dir_all(folder.join(format!("executor{victim}"))).unwrap();
        assert!(
            !answer.is_finished(),
            "it answered before the executor was killed"
        );
        assert_eq!(answer.join().unwrap().unwrap(), expected);
    });
}

#[test]
fn what_cannot_be_answered_is_said_and_ends() {
    let Some(mut cluster) = Cluster::new() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().to_str().unwrap();
    let lake = Lake::open(place).unwrap();
    fill(&lake);
    let url = cluster.url();
    let nobody = format!("df://127.0.0.1:{}", free_port());
    let count = "SELECT count(DISTINCT tool_cycles) FROM checks";
    let refused = |question, url: &str, why| {
        let (code, said) = asked(place, question, Some(url), &[]).unwrap_err();
        assert!(
            code == Some(3) && said.contains(why),
            "{url}: {code:?} {said}"
        );
    };
    refused(count, "localhost:50050", "df://HOST:PORT");
    refused(count, "df://localhost", "df://HOST:PORT");
    refused(count, &nobody, &nobody);
    refused(
        "EXPLAIN ANALYZE SELECT * FROM checks",
        &url,
        "without --cluster",
    );
    refused("DROP TABLE checks", &url, "DDL");
    for lost in [
        "SELECT count(*) FILTER (WHERE tooth = 1) OVER (PARTITION BY station) FROM checks",
        "SELECT lag(serial) IGNORE NULLS OVER (ORDER BY stored_at) FROM checks",
        // The engine turns one of them round.
        "SELECT lag(tooth) OVER (ORDER BY stored_at), lag(tooth) OVER (ORDER BY stored_at DESC) FROM checks",
    ] {
        refused(lost, &url, "IGNORE NULLS");
    }
    refused(count, &url, "no executor");
    // An executor on a machine where the lake is not.
    let hidden = format!("mount -t tmpfs none '{place}' && exec \"$@\"");
    let elsewhere = [
        "unshare",
        "--map-root-user",
        "--mount",
        "sh",
        "-c",
        &hidden,
        "sh",
    ];
    cluster.executor(&elsewhere, &[]);
    refused(count, &url, "not found");
    // A file that is cut short is named before anything is sent.
    let name = &run(lake.list(None)).unwrap().files[0].name;
    let file = folder.path().join(name.to_string());
    std::fs::write(&file, &std::fs::read(&file).unwrap()[..1000]).unwrap();
    refused(count, &url, &name.to_string());
}

/// As on machines of their own: what the processes share is the store, whose credentials each has for itself.
#[cfg(feature = "s3")]
#[test]
fn executors_read_an_object_store_by_themselves() {
    let (Some(python), Some(mut cluster)) = (lake_readers(), Cluster::new()) else {
        return;
    };
    let (mut server, environment) = histories::s3_server(&python);
    let station = histories::Station::new("press 7/ä");
    station.store(200);
    let url = "s3://lake/of/all";
    let mut ship = histories::fleet!(station, ["ship", "--lake", url, "--history"]);
    let ship = ship.arg(station.history()).envs(environment.clone());
    assert!(ship.status().unwrap().success());
    cluster.executor(&[], &environment);
    let count =
        "SELECT station, count(*) AS rows, sum(wear_um) AS wear_um FROM checks GROUP BY station";
    for question in [count, "presses"] {
        let expected = asked(url, question, None, &environment).unwrap();
        assert_eq!(expected[0]["station"], "press 7/ä");
        let found = asked(url, question, Some(&cluster.url()), &environment);
        assert_same(&found.unwrap(), &expected, question);
    }
    server.kill().unwrap();
    server.wait().unwrap();
}
