//! Interruption of a run from outside, by the operator: the head leaves the die, and nothing new begins.

use tokio::sync::watch;

/// The sender, for the part of the program that hears the operator.
#[derive(Debug)]
pub struct Interrupter(watch::Sender<bool>);

impl Interrupter {
    /// Requests the interruption; cannot be taken back.
    pub fn interrupt(&self) {
        self.0.send_replace(true);
    }
}

/// The receiver, for the parts of the program that have to end.
#[derive(Clone, Debug)]
pub struct Interrupt(watch::Receiver<bool>);

impl Interrupt {
    /// Sender and receiver.
    #[must_use]
    pub fn pair() -> (Interrupter, Self) {
        let (sender, receiver) = watch::channel(false);
        (Interrupter(sender), Self(receiver))
    }

    /// A receiver that is never interrupted.
    #[must_use]
    pub fn never() -> Self {
        Self::pair().1
    }

    /// Whether the interruption was requested.
    pub fn is_requested(&self) -> bool {
        *self.0.borrow()
    }

    /// Waits until the interruption is requested; for ever if the sender is gone. Cancel safe.
    pub async fn requested(&mut self) {
        if self.0.wait_for(|&wished| wished).await.is_err() {
            std::future::pending().await
        }
    }
}
