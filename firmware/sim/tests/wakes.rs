//! Threads that speak to a simulation while others hold its time: no word stays without an answer.
//!
//! A wake that is lost between two threads shows as a silence that only the next byte ends. Which of the threads comes first is left
//! to the system, so the number of rounds makes a window of some ten nanoseconds likely to be met.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use embassy_time::Timer;
use embedded_io_async::{Read, Write};
use flankscope_sim::{Clock, Port, Sim};

/// No scheduler keeps a thread from running for so long.
const LOST: Duration = Duration::from_secs(20);

/// Less than a second of them.
const ROUNDS: u32 = 10_000;

#[test]
fn no_wake_is_lost_between_threads() {
    let (device, host) = Port::pair();
    let stop = Arc::new(AtomicBool::new(false));
    let sim = Sim::new(Clock::Paced { speed: 1000.0 });
    let (remote, woken) = (sim.remote(), sim.remote());
    sim.spawn(async move {
        let mut device = device;
        let mut byte = [0];
        loop {
            let Ok(count) = device.read(&mut byte).await;
            let Ok(_) = device.write(&byte[..count]).await;
        }
    });
    // Deadlines that come and go, as those of a controller's other tasks.
    sim.spawn(async {
        loop {
            Timer::after_micros(50).await;
        }
    });
    let holding = {
        let stop = Arc::clone(&stop);
        std::thread::spawn(move || {
            let mut holds = 0_u64;
            while !stop.load(Ordering::Acquire) {
                let hold = remote.hold();
                for _ in 0..holds % 64 {
                    std::hint::spin_loop();
                }
                drop(hold);
                holds += 1;
                std::thread::yield_now();
            }
            holds
        })
    };
    let speaking = {
        let stop = Arc::clone(&stop);
        std::thread::spawn(move || {
            let mut longest = Duration::ZERO;
            let mut lost = None;
            'rounds: for round in 0..ROUNDS {
                let began = Instant::now();
                host.send(&[round as u8]);
                while host.take().is_empty() {
                    if began.elapsed() > LOST {
                        lost = Some(round);
                        break 'rounds;
                    }
                    std::hint::spin_loop();
                }
                longest = longest.max(began.elapsed());
            }
            stop.store(true, Ordering::Release);
            woken.wake();
            (lost, longest)
        })
    };
    sim.run_until(|| stop.load(Ordering::Acquire));
    let (lost, longest) = speaking.join().expect("no panic");
    let holds = holding.join().expect("no panic");
    println!("{ROUNDS} rounds, {holds} holds, the longest answer took {longest:?}");
    assert_eq!(lost, None, "a byte was never answered");
}
