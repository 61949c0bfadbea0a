//! Virtual time: per thread, from deadline to deadline, held and released.

use embassy_futures::select::select;
use embassy_time::{Duration, Instant, Timer};
use embedded_hal_async::digital::Wait;
use flankscope_sim::{Clock, Port, Sim, now_us};
use std::cell::RefCell;
use std::rc::Rc;

#[test]
fn simulations_on_different_threads_have_clocks_of_their_own() {
    let threads: Vec<_> = (1..=4u64)
        .map(|step_ms| {
            std::thread::spawn(move || {
                let sim = Sim::new(Clock::Stepped);
                let times = Rc::new(RefCell::new(Vec::new()));
                let log = Rc::clone(&times);
                sim.spawn(async move {
                    for _ in 0..1_000 {
                        Timer::after(Duration::from_millis(step_ms)).await;
                        log.borrow_mut().push(Instant::now().as_millis());
                    }
                });
                sim.run();
                assert_eq!(
                    *times.borrow(),
                    (1..=1_000).map(|n| n * step_ms).collect::<Vec<_>>()
                );
            })
        })
        .collect();
    for thread in threads {
        thread.join().expect("no panic");
    }
}

#[test]
fn an_abandoned_timer_does_not_move_time() {
    let sim = Sim::new(Clock::Stepped);
    let (sensor, mut watched) = (sim.line("sensor"), sim.line("unused"));
    let mut input = sensor.clone();
    sim.spawn(async move {
        select(
            input.wait_for_high(),
            Timer::after(Duration::from_secs(100)),
        )
        .await;
        watched.wait_for_high().await.unwrap();
    });
    sim.spawn(async move {
        Timer::after(Duration::from_millis(5)).await;
        sensor.set(true);
    });
    assert!(!sim.run_until(|| false), "nothing is left to do");
    assert_eq!(now_us(), 5_000);
}

#[test]
fn a_short_pulse_is_seen_by_whoever_waits_for_its_edge() {
    let sim = Sim::new(Clock::Stepped);
    let line = sim.line("pulse");
    let seen = Rc::new(RefCell::new(0));
    let (mut input, count) = (line.clone(), Rc::clone(&seen));
    sim.spawn(async move {
        loop {
            input.wait_for_rising_edge().await.unwrap();
            *count.borrow_mut() += 1;
        }
    });
    sim.spawn(async move {
        for _ in 0..10 {
            Timer::after(Duration::from_micros(1)).await;
            // Gone again before anybody else is polled.
            line.set(true);
            line.set(false);
        }
    });
    sim.run();
    assert_eq!((*seen.borrow(), sim.edges().len()), (10, 20));
}

#[test]
fn what_a_task_owns_is_dropped_with_the_simulation() {
    let (sender, receiver) = std::sync::mpsc::channel::<()>();
    let sim = Sim::new(Clock::Stepped);
    sim.spawn(async move {
        let _kept = sender;
        core::future::pending::<()>().await;
    });
    sim.run();
    assert_eq!(
        receiver.try_recv(),
        Err(std::sync::mpsc::TryRecvError::Empty)
    );
    drop(sim);
    assert_eq!(
        receiver.try_recv(),
        Err(std::sync::mpsc::TryRecvError::Disconnected)
    );
}

/// Bytes from another thread arrive although virtual time is held, and no deadline passes meanwhile.
#[test]
fn held_time_stands_still_for_deadlines_but_not_for_bytes() {
    use embedded_io_async::Read;
    for clock in [Clock::Stepped, Clock::Paced { speed: 1_000.0 }] {
        let sim = Sim::new(clock);
        let (mut inner, outer) = Port::pair();
        let order = Rc::new(RefCell::new(Vec::new()));
        let (bytes, timer) = (Rc::clone(&order), Rc::clone(&order));
        sim.spawn(async move {
            let mut byte = [0];
            let _count = inner.read(&mut byte).await;
            bytes.borrow_mut().push("byte");
        });
        sim.spawn(async move {
            Timer::after(Duration::from_micros(1)).await;
            timer.borrow_mut().push("timer");
        });
        let remote = sim.remote();
        let hold = remote.hold();
        let outside = std::thread::spawn(move || {
            outer.send(&[1]);
            std::thread::sleep(std::time::Duration::from_millis(20));
            drop(hold);
        });
        assert!(sim.run_until(|| order.borrow().len() == 2));
        outside.join().expect("no panic");
        assert_eq!(*order.borrow(), ["byte", "timer"]);
        assert!(sim.pace().held >= std::time::Duration::from_millis(20));
    }
}
