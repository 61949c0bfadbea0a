//! Many views of one die: adjusted on the CAD together, merged over the unrolled bore, and evaluated for the die as a whole.

pub mod adjustment;
pub mod cylinder;
pub mod drift;
pub mod form;
pub mod seen_before;
pub mod spacing;
pub mod tooth_identity;
