//! Stored and printed results end to end: histories, seals, pages, documentation.

mod documents;
mod history;
mod hostile;
mod origin;
mod pages;
mod papers;
