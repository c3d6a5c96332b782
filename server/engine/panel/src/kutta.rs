//! The Kutta condition: circulation of each strip = upper minus lower potential at the trailing edge (Morino and Kuo, AIAA J. 12,
//! 1974), each extrapolated from the panel's centre c to the middle m of the edge: `mu + gradient . (m - c)`.

use moldline_mesh::Vector3;

use crate::{
    gradient::{Gradients, Slope},
    surface::{Surface, SurfaceChange},
    wake::Wakes,
};

/// The Kutta condition on a surface.
pub(crate) struct Kutta<'a> {
    pub surface: &'a Surface,
    pub wakes: &'a Wakes,
    pub gradients: &'a Gradients<'a>,
}

impl Kutta<'_> {
    /// Both panels of a strip with their signs, and the way from their centres to the edge.
    fn sides(&self, strip: usize) -> [(usize, f64, Vector3); 2] {
        let strip = &self.wakes.strips[strip];
        let middle = 0.5 * (self.surface.points[strip.a as usize] + self.surface.points[strip.b as usize]);
        [(strip.upper, 1.0), (strip.lower, -1.0)]
            .map(|(panel, sign)| (panel as usize, sign, middle - self.surface.centres[panel as usize]))
    }

    /// The circulation of every strip as a sum over panels.
    pub fn rows(&self) -> Vec<Vec<(u32, f64)>> {
        let row = |strip: usize| {
            let mut row = Vec::with_capacity(10);
            for (panel, sign, way) in self.sides(strip) {
                row.push((panel as u32, sign));
                row.extend(self.gradients.weights(panel).iter().map(|(p, g)| (*p, sign * g.dot(&way))));
            }
            row
        };
        (0..self.wakes.strips.len()).map(row).collect()
    }

    /// The changes of all circulations. Beside trailing edges no gradient reaches over the border of a wake, so no circulation depends on
    /// another.
    pub fn jvp(&self, mu: &[f64], surface: &SurfaceChange, d_mu: &[f64]) -> Vec<f64> {
        let of_strip = |strip: usize| {
            let edge = &self.wakes.strips[strip];
            let middle = 0.5 * (surface.points[edge.a as usize] + surface.points[edge.b as usize]);
            let change = |(panel, sign, way): (usize, f64, Vector3)| {
                let g = self.gradients.eval(panel, [mu, &[]]).gradient;
                let dg = self.gradients.jvp(panel, [mu, &[]], surface, [d_mu, &[]]).gradient;
                sign * (d_mu[panel] + dg.dot(&way) + g.dot(&(middle - surface.centres[panel])))
            };
            self.sides(strip).into_iter().map(change).sum()
        };
        (0..self.wakes.strips.len()).map(of_strip).collect()
    }

    /// The transpose of [`jvp`](Self::jvp): adds to the seeds of surface and doublets.
    pub fn vjp(&self, mu: &[f64], seeds: &[f64], surface: &mut SurfaceChange, mu_seeds: &mut [f64]) {
        for (strip, seed) in seeds.iter().enumerate() {
            let edge = &self.wakes.strips[strip];
            for (panel, sign, way) in self.sides(strip) {
                let seed = sign * seed;
                mu_seeds[panel] += seed;
                let g = self.gradients.eval(panel, [mu, &[]]).gradient;
                let of_slope = Slope { gradient: seed * way, ..Slope::default() };
                self.gradients.vjp(panel, [mu, &[]], &of_slope, surface, [mu_seeds, &mut []]);
                surface.points[edge.a as usize] += 0.5 * seed * g;
                surface.points[edge.b as usize] += 0.5 * seed * g;
                surface.centres[panel] -= seed * g;
            }
        }
    }
}
