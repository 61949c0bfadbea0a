//! Involute gear CAD as a watertight mesh: PLY and STL.
