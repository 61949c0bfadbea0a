//! [`DieKey::is_same`](crate::die::DieKey::is_same) in SQL.

/// SQL condition that two rows or sets of parameters, each with `tool`, `geometry` and `serial`, are of the same die.
pub(super) fn same(
    [tool, geometry, serial]: [&str; 3],
    [other, other_geometry, other_serial]: [&str; 3],
) -> String {
    format!(
        "(CASE WHEN {serial} IS NOT NULL AND {other_serial} IS NOT NULL THEN {serial} = {other_serial} \
         ELSE {tool} = {other} OR {geometry} = {other_geometry} END)"
    )
}

/// The three columns in a table.
pub(super) fn columns(table: &str) -> [String; 3] {
    ["tool", "geometry", "serial"].map(|column| format!("{table}.{column}"))
}

/// [`same`] for the row of a table and the parameters 1 to 3.
pub(super) fn same_as_asked(table: &str) -> String {
    let [tool, geometry, serial] = &columns(table);
    same([tool, geometry, serial], ["?1", "?2", "?3"])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::die::DieKey;

    #[test]
    fn database_and_program_agree_on_what_is_the_same_die() {
        let connection = rusqlite::Connection::open_in_memory().unwrap();
        let some = |text: &str| (!text.is_empty()).then(|| text.to_owned());
        let mut dies = Vec::new();
        for tool in ["a", "b"] {
            for geometry in ["g", "h"] {
                for serial in ["", "1", "2"] {
                    dies.push(DieKey {
                        tool: tool.into(),
                        geometry: geometry.into(),
                        serial: some(serial),
                    });
                }
            }
        }
        let sql = format!("SELECT {}", same(["?1", "?2", "?3"], ["?4", "?5", "?6"]));
        let mut same_ones = 0;
        for one in &dies {
            for two in &dies {
                let found: bool = connection
                    .query_row(
                        &sql,
                        rusqlite::params![
                            one.tool,
                            one.geometry,
                            one.serial,
                            two.tool,
                            two.geometry,
                            two.serial
                        ],
                        |row| row.get(0),
                    )
                    .unwrap();
                assert_eq!(found, one.is_same(two), "{one:?} {two:?}");
                assert_eq!(found, two.is_same(one));
                same_ones += usize::from(found);
            }
        }
        assert!(same_ones > dies.len());
    }
}
