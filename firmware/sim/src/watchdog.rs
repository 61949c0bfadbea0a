//! A controller that can be reset: by its watchdog, or by hand; and whose tasks can be made to hang.

use crate::executor::Sim;
use crate::wiring::{BoxedTask, Wiring, tasks};
use core::cell::{Cell, RefCell};
use core::future::poll_fn;
use core::task::{Poll, Waker};
use embassy_time::{Duration, Instant, Timer};
use flankscope_controller::liveness::Task;
use flankscope_controller::{Mailboxes, Watchdog, sequence, supervise};
use flankscope_protocol::message::Boot;
use std::rc::Rc;

/// Window of the watchdog: four beats of the tasks.
const WINDOW: Duration = Duration::from_millis(200);

/// Where one task runs; a reset puts a new one in its place.
#[derive(Default)]
struct Slot {
    task: RefCell<Option<BoxedTask>>,
    hangs: Cell<bool>,
    waker: RefCell<Option<Waker>>,
}

impl Slot {
    fn put(&self, task: BoxedTask) {
        self.hangs.set(false);
        // Dropped outside the borrow: what it owns may wake others.
        let old = self.task.borrow_mut().replace(task);
        drop(old);
        if let Some(waker) = self.waker.borrow().as_ref() {
            waker.wake_by_ref();
        }
    }

    async fn run(self: Rc<Self>) {
        poll_fn(|context| {
            *self.waker.borrow_mut() = Some(context.waker().clone());
            if !self.hangs.get()
                && let Some(task) = self.task.borrow_mut().as_mut()
            {
                let _ends_never = task.as_mut().poll(context);
            }
            Poll::<()>::Pending
        })
        .await;
    }
}

/// A supervised controller on its side of the wiring.
#[derive(Clone)]
pub struct Controller {
    wiring: Rc<Wiring>,
    config: sequence::Config,
    slots: Rc<[Rc<Slot>; 5]>,
    fed_at: Rc<Cell<Instant>>,
    resets: Rc<RefCell<Vec<u64>>>,
}

struct Feeder(Rc<Cell<Instant>>);

impl Watchdog for Feeder {
    fn feed(&mut self) {
        self.0.set(Instant::now());
    }
}

impl Controller {
    #[must_use]
    pub fn power_up(sim: &Sim, wiring: Rc<Wiring>, config: sequence::Config) -> Self {
        let controller = Self {
            wiring,
            config,
            slots: Rc::default(),
            fed_at: Rc::new(Cell::new(Instant::now())),
            resets: Rc::default(),
        };
        controller.start(Boot::PowerUp);
        for slot in controller.slots.iter() {
            sim.spawn(Rc::clone(slot).run());
        }
        let watched = controller.clone();
        sim.spawn(async move {
            loop {
                let due = watched.fed_at.get() + WINDOW;
                if Instant::now() >= due {
                    watched.reset(Boot::Watchdog);
                } else {
                    Timer::at(due).await;
                }
            }
        });
        controller
    }

    /// From here on this task is never polled again.
    pub fn hang(&self, task: Task) {
        self.slots[task as usize].hangs.set(true);
    }

    /// Everything in the controller is lost and its outputs fall; then it starts anew.
    pub fn reset(&self, why: Boot) {
        self.resets.borrow_mut().push(crate::now_us());
        self.wiring.board.release_outputs();
        self.start(why);
    }

    /// When it was reset, virtual time.
    pub fn resets_us(&self) -> Vec<u64> {
        self.resets.borrow().clone()
    }

    fn start(&self, why: Boot) {
        let mail: &'static Mailboxes = Box::leak(Box::new(Mailboxes::supervised()));
        self.fed_at.set(Instant::now());
        for (task, future) in tasks(&self.wiring, self.config, why, mail) {
            self.slots[task as usize].put(future);
        }
        let feeder = Feeder(Rc::clone(&self.fed_at));
        self.slots[Task::ALL.len()].put(Box::pin(async move { supervise(feeder, mail).await }));
    }
}
