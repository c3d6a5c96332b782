//! A component in one state of its control points, and its evaluation (eq. 1).

use crate::bounds::Aabb;
use crate::component::Component;
use crate::hierarchy::Hierarchy;
use crate::location::Location;
use moldline_foundation::Vector3;
use moldline_spline::{SurfaceJet, SurfacePoint};
use std::sync::{Arc, OnceLock};

/// A component in one state, reference or deformed. Closest-point queries build a bounding hierarchy on first use.
#[derive(Debug, Clone)]
pub struct Body {
    component: Arc<Component>,
    control_points: Vec<[f64; 4]>,
    bounds: Aabb,
    hierarchy: OnceLock<Hierarchy>,
}

impl Body {
    /// The component with the given internal control points.
    ///
    /// # Panics
    /// If their number is not the component's.
    pub fn new(component: Arc<Component>, control_points: Vec<[f64; 4]>) -> Self {
        assert_eq!(
            control_points.len(),
            component.control_point_count(),
            "a body has as many control points as its component"
        );
        let bounds = Aabb::around(control_points.iter().map(|c| Vector3::new(c[0], c[1], c[2]) / c[3]));
        Self { component, control_points, bounds, hierarchy: OnceLock::new() }
    }

    /// The component.
    pub fn component(&self) -> &Arc<Component> {
        &self.component
    }

    /// The internal control points of this state.
    pub fn control_points(&self) -> &[[f64; 4]] {
        &self.control_points
    }

    /// The box around the control points, which contains the body.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// The length all tolerances are relative to: the diagonal of the bounds.
    pub fn size(&self) -> f64 {
        self.bounds.diagonal()
    }

    pub(crate) fn patch_points(&self, patch: u32) -> &[[f64; 4]] {
        &self.control_points[self.component.patches()[patch as usize].range.clone()]
    }

    /// The position of a location, metres.
    #[inline]
    pub fn position(&self, l: &Location) -> Vector3 {
        let patch = &self.component.patches()[l.patch as usize];
        patch.surface.position(self.patch_points(l.patch), l.u, l.v)
    }

    /// Position and first derivatives.
    #[inline]
    pub fn point(&self, l: &Location) -> SurfacePoint {
        let patch = &self.component.patches()[l.patch as usize];
        patch.surface.point(self.patch_points(l.patch), l.u, l.v)
    }

    /// Position, first and second derivatives.
    #[inline]
    pub fn jet(&self, l: &Location) -> SurfaceJet {
        let patch = &self.component.patches()[l.patch as usize];
        patch.surface.jet(self.patch_points(l.patch), l.u, l.v)
    }

    /// The outward unit normal; at poles and collapsed sides its limit from inside the patch. Zero where there is no
    /// limit (patches without area).
    pub fn normal(&self, l: &Location) -> Vector3 {
        self.normal_at(l, &self.point(l))
    }

    #[inline]
    pub(crate) fn normal_at(&self, l: &Location, point: &SurfacePoint) -> Vector3 {
        let patch = &self.component.patches()[l.patch as usize];
        let n = patch.normal_at(&self.control_points, l.u, l.v, point);
        if patch.flipped { -n } else { n }
    }

    pub(crate) fn hierarchy(&self) -> &Hierarchy {
        self.hierarchy.get_or_init(|| Hierarchy::new(self.component.patches(), &self.control_points))
    }
}
