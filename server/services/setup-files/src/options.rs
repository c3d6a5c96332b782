//! The engine's options as a document: every field is optional.

use moldline_deform::{Kernel, OnEvent, Options, OuterMoldLine, Propagation};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Options of the engine. Absent fields take their defaults.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct OptionsDocument {
    /// The surface on which the deformed mesh ends.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outer_mold_line: Option<OuterMoldLineDocument>,
    /// Fillet length of the smooth outer mold line, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fillet: Option<f64>,
    /// How displacements propagate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub propagation: Option<PropagationDocument>,
    /// Radial function of the displacement fields.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kernel: Option<KernelDocument>,
    /// Regularisation of the displacement fields; 0 interpolates.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub regularisation: Option<f64>,
    /// Largest number of training vertices.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub training_vertices: Option<usize>,
    /// Blending radius, as a fraction of the largest distance from a seam on the same component.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub blend_radius: Option<f64>,
    /// Other blending radii for some components, by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub blend_radius_of: BTreeMap<String, f64>,
    /// A vertex belongs to the components that are nearer than this, relative to the reference length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface_tolerance: Option<f64>,
    /// Whether a mesh with holes is accepted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub open_mesh: Option<bool>,
    /// Whether the configuration is symmetric about y = 0; found from the mesh if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub symmetric: Option<bool>,
    /// Vertex groups of the mesh that follow their component exactly.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub protected_groups: Vec<String>,
    /// Vertex groups of the mesh that stay where they are.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub stationary_groups: Vec<String>,
    /// What is done about components that come to cross where they did not, and surfaces that pass through themselves.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub on_event: Option<OnEventDocument>,
    /// The seam search.
    pub seam: SeamDocument,
    /// Smoothing after the displacement field.
    pub smoothing: SmoothingDocument,
    /// Largest number of projection steps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub projection_steps: Option<usize>,
    /// Largest distance from the outer mold line accepted, relative to the reference length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub projection_tolerance: Option<f64>,
}

/// The surface on which the deformed mesh ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OuterMoldLineDocument {
    /// On the components as they are.
    Sharp,
    /// On the zero set of their smooth union.
    Smooth,
}

/// What is done about an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnEventDocument {
    /// The design is refused (default).
    Refuse,
    /// The answer says so.
    Report,
    /// Nothing looks for it.
    Ignore,
}

/// How displacements propagate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PropagationDocument {
    /// One field of absolute displacements.
    Absolute,
    /// Only the departure of the seams from their components' motion is interpolated.
    Departure,
    /// As `departure`, along the undeformed components' surfaces.
    Surface,
}

/// Radial function.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum KernelDocument {
    /// Multiquadric, -sqrt(r^2 + c^2) with a small c: nearly -r.
    #[serde(rename = "linear")]
    Multiquadric,
    /// r^3.
    Cubic,
}

/// The seam search.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SeamDocument {
    /// Soft bisection steps before the polish.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub soft_steps: Option<usize>,
    /// Whether Newton steps finish the search (default). Without them the seam is where soft bisection leaves it, off the
    /// target by about the reference length over the square root of `eta`: for comparison.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub polish: Option<bool>,
    /// Sharpness of the soft indicator.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub eta: Option<f64>,
    /// Largest residual at a root, relative to the reference length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    /// Fillet length of the union of several targets, relative to the reference length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fillet: Option<f64>,
}

/// Laplacian smoothing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SmoothingDocument {
    /// Rounds of smoothing and projection.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rounds: Option<usize>,
    /// Weight of the neighbours' mean, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relaxation: Option<f64>,
}

impl OptionsDocument {
    /// The engine's options; their ranges are checked there.
    pub(crate) fn to_options(&self) -> Options {
        let mut options = Options::default();
        let o = self;
        set(&mut options.outer_mold_line, o.outer_mold_line.map(Into::into));
        options.fillet = o.fillet.or(options.fillet);
        set(&mut options.propagation, o.propagation.map(Into::into));
        options.kernel = o.kernel.map(Into::into).or(options.kernel);
        set(&mut options.regularisation, o.regularisation);
        set(&mut options.training_vertices, o.training_vertices);
        set(&mut options.blend_radius, o.blend_radius);
        options.blend_radius_of =
            o.blend_radius_of.iter().map(|(name, radius)| (name.clone(), *radius)).collect();
        set(&mut options.surface_tolerance, o.surface_tolerance);
        set(&mut options.open_mesh, o.open_mesh);
        options.symmetric = o.symmetric.or(options.symmetric);
        options.protected_groups.clone_from(&o.protected_groups);
        options.stationary_groups.clone_from(&o.stationary_groups);
        set(&mut options.on_event, o.on_event.map(Into::into));
        set(&mut options.seam.soft_steps, o.seam.soft_steps);
        set(&mut options.seam.polish, o.seam.polish);
        set(&mut options.seam.eta, o.seam.eta);
        set(&mut options.seam.tolerance, o.seam.tolerance);
        set(&mut options.seam.fillet, o.seam.fillet);
        set(&mut options.smoothing.rounds, o.smoothing.rounds);
        set(&mut options.smoothing.relaxation, o.smoothing.relaxation);
        set(&mut options.projection_steps, o.projection_steps);
        set(&mut options.projection_tolerance, o.projection_tolerance);
        options
    }
}

impl From<&Options> for OptionsDocument {
    fn from(options: &Options) -> Self {
        Self {
            outer_mold_line: Some(options.outer_mold_line.into()),
            fillet: options.fillet,
            propagation: Some(options.propagation.into()),
            kernel: options.kernel.map(Into::into),
            regularisation: Some(options.regularisation),
            training_vertices: Some(options.training_vertices),
            blend_radius: Some(options.blend_radius),
            blend_radius_of: options.blend_radius_of.iter().cloned().collect(),
            surface_tolerance: Some(options.surface_tolerance),
            open_mesh: Some(options.open_mesh),
            symmetric: options.symmetric,
            protected_groups: options.protected_groups.clone(),
            stationary_groups: options.stationary_groups.clone(),
            on_event: Some(options.on_event.into()),
            seam: SeamDocument {
                soft_steps: Some(options.seam.soft_steps),
                polish: Some(options.seam.polish),
                eta: Some(options.seam.eta),
                tolerance: Some(options.seam.tolerance),
                fillet: Some(options.seam.fillet),
            },
            smoothing: SmoothingDocument {
                rounds: Some(options.smoothing.rounds),
                relaxation: Some(options.smoothing.relaxation),
            },
            projection_steps: Some(options.projection_steps),
            projection_tolerance: Some(options.projection_tolerance),
        }
    }
}

fn set<T>(to: &mut T, value: Option<T>) {
    if let Some(value) = value {
        *to = value;
    }
}

/// Conversions in both directions between two enums with the same variants.
macro_rules! same_variants {
    ($document:ident, $domain:ident: $($variant:ident),+) => {
        impl From<$document> for $domain {
            fn from(value: $document) -> Self {
                match value { $($document::$variant => Self::$variant),+ }
            }
        }
        impl From<$domain> for $document {
            fn from(value: $domain) -> Self {
                match value { $($domain::$variant => Self::$variant),+ }
            }
        }
    };
}

same_variants!(OuterMoldLineDocument, OuterMoldLine: Sharp, Smooth);
same_variants!(OnEventDocument, OnEvent: Refuse, Report, Ignore);
same_variants!(PropagationDocument, Propagation: Absolute, Departure, Surface);
same_variants!(KernelDocument, Kernel: Multiquadric, Cubic);
