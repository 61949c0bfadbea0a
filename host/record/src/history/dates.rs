//! Checks that are dated before their predecessor: the host's clock was set back. Numbers and cycles tell the order, not dates.

/// A sentence on check `id` of date `at`, if the one before it has a later date. Dates are ISO 8601, UTC, so they sort as texts.
pub(super) fn dated_before((last, dated): (i64, &str), (id, at): (i64, &str)) -> Option<String> {
    (at < dated).then(|| {
        format!(
            "clock_set_back: check {id} is dated {at}, before check {last} ({dated}); set the clock right, whichever is wrong"
        )
    })
}

/// The sentences on all checks whose predecessor has a later date.
#[must_use]
pub fn clock_set_back(checks: &[super::Check]) -> Vec<String> {
    let pairs = checks.windows(2);
    pairs
        .filter_map(|pair| dated_before((pair[0].id, &pair[0].at), (pair[1].id, &pair[1].at)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_earlier_date_gets_a_word() {
        let dates = ["2026-03-31T12:00:00.000Z", "2026-03-01T12:00:00.000Z"];
        let said = dated_before((6, dates[0]), (7, dates[1])).unwrap();
        assert!(
            ["clock_set_back", "check 7", "check 6", dates[0], dates[1]]
                .iter()
                .all(|part| said.contains(part)),
            "{said}"
        );
        assert_eq!(dated_before((6, dates[1]), (7, dates[0])), None);
        assert_eq!(dated_before((6, dates[0]), (7, dates[0])), None);
    }
}
