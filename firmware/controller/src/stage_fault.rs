//! Why stages did not do what they were asked: what the sequence and the drivers both know.

use flankscope_protocol::Fault;

/// Why the stages did not do what they were asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StageFault {
    /// In the instrument's numbering.
    pub fault: Fault,
    /// In the stage controller's own numbering, 0 if none.
    pub detail: u32,
}
