//! Clients that are slow or silent, against the page, the metrics and the registers: 1 200 of them, from three addresses, which come again
//! whenever they are closed. Ten seconds, or as many as the argument says: `cargo test -p flankscope-plant --test slow_clients -- 600`.

#[allow(dead_code)]
mod press;
#[allow(dead_code)]
mod station;

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::net::{Ipv4Addr, SocketAddr};
use std::time::{Duration, Instant};

use flankscope_metrology::verdict::Word;
use flankscope_test_requisites::Random;
use press::Press;
use rustix::net::{AddressFamily, SocketType, bind, connect, socket};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use station::Station;

const CLIENTS: usize = 1_200;
/// Silent connections to Modbus.
const SILENT_CONTROLLERS: usize = 40;
/// Longest time for a scrape and for a question to Modbus.
const ANSWER_WITHIN: Duration = Duration::from_secs(2);
/// Time after which the memory is compared with that at the end, or half of a shorter run: requests end after 20 s, and the memory of an
/// allocator grows for a few generations of them.
const WARM_UP: Duration = Duration::from_secs(120);

fn main() {
    let seconds = std::env::args().nth(1).and_then(|text| text.parse().ok());
    campaign(Duration::from_secs(seconds.unwrap_or(10)));
}

/// Bytes that a client sends, and those that it holds back.
#[derive(Clone, Copy)]
enum Manner {
    Silent,
    /// A login whose body never comes.
    NoBody,
    /// Headers that come byte by byte.
    SlowHeaders,
    /// A body that comes byte by byte.
    SlowBody,
}

const MANNERS: [Manner; 4] = [
    Manner::Silent,
    Manner::NoBody,
    Manner::SlowHeaders,
    Manner::SlowBody,
];

struct Client {
    manner: Manner,
    stream: Option<TcpStream>,
    address: Ipv4Addr,
}

impl Client {
    /// Connects from its address and sends what comes first.
    fn begin(&mut self, page: SocketAddr) {
        let login = |length: u32| {
            format!("POST /login HTTP/1.1\r\nHost: {page}\r\nContent-Length: {length}\r\n\r\n")
        };
        let first = match self.manner {
            Manner::Silent => String::new(),
            Manner::NoBody => login(100),
            Manner::SlowHeaders => format!("GET / HTTP/1.1\r\nHost: {page}\r\nX-Slow: "),
            Manner::SlowBody => login(4_000) + "token=",
        };
        self.stream = from_address(self.address, page).ok();
        if let Some(stream) = &mut self.stream
            && stream.write_all(first.as_bytes()).is_err()
        {
            self.stream = None;
        }
    }

    /// Sends a byte if it is its manner; whether the connection is still open.
    fn go_on(&mut self) -> bool {
        let Some(stream) = &mut self.stream else {
            return false;
        };
        let is_slow = matches!(self.manner, Manner::SlowHeaders | Manner::SlowBody);
        if is_slow && stream.write_all(b"x").is_err() {
            return false;
        }
        match stream.read(&mut [0; 256]) {
            Ok(count) => count > 0,
            Err(error) => error.kind() == ErrorKind::WouldBlock,
        }
    }
}

fn from_address(address: Ipv4Addr, to: SocketAddr) -> std::io::Result<TcpStream> {
    let socket = socket(AddressFamily::INET, SocketType::STREAM, None)?;
    bind(&socket, &SocketAddr::from((address, 0)))?;
    connect(&socket, &to)?;
    let stream = TcpStream::from(socket);
    stream.set_nonblocking(true)?;
    Ok(stream)
}

fn campaign(length: Duration) {
    // For this process and the one that it starts.
    let limit = getrlimit(Resource::Nofile);
    let current = limit.maximum.or(Some(4_096)).map(|most| most.min(4_096));
    setrlimit(Resource::Nofile, Rlimit { current, ..limit }).unwrap();
    let station = Station::new(3_600);
    let mut press = Press::new(&station.history());
    press.check_now("die", 40, Word::Go);
    let plant = station.serve();
    plant.board_with("verdict go");
    let mut random = Random(60);
    let mut clients: Vec<Client> = (0..CLIENTS)
        .map(|number| Client {
            manner: MANNERS[number % MANNERS.len()],
            stream: None,
            address: Ipv4Addr::new(127, 0, 0, 2 + (number % 3) as u8),
        })
        .collect();
    let _silent: Vec<_> = (0..SILENT_CONTROLLERS)
        .map(|_| TcpStream::connect(plant.modbus).unwrap())
        .collect();
    let warm_up = WARM_UP.min(length / 2);
    let begun = Instant::now();
    let (mut rounds, mut reconnected, mut slowest) = (0, 0, Duration::ZERO);
    let mut warm_kb = None;
    while begun.elapsed() < length {
        let round = Instant::now();
        for client in &mut clients {
            if !client.go_on() {
                reconnected += 1;
                client.begin(plant.page);
            }
        }
        let question = Instant::now();
        assert_eq!(plant.with_token("/metrics").status, 200);
        let scraped = question.elapsed();
        assert_eq!(plant.registers().len(), 10);
        let answered = question.elapsed() - scraped;
        slowest = slowest.max(scraped).max(answered);
        assert!(scraped < ANSWER_WITHIN, "scrape after {scraped:?}");
        assert!(answered < ANSWER_WITHIN, "registers after {answered:?}");
        rounds += 1;
        if warm_kb.is_none() && begun.elapsed() > warm_up {
            warm_kb = Some(plant.resident_kb());
        }
        let pause = Duration::from_millis(700 + (300.0 * random.uniform()) as u64);
        std::thread::sleep(pause.saturating_sub(round.elapsed()));
    }
    let (warm_kb, end_kb) = (warm_kb.unwrap(), plant.resident_kb());
    println!(
        "{CLIENTS} clients for {} s, {} connections: {rounds} of {rounds} scrapes and registers answered, the slowest after {:.2} s; \
         memory {:.1} MB after {} s, {:.1} MB at the end",
        length.as_secs(),
        reconnected,
        slowest.as_secs_f64(),
        warm_kb / 1e3,
        warm_up.as_secs(),
        end_kb / 1e3
    );
    assert!(end_kb < 1.25 * warm_kb, "{warm_kb} kB, then {end_kb} kB");
    assert!(reconnected >= CLIENTS, "{reconnected}");
}
