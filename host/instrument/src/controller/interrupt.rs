//! Somebody's wish, from outside, that what runs ends: the head comes out, and nothing new begins.

use tokio::sync::watch;

/// Whoever may wish it.
#[derive(Debug)]
pub struct Interrupter(watch::Sender<bool>);

impl Interrupter {
    /// Wishes it, once and for all.
    pub fn interrupt(&self) {
        self.0.send_replace(true);
    }
}

/// Whoever is to end.
#[derive(Clone, Debug)]
pub struct Interrupt(watch::Receiver<bool>);

impl Interrupt {
    /// Both ends.
    #[must_use]
    pub fn pair() -> (Interrupter, Self) {
        let (sender, receiver) = watch::channel(false);
        (Interrupter(sender), Self(receiver))
    }

    /// Of nobody.
    #[must_use]
    pub fn never() -> Self {
        Self::pair().1
    }

    /// Whether it is wished.
    #[must_use]
    pub fn is_requested(&self) -> bool {
        *self.0.borrow()
    }

    /// Waits until it is wished; for ever, when nobody is left who could. May be dropped and waited for again.
    pub async fn requested(&mut self) {
        if self.0.wait_for(|&wished| wished).await.is_err() {
            std::future::pending().await
        }
    }
}
