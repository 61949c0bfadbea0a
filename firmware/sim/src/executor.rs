//! The executor loop: poll what is ready, then move virtual time to the next deadline.

use crate::clock;
use crate::line::{Edge, Line, Recorder};
use crate::sync::{Condvar, Mutex, MutexGuard, ThreadId, current};
use core::cell::{Cell, RefCell};
use core::future::Future;
use core::pin::Pin;
use core::task::{Context, Poll};
use embassy_executor::raw::{Executor, TaskStorage};
use std::rc::Rc;
use std::sync::{Arc, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// How virtual time passes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Clock {
    /// As fast as possible: whenever nothing is left to do, on to the next deadline.
    Stepped,
    /// This many virtual seconds per real second.
    Paced {
        /// 1 is real time.
        speed: f64,
    },
}

/// How well virtual time kept its pace.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Pace {
    /// Virtual time reached.
    pub virtual_us: u64,
    /// Real time during which virtual time was held on purpose.
    pub held: Duration,
    /// Real time by which virtual time fell behind because this thread was busy or was not scheduled; it is not
    /// made up for, so that virtual time never rushes.
    pub lagged: Duration,
}

/// Virtual time may be this much behind, in real time, before it counts as lag; below, it catches up.
const LAG_TOLERATED: Duration = Duration::from_millis(2);

#[derive(Default)]
struct Shared {
    /// A task woke another: it goes on at the same virtual time.
    woken_inside: bool,
    /// Another thread woke a task: real time has passed for it.
    woken_outside: bool,
    holds: u32,
    held_since: Option<Instant>,
    held: Duration,
}

/// The bell that other threads ring, and the holds.
struct Bell {
    owner: ThreadId,
    shared: Mutex<Shared>,
    rung: Condvar,
    time_elsewhere: OnceLock<HoldHook>,
}

/// Called with true when virtual time is held, with false when it goes on.
type HoldHook = Box<dyn Fn(bool) + Send + Sync>;

impl Bell {
    fn lock(&self) -> MutexGuard<'_, Shared> {
        // Every critical section leaves the state whole, so a panic elsewhere does not matter.
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Only called with the lock taken, so that the two calls of a hold keep their order.
    fn tell_hold(&self, held: bool) {
        if let Some(hook) = self.time_elsewhere.get() {
            hook(held);
        }
    }

    fn ring(&self) {
        let inside = current().id() == self.owner;
        let mut shared = self.lock();
        if inside {
            shared.woken_inside = true;
        } else {
            shared.woken_outside = true;
            self.rung.notify_one();
        }
    }
}

/// Called by the executor, from any thread, whenever a task is woken.
#[unsafe(export_name = "__pender")]
fn pender(context: *mut ()) {
    // SAFETY: the context is the leaked `Bell` that `Sim::new` gave the executor.
    let bell = unsafe { &*context.cast::<Bell>() };
    bell.ring();
}

/// A handle to a simulation for other threads.
#[derive(Clone)]
pub struct Remote {
    bell: &'static Bell,
    /// Counted, so that a stepped simulation knows whether anybody can still wake it.
    _alive: Arc<()>,
}

impl Remote {
    /// Holds virtual time until the guard is dropped. Tasks already due still run, and a bus transaction that has begun ends;
    /// holds may overlap.
    pub fn hold(&self) -> Hold {
        let mut shared = self.bell.lock();
        shared.holds += 1;
        if shared.holds == 1 {
            shared.held_since = Some(Instant::now());
            self.bell.tell_hold(true);
        }
        Hold {
            remote: self.clone(),
        }
    }

    /// Makes the simulation look again at its stop condition.
    pub fn wake(&self) {
        self.bell.ring();
    }
}

/// Virtual time stands still while this lives.
pub struct Hold {
    remote: Remote,
}

impl Drop for Hold {
    fn drop(&mut self) {
        let mut shared = self.remote.bell.lock();
        shared.holds -= 1;
        if shared.holds == 0
            && let Some(since) = shared.held_since.take()
        {
            shared.held += since.elapsed();
            self.remote.bell.tell_hold(false);
        }
        drop(shared);
        self.remote.bell.rung.notify_one();
    }
}

/// A simulation. It owns its thread until dropped.
pub struct Sim {
    executor: &'static Executor,
    bell: &'static Bell,
    alive: Arc<()>,
    mode: Clock,
    started: Instant,
    lagged: Cell<Duration>,
    recorder: Recorder,
    tasks: RefCell<Vec<Task>>,
}

impl Sim {
    /// Begins a simulation on this thread at virtual time 0.
    ///
    /// The executor itself is never freed: it is as static here as on a microcontroller. What tasks own is.
    #[must_use]
    pub fn new(mode: Clock) -> Self {
        clock::reset();
        let owner = current().id();
        let bell = Bell {
            owner,
            shared: Mutex::default(),
            rung: Condvar::new(),
            time_elsewhere: OnceLock::new(),
        };
        let bell: &'static Bell = Box::leak(Box::new(bell));
        let context = core::ptr::from_ref(bell).cast_mut().cast::<()>();
        Self {
            executor: Box::leak(Box::new(Executor::new(context))),
            bell,
            alive: Arc::new(()),
            mode,
            started: Instant::now(),
            lagged: Cell::default(),
            recorder: Recorder::default(),
            tasks: RefCell::default(),
        }
    }

    /// A handle for other threads.
    pub fn remote(&self) -> Remote {
        Remote {
            bell: self.bell,
            _alive: Arc::clone(&self.alive),
        }
    }

    /// Somebody else's clock is the one that counts, and this simulation only accompanies it: holds are passed on to
    /// `hold` (true: hold, false: go on), and time here passes on. Holding both would leave the other's questions, on
    /// their way while it is being stopped, without an answer. Only the first to ask is told; `hold` is called on the
    /// thread that holds and must not hold itself.
    pub fn follow(&self, hold: impl Fn(bool) + Send + Sync + 'static) {
        let _first = self.bell.time_elsewhere.set(Box::new(hold));
    }

    /// A new line at low level whose edges are recorded under `name`.
    #[must_use]
    pub fn line(&self, name: &'static str) -> Line {
        Line::new(name, &self.recorder)
    }

    /// The latest edges of all lines, in order; all of them in anything shorter than a hundred views.
    pub fn edges(&self) -> Vec<Edge> {
        self.recorder.edges()
    }

    /// Adds a task. What it owns is dropped when it ends, or with the simulation.
    pub fn spawn<F: Future<Output = ()> + 'static>(&self, future: F) {
        let task: Task = Rc::new(RefCell::new(Some(Box::pin(future))));
        self.tasks.borrow_mut().push(Rc::clone(&task));
        let storage: &'static TaskStorage<Fresh> = Box::leak(Box::new(TaskStorage::new()));
        // A storage of its own is always free.
        if let Ok(token) = storage.spawn(|| Fresh(task)) {
            self.executor.spawner().spawn(token);
        }
    }

    /// Runs until nothing is left to do: for ever, unless stepped without a [`Remote`].
    pub fn run(&self) {
        self.run_until(|| false);
    }

    /// Runs until `done`, which is asked whenever all tasks wait. False if nothing is left to do before.
    pub fn run_until(&self, mut done: impl FnMut() -> bool) -> bool {
        loop {
            // SAFETY: never called by a task, so not reentrant.
            unsafe { self.executor.poll() };
            if done() {
                return true;
            }
            if !self.wait() {
                return false;
            }
        }
    }

    /// How well virtual time kept its pace so far.
    pub fn pace(&self) -> Pace {
        Pace {
            virtual_us: clock::now_us(),
            held: held(&self.bell.lock()),
            lagged: self.lagged.get(),
        }
    }

    /// Waits for a deadline or for another thread. False if neither can come.
    fn wait(&self) -> bool {
        let mut shared = self.bell.lock();
        loop {
            if core::mem::take(&mut shared.woken_inside) {
                return true;
            }
            if core::mem::take(&mut shared.woken_outside) {
                drop(shared);
                self.catch_up();
                return true;
            }
            let deadline = clock::next_deadline_us();
            shared = match (deadline, self.mode) {
                (Some(at), _) if shared.holds > 0 && clock::in_transaction() => {
                    drop(shared);
                    clock::advance_to(at);
                    return true;
                }
                _ if shared.holds > 0 && !self.follows() => self.sleep(shared, None),
                (None, Clock::Stepped) if Arc::strong_count(&self.alive) == 1 => return false,
                (None, _) => self.sleep(shared, None),
                (Some(at), Clock::Stepped) => {
                    drop(shared);
                    clock::advance_to(at);
                    return true;
                }
                (Some(at), Clock::Paced { speed }) => {
                    let due = Duration::from_secs_f64(at as f64 * 1e-6 / speed);
                    let real = self.real_elapsed(&shared);
                    match due.checked_sub(real).filter(|left| !left.is_zero()) {
                        Some(left) => self.sleep(shared, Some(left)),
                        None => {
                            drop(shared);
                            let late = real.saturating_sub(due);
                            if late > LAG_TOLERATED {
                                self.lagged.set(self.lagged.get() + late);
                            }
                            clock::advance_to(at);
                            return true;
                        }
                    }
                }
            };
        }
    }

    fn sleep<'a>(
        &self,
        shared: MutexGuard<'a, Shared>,
        longest: Option<Duration>,
    ) -> MutexGuard<'a, Shared> {
        match longest {
            Some(longest) => {
                self.bell
                    .rung
                    .wait_timeout(shared, longest)
                    .unwrap_or_else(PoisonError::into_inner)
                    .0
            }
            None => self
                .bell
                .rung
                .wait(shared)
                .unwrap_or_else(PoisonError::into_inner),
        }
    }

    /// Somebody else's clock counts.
    fn follows(&self) -> bool {
        self.bell.time_elsewhere.get().is_some()
    }

    /// Real time since the start, without holds and lag: what virtual time is paced by.
    fn real_elapsed(&self, shared: &Shared) -> Duration {
        let held = if self.follows() {
            Duration::ZERO
        } else {
            held(shared)
        };
        self.started
            .elapsed()
            .saturating_sub(held)
            .saturating_sub(self.lagged.get())
    }

    /// Another thread brought something: it happens now, between two deadlines, never beyond the next one.
    fn catch_up(&self) {
        if let Clock::Paced { speed } = self.mode {
            let now_us = (self.real_elapsed(&self.bell.lock()).as_secs_f64() * 1e6 * speed) as u64;
            // Time only moves here while no deadline is due: what is due is handled first, at its own time.
            let bound = clock::next_deadline_us().unwrap_or(u64::MAX);
            if now_us < bound {
                clock::advance_to(now_us);
            }
        }
    }
}

fn held(shared: &Shared) -> Duration {
    shared.held
        + shared
            .held_since
            .map_or(Duration::ZERO, |since| since.elapsed())
}

impl Drop for Sim {
    fn drop(&mut self) {
        for task in self.tasks.take() {
            // Taken out first: what a task owns may wake others while it is dropped.
            let future = task.borrow_mut().take();
            drop(future);
        }
        clock::reset();
    }
}

/// A future that the simulation can drop although its executor never will.
type Task = Rc<RefCell<Option<Pin<Box<dyn Future<Output = ()>>>>>>;

/// A task that renews its timers each time it is polled; see [`clock::forget`].
struct Fresh(Task);

impl Future for Fresh {
    type Output = ();

    fn poll(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        clock::forget(context.waker());
        let mut task = self.0.borrow_mut();
        let Some(future) = task.as_mut() else {
            return Poll::Ready(());
        };
        let polled = future.as_mut().poll(context);
        if polled.is_ready() {
            *task = None;
        }
        polled
    }
}
