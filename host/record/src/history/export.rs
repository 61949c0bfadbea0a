//! Writes all values of a history as a table for other programs.

use std::io::{self, Write};

use flankscope_foundation::display::cell;
use flankscope_metrology::verdict::Code;

use super::rows::Check;

/// Writes a line per check and flank, as comma-separated values (RFC 4180) below a header line.
///
/// # Errors
/// Errors of the writer.
pub fn csv(checks: &[Check], out: &mut dyn Write) -> io::Result<()> {
    writeln!(
        out,
        "check,at,tool,tool_cycles,press_cycles,baseline,check_verdict,tooth,flank,wear_um,u95_um,warn_um,limit_um,verdict,code,\
         link,simulated,head,head_blake3,station,operator,patch"
    )?;
    let number = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
    for check in checks {
        let origin = &check.origin;
        let text = |text: Option<&str>| text.map_or_else(String::new, cell);
        for flank in &check.flanks {
            writeln!(
                out,
                "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}",
                check.id,
                check.at,
                cell(&check.tool),
                check.tool_cycles,
                check.press_cycles,
                check.baseline.as_deref().unwrap_or_default(),
                check.verdict,
                flank.id.tooth,
                flank.id.flank,
                number(flank.wear_um),
                number(flank.u95_um),
                flank.warn_um,
                flank.limit_um,
                flank.verdict,
                flank.code.map_or("", Code::word),
                cell(&origin.link),
                origin.simulated,
                cell(&origin.head.name),
                origin.head.blake3,
                cell(&origin.station),
                text(origin.operator.as_deref()),
                text(flank.id.patch.as_deref()),
            )?;
        }
    }
    Ok(())
}
