//! Faces as a file lists them.

/// Triangles, and further polygons with their place among them.
#[derive(Debug, Default, Clone, PartialEq)]
pub(crate) struct Faces {
    pub triangles: Vec<[u32; 3]>,
    pub polygons: Vec<Polygon>,
}

/// A face of more than three corners.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Polygon {
    /// Number of triangles that come before it.
    pub after: usize,
    /// Number of the face, from 0.
    pub face: usize,
    pub corners: Vec<u32>,
}

impl Faces {
    /// Takes a face of at least three corners.
    pub fn push(&mut self, corners: &[u32]) {
        match *corners {
            [a, b, c] => self.triangles.push([a, b, c]),
            _ => self.polygons.push(Polygon {
                after: self.triangles.len(),
                face: self.len(),
                corners: corners.to_vec(),
            }),
        }
    }

    /// Number of faces so far.
    pub fn len(&self) -> usize {
        self.triangles.len() + self.polygons.len()
    }
}
