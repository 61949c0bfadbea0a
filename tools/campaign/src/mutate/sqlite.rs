//! Changes to a database by whoever has a database program: values, rows, triggers, tables, pragmas.

use rand::RngExt;
use rand_pcg::Pcg64;
use rusqlite::Connection;

use super::NUMBERS;

/// `None`: it is no database any more.
pub fn rows(content: &[u8], random: &mut Pcg64) -> Option<Vec<u8>> {
    let file = tempfile::NamedTempFile::new().ok()?;
    std::fs::write(file.path(), content).ok()?;
    let changed = edit(file.path(), random).is_ok();
    changed.then(|| std::fs::read(file.path()).ok()).flatten()
}

fn edit(path: &std::path::Path, random: &mut Pcg64) -> rusqlite::Result<()> {
    let connection = Connection::open(path)?;
    // Without a journal beside it: the file is all that is read.
    connection.pragma_update(None, "journal_mode", "DELETE")?;
    let names = |kind: &str| -> rusqlite::Result<Vec<String>> {
        let sql = "SELECT name FROM sqlite_schema WHERE type = ?1 AND name NOT LIKE 'sqlite_%' ORDER BY name";
        let mut statement = connection.prepare(sql)?;
        statement.query_map([kind], |row| row.get(0))?.collect()
    };
    // Whoever edits drops what is in the way.
    let triggers = names("trigger")?;
    if random.random_bool(0.9) {
        for trigger in &triggers {
            connection.execute_batch(&format!("DROP TRIGGER \"{trigger}\""))?;
        }
    }
    let tables = names("table")?;
    let none = || rusqlite::Error::QueryReturnedNoRows;
    let table = tables
        .get(random.random_range(0..tables.len().max(1)))
        .ok_or_else(none)?;
    let columns: Vec<String> = {
        let mut statement = connection.prepare("SELECT name FROM pragma_table_info(?1)")?;
        statement
            .query_map([table], |row| row.get(0))?
            .collect::<rusqlite::Result<_>>()?
    };
    let column = columns
        .get(random.random_range(0..columns.len().max(1)))
        .ok_or_else(none)?;
    let number = NUMBERS[random.random_range(0..NUMBERS.len())];
    let one = format!("(SELECT \"{column}\" FROM \"{table}\" ORDER BY random() LIMIT 1)");
    let sql = match random.random_range(0..9) {
        0 => format!("DELETE FROM \"{table}\" WHERE \"{column}\" = {one}"),
        1 => format!("DROP TABLE \"{table}\""),
        2 => format!("PRAGMA user_version = {}", random.random_range(-1..9)),
        3 => format!("PRAGMA application_id = {}", random.random_range(0..3)),
        4 => format!("UPDATE \"{table}\" SET \"{column}\" = NULL"),
        5 => format!(
            "UPDATE \"{table}\" SET \"{column}\" = \"{column}\" + 1 WHERE \"{column}\" = {one}"
        ),
        6 => format!(
            "UPDATE OR IGNORE \"{table}\" SET \"{column}\" = 'go' WHERE \"{column}\" = {one}"
        ),
        7 => format!("UPDATE OR IGNORE \"{table}\" SET \"{column}\" = {one}"),
        _ => format!("UPDATE \"{table}\" SET \"{column}\" = '{number}' WHERE \"{column}\" = {one}"),
    };
    connection.execute_batch(&sql)
}
