//! Reads the file: checks and their results, baselines, acknowledgements.

use std::str::FromStr;

use flankscope_metrology::verdict::{Code, Word};
use rusqlite::types::Type;
use rusqlite::{OptionalExtension, Row, params};

use super::error::HistoryError;
use super::same_die::{columns, same, same_as_asked};
use super::store::History;
use crate::die::DieKey;
use crate::document::{FeatureId, LastExposure};
use crate::origin::{HeadId, Origin, OriginKind, RECORDED_LINKS};
use crate::seal::StandingNoGo;

/// A stored check.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Check {
    /// Number, from 1.
    pub id: i64,
    /// When it was stored: ISO 8601, UTC, by the host's clock.
    pub at: String,
    /// Name of the tool.
    pub tool: String,
    /// Press cycles done with the tool.
    pub tool_cycles: i64,
    /// The controller's counter of press cycles since its power-up.
    pub press_cycles: i64,
    /// BLAKE3 of the baseline that wear is relative to; absent if wear is relative to CAD.
    pub baseline: Option<String>,
    pub verdict: Word,
    /// Reason of the verdict.
    pub reason: String,
    /// Link, head, station and operator.
    #[serde(flatten)]
    pub origin: Origin,
    /// Serial number of the tool, if its file names one.
    pub serial: Option<String>,
    /// One entry per inspected flank or patch.
    pub flanks: Vec<FlankRow>,
}

/// A flank or patch of a stored check.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct FlankRow {
    #[serde(flatten)]
    pub id: FeatureId,
    /// Wear, µm; absent when it was not measured.
    pub wear_um: Option<f64>,
    /// Its expanded uncertainty (95 %), µm.
    pub u95_um: Option<f64>,
    /// Warn limit, µm.
    pub warn_um: f64,
    /// Stop limit, µm.
    pub limit_um: f64,
    pub verdict: Word,
    /// Class of the reason, if indeterminate.
    pub code: Option<Code>,
}

/// The newest checks of a tool.
#[derive(Clone, Debug, PartialEq)]
pub struct LastChecks {
    /// Die of the newest check that is not a recording; of the newest recording if there is no other.
    pub die: DieKey,
    /// The newest check of the press or the bench.
    pub check: Option<Check>,
    /// When the last exposure of that check ended, if its document says so.
    pub exposure: Option<LastExposure>,
    /// The newest recording, if it was stored after that check.
    pub recording: Option<Check>,
}

/// A person's acknowledgement of a verdict.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Acknowledgement {
    /// Time.
    pub at: String,
    /// Name of the tool.
    pub tool: String,
    /// Name of the person.
    pub who: String,
    /// The check whose verdict was displayed at the press.
    pub inspection: Option<i64>,
}

impl History {
    /// Names of the tools, the most recently checked first.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn tools(&self) -> Result<Vec<String>, HistoryError> {
        self.rows(
            "SELECT tool FROM inspection GROUP BY tool ORDER BY max(id) DESC",
            [],
            |row| row.get(0),
        )
    }

    /// Number of commits by other processes, as far as it tells one moment from another: equal numbers of one connection mean that
    /// nothing was written between them.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn commits(&self) -> Result<i64, HistoryError> {
        self.connection
            .pragma_query_value(None, "data_version", |row| row.get(0))
            .map_err(self.because("read its version"))
    }

    /// Number of a tool's checks with each verdict.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn verdict_counts(&self, tool: &str) -> Result<Vec<(Word, u64)>, HistoryError> {
        self.rows(
            "SELECT verdict, count(*) FROM inspection WHERE tool = ?1 GROUP BY verdict",
            [tool],
            |row| Ok((parsed(row, 0)?, row.get::<_, i64>(1)?.unsigned_abs())),
        )
    }

    /// The newest checks, at most `most`, newest first: of a tool, with a verdict, and before a check, if these are given.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn listed(
        &self,
        tool: Option<&str>,
        verdict: Option<Word>,
        before: Option<i64>,
        most: u32,
    ) -> Result<Vec<Check>, HistoryError> {
        let ids: Vec<i64> = self.rows(
            "SELECT id FROM inspection WHERE (?1 IS NULL OR tool = ?1) AND (?2 IS NULL OR verdict = ?2) \
             AND (?3 IS NULL OR id < ?3) ORDER BY id DESC LIMIT ?4",
            params![tool, verdict.map(Word::as_str), before, most],
            |row| row.get(0),
        )?;
        ids.into_iter().map(|id| self.check(id)).collect()
    }

    /// The newest checks of every tool: the tools that the press or the bench checked last come first, tools with recordings alone last.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn last_checks(&self) -> Result<Vec<LastChecks>, HistoryError> {
        let mut all = Vec::new();
        for tool in self.tools()? {
            all.push(self.last_checks_of_tool(&tool)?);
        }
        all.sort_by_key(|last| std::cmp::Reverse(last.check.as_ref().map(|check| check.id)));
        Ok(all)
    }

    fn last_checks_of_tool(&self, tool: &str) -> Result<LastChecks, HistoryError> {
        let (mut found, mut recording, mut before) = (None, None, None);
        while let Some(check) = self.listed(Some(tool), None, before, 1)?.pop() {
            before = Some(check.id);
            if check.origin.kind() == OriginKind::Recording {
                recording.get_or_insert(check);
            } else {
                found = Some(check);
                break;
            }
        }
        let newest = found.as_ref().or(recording.as_ref());
        let die = DieKey {
            tool: tool.to_owned(),
            geometry: newest.map_or(Ok(String::new()), |check| self.geometry(check.id))?,
            serial: newest.and_then(|check| check.serial.clone()),
        };
        let exposure = match &found {
            Some(check) => self.last_exposure(check.id)?,
            None => None,
        };
        Ok(LastChecks {
            die,
            check: found,
            exposure,
            recording,
        })
    }

    fn geometry(&self, id: i64) -> Result<String, HistoryError> {
        let sql = "SELECT geometry FROM inspection WHERE id = ?1";
        self.connection
            .query_row(sql, [id], |row| row.get(0))
            .map_err(self.because("read a check"))
    }

    /// When the last exposure of a check ended, if its document says so.
    fn last_exposure(&self, id: i64) -> Result<Option<LastExposure>, HistoryError> {
        #[derive(serde::Deserialize)]
        struct Exposed {
            last_exposure: Option<LastExposure>,
        }
        let document = self.document(id)?;
        let read = serde_json::from_str::<Exposed>(&document);
        let read = read.map_err(|source| HistoryError::Stored { id, source })?;
        Ok(read.last_exposure)
    }

    /// Date of the newest row, by the clock of the computer that stored it; `None` while there is none.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn newest_date(&self) -> Result<Option<String>, HistoryError> {
        let newest = |table: &str| {
            format!("SELECT at FROM (SELECT at FROM {table} ORDER BY id DESC LIMIT 1)")
        };
        let tables = ["inspection", "acknowledgement", "audit"].map(newest);
        let sql = format!("SELECT max(at) FROM ({})", tables.join(" UNION ALL "));
        self.connection
            .query_row(&sql, [], |row| row.get(0))
            .map_err(self.because("read its dates"))
    }

    /// Number of the newest check of a die; 0 before the first.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn newest_check(&self, die: &DieKey) -> Result<i64, HistoryError> {
        let sql = format!(
            "SELECT coalesce(max(id), 0) FROM inspection WHERE {}",
            same_as_asked("inspection")
        );
        self.connection
            .query_row(&sql, params![die.tool, die.geometry, die.serial], |row| {
                row.get(0)
            })
            .map_err(self.because("read its checks"))
    }

    /// Every check of a tool, in order.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn checks(&self, tool: &str) -> Result<Vec<Check>, HistoryError> {
        self.checks_where("tool = ?1", [tool])
    }

    /// The row of a check.
    ///
    /// # Errors
    /// There is no such check, or the file cannot be read.
    pub fn check(&self, id: i64) -> Result<Check, HistoryError> {
        let found = self.checks_where("id = ?1", [id])?;
        found
            .into_iter()
            .next()
            .ok_or_else(|| self.no_such_check(id))
    }

    /// Numbers of all checks, in order.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn ids(&self) -> Result<Vec<i64>, HistoryError> {
        self.rows("SELECT id FROM inspection ORDER BY id", [], |row| {
            row.get(0)
        })
    }

    /// Number of the first check after this one; 0 is before the first.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn next_after(&self, id: i64) -> Result<Option<i64>, HistoryError> {
        self.connection
            .query_row(
                "SELECT min(id) FROM inspection WHERE id > ?1",
                [id],
                |row| row.get(0),
            )
            .map_err(self.because("read which checks follow"))
    }

    pub(super) fn checks_where(
        &self,
        condition: &str,
        parameters: impl rusqlite::Params + Clone,
    ) -> Result<Vec<Check>, HistoryError> {
        let mut checks = self.rows(
            &format!(
                "SELECT id, at, tool, tool_cycles, press_cycles, baseline, verdict, reason, \
                 link, simulated, head, head_blake3, head_seal, station, operator, serial FROM inspection \
                 WHERE {condition} ORDER BY id"
            ),
            parameters.clone(),
            |row| {
                Ok(Check {
                    id: row.get(0)?,
                    at: row.get(1)?,
                    tool: row.get(2)?,
                    tool_cycles: row.get(3)?,
                    press_cycles: row.get(4)?,
                    baseline: row.get(5)?,
                    verdict: parsed(row, 6)?,
                    reason: row.get(7)?,
                    origin: Origin {
                        link: row.get(8)?,
                        simulated: row.get(9)?,
                        head: HeadId {
                            name: row.get(10)?,
                            blake3: row.get(11)?,
                            seal: row.get(12)?,
                        },
                        station: row.get(13)?,
                        operator: row.get(14)?,
                        recording: None,
                    },
                    serial: row.get(15)?,
                    flanks: Vec::new(),
                })
            },
        )?;
        let flanks = self.rows(
            &format!(
                "SELECT inspection, tooth, flank, patch, wear_um, u95_um, warn_um, limit_um, flank.verdict, code FROM flank \
                 JOIN inspection ON inspection.id = inspection WHERE {condition} ORDER BY inspection, tooth, flank"
            ),
            parameters,
            |row| {
                let flank = FlankRow {
                    id: FeatureId {
                        tooth: row.get(1)?,
                        flank: parsed(row, 2)?,
                        patch: row.get(3)?,
                    },
                    wear_um: row.get(4)?,
                    u95_um: row.get(5)?,
                    warn_um: row.get(6)?,
                    limit_um: row.get(7)?,
                    verdict: parsed(row, 8)?,
                    code: parsed_or_none(row, 9)?,
                };
                Ok((row.get::<_, i64>(0)?, flank))
            },
        )?;
        let mut flanks = flanks.into_iter().peekable();
        for check in &mut checks {
            while let Some((_, flank)) = flanks.next_if(|(id, _)| *id <= check.id) {
                check.flanks.push(flank);
            }
        }
        Ok(checks)
    }

    /// The result document of a check, as it was stored.
    ///
    /// # Errors
    /// There is no such check, or the file cannot be read.
    pub fn document(&self, id: i64) -> Result<String, HistoryError> {
        let found = self
            .connection
            .query_row(
                "SELECT document FROM inspection WHERE id = ?1",
                [id],
                |row| row.get(0),
            )
            .optional()
            .map_err(self.because("read a check"))?;
        found.ok_or_else(|| self.no_such_check(id))
    }

    fn no_such_check(&self, id: i64) -> HistoryError {
        let last = "SELECT max(id) FROM inspection";
        match self.connection.query_row(last, [], |row| row.get(0)) {
            Ok(last) => HistoryError::NoSuchCheck {
                path: self.path.clone(),
                id,
                last,
            },
            Err(source) => self.because("read a check")(source),
        }
    }

    /// The text of a baseline, by its hash.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn baseline(&self, blake3: &str) -> Result<Option<String>, HistoryError> {
        self.connection
            .query_row(
                "SELECT document FROM baseline WHERE blake3 = ?1",
                [blake3],
                |row| row.get(0),
            )
            .optional()
            .map_err(self.because("read a baseline"))
    }

    /// The acknowledgements of a tool, in order.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn acknowledgements(&self, tool: &str) -> Result<Vec<Acknowledgement>, HistoryError> {
        self.rows(
            "SELECT at, tool, who, inspection FROM acknowledgement WHERE tool = ?1 ORDER BY id",
            [tool],
            |row| {
                Ok(Acknowledgement {
                    at: row.get(0)?,
                    tool: row.get(1)?,
                    who: row.get(2)?,
                    inspection: row.get(3)?,
                })
            },
        )
    }

    /// Number of acknowledgements of a die.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn acknowledgement_count(&self, die: &DieKey) -> Result<i64, HistoryError> {
        let sql = format!(
            "SELECT count(*) FROM acknowledgement WHERE {}",
            same_as_asked("acknowledgement")
        );
        self.connection
            .query_row(&sql, params![die.tool, die.geometry, die.serial], |row| {
                row.get(0)
            })
            .map_err(self.because("read its acknowledgements"))
    }

    /// The unacknowledged verdicts of a die, in order. Recordings are left out: they neither set nor clear a latch.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn open_verdicts(&self, die: &DieKey) -> Result<Vec<Word>, HistoryError> {
        self.rows(
            &format!(
                "SELECT verdict FROM inspection WHERE {} AND {} AND NOT {} ORDER BY id",
                same_as_asked("inspection"),
                not_recorded(),
                acknowledged()
            ),
            params![die.tool, die.geometry, die.serial],
            |row| parsed(row, 0),
        )
    }

    /// Unacknowledged no-gos of the press or the bench, the newest of each die. A no-go of a recording is not among them.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn standing_no_gos(&self) -> Result<Vec<StandingNoGo>, HistoryError> {
        self.rows(
            &format!(
                "SELECT tool, geometry, serial, max(id), at FROM inspection WHERE verdict = 'no-go' AND {} AND NOT {} \
                 GROUP BY tool, geometry, serial ORDER BY max(id) DESC",
                not_recorded(),
                acknowledged()
            ),
            [],
            |row| {
                Ok(StandingNoGo {
                    die: DieKey {
                        tool: row.get(0)?,
                        geometry: row.get(1)?,
                        serial: row.get(2)?,
                    },
                    check: row.get(3)?,
                    at: row.get(4)?,
                })
            },
        )
    }

    /// Refuses a head without a digest if an earlier check was made with a signed head of this name.
    ///
    /// # Errors
    /// [`HistoryError::Stripped`], or the file cannot be read.
    pub fn takes_head(&self, head: &HeadId) -> Result<(), HistoryError> {
        if head.seal != "unsigned" {
            return Ok(());
        }
        let signed = self.rows(
            "SELECT id, at FROM inspection WHERE head = ?1 AND head_seal = 'signed' ORDER BY id DESC LIMIT 1",
            [&head.name],
            |row| Ok((row.get(0)?, row.get(1)?)),
        )?;
        match signed.into_iter().next() {
            None => Ok(()),
            Some((id, at)) => Err(HistoryError::Stripped {
                head: head.name.clone(),
                id,
                at,
            }),
        }
    }

    pub(super) fn rows<T>(
        &self,
        sql: &str,
        parameters: impl rusqlite::Params,
        row: impl FnMut(&rusqlite::Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Vec<T>, HistoryError> {
        let read = || -> rusqlite::Result<Vec<T>> {
            let mut statement = self.connection.prepare(sql)?;
            statement.query_map(parameters, row)?.collect()
        };
        read().map_err(self.because("read it"))
    }
}

/// SQL condition: a check is not a recording.
pub(super) fn not_recorded() -> String {
    let [frames, clouds] = RECORDED_LINKS;
    format!("inspection.link NOT IN ('{frames}', '{clouds}')")
}

/// SQL condition: a check was acknowledged by a later entry for the same die.
fn acknowledged() -> String {
    let [checks, notes] = ["inspection", "noted"].map(columns);
    let [a, b, c] = &checks;
    let [d, e, f] = &notes;
    format!(
        "EXISTS (SELECT 1 FROM acknowledgement AS noted WHERE noted.inspection >= inspection.id AND {})",
        same([a, b, c], [d, e, f])
    )
}

/// Parses a word of a closed list; an unknown word is an error.
fn parsed<T>(row: &Row<'_>, column: usize) -> rusqlite::Result<T>
where
    T: FromStr<Err: std::error::Error + Send + Sync + 'static>,
{
    let word: String = row.get(column)?;
    word.parse().map_err(|error| {
        rusqlite::Error::FromSqlConversionFailure(column, Type::Text, Box::new(error))
    })
}

/// Like [`parsed`], for a column that may be null.
fn parsed_or_none<T>(row: &Row<'_>, column: usize) -> rusqlite::Result<Option<T>>
where
    T: FromStr<Err: std::error::Error + Send + Sync + 'static>,
{
    match row.get_ref(column)? {
        rusqlite::types::ValueRef::Null => Ok(None),
        _ => parsed(row, column).map(Some),
    }
}
