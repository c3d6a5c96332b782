//! placeholder
use crate::{Body, Location, Vector3};
#[derive(Debug, Clone)]
pub(crate) struct Hierarchy {
    seeds: Vec<(Vector3, Location)>,
}
impl Hierarchy {
    pub fn new(body: &Body) -> Self {
        let mut seeds = Vec::new();
        for (i, p) in body.component().patches().iter().enumerate() {
            for u in crate::component::samples(p.surface.knots_u(), 6) {
                for v in crate::component::samples(p.surface.knots_v(), 6) {
                    let l = Location { patch: i as u32, u, v };
                    seeds.push((body.position(&l), l));
                }
            }
        }
        Self { seeds }
    }
    pub fn closest(&self, body: &Body, x: &Vector3, _bound: f64) -> Option<Location> {
        let mut order: Vec<(f64, usize)> =
            self.seeds.iter().enumerate().map(|(i, s)| ((s.0 - x).norm_squared(), i)).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut best = (f64::INFINITY, None);
        for &(_, i) in order.iter().take(12) {
            let l = self.seeds[i].1;
            let p = &body.component().patches()[l.patch as usize];
            let m = crate::newton::in_rectangle(
                &p.surface,
                body.patch_points(l.patch),
                x,
                p.surface.domain(),
                (l.u, l.v),
                body.size(),
                None,
            );
            if let Some(m) = m.filter(|m| m.squared < best.0) {
                best = (m.squared, Some(Location { patch: l.patch, u: m.u, v: m.v }));
            }
        }
        best.1
    }
}
