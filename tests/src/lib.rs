//! Cross-crate tests: end to end, fault campaigns, conformance.
