//! Velocities of panels from the gradients of the potential, which are constant on every element.
//!
//! A gradient is of first order on triangles, and on a bent surface too large, because chords are shorter than arcs. So velocities are means
//! over neighbours: with G, which averages panels over the vertices by area and vertices over the panel,
//! `v = G ((1 + a) w - a G w)` for the gradients w. The second application takes back what the first one loses where the velocity bends, but for a
//! sixth (a = 5/6): on a circle of equal chords that turn by t, w is too large by t^2 / 24 and G w too small by a quarter of t^2, so that v is right to
//! the fourth order; on a line of equal cells v is the mean over the cell. No average reaches over cuts and creases.

use moldline_mesh::Vector3;

use crate::{nodes::Smooth, panels::Panels};

/// How much of what averaging loses is taken back.
const BACK: f64 = 5.0 / 6.0;

/// The averaging over areas of panels.
pub(crate) struct Recovery<'a> {
    pub panels: &'a Panels,
    pub smooth: &'a Smooth,
    /// Areas of the panels.
    pub sizes: &'a [f64],
    /// Areas around the vertices.
    sums: Vec<f64>,
}

impl<'a> Recovery<'a> {
    pub fn new(panels: &'a Panels, smooth: &'a Smooth, sizes: &'a [f64]) -> Self {
        let mut sums = vec![0.0; smooth.count];
        for (panel, size) in sizes.iter().enumerate() {
            smooth.corners(panels, panel).iter().for_each(|v| sums[*v as usize] += size);
        }
        Self { panels, smooth, sizes, sums }
    }

    /// Means of panels at vertices.
    fn at_vertices(&self, sizes: &[f64], values: &[Vector3]) -> Vec<Vector3> {
        let mut out = vec![Vector3::zeros(); self.sums.len()];
        for (panel, value) in values.iter().enumerate() {
            for v in self.smooth.corners(self.panels, panel) {
                out[*v as usize] += sizes[panel] * value;
            }
        }
        out.iter_mut().zip(&self.sums).for_each(|(x, sum)| *x /= *sum);
        out
    }

    /// Means of vertices on panels.
    fn on_panels(&self, vertices: &[Vector3]) -> Vec<Vector3> {
        let mean = |panel: usize| {
            let corners = self.smooth.corners(self.panels, panel);
            corners.iter().map(|v| vertices[*v as usize]).sum::<Vector3>() / corners.len() as f64
        };
        (0..self.panels.len()).map(mean).collect()
    }

    /// G.
    fn averaged(&self, values: &[Vector3]) -> Vec<Vector3> {
        self.on_panels(&self.at_vertices(self.sizes, values))
    }

    /// The change of G x with the areas.
    fn averaged_by_sizes(&self, values: &[Vector3], d_sizes: &[f64]) -> Vec<Vector3> {
        let means = self.at_vertices(self.sizes, values);
        let mut change = self.at_vertices(d_sizes, values);
        let mut d_sums = vec![0.0; self.sums.len()];
        for (panel, d) in d_sizes.iter().enumerate() {
            self.smooth.corners(self.panels, panel).iter().for_each(|v| d_sums[*v as usize] += d);
        }
        for (v, out) in change.iter_mut().enumerate() {
            *out -= d_sums[v] / self.sums[v] * means[v];
        }
        self.on_panels(&change)
    }

    /// The transpose of G, and of its change with the areas at `values`: seeds of the values, and those of the areas added.
    fn averaged_vjp(&self, values: &[Vector3], seeds: &[Vector3], of_sizes: &mut [f64]) -> Vec<Vector3> {
        let means = self.at_vertices(self.sizes, values);
        let mut of_vertices = vec![Vector3::zeros(); self.sums.len()];
        for (panel, seed) in seeds.iter().enumerate() {
            let corners = self.smooth.corners(self.panels, panel);
            corners.iter().for_each(|v| of_vertices[*v as usize] += seed / corners.len() as f64);
        }
        let mut out = vec![Vector3::zeros(); seeds.len()];
        for (panel, out) in out.iter_mut().enumerate() {
            for v in self.smooth.corners(self.panels, panel) {
                let seed = of_vertices[*v as usize] / self.sums[*v as usize];
                *out += self.sizes[panel] * seed;
                of_sizes[panel] += seed.dot(&(values[panel] - means[*v as usize]));
            }
        }
        out
    }

    /// The velocities for gradients of all panels.
    pub fn eval(&self, gradients: &[Vector3]) -> Vec<Vector3> {
        let once = self.averaged(gradients);
        let twice: Vec<Vector3> =
            gradients.iter().zip(&once).map(|(w, g)| (1.0 + BACK) * w - BACK * g).collect();
        self.averaged(&twice)
    }

    /// The changes of the velocities.
    pub fn jvp(&self, gradients: &[Vector3], d_gradients: &[Vector3], d_sizes: &[f64]) -> Vec<Vector3> {
        let once = self.averaged(gradients);
        let twice: Vec<Vector3> =
            gradients.iter().zip(&once).map(|(w, g)| (1.0 + BACK) * w - BACK * g).collect();
        let by_sizes = self.averaged_by_sizes(gradients, d_sizes);
        let d_once = self.averaged(d_gradients);
        let d_twice: Vec<Vector3> = (0..gradients.len())
            .map(|p| (1.0 + BACK) * d_gradients[p] - BACK * (d_once[p] + by_sizes[p]))
            .collect();
        let mut out = self.averaged(&d_twice);
        out.iter_mut().zip(self.averaged_by_sizes(&twice, d_sizes)).for_each(|(x, y)| *x += y);
        out
    }

    /// The transpose of [`jvp`](Self::jvp): seeds of the gradients; adds to those of the areas.
    pub fn vjp(&self, gradients: &[Vector3], seeds: &[Vector3], of_sizes: &mut [f64]) -> Vec<Vector3> {
        let once = self.averaged(gradients);
        let twice: Vec<Vector3> =
            gradients.iter().zip(&once).map(|(w, g)| (1.0 + BACK) * w - BACK * g).collect();
        let of_twice = self.averaged_vjp(&twice, seeds, of_sizes);
        let minus: Vec<Vector3> = of_twice.iter().map(|s| -BACK * s).collect();
        let of_once = self.averaged_vjp(gradients, &minus, of_sizes);
        of_twice.iter().zip(of_once).map(|(twice, once)| (1.0 + BACK) * twice + once).collect()
    }
}
