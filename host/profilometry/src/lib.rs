//! Fringe images to points with a standard uncertainty each.
