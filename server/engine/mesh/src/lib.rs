//! Surface meshes of quadrilaterals and triangles: validation, topology, symmetry, distances along the mesh,
//! smoothing operators, quality measures, and the MSH, VTU and STL formats on byte slices.
//!
//! Lengths are in metres (readers return the numbers of the file, whatever its unit), angles in degrees. Vertices are
//! `[x, y, z]` in one contiguous vector, cells index them. Results do not depend on the number of threads.
//!
//! ```
//! use moldline_mesh::{Cell, Limits, SurfaceMesh, Topology, io::msh, topology::enclosed_volume};
//!
//! // A tetrahedron, its faces counter-clockwise seen from outside.
//! let vertices = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
//! let faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
//! let cells = faces.map(|[a, b, c]| Cell::triangle(a, b, c)).to_vec();
//! let mesh = SurfaceMesh::new(vertices, cells, vec![], vec![])?;
//!
//! assert_eq!(Topology::new(&mesh).euler(), 2);
//! assert!((enclosed_volume(&mesh.vertices, &mesh.cells, None) - 1.0 / 6.0).abs() < 1e-15);
//! // What is written reads back to the same bits.
//! let file = msh::write(&mesh, msh::Version::V4);
//! assert_eq!(msh::read(&file, &Limits::default())?.mesh, mesh);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod cracks;
pub mod crossing;
pub mod graph;
mod grid;
pub mod io;
pub mod laplacian;
pub mod merge;
mod mesh;
mod normals;
pub mod orientation;
pub mod origin;
pub mod quality;
pub mod symmetry;
pub mod topology;

pub use crossing::Crossings;
pub use graph::{graph_distance, nearest_source, nearest_sources};
pub use laplacian::Laplacian;
pub use mesh::{Cell, Group, Limits, MeshError, SurfaceMesh};
pub use normals::{area_vector, vertex_normals};
pub use origin::{LeftOut, Numbering, Origin};
pub use quality::{CellQuality, Distribution, QualityReport, Summary};
pub use symmetry::Plane;
pub use topology::{Csr, Topology};

pub use moldline_foundation::Vector3;
