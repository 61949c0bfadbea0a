//! The rim of an open mesh, and where it is a hole and not a crack.
//!
//! Many CAD programs tessellate two faces with different corners along the edge that they share. The file then has edges of one
//! triangle only, yet no light would pass. At a hole an open edge has no other open edge along it.

use nalgebra::Vector3;

/// Two open edges that lie this close together bound a crack, mm: far below what any figure states.
const CRACK_MM: f64 = 0.001;
/// Comparisons of two edges until a rim is no longer searched: about a second.
const MOST_PAIRS: usize = 200_000_000;

/// The edges of one triangle only.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rim {
    /// Ends of every edge, mm.
    pub edges_mm: Vec<[[f64; 3]; 2]>,
}

impl Rim {
    /// The middle of an open edge beside which no other one lies, among those with their middle where `is_asked` says.
    ///
    /// Where too many edges would have to be compared, the first of them counts as a hole.
    pub fn hole(&self, is_asked: impl Fn([f64; 3]) -> bool) -> Option<[f64; 3]> {
        let edges: Vec<[Vector3<f64>; 2]> = self
            .edges_mm
            .iter()
            .map(|ends| ends.map(Vector3::from))
            .collect();
        let middle = |[from, to]: &[Vector3<f64>; 2]| (from + to) / 2.0;
        let asked: Vec<usize> = (0..edges.len())
            .filter(|&index| is_asked(middle(&edges[index]).into()))
            .collect();
        let is_searched = asked.len().saturating_mul(edges.len()) <= MOST_PAIRS;
        let is_hole = |index: &usize| {
            let middle = middle(&edges[*index]);
            let is_beside =
                |(other, edge)| other != *index && distance_mm(&middle, edge) <= CRACK_MM;
            let is_crack = is_searched && edges.iter().enumerate().any(is_beside);
            (!is_crack).then(|| middle.into())
        };
        asked.iter().find_map(is_hole)
    }
}

/// Distance of a point from a straight edge.
fn distance_mm(point: &Vector3<f64>, [from, to]: &[Vector3<f64>; 2]) -> f64 {
    let along = to - from;
    let share = (point - from).dot(&along) / along.norm_squared();
    (point - from - share.clamp(0.0, 1.0) * along).norm()
}
