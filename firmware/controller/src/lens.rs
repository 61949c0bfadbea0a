//! What the controller needs of a liquid lens' driver.

use flankscope_protocol::{Fault, LensCounts};

/// Why a lens does not do what it was told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LensFault {
    /// How.
    pub fault: Fault,
    /// The register that tells so, or its answer.
    pub detail: u32,
}

impl LensFault {
    /// A fault, and the byte that tells so.
    #[must_use]
    pub fn of(fault: Fault, detail: Option<&u8>) -> Self {
        let detail = detail.map_or(0, |&byte| u32::from(byte));
        Self { fault, detail }
    }
}

/// The liquid lens' driver.
pub trait Lens {
    /// Switches the lens off; false where no driver answers.
    async fn off(&mut self) -> bool;
    /// Gives the lens its voltage, and makes sure that it has it.
    async fn set(&mut self, counts: LensCounts) -> Result<(), LensFault>;
    /// Makes sure that the lens still has it.
    async fn check(&mut self, counts: LensCounts) -> Result<(), LensFault>;
}

/// No lens on this board.
#[derive(Debug)]
pub struct NoLens;

impl Lens for NoLens {
    async fn off(&mut self) -> bool {
        false
    }
    async fn set(&mut self, _: LensCounts) -> Result<(), LensFault> {
        Err(LensFault::of(Fault::LensSilent, None))
    }
    async fn check(&mut self, _: LensCounts) -> Result<(), LensFault> {
        Err(LensFault::of(Fault::LensSilent, None))
    }
}
