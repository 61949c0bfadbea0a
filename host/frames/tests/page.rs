//! The layouts of docs/camera.md are those of the code: whoever writes a camera in another language has only the page.

use std::mem::{offset_of, size_of};
use std::path::Path;

use flankscope_frames::{Arm, EXPOSURE_TOLERANCE_US, FrameHeader, Ready};

fn page() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/camera.md");
    std::fs::read_to_string(path).unwrap()
}

#[test]
fn the_table_of_the_header_is_its_layout() {
    let page = page();
    let table = page.split("`flankscope/FrameHeader/1` (").nth(1).unwrap();
    let table = table.split("\n\n`flankscope/Arm/1`").next().unwrap();
    assert!(table.starts_with(&format!("{} bytes):", size_of::<FrameHeader>())));
    let rows: Vec<(usize, &str)> = table
        .lines()
        .filter_map(|line| {
            let mut cells = line.split('|').skip(1).map(str::trim);
            Some((cells.next()?.parse().ok()?, cells.next()?))
        })
        .collect();
    let expected = [
        (offset_of!(FrameHeader, session), "`session`"),
        (offset_of!(FrameHeader, counter), "`counter`"),
        (
            offset_of!(FrameHeader, label),
            "`view`, `in_view`, `exposure`, `pattern`",
        ),
        (
            offset_of!(FrameHeader, width_px),
            "`width_px`, `height_px`, `stride_px`",
        ),
        (offset_of!(FrameHeader, measured), "`measured`"),
        (
            offset_of!(FrameHeader, exposure_start_us),
            "`exposure_start_us`, `exposure_end_us`",
        ),
        (
            offset_of!(FrameHeader, exposure_end_monotonic_ns),
            "`exposure_end_monotonic_ns`",
        ),
        (
            offset_of!(FrameHeader, published_monotonic_ns),
            "`published_monotonic_ns`",
        ),
        (offset_of!(FrameHeader, checksum), "`checksum`"),
    ];
    assert_eq!(rows, expected);
}

#[test]
fn sizes_and_tolerances_are_those_of_the_code() {
    let page = page();
    for words in [
        format!("`flankscope/Arm/1` ({} bytes)", size_of::<Arm>()),
        format!("`flankscope/Ready/1` ({} bytes)", size_of::<Ready>()),
        format!("within {EXPOSURE_TOLERANCE_US} µs of the commanded one"),
    ] {
        assert!(page.contains(&words), "{words}");
    }
}
