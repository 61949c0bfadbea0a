//! Scans of the whole die end to end, and what is computed from them.

mod article;
mod clouds;
mod gear;
mod mesh;
mod strangers;
mod whole;
