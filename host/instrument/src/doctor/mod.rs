//! Checks what is installed, connected, calibrated and expired: one finding each, with its remedy.
//!
//! All checks are independent: none is skipped because another one failed. None moves anything.

mod controller;
mod machine;

use serde::Serialize;
use serde_json::Value;

pub use controller::controller;
pub use machine::{SharedMemoryTooSmall, check_shared_memory, clock, disk, shared_memory};

/// Health of a checked item.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Health {
    /// In order.
    Ok,
    /// It works today, but needs action later.
    Attention,
    /// No measurement is possible.
    Failed,
    /// It could not be checked, because of another finding.
    NotAsked,
}

impl Health {
    /// The word, as in documents.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Attention => "attention",
            Self::Failed => "failed",
            Self::NotAsked => "not asked",
        }
    }
}

/// One checked item.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Name of the item.
    pub check: &'static str,
    pub health: Health,
    /// Observation, in words.
    pub seen: String,
    /// How to correct it; absent if nothing is to be done.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
    /// The observation as numbers, for programs.
    #[serde(skip_serializing_if = "Value::is_null")]
    pub figures: Value,
}

impl Finding {
    /// A finding in order.
    #[must_use]
    pub fn ok(check: &'static str, seen: impl Into<String>) -> Self {
        Self {
            check,
            health: Health::Ok,
            seen: seen.into(),
            remedy: None,
            figures: Value::Null,
        }
    }

    /// A finding that needs action later.
    #[must_use]
    pub fn attention(
        check: &'static str,
        seen: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self {
            health: Health::Attention,
            remedy: Some(remedy.into()),
            ..Self::ok(check, seen)
        }
    }

    /// A finding that prevents measurements.
    #[must_use]
    pub fn failed(check: &'static str, seen: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            health: Health::Failed,
            remedy: Some(remedy.into()),
            ..Self::ok(check, seen)
        }
    }

    /// An item that could not be checked.
    #[must_use]
    pub fn not_asked(check: &'static str, why: impl Into<String>) -> Self {
        Self {
            health: Health::NotAsked,
            ..Self::ok(check, why)
        }
    }

    /// Adds numbers for programs.
    #[must_use]
    pub fn with(self, figures: Value) -> Self {
        Self { figures, ..self }
    }

    /// One line: health, item, observation, remedy.
    pub fn line(&self) -> String {
        let remedy = self.remedy.as_ref().map(|remedy| format!(" -> {remedy}"));
        format!(
            "{:<9}  {:<13}  {}{}",
            self.health.word(),
            self.check,
            self.seen.replace('\n', " "),
            remedy.unwrap_or_default()
        )
    }
}

/// Whether a measurement is possible.
#[must_use]
pub fn healthy(findings: &[Finding]) -> bool {
    findings
        .iter()
        .all(|finding| matches!(finding.health, Health::Ok | Health::Attention))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_line_each_and_nothing_unseen_is_healthy() {
        let ok = Finding::ok("tool", "demo die");
        let late = Finding::attention("head", "expires soon", "calibrate");
        let bad = Finding::failed("camera", "gone\naway", "plug it in");
        let unseen = Finding::not_asked("stage", "the controller does not answer");
        assert!(healthy(&[ok.clone(), late]));
        assert!(!healthy(&[ok.clone(), bad.clone()]));
        assert!(!healthy(&[ok, unseen]));
        assert_eq!(
            bad.line(),
            "failed     camera         gone away -> plug it in"
        );
    }
}
