//! Neighbours in the plane.

/// Points sorted into square buckets.
pub(crate) struct Buckets {
    origin: [f64; 2],
    side: f64,
    columns: usize,
    rows: usize,
    /// First entry of each bucket in `members`, and their number as a last one.
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl Buckets {
    /// Buckets of `side` over finite points.
    pub fn new(points: &[[f64; 2]], side: f64) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in points {
            for axis in 0..2 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
            }
        }
        let count = |axis: usize| (((high[axis] - low[axis]) / side).max(0.0) as usize) + 1;
        let (columns, rows) = (count(0), count(1));
        let mut buckets = Self {
            origin: low,
            side,
            columns,
            rows,
            starts: vec![0; columns * rows + 1],
            members: vec![0; points.len()],
        };
        let home: Vec<usize> = points
            .iter()
            .map(|&point| {
                let [column, row] = buckets.bucket(point);
                row * columns + column
            })
            .collect();
        for &bucket in &home {
            buckets.starts[bucket + 1] += 1;
        }
        for bucket in 0..columns * rows {
            buckets.starts[bucket + 1] += buckets.starts[bucket];
        }
        let mut next = buckets.starts.clone();
        for (index, &bucket) in home.iter().enumerate() {
            buckets.members[next[bucket] as usize] = index as u32;
            next[bucket] += 1;
        }
        buckets
    }

    fn bucket(&self, point: [f64; 2]) -> [usize; 2] {
        let place = |axis: usize, count: usize| {
            (((point[axis] - self.origin[axis]) / self.side).max(0.0) as usize).min(count - 1)
        };
        [place(0, self.columns), place(1, self.rows)]
    }

    /// All points within one bucket's side of `point`, and some farther away.
    pub fn near(&self, point: [f64; 2]) -> impl Iterator<Item = usize> + '_ {
        let [column, row] = self.bucket(point);
        let columns = column.saturating_sub(1)..(column + 2).min(self.columns);
        (row.saturating_sub(1)..(row + 2).min(self.rows)).flat_map(move |row| {
            let first = self.starts[row * self.columns + columns.start] as usize;
            let last = self.starts[row * self.columns + columns.end] as usize;
            self.members[first..last]
                .iter()
                .map(|&index| index as usize)
        })
    }
}
