//! Surface meshes of quadrilaterals and triangles: validation, topology, symmetry, distances along the mesh,
//! smoothing operators, quality measures, and the MSH, VTU and STL formats on byte slices.
//!
//! Lengths are in metres unless a reader's file says nothing about its unit, angles in degrees. Vertices are
//! `[x, y, z]` in one contiguous vector, cells index them. Everything here is deterministic: results do not depend
//! on the number of threads.

pub mod graph;
mod grid;
pub mod io;
pub mod laplacian;
mod mesh;
mod normals;
pub mod orientation;
pub mod quality;
pub mod symmetry;
pub mod topology;

pub use graph::{graph_distance, nearest_source, nearest_sources};
pub use laplacian::Laplacian;
pub use mesh::{Cell, Group, Limits, MeshError, SurfaceMesh};
pub use normals::{area_vector, vertex_normals};
pub use quality::{CellQuality, Distribution, QualityReport, Summary};
pub use symmetry::Plane;
pub use topology::{Csr, Topology};

pub use moldline_foundation::Vector3;
