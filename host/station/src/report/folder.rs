//! Results as files for people: a page and what belongs to it, in one folder.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::files::{stream_whole, write_whole};
use crate::inspection::Inspection;
use crate::scan::Scan;
use crate::sink::{ResultSink, SinkError, document_text};

/// The page's name.
const PAGE: &str = "report.html";

/// A folder that is there.
#[derive(Clone, Debug)]
pub struct ReportFolder(PathBuf);

impl ReportFolder {
    /// What a check writes into its folder.
    pub const OF_CHECK: &'static [&'static str] = &[PAGE, "inspection.json"];
    /// What a scan writes into its folder.
    pub const OF_SCAN: &'static [&'static str] = &[PAGE, "scan.json", "map.ply"];

    /// Writes into this folder.
    #[must_use]
    pub fn new(folder: &Path) -> Self {
        Self(folder.to_owned())
    }

    /// Where the page is.
    #[must_use]
    pub fn page(&self) -> PathBuf {
        self.0.join(PAGE)
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
}

impl ResultSink<Inspection> for ReportFolder {
    /// The document first: what it says cannot be drawn again.
    fn put(&mut self, inspection: &mut Inspection) -> Result<(), SinkError> {
        self.write("inspection.json", &document_text(inspection)?)?;
        self.write(PAGE, &super::html(inspection)?)
    }
}

impl ResultSink<Scan> for ReportFolder {
    /// The document first: what it says cannot be drawn again.
    fn put(&mut self, scan: &mut Scan) -> Result<(), SinkError> {
        self.write("scan.json", &document_text(scan)?)?;
        self.write(PAGE, &super::scan_html(scan)?)?;
        self.stream("map.ply", |file| super::scan_ply(scan, file))
    }
}

/// The page of the latest check alone.
#[derive(Clone, Debug)]
pub struct LatestPage(pub ReportFolder);

impl ResultSink<Inspection> for LatestPage {
    fn put(&mut self, inspection: &mut Inspection) -> Result<(), SinkError> {
        self.0.write(PAGE, &super::html(inspection)?)
    }
}
