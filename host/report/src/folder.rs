//! Results as files for people, in one folder: a page per result, a copy of the newest one under a fixed name, and an index.
//!
//! ```text
//!  index.html                        every page, the newest first
//!  report.html                       the newest page
//!  map3d.html                        its maps in space
//!  reports/DATE-NAME-VERDICT.html    every page, as long as it is kept
//!  inspection.json, flanks.csv, ...  the newest result's figures
//! ```

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use askama::Template;
use flankscope_metrology::io::ply::Column;
use flankscope_metrology::io::points::{Format, PointFile};
use flankscope_metrology::verdict::Word;

use super::{map3d_source, tables};
use flankscope_article::Article;
use flankscope_foundation::files::{make_folder_within, stream_whole, write_whole};
use flankscope_record::document::Inspection;
use flankscope_record::document::scan::Scan;
use flankscope_record::sink::{ResultSink, SinkError, document_text};

/// Name of the newest page.
const PAGE: &str = "report.html";
/// The newest maps in space.
const MAP3D: &str = "map3d.html";
/// The page of the article's figures.
const ARTICLE: &str = "article.html";
/// Number of newest pages that the index lists.
const LISTED: usize = 500;
/// Number of newest pages that are kept: 1 GB of checks. A page shows what the history keeps of its check, and the figures of
/// every check are there for good.
const KEPT: usize = 10_000;

/// An existing folder for reports.
#[derive(Clone, Debug)]
pub struct ReportFolder(PathBuf);

/// The index of a folder's pages.
#[derive(Template)]
#[template(path = "index.html")]
struct Index {
    listed: Vec<Entry>,
    beyond: usize,
    has_history: bool,
    has_map: bool,
}

/// A page, by the parts of its file name and what its head says.
#[derive(Clone, Debug, PartialEq)]
struct Entry {
    file: String,
    date: String,
    what: String,
    verdict: Word,
    /// As HTML; a dash where the page does not say.
    tool: String,
    most_wear: String,
}

/// Bytes of a page in which its tool and most wear stand.
const HEAD_BYTES: u64 = 4096;

/// What a page's head says under a name, as the HTML that stands there; a dash if it says nothing, or what would be more than text.
fn said_by_head(head: &str, name: &str) -> String {
    let begin = format!("<meta name=\"{name}\" content=\"");
    let said = head
        .split_once(&begin)
        .and_then(|(_, after)| after.split_once('"'));
    let text = said.map(|(text, _)| text);
    text.filter(|text| !text.contains(['<', '>']))
        .unwrap_or("–")
        .to_owned()
}

impl Entry {
    /// Parses `20260131T120000Z-check-12-no-go.html`; `None` for any other name.
    fn of(file: String) -> Option<Self> {
        let stem = file.strip_suffix(".html")?;
        let (date, rest) = stem.split_once('-')?;
        let digits = |range: std::ops::Range<usize>| {
            date.get(range)
                .filter(|part| part.bytes().all(|b| b.is_ascii_digit()))
        };
        let (day, time) = (digits(0..8)?, digits(9..15)?);
        // "no-go" ends with "go", too, so the longest word counts.
        let ends = |word: &&Word| rest.ends_with(&format!("-{word}"));
        let words = Word::ALL.iter().filter(ends);
        let verdict = *words.max_by_key(|word| word.as_str().len())?;
        let what = rest.strip_suffix(&format!("-{verdict}"))?.replace('-', " ");
        let date = format!(
            "{}-{}-{} {}:{}:{}",
            &day[..4],
            &day[4..6],
            &day[6..],
            &time[..2],
            &time[2..4],
            &time[4..]
        );
        Some(Self {
            file,
            date,
            what,
            verdict,
            tool: "–".into(),
            most_wear: "–".into(),
        })
    }

    /// Takes from the page's head what its name does not say; a page that cannot be read is listed without.
    fn read_head(&mut self, folder: &Path) {
        let mut head = Vec::new();
        let page = File::open(folder.join(&self.file));
        let read = page.and_then(|page| page.take(HEAD_BYTES).read_to_end(&mut head));
        if read.is_ok() {
            let head = String::from_utf8_lossy(&head);
            self.tool = said_by_head(&head, "tool");
            self.most_wear = said_by_head(&head, "most-wear");
        }
    }
}

/// Files of the pages, newest first, that need not be kept: those beyond `kept`, except for each no-go after a go or a warning.
/// It stands until somebody acknowledges it, however many checks follow.
fn superfluous(pages: &[Entry], kept: usize) -> BTreeSet<String> {
    let mut stands = false;
    let mut old = BTreeSet::new();
    for (age, page) in pages.iter().enumerate().rev() {
        let begins = page.verdict == Word::NoGo && !stands;
        stands = match page.verdict {
            Word::Go | Word::Warn => false,
            Word::NoGo => true,
            Word::Indeterminate => stands,
        };
        if age >= kept && !begins {
            old.insert(page.file.clone());
        }
    }
    old
}

/// File name of a result's own page without extension: the date comes first, so that names sort by it.
fn name_of(date: &str, what: &str, verdict: Word) -> String {
    let date: String = date.chars().filter(char::is_ascii_alphanumeric).collect();
    format!("{date}-{what}-{verdict}")
}

impl ReportFolder {
    /// Subfolder of all pages.
    pub const PAGES: &'static str = "reports";
    /// Files that a check writes.
    pub const OF_CHECK: &'static [&'static str] = &[
        PAGE,
        MAP3D,
        "index.html",
        "inspection.json",
        "flanks.csv",
        "cells.csv",
    ];
    /// Files that a scan writes.
    pub const OF_SCAN: &'static [&'static str] = &[
        PAGE,
        MAP3D,
        "index.html",
        "scan.json",
        "map.ply",
        "flanks.csv",
        "views.csv",
        "gear.csv",
    ];
    /// Files of the article's figures.
    pub const OF_ARTICLE: &'static [&'static str] = &[ARTICLE, "article.json", "first-view.ply"];
    /// Files that a watch writes for every check.
    pub const OF_WATCH: &'static [&'static str] = &[PAGE, MAP3D, "index.html"];

    /// Writes into this folder, which must exist.
    #[must_use]
    pub fn new(folder: &Path) -> Self {
        Self(folder.to_owned())
    }

    /// Path of the newest page.
    #[must_use]
    pub fn page(&self) -> PathBuf {
        self.0.join(PAGE)
    }

    /// Path of the page of the article's figures.
    #[must_use]
    pub fn article(&self) -> PathBuf {
        self.0.join(ARTICLE)
    }

    fn write(&self, name: &str, text: &str) -> Result<(), SinkError> {
        let path = self.0.join(name);
        let written = write_whole(&path, text.as_bytes());
        written.map_err(|source| SinkError::Write { path, source })
    }

    fn stream(
        &self,
        name: &str,
        write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<(), SinkError> {
        let path = self.0.join(name);
        let written = stream_whole(&path, write);
        written.map_err(|source| SinkError::Write { path, source })
    }

    fn remove(&self, name: &str) -> Result<(), SinkError> {
        let path = self.0.join(name);
        match std::fs::remove_file(&path) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => {
                Err(SinkError::Write { path, source })
            }
            _ => Ok(()),
        }
    }

    /// Writes the page under the fixed name, its maps in space if there are any, the page under its own name, then the index. `date`
    /// is ISO 8601, UTC.
    fn put_page(
        &self,
        page: &str,
        map3d: Option<&str>,
        date: &str,
        what: &str,
        verdict: Word,
    ) -> Result<(), SinkError> {
        self.write(PAGE, page)?;
        if let Some(map3d) = map3d {
            self.write(MAP3D, map3d)?;
        }
        let pages = self.0.join(Self::PAGES);
        make_folder_within(&pages).map_err(|source| SinkError::Write {
            path: pages.clone(),
            source,
        })?;
        let name = name_of(date, what, verdict);
        // Two pages of the same second get different names.
        let (mut own, mut number) = (format!("{}/{name}.html", Self::PAGES), 1);
        while self.0.join(&own).exists() {
            number += 1;
            let again = name_of(date, &format!("{what}-again-{number}"), verdict);
            own = format!("{}/{again}.html", Self::PAGES);
        }
        // Links from the newest page lead down to tables and pages, those from its own page lead up.
        let page = page.replace("href=\"./", "href=\"../");
        self.write(&own, &page)?;
        self.index(KEPT)
    }

    /// Removes pages beyond `kept`, and writes the index again.
    fn index(&self, kept: usize) -> Result<(), SinkError> {
        let path = self.0.join(Self::PAGES);
        let entries = std::fs::read_dir(&path).map_err(|source| SinkError::Write {
            path: path.clone(),
            source,
        })?;
        let mut listed: Vec<Entry> = entries
            .filter_map(|entry| Entry::of(entry.ok()?.file_name().into_string().ok()?))
            .collect();
        listed.sort_by(|a, b| b.file.cmp(&a.file));
        let old = superfluous(&listed, kept);
        for file in &old {
            self.remove(&format!("{}/{file}", Self::PAGES))?;
        }
        listed.retain(|entry| !old.contains(&entry.file));
        let beyond = listed.len().saturating_sub(LISTED);
        listed.truncate(LISTED);
        listed.iter_mut().for_each(|entry| entry.read_head(&path));
        let has_history = self.0.join("history.html").is_file();
        let index = Index {
            listed,
            beyond,
            has_history,
            has_map: self.0.join(MAP3D).is_file(),
        };
        self.write("index.html", &index.render().map_err(no_page)?)
    }

    fn put_page_of(&self, check: &Inspection) -> Result<(), SinkError> {
        let what = check
            .id
            .map_or_else(|| "check".into(), |id| format!("check-{id}"));
        let page = super::html(check).map_err(no_page)?;
        let map3d = map3d_source::from_check(check).page().map_err(no_page)?;
        self.put_page(&page, Some(&map3d), &check.date, &what, check.verdict)
    }
}

fn no_page(error: askama::Error) -> SinkError {
    SinkError::Page(Box::new(error))
}

impl ResultSink<Inspection> for ReportFolder {
    /// The document is written first, because its data cannot be recovered from the page.
    fn put(&mut self, inspection: &mut Inspection) -> Result<(), SinkError> {
        self.write("inspection.json", &document_text(inspection)?)?;
        self.stream("flanks.csv", |out| {
            tables::flanks(&inspection.features, out)
        })?;
        self.stream("cells.csv", |out| tables::cells(inspection, out))?;
        self.put_page_of(inspection)
    }
}

impl ResultSink<Scan> for ReportFolder {
    /// The document is written first, because its data cannot be recovered from the page.
    fn put(&mut self, scan: &mut Scan) -> Result<(), SinkError> {
        self.write("scan.json", &document_text(scan)?)?;
        self.stream("flanks.csv", |out| tables::flanks(&scan.features, out))?;
        self.stream("views.csv", |out| tables::views(scan, out))?;
        match &scan.gear {
            Some(gear) => self.stream("gear.csv", |out| tables::gear(gear, out))?,
            // A file of an earlier scan would be mistaken for this one's.
            None => self.remove("gear.csv")?,
        }
        self.stream("map.ply", |file| super::scan_ply(scan, file))?;
        let page = super::scan_html(scan).map_err(no_page)?;
        let map3d = map3d_source::from_scan(scan).page().map_err(no_page)?;
        self.put_page(&page, Some(&map3d), &scan.date, "scan", scan.verdict)
    }
}

impl ResultSink<Article> for ReportFolder {
    /// The document is written first, because its data cannot be recovered from the page.
    fn put(&mut self, article: &mut Article) -> Result<(), SinkError> {
        self.write("article.json", &document_text(article)?)?;
        self.stream("first-view.ply", |out| {
            let first = &article.first_view;
            let points = PointFile {
                columns: &[Column::Float("fringes", &first.fringes_dn)],
                ..PointFile::from_points(&first.points)
            };
            points.write(Format::Ply, out)
        })?;
        self.write(
            ARTICLE,
            &super::article::article_html(article).map_err(no_page)?,
        )
    }
}

/// Writes pages of checks, without their tables.
#[derive(Clone, Debug)]
pub struct Pages(pub ReportFolder);

impl ResultSink<Inspection> for Pages {
    fn put(&mut self, inspection: &mut Inspection) -> Result<(), SinkError> {
        self.0.put_page_of(inspection)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_what_the_index_lists() {
        let named = name_of("2026-01-31T12:00:05Z", "check-12", Word::NoGo);
        assert_eq!(named, "20260131T120005Z-check-12-no-go");
        let entry = Entry::of(format!("{named}.html")).unwrap();
        assert_eq!(
            (entry.date.as_str(), entry.what.as_str(), entry.verdict),
            ("2026-01-31 12:00:05", "check 12", Word::NoGo)
        );
        let foreign = [
            "notes.html",
            "20260131T120005Z-check.html",
            "ä-go.html",
            "20260131Tabcdef-go.html",
        ];
        for foreign in foreign {
            assert_eq!(Entry::of(foreign.into()), None, "{foreign}");
        }
    }

    #[test]
    fn the_index_says_tool_and_most_wear_as_text() {
        let folder = tempfile::tempdir().unwrap();
        let pages = ReportFolder::new(folder.path());
        let head = |tool: &str, wear: &str| {
            format!(
                "<meta name=\"tool\" content=\"{tool}\">\n<meta name=\"most-wear\" content=\"{wear}\">"
            )
        };
        let far = " ".repeat(HEAD_BYTES as usize) + &head("far", "far");
        let cases = [
            (
                head("die &#60;A&#62;", "tooth 40 left: 80.5 ± 4.3 µm"),
                "die &#60;A&#62;",
                "tooth 40 left: 80.5 ± 4.3 µm",
            ),
            (head("<b>bold", "–"), "–", "–"),
            (head("never ends", "").replace("\">", ""), "–", "–"),
            (far, "–", "–"),
        ];
        for (page, tool, wear) in cases {
            pages
                .put_page(&page, None, "2026-01-31T12:00:05Z", "check", Word::Go)
                .unwrap();
            let index = std::fs::read_to_string(folder.path().join("index.html")).unwrap();
            let newest = index.split("<tr><td").nth(1).unwrap();
            assert!(
                newest.contains(&format!("<td class=\"text\">{tool}</td>")),
                "{newest}"
            );
            assert!(
                newest.contains(&format!("<td class=\"text\">{wear}</td>")),
                "{newest}"
            );
            std::fs::remove_dir_all(folder.path().join(ReportFolder::PAGES)).unwrap();
        }
    }

    #[test]
    fn old_pages_go_but_the_no_go_that_stands() {
        let folder = tempfile::tempdir().unwrap();
        let pages = ReportFolder::new(folder.path());
        use Word::{Go, Indeterminate, NoGo, Warn};
        for (number, verdict) in [Go, NoGo, NoGo, Indeterminate, NoGo, Warn, NoGo, NoGo, Go]
            .into_iter()
            .enumerate()
        {
            let (date, what) = (
                format!("2026-01-31T12:00:0{number}Z"),
                format!("check-{number}"),
            );
            pages.put_page("page", None, &date, &what, verdict).unwrap();
        }
        let own = folder.path().join(ReportFolder::PAGES);
        std::fs::write(own.join("notes.html"), "somebody's").unwrap();
        pages.index(2).unwrap();
        let entries = std::fs::read_dir(own).unwrap().flatten();
        let mut left: Vec<String> = entries
            .map(|entry| entry.file_name().into_string().unwrap())
            .collect();
        left.sort();
        assert_eq!(
            left,
            [
                "20260131T120001Z-check-1-no-go.html",
                "20260131T120006Z-check-6-no-go.html",
                "20260131T120007Z-check-7-no-go.html",
                "20260131T120008Z-check-8-go.html",
                "notes.html"
            ]
        );
        let index = std::fs::read_to_string(folder.path().join("index.html")).unwrap();
        assert_eq!(index.matches("<tr><td").count(), 4);
    }

    #[test]
    fn no_page_takes_the_place_of_another_and_the_index_lists_all() {
        let folder = tempfile::tempdir().unwrap();
        let pages = ReportFolder::new(folder.path());
        let text = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
        for (number, verdict) in [Word::Go, Word::Go, Word::NoGo].into_iter().enumerate() {
            let page = format!("<a href=\"./flanks.csv\">page {number}</a>");
            pages
                .put_page(&page, None, "2026-01-31T12:00:05Z", "check", verdict)
                .unwrap();
        }
        assert!(text("report.html").contains("./flanks.csv\">page 2"));
        let first = text("reports/20260131T120005Z-check-go.html");
        assert!(first.contains("../flanks.csv\">page 0"));
        assert!(text("reports/20260131T120005Z-check-again-2-go.html").contains("page 1"));
        let index = text("index.html");
        assert_eq!(index.matches("<tr><td").count(), 3);
        assert!(index.contains("reports/20260131T120005Z-check-no-go.html"));
    }
}
