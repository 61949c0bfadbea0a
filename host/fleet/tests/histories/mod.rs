//! Histories of checks that nobody made, written by the instrument's own code, and lakes to ship them into.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use flankscope_fleet::lake::Lake;
use flankscope_fleet::ship::{ShipError, Shipped, Shipper};
use flankscope_metrology::gear::Flank;
use flankscope_metrology::verdict::Word;
use flankscope_record::die::DieKey;
use flankscope_record::document::{
    Feature, FeatureId, FrameCount, Inspection, Pictures, Recipe, Timing,
};
use flankscope_record::history::History;
use flankscope_record::origin::{HeadId, Origin};
use flankscope_record::seal::Seals;

/// A day long before any test.
#[allow(dead_code)]
pub const OVER: &str = "2000-01-01";
/// A day after any test: every day is over.
#[allow(dead_code)]
pub const LATER: &str = "2999-01-01";

/// A check of six flanks by a station.
pub fn inspection(station: &str, press_cycles: u32) -> Inspection {
    let feature = |tooth, flank: Flank| Feature {
        id: FeatureId {
            tooth,
            flank,
            patch: None,
        },
        // A line that wears, and something beside it.
        wear_um: (press_cycles % 50 != 7).then(|| {
            f64::from(press_cycles) / 800.0 + f64::from(press_cycles * 7919 % 1000) / 997.0
        }),
        u95_um: Some(4.0 + f64::from(press_cycles * 104_729 % 1000) / 9973.0),
        at_least_um: None,
        mean_um: Some(0.0),
        coverage_ratio: 1.0,
        warn_um: 30.0,
        limit_um: 50.0,
        conformity: Some(1.0),
        detail: None,
        measurements: Vec::new(),
        verdict: Word::Go,
        reason: None,
        code: None,
    };
    Inspection {
        id: None,
        origin: Origin {
            link: "sim".into(),
            simulated: true,
            head: HeadId {
                name: "demo, 20 mm".into(),
                blake3: "ab".repeat(32),
                seal: "signed".into(),
            },
            station: station.into(),
            operator: press_cycles.is_multiple_of(3).then(|| "Ada".into()),
            recording: None,
        },
        date: "2026-01-31T12:00:00Z".into(),
        last_exposure: None,
        verdict: Word::Go,
        reason: format!("all is well after {press_cycles}"),
        // A check that saw nothing has no flanks.
        features: match press_cycles % 100 {
            99 => Vec::new(),
            _ => [12, 40, 68]
                .into_iter()
                .flat_map(|tooth| [feature(tooth, Flank::Left), feature(tooth, Flank::Right)])
                .collect(),
        },
        in_view: Vec::new(),
        missing_teeth: Vec::new(),
        tooth_identity: None,
        timing_ms: Timing::default(),
        frames: FrameCount::default(),
        press_cycles,
        peak_memory_mb: None,
        registration: Vec::new(),
        tool: "die".into(),
        die: DieKey {
            tool: "die".into(),
            geometry: "geometry of die".into(),
            serial: Some("A 7".into()),
        },
        temperature_degc: None,
        versions: [("host", "0.1.0".to_owned())].into(),
        hashes: [("cad", "0".repeat(64))].into(),
        recipe: Recipe::default(),
        evidence: Vec::new(),
        stopped: None,
        stopped_code: None,
        truth: None,
        phasors: Vec::new(),
        fields: Vec::new(),
        neighbours: Vec::new(),
        poses: Vec::new(),
        pictures: Pictures::default(),
    }
}

/// A station with a key, a history and a lake, each in a folder of its own.
pub struct Station {
    pub folder: tempfile::TempDir,
    pub seals: Seals,
    pub name: String,
}

#[allow(dead_code)]
impl Station {
    pub fn new(name: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("lake")).unwrap();
        Self {
            seals: Seals::open(&folder.path().join("key")).unwrap(),
            folder,
            name: name.into(),
        }
    }

    pub fn key(&self) -> PathBuf {
        self.folder.path().join("key")
    }

    pub fn history(&self) -> PathBuf {
        self.folder.path().join("press.db")
    }

    pub fn lake_folder(&self) -> PathBuf {
        self.folder.path().join("lake")
    }

    pub fn lake(&self) -> Lake {
        Lake::open(self.lake_folder().to_str().unwrap()).unwrap()
    }

    /// Stores so many further checks.
    pub fn store(&self, checks: u32) {
        self.store_in(&self.history(), checks);
    }

    pub fn store_in(&self, path: &Path, checks: u32) {
        let mut history = History::open(path, &self.seals).unwrap();
        let stored = u32::try_from(history.ids().unwrap().len()).unwrap();
        for number in 0..checks {
            history
                .record(&inspection(&self.name, stored + number), None)
                .unwrap();
        }
    }

    /// Dates every check anew, and accepts the history so.
    pub fn date(&self, date_of: impl Fn(i64) -> String) {
        let database = rusqlite::Connection::open(self.history()).unwrap();
        database
            .execute_batch("DROP TRIGGER inspection_keeps_UPDATE; BEGIN")
            .unwrap();
        let ids: Vec<i64> = {
            let mut ids = database.prepare("SELECT id FROM inspection").unwrap();
            let ids = ids.query_map([], |row| row.get(0)).unwrap();
            ids.map(Result::unwrap).collect()
        };
        for id in ids {
            database
                .execute(
                    "UPDATE inspection SET at = ?2 WHERE id = ?1",
                    (id, date_of(id)),
                )
                .unwrap();
        }
        database.execute_batch("COMMIT").unwrap();
        drop(database);
        History::trust(&self.history(), &self.seals, "Ada").unwrap();
    }

    /// A copy of the history that went on by sixty checks, on a station with the same key that does not know of this one.
    pub fn copy_that_went_on(&self) -> (PathBuf, Seals) {
        let elsewhere = self.folder.path().join("elsewhere");
        Seals::open(&elsewhere).unwrap();
        std::fs::copy(
            self.key().join("station.key"),
            elsewhere.join("station.key"),
        )
        .unwrap();
        let seals = Seals::existing(&elsewhere).unwrap();
        let copy = self.folder.path().join("copy.db");
        std::fs::copy(self.history(), &copy).unwrap();
        let mut other = History::open(&copy, &seals).unwrap();
        for number in 0..60 {
            other
                .record(&inspection(&self.name, 1000 + number), None)
                .unwrap();
        }
        (copy, seals)
    }

    pub fn read(&self) -> History {
        History::read(&self.history(), &self.seals).unwrap()
    }

    /// Ships what is closed today.
    pub fn ship(&self, lake: &Lake, today: &str) -> Result<Shipped, ShipError> {
        run(async {
            let mut shipper = Shipper::new(self.read(), &self.seals, lake).await?;
            shipper.pass(today).await
        })
    }
}

/// A server that speaks S3, with an empty bucket `lake`, and the environment in which programs find it.
#[allow(dead_code)]
pub fn s3_server(python: &Path) -> (Child, [(&'static str, String); 5]) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/peers/lake_readers.py");
    let mut server = Command::new(python);
    server.arg(script).arg("--s3").stderr(Stdio::null());
    let piped = server.stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut server = piped.spawn().unwrap();
    let mut endpoint = String::new();
    BufReader::new(server.stdout.take().unwrap())
        .read_line(&mut endpoint)
        .unwrap();
    let bucket = "import boto3, sys; boto3.client('s3', endpoint_url=sys.argv[1], region_name='eu-central-1', \
        aws_access_key_id='t', aws_secret_access_key='t').create_bucket(Bucket='lake', \
        CreateBucketConfiguration={'LocationConstraint': 'eu-central-1'})";
    let mut made = Command::new(python);
    let made = made.args(["-c", bucket, endpoint.trim()]).status();
    assert!(made.unwrap().success());
    let environment = [
        ("AWS_ENDPOINT", endpoint.trim().to_owned()),
        ("AWS_ALLOW_HTTP", "true".into()),
        ("AWS_ACCESS_KEY_ID", "of a test".into()),
        ("AWS_SECRET_ACCESS_KEY", "of a test".into()),
        ("AWS_REGION", "eu-central-1".into()),
    ];
    (server, environment)
}

/// Runs to the end.
pub fn run<T>(work: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .build()
        .unwrap();
    runtime.block_on(work)
}

/// The date of the `n`th minute of a March.
#[allow(dead_code)]
pub fn minute_of_march(n: i64) -> String {
    let (day, hour, minute) = (1 + n / 1440, n / 60 % 24, n % 60);
    format!("2001-03-{day:02}T{hour:02}:{minute:02}:00.000Z")
}

/// The program, as a station starts it. Examples do not know where it is.
#[allow(unused_macros)]
macro_rules! fleet {
    ($station:expr, $arguments:expr) => {{
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_flankscope-fleet"));
        command
            .env("FLANKSCOPE_STATE", $station.key())
            .args($arguments);
        command
    }};
}
#[allow(unused_imports)]
pub(crate) use fleet;
