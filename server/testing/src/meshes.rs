//! Generated surface meshes.

use moldline_mesh::{Cell, Group, SurfaceMesh};

/// The unit sphere as a cube whose faces have `n` by `n` cells, equal in angle.
pub fn sphere(n: usize) -> SurfaceMesh {
    let mut builder = Builder::default();
    let angle = |i: usize| (std::f64::consts::FRAC_PI_4 * (2.0 * i as f64 / n as f64 - 1.0)).tan();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            for i in 0..n {
                for j in 0..n {
                    let corner = |i: usize, j: usize| {
                        let mut p = [0.0; 3];
                        p[axis] = side;
                        p[(axis + 1) % 3] = angle(i);
                        p[(axis + 2) % 3] = angle(j);
                        let r = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
                        p.map(|x| x / r)
                    };
                    let mut cell = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
                    if side < 0.0 {
                        cell.reverse();
                    }
                    builder.cell(&cell);
                }
            }
        }
    }
    builder.finish()
}

/// A wing with NACA 0012 sections of sharp trailing edge and flat tips: `around` cells around, `span` along the span.
pub struct Wing {
    /// Cells around a section.
    pub around: usize,
    /// Cells along the span.
    pub span: usize,
    /// Half the span, m.
    pub half_span: f64,
    /// Chord at a spanwise fraction in -1..1, m.
    pub chord: fn(f64) -> f64,
    /// x of the leading edge there, m.
    pub leading_edge: fn(f64) -> f64,
    /// Thickness over chord.
    pub thickness: f64,
    /// Whether to keep only y >= 0.
    pub half: bool,
}

impl Wing {
    /// Chord 1 m, half span 4 m, thickness 12 %.
    pub fn rectangular(around: usize, span: usize) -> Self {
        Self {
            around,
            span,
            half_span: 4.0,
            chord: |_| 1.0,
            leading_edge: |_| 0.0,
            thickness: 0.12,
            half: false,
        }
    }

    /// The mesh, with a vertex group `trailing_edge`.
    pub fn mesh(&self) -> SurfaceMesh {
        let (n, m) = (self.around, self.span);
        let mut vertices = Vec::new();
        let first = if self.half { m / 2 } else { 0 };
        for j in first..=m {
            let eta = -(std::f64::consts::PI * j as f64 / m as f64).cos();
            let eta = if 2 * j == m { 0.0 } else { eta };
            for i in 0..n {
                let theta = std::f64::consts::TAU * i as f64 / n as f64;
                let x = 0.5 * (1.0 + theta.cos());
                let t = self.thickness / 0.2
                    * (0.2969 * x.sqrt() - 0.126 * x - 0.3516 * x * x + 0.2843 * x.powi(3)
                        - 0.1036 * x.powi(4));
                let t = if i == 0 || 2 * i == n { 0.0 } else { t };
                let z = if 2 * i < n { -t } else { t };
                let c = (self.chord)(eta);
                vertices.push([(self.leading_edge)(eta) + c * x, self.half_span * eta, c * z]);
            }
        }
        let at = |i: usize, j: usize| ((j - first) * n + i % n) as u32;
        let mut cells = Vec::new();
        for j in first..m {
            for i in 0..n {
                cells.push(Cell::quad(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)));
            }
        }
        let tips: &[usize] = if self.half { &[m] } else { &[0, m] };
        for &j in tips {
            for i in 0..n / 2 {
                let ring = [at(i, j), at(i + 1, j), at(n - i - 1, j), at(n - i, j)];
                let mut ring: Vec<u32> = ring.to_vec();
                ring.dedup();
                if ring.first() == ring.last() {
                    ring.pop();
                }
                if j == 0 {
                    ring.reverse();
                }
                cells.push(match *ring {
                    [a, b, c] => Cell::triangle(a, b, c),
                    [a, b, c, d] => Cell::quad(a, b, c, d),
                    _ => unreachable!(),
                });
            }
        }
        let trailing = (first..=m).map(|j| at(0, j)).collect();
        let groups = vec![Group { name: "trailing_edge".to_owned(), indices: trailing }];
        SurfaceMesh::new(vertices, cells, Vec::new(), groups).unwrap()
    }
}

/// Cells by the positions of their corners.
#[derive(Default)]
pub struct Builder {
    vertices: Vec<[f64; 3]>,
    known: std::collections::HashMap<[i64; 3], u32>,
    cells: Vec<Cell>,
}

impl Builder {
    /// Adds a triangle or quadrilateral; corners within a nanometre are the same vertex.
    pub fn cell(&mut self, corners: &[[f64; 3]]) {
        let indices: Vec<u32> = corners
            .iter()
            .map(|p| {
                let key = p.map(|x| (x * 1e9).round() as i64);
                *self.known.entry(key).or_insert_with(|| {
                    self.vertices.push(*p);
                    self.vertices.len() as u32 - 1
                })
            })
            .collect();
        self.cells.push(match *indices {
            [a, b, c] => Cell::triangle(a, b, c),
            [a, b, c, d] => Cell::quad(a, b, c, d),
            _ => unreachable!(),
        });
    }

    /// The mesh.
    pub fn finish(self) -> SurfaceMesh {
        SurfaceMesh::new(self.vertices, self.cells, Vec::new(), Vec::new()).unwrap()
    }
}

/// Every second cell cut into triangles.
pub fn partly_triangles(mesh: &SurfaceMesh) -> SurfaceMesh {
    let mut cells = Vec::new();
    for (i, cell) in mesh.cells.iter().enumerate() {
        match *cell.vertices() {
            [a, b, c, d] if i % 2 == 0 => {
                cells.extend([Cell::triangle(a, b, c), Cell::triangle(a, c, d)]);
            }
            _ => cells.push(*cell),
        }
    }
    SurfaceMesh::new(mesh.vertices.clone(), cells, Vec::new(), mesh.vertex_groups.clone()).unwrap()
}
