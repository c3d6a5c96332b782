//! Set-up of the displacement fields: regions, training vertices, charts, mirrors, factorised systems.

use std::sync::Arc;

use moldline_geometry::Body;
use moldline_mesh::{Plane, SurfaceMesh, Topology};
use moldline_rbf::Factors;
use moldline_spline::Vector3;

use super::{
    Anchor, Field, Fields, Mirror, RegionField,
    training::{Region, TrainingVertex},
};
use crate::{
    Monitor, Options, Propagation, SetupError, Stage,
    chain::seams::SeamSolver,
    chart::Chart,
    ownership::{Freedom, Ownership},
};

/// What the fields of a set-up are built from.
pub(crate) struct FieldBuilder<'a> {
    pub options: &'a Options,
    pub mesh: &'a SurfaceMesh,
    pub topology: &'a Topology,
    pub ownership: &'a Ownership,
    pub seams: &'a SeamSolver,
    pub reference: &'a [Body],
    pub positions: &'a [Vector3],
    pub mirror: Option<&'a [u32]>,
    pub half: Option<(&'a Plane, f64)>,
    pub names: &'a [String],
    /// Factors known already, in the order of the fields.
    pub found: &'a [Factors],
}

impl FieldBuilder<'_> {
    /// Chooses the training vertices and factorises, region by region.
    pub fn build(&self, monitor: &dyn Monitor<Stage>) -> Result<Fields, SetupError> {
        let regions: Vec<Option<u32>> = match self.options.propagation {
            Propagation::Absolute => vec![None],
            Propagation::Departure | Propagation::Surface => {
                (0u32..).zip(self.names).map(|(c, _)| Some(c)).collect()
            }
        };
        let seam_vertices: Vec<u32> = self.seams.vertices.iter().map(|s| s.vertex).collect();
        let fixed = |v: &u32| self.ownership.of(*v).iter().any(|a| a.freedom == Freedom::Fixed);
        let held: Vec<u32> = self.ownership.vertices().filter(fixed).collect();
        let mut fields = Vec::new();
        for (done, &component) in regions.iter().enumerate() {
            if monitor.cancelled() {
                return Err(SetupError::Cancelled);
            }
            let contains = |v: u32| component.is_none_or(|c| self.ownership.on(v, c).is_some());
            let members = self.ownership.vertices().filter(|&v| contains(v));
            let share = members.clone().count() as f64 / self.positions.len() as f64;
            let region = Region {
                topology: self.topology,
                vertices: &self.mesh.vertices,
                contains: &contains,
                mirror: self.mirror,
                seam_vertices: &seam_vertices,
                held: &held,
                blend_radius: self.blend_radius(component),
                monitor,
            };
            let count = (share * self.options.training_vertices as f64).ceil() as usize;
            let training = match component {
                None => region.absolute_set(count),
                Some(_) => region.departure_set(count),
            };
            if monitor.cancelled() {
                return Err(SetupError::Cancelled);
            }
            if training.is_empty() {
                continue;
            }
            let chart = component
                .filter(|_| self.options.propagation == Propagation::Surface)
                .and_then(|c| self.chart(c))
                .map(Arc::new);
            let mirror = self.mirror_of(component, chart.as_deref());
            let kernel = self.options.kernel();
            let regularisation = self.options.regularisation;
            let found = self.found.get(fields.len());
            let anchor = |t: &TrainingVertex| {
                let own = self.ownership.first(t.vertex);
                let start = self.positions[t.vertex as usize];
                Anchor { component: own.component as usize, location: own.location, start }
            };
            let anchors = component.is_none().then(|| training.iter().map(anchor).collect());
            let field = Field::new(training, self.positions, kernel, regularisation, mirror, found).map_err(
                |reason| SetupError::Factorisation {
                    field: component.map_or("the whole mesh".into(), |c| self.names[c as usize].clone()),
                    reason,
                },
            )?;
            let moved =
                members.filter(|&v| matches!(self.ownership.of(v), [only] if only.freedom != Freedom::Fixed));
            let vertices: Vec<u32> = moved.collect();
            let points = vertices.iter().map(|&v| self.positions[v as usize]).collect();
            fields.push(RegionField { component, chart, field, vertices, points, anchors });
            monitor.progress(Stage::Factorisation, (done + 1) as f64 / regions.len() as f64);
        }
        monitor.progress(Stage::Factorisation, 1.0);
        Ok(Fields::new(fields, self.positions.len(), seam_vertices.len()))
    }

    /// Surface coordinates over at least the patches that carry seams.
    fn chart(&self, component: u32) -> Option<Chart> {
        let body = &self.reference[component as usize];
        let mut required = vec![false; body.component().patches().len()];
        for own in self.seams.vertices.iter().filter_map(|s| self.ownership.on(s.vertex, component)) {
            required[own.location.patch as usize] = true;
        }
        Chart::new(body, &required)
    }

    /// The mirror of a half model, for regions that reach its plane.
    fn mirror_of(&self, component: Option<u32>, chart: Option<&Chart>) -> Option<Mirror<'_>> {
        let (plane, tolerance) = self.half?;
        let on = |v: u32| component.is_none_or(|c| self.ownership.on(v, c).is_some());
        let in_plane = |v: u32| plane.signed_distance(&self.mesh.vertices[v as usize]).abs() <= tolerance;
        if !self.ownership.vertices().any(|v| on(v) && in_plane(v)) {
            return None;
        }
        let signs = match (chart, component) {
            (Some(chart), Some(c)) => {
                let seam = self.seams.vertices.iter().find_map(|s| self.ownership.on(s.vertex, c));
                let location = seam.map(|a| a.location)?;
                chart.mirror_signs(&self.reference[c as usize], &location, plane)?.to_vec()
            }
            _ => vec![1.0, -1.0, 1.0],
        };
        Some(Mirror { plane, tolerance, signs })
    }

    fn blend_radius(&self, component: Option<u32>) -> f64 {
        let of_name = component.and_then(|c| {
            let name = &self.names[c as usize];
            self.options.blend_radius_of.iter().find(|(n, _)| n == name)
        });
        of_name.map_or(self.options.blend_radius, |(_, radius)| *radius)
    }
}
