//! Why a mesh and its components do not fit, as their bounding boxes tell: units, axes, mirror images, origins.

use std::fmt;

use moldline_geometry::{Aabb, Body, Location};
use moldline_spline::Vector3;

/// Relative difference within which two extents are the same. Surfaces are sampled, and meshes cut their corners.
const SAME: f64 = 0.03;
/// Samples of a patch in each direction.
const SAMPLES: u32 = 12;

/// What is probably wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Misfit {
    /// One is so many times as large as the other.
    Scale {
        /// Extent of the mesh over that of the components.
        ratio: f64,
        /// Probable units of mesh and components.
        units: [&'static str; 2],
    },
    /// The mesh's axes are in another order: its axis `axes[i]` is the components' axis `i`.
    Axes {
        /// 0, 1, 2 for x, y, z.
        axes: [usize; 3],
    },
    /// One is the mirror image of the other.
    Mirrored {
        /// The axis that is reversed.
        axis: usize,
    },
    /// The mesh is somewhere else.
    Moved {
        /// From the components to the mesh, m.
        by: [f64; 3],
    },
}

/// Ratios of units, the mesh's over the components', as the numbers of a mesh are larger in smaller units.
const UNITS: [(f64, &str, &str); 7] = [
    (1000.0, "mm", "m"),
    (304.8, "mm", "ft"),
    (100.0, "cm", "m"),
    (1.0 / 0.0254, "in", "m"),
    (25.4, "mm", "in"),
    (12.0, "in", "ft"),
    (1.0 / 0.3048, "ft", "m"),
];
const NAMES: [char; 3] = ['x', 'y', 'z'];

impl fmt::Display for Misfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scale { ratio, units: [mesh, components] } => write!(
                f,
                "the mesh is {ratio:.4} times as large as the components, which says that the unit of the mesh should be \
                 `{mesh}` where that of the components is `{components}` (set `unit` of either)"
            ),
            Self::Axes { axes } => {
                let axes = axes.map(|axis| NAMES[axis]);
                write!(
                    f,
                    "the axes of the mesh are in another order: its {}, {}, {} are x, y, z of the components",
                    axes[0], axes[1], axes[2]
                )
            }
            Self::Mirrored { axis } => {
                write!(f, "the mesh is the mirror image of the components: {} is reversed", NAMES[*axis])
            }
            Self::Moved { by: [x, y, z] } => {
                write!(f, "the mesh has the components' size, but lies [{x:.4}, {y:.4}, {z:.4}] m from them")
            }
        }
    }
}

/// Compares the boxes around a mesh and around the components. `None` if they tell nothing.
pub(crate) fn misfit(vertices: &[[f64; 3]], bodies: &[Body]) -> Option<Misfit> {
    let mesh = Aabb::around(vertices.iter().map(|x| Vector3::from(*x)));
    let components = Aabb::around(bodies.iter().flat_map(samples));
    let size = components.diagonal();
    let (extent, sizes) = (mesh.high - mesh.low, components.high - components.low);
    let near = |a: f64, b: f64, length: f64| (a - b).abs() <= SAME * length;
    let axes = [0, 1, 2];
    let same_box = |low: Vector3, high: Vector3| {
        axes.iter().all(|&i| near(low[i], components.low[i], size) && near(high[i], components.high[i], size))
    };
    if same_box(mesh.low, mesh.high) {
        return None;
    }
    let ratio = extent.norm() / size;
    let scale = UNITS.iter().flat_map(|&(unit, mesh, of)| [(unit, [mesh, of]), (1.0 / unit, [of, mesh])]);
    for (unit, units) in scale {
        if near(ratio, unit, unit) && axes.iter().all(|&i| near(extent[i], unit * sizes[i], unit * size)) {
            return Some(Misfit::Scale { ratio, units });
        }
    }
    for axis in axes {
        let (mut low, mut high) = (mesh.low, mesh.high);
        (low[axis], high[axis]) = (-mesh.high[axis], -mesh.low[axis]);
        if same_box(low, high) {
            return Some(Misfit::Mirrored { axis });
        }
    }
    for axes in [[0, 2, 1], [1, 0, 2], [2, 1, 0], [1, 2, 0], [2, 0, 1]] {
        let order = |x: Vector3| Vector3::new(x[axes[0]], x[axes[1]], x[axes[2]]);
        if same_box(order(mesh.low), order(mesh.high)) {
            return Some(Misfit::Axes { axes });
        }
    }
    if axes.iter().all(|&i| near(extent[i], sizes[i], size)) {
        let by = mesh.center() - components.center();
        return Some(Misfit::Moved { by: by.into() });
    }
    None
}

/// Points of a body's surface.
fn samples(body: &Body) -> impl Iterator<Item = Vector3> + '_ {
    (0..).zip(body.component().patches()).flat_map(move |(patch, of)| {
        let [u, v] = of.surface.domain();
        let at = |(low, high): (f64, f64), k: u32| low + (high - low) * f64::from(k) / f64::from(SAMPLES);
        (0..=SAMPLES).flat_map(move |i| {
            (0..=SAMPLES).map(move |j| body.position(&Location { patch, u: at(u, i), v: at(v, j) }))
        })
    })
}
