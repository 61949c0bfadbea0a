//! What is installed, connected, calibrated and expired: a finding each, with the remedy.
//!
//! Every examination stands alone: none is left out because another one failed, and none moves anything.

mod controller;
mod machine;

use serde::Serialize;
use serde_json::Value;

pub use controller::controller;
pub use machine::{clock, disk, shared_memory};

/// How something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Health {
    /// As it should be.
    Ok,
    /// It works today, and somebody should know.
    Attention,
    /// Nothing can be measured like this.
    Failed,
    /// It could not be looked at, because of another finding.
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

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// What.
    pub check: &'static str,
    /// How it is.
    pub health: Health,
    /// What was seen, in words.
    pub seen: String,
    /// What would make it right; absent where nothing is to be done.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
    /// The same in figures, for programs.
    #[serde(skip_serializing_if = "Value::is_null")]
    pub figures: Value,
}

impl Finding {
    /// As it should be.
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

    /// It works today; the remedy is for later.
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

    /// Nothing can be measured like this.
    #[must_use]
    pub fn failed(check: &'static str, seen: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            health: Health::Failed,
            remedy: Some(remedy.into()),
            ..Self::ok(check, seen)
        }
    }

    /// It could not be looked at.
    #[must_use]
    pub fn not_asked(check: &'static str, why: impl Into<String>) -> Self {
        Self {
            health: Health::NotAsked,
            ..Self::ok(check, why)
        }
    }

    /// With figures for programs.
    #[must_use]
    pub fn with(self, figures: Value) -> Self {
        Self { figures, ..self }
    }

    /// One line: health, what, what was seen, remedy.
    #[must_use]
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

/// Whether something can be measured.
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
