//! Poses known in advance: a table with a line for each tooth.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use flankscope_foundation::rigid::{Camera, Rigid, Tool};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use super::{PoseError, Wanted};
use flankscope_metrology::kinematics::Moves;
use flankscope_metrology::view::StatedPose;

/// Largest deviation of a quaternion's length from 1, as printing with few digits causes it.
const UNIT: f64 = 1e-3;
/// First line of `poses.csv`: camera in the tool frame, mm, a unit quaternion, standard uncertainties.
const COLUMNS: &str = "tooth,x_mm,y_mm,z_mm,qw,qx,qy,qz,u_mm,u_mrad";

/// `poses.csv`: a pose for each tooth.
#[derive(Clone, Debug)]
pub struct PoseTable {
    path: PathBuf,
    poses: BTreeMap<u32, StatedPose>,
}

impl PoseTable {
    /// Reads a table.
    ///
    /// # Errors
    /// The table cannot be read, or a line is not a pose: file, line and what is wrong.
    pub fn load(path: &Path) -> Result<Self, PoseError> {
        let bad = |why: String| PoseError::Table {
            path: path.to_owned(),
            why,
        };
        let text = flankscope_foundation::textfile::read(path).map_err(|e| bad(e.to_string()))?;
        let mut lines = (1..).zip(text.lines().map(str::trim));
        let mut next = || lines.find(|(_, line)| !line.is_empty() && !line.starts_with('#'));
        if next().is_none_or(|(_, line)| line.replace(' ', "") != COLUMNS) {
            return Err(bad(format!("the first line must be {COLUMNS}")));
        }
        let mut poses = BTreeMap::new();
        while let Some((number, line)) = next() {
            let (tooth, pose) = row(line).map_err(|why| bad(format!("line {number}: {why}")))?;
            if poses.insert(tooth, pose).is_some() {
                return Err(bad(format!(
                    "line {number}: tooth {tooth} has two poses; one is enough"
                )));
            }
        }
        Ok(Self {
            path: path.to_owned(),
            poses,
        })
    }

    /// Whether a check of this many views can use the table. It cannot say when an arm has moved from one view to the next, and
    /// teeth look alike.
    ///
    /// # Errors
    /// [`PoseError::NobodyMoves`].
    pub fn fits(&self, moves: Moves, views: usize) -> Result<(), PoseError> {
        if moves == Moves::Outside && views > 1 {
            let path = self.path.clone();
            return Err(PoseError::NobodyMoves { path, views });
        }
        Ok(())
    }

    /// The pose of a view.
    ///
    /// # Errors
    /// There is no pose, or none that can be used.
    pub fn reach(&self, wanted: &Wanted) -> Result<StatedPose, PoseError> {
        let stated = self.poses.get(&wanted.tooth);
        let stated = stated.cloned().ok_or_else(|| PoseError::NotListed {
            path: self.path.clone(),
            tooth: wanted.tooth,
        })?;
        wanted.checked(stated)
    }
}

/// A line of `poses.csv`.
fn row(line: &str) -> Result<(u32, StatedPose), String> {
    let mut fields = line.split(',').map(str::trim);
    let tooth = fields.next().unwrap_or_default();
    let tooth = tooth
        .parse()
        .map_err(|_| format!("{tooth:?} is no tooth"))?;
    let numbers = fields.map(|field| match field.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(format!("{field:?} is no finite number")),
    });
    let numbers: Vec<f64> = numbers.collect::<Result<_, _>>()?;
    let &[x_mm, y_mm, z_mm, qw, qx, qy, qz, u_mm, u_mrad] = &numbers[..] else {
        return Err(format!("{} columns; right is {COLUMNS}", numbers.len() + 1));
    };
    let turn = Quaternion::new(qw, qx, qy, qz);
    let length = turn.norm();
    if (length - 1.0).abs() > UNIT {
        return Err(format!("its quaternion has length {length}; right is 1"));
    }
    let place = Translation3::new(x_mm, y_mm, z_mm);
    let pose = Isometry3::from_parts(place, UnitQuaternion::new_normalize(turn));
    let pose: Rigid<Tool, Camera> = Rigid::from_isometry(pose);
    let stated = StatedPose {
        tool_from_camera: pose.to_rows(),
        u_mm,
        u_mrad,
    };
    Ok((tooth, stated))
}

#[cfg(test)]
mod tests {
    use super::super::wanted;
    use super::*;

    #[test]
    fn a_table_has_a_pose_for_each_tooth_or_says_what_is_wrong() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("poses.csv");
        let load = |rows: &str| {
            let header = "tooth,x_mm,y_mm,z_mm,qw,qx,qy,qz,u_mm,u_mrad\n";
            std::fs::write(&path, format!("{header}{rows}")).unwrap();
            PoseTable::load(&path)
        };
        let table = load("# by the arm\n12, 0.1, 0, 0, 1, 0, 0, 0, 0.02, 0.1\n").unwrap();
        let stated = table.reach(&wanted(1)).unwrap();
        assert_eq!(stated.tool_from_camera[0][3], 0.1);
        let other = Wanted {
            tooth: 13,
            ..wanted(2)
        };
        let none = table.reach(&other).unwrap_err().to_string();
        assert!(
            none.ends_with("poses.csv has no pose of tooth 13"),
            "{none}"
        );
        for (rows, words) in [
            ("12,nan,0,0,1,0,0,0,0.02,0.1\n", "no finite number"),
            ("12,0,0,0,1,1,0,0,0.02,0.1\n", "has length 1.41"),
            ("12,0,0,0,0,0,0,0,0.02,0.1\n", "has length 0"),
            ("12,0,0,0,1,0,0,0,0.02\n", "line 2"),
            (
                "12,0,0,0,1,0,0,0,0.02,0.1\n12,0,0,0,1,0,0,0,0.02,0.1\n",
                "two poses",
            ),
        ] {
            let error = load(rows).unwrap_err().to_string();
            assert!(
                error.contains("poses.csv") && error.contains(words),
                "{error}"
            );
        }
    }
}
