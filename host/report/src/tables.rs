//! Values of a page as comma-separated values (RFC 4180), for other programs.

use std::io::{self, Write};

use flankscope_metrology::gear::Flank;
use flankscope_metrology::gear::evaluation::TraceFigures;

use flankscope_record::document::scan::{Scan, ScanGear};
use flankscope_record::document::{Feature, Inspection};

fn number(value: Option<f64>) -> String {
    value
        .filter(|value| value.is_finite())
        .map_or_else(String::new, |value| value.to_string())
}

/// A line per flank.
pub(super) fn flanks(features: &[Feature], out: &mut dyn Write) -> io::Result<()> {
    writeln!(
        out,
        "tooth,flank,wear_um,u95_um,mean_um,coverage_ratio,warn_um,limit_um,verdict,code,at_least_um"
    )?;
    for f in features {
        writeln!(
            out,
            "{},{},{},{},{},{},{},{},{},{},{}",
            f.id.tooth,
            f.id.flank,
            number(f.wear_um),
            number(f.u95_um),
            number(f.mean_um),
            f.coverage_ratio,
            f.warn_um,
            f.limit_um,
            f.verdict,
            f.code.map_or_else(String::new, |code| code.to_string()),
            number(f.at_least_um)
        )?;
    }
    Ok(())
}

/// A line per cell of the deviation maps: position of its centre along the profile and up from the zone's lower end.
pub(super) fn cells(inspection: &Inspection, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "tooth,flank,along_mm,up_mm,deviation_um")?;
    for map in &inspection.pictures.maps {
        let [wide_mm, high_mm] = map.size_mm;
        let along = wide_mm / map.columns as f64;
        let up = high_mm / map.rows as f64;
        for (place, um) in map.deviation_um.iter().enumerate() {
            let (column, row) = (place % map.columns, place / map.columns);
            writeln!(
                out,
                "{},{},{:.3},{:.3},{}",
                map.id.tooth,
                map.id.flank,
                (column as f64 + 0.5) * along,
                high_mm - (row as f64 + 0.5) * up,
                number(um.is_finite().then_some((um * 1e3).round() / 1e3))
            )?;
        }
    }
    Ok(())
}

/// A line per view of a scan.
pub(super) fn views(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    writeln!(
        out,
        "view,rotation_deg,vertical_mm,status,rms_um,rms_about_form_um,residual_um,residual_turn_mdeg"
    )?;
    for r in &scan.registration {
        writeln!(
            out,
            "{},{},{},{},{},{},{},{}",
            r.view,
            r.rotation_deg,
            r.vertical_mm,
            r.status,
            number(r.rms_um),
            number(r.rms_about_form_um),
            number(r.residual_um),
            number(r.residual_turn_mdeg)
        )?;
    }
    Ok(())
}

/// A line per flank of a scan with a gear evaluation.
pub(super) fn gear(of: &ScanGear, out: &mut dyn Write) -> io::Result<()> {
    writeln!(
        out,
        "tooth,flank,F_alpha_um,f_f_alpha_um,f_H_alpha_um,profile_u95_um,F_beta_um,f_f_beta_um,f_H_beta_um,helix_u95_um,position_um,\
         single_pitch_um,position_u95_um"
    )?;
    let evaluation = &of.evaluation;
    for flank in &evaluation.flanks {
        let traces = [&flank.profile, &flank.helix].map(|trace| {
            let read = |of: fn(&TraceFigures) -> f64| number(trace.as_ref().map(of));
            let u95_um = trace.as_ref().map(|trace| of.u95_with_um(trace.noise_um));
            [
                read(|t| t.total_um),
                read(|t| t.form_um),
                read(|t| t.slope_um),
                number(u95_um),
            ]
            .join(",")
        });
        let side = match flank.flank {
            Flank::Right => &evaluation.right,
            Flank::Left | Flank::Face => &evaluation.left,
        };
        let single_um = side.single_um.get(flank.tooth as usize - 1).copied();
        writeln!(
            out,
            "{},{},{},{},{},{},{}",
            flank.tooth,
            flank.flank,
            traces[0],
            traces[1],
            number(flank.position_um),
            number(single_um.flatten()),
            number(
                flank
                    .position_noise_um
                    .map(|noise_um| of.u95_with_um(noise_um))
            )
        )?;
    }
    Ok(())
}
