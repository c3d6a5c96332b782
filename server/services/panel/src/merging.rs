//! Merging of near vertices: the engine sees the merged mesh, callers keep their own vertices.

use moldline_host::ServiceError;
use moldline_mesh::{Cell, Group, Numbering, Origin, SurfaceMesh, merge};
use moldline_panel::{Analysis, Inputs, PanelError, SetupSummary, TrailingEdges};

/// Distance within which vertices that were merged have to stay together, in tolerances.
const TOGETHER: f64 = 10.0;

/// Which of a caller's vertices are one. A merged vertex is the mean `x_j = sum x_i / n_j` of its `n_j` vertices, so that
/// derivatives with respect to all of them are exact.
#[derive(Debug)]
pub struct Merging {
    tolerance: f64,
    /// The merged vertex of each vertex.
    merged: Vec<u32>,
    /// `1 / n_j` of each merged vertex.
    weights: Vec<f64>,
    /// The first of each merged vertex's vertices, as numbers in messages.
    origin: Origin,
}

impl Merging {
    /// Merges the vertices of a mesh within `tolerance`, m; the mesh that the engine sees.
    ///
    /// # Errors
    /// `InvalidArgument` if the tolerance is not positive, or if cells would collapse to nothing.
    pub fn new(mesh: SurfaceMesh, tolerance: f64) -> Result<(Self, SurfaceMesh), ServiceError> {
        let field = "options.merge_tolerance";
        if !(tolerance > 0.0 && tolerance.is_finite()) {
            return Err(ServiceError::invalid(field, format!("{tolerance} is not a positive number")));
        }
        let SurfaceMesh { vertices, cells, cell_groups, vertex_groups } = mesh;
        let target = merge::near(&vertices, tolerance);
        let mut merged = vec![0; vertices.len()];
        let mut nodes = Vec::new();
        for (vertex, &target) in target.iter().enumerate() {
            // A vertex becomes an earlier one, or itself.
            merged[vertex] = if target as usize == vertex {
                nodes.push(vertex as u64);
                nodes.len() as u32 - 1
            } else {
                merged[target as usize]
            };
        }
        let becomes = |cell: &Cell| merge::collapse(&cell.map(|vertex| merged[vertex as usize]));
        let kept: Vec<Option<Cell>> = cells.iter().map(becomes).collect();
        if let Some(first) = kept.iter().position(Option::is_none) {
            let count = kept.iter().filter(|cell| cell.is_none()).count();
            let description = format!(
                "{tolerance:e} m collapses {count} cells, the first is cells[{first}]; leave them out, or take a smaller tolerance"
            );
            return Err(ServiceError::invalid(field, description));
        }
        let vertex_groups = vertex_groups.into_iter().map(|Group { name, mut indices }| {
            indices.iter_mut().for_each(|index| *index = merged[*index as usize]);
            indices.sort_unstable();
            indices.dedup();
            Group { name, indices }
        });
        let vertex_groups = vertex_groups.collect();
        let mut counts = vec![0.0; nodes.len()];
        merged.iter().for_each(|&vertex| counts[vertex as usize] += 1.0);
        let origin = Origin { numbering: Numbering::Arrays, nodes, ..Origin::default() };
        let weights = counts.into_iter().map(|count: f64| 1.0 / count).collect();
        let merging = Self { tolerance, merged, weights, origin };
        let mesh = SurfaceMesh {
            vertices: merging.sum(&vertices),
            cells: kept.into_iter().flatten().collect(),
            cell_groups,
            vertex_groups,
        };
        Ok((merging, mesh))
    }

    /// Number of vertices that became others.
    pub fn count(&self) -> usize {
        self.merged.len() - self.weights.len()
    }

    /// An error of the engine with the caller's vertices.
    pub fn explain(&self, error: PanelError) -> ServiceError {
        ServiceError::from(error).reworded(|text| self.origin.explain(text))
    }

    /// The merged positions.
    ///
    /// # Errors
    /// `InvalidArgument` for another number of vertices, or if vertices that are one have left each other.
    pub fn positions(&self, vertices: &[[f64; 3]]) -> Result<Vec<[f64; 3]>, ServiceError> {
        let (got, expected) = (vertices.len(), self.merged.len());
        if got != expected {
            return Err(PanelError::Length { field: "vertices".to_owned(), got, expected }.into());
        }
        let positions = self.sum(vertices);
        for (vertex, (x, &merged)) in vertices.iter().zip(&self.merged).enumerate() {
            let mean = positions[merged as usize];
            let distance = (0..3).map(|axis| (x[axis] - mean[axis]).powi(2)).sum::<f64>().sqrt();
            // Coordinates that are not finite have an error of their own.
            if distance > TOGETHER * self.tolerance {
                let description = format!(
                    "has left the vertices that it was merged with: it is {distance:e} m from their mean; move double vertices \
                     together"
                );
                return Err(ServiceError::invalid(format!("vertices[{vertex}]"), description));
            }
        }
        Ok(positions)
    }

    /// The means of vectors at the caller's vertices. Linear.
    fn sum(&self, vectors: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let mut sums = vec![[0.0; 3]; self.weights.len()];
        for (vector, &merged) in vectors.iter().zip(&self.merged) {
            (0..3).for_each(|axis| sums[merged as usize][axis] += vector[axis]);
        }
        for (sum, weight) in sums.iter_mut().zip(&self.weights) {
            sum.iter_mut().for_each(|x| *x *= weight);
        }
        sums
    }

    /// Directions of the inputs for the engine.
    ///
    /// # Errors
    /// `InvalidArgument` for another number of vertices.
    pub fn directions(&self, mut directions: Vec<Inputs>) -> Result<Vec<Inputs>, ServiceError> {
        for (index, direction) in directions.iter_mut().enumerate() {
            let (got, expected) = (direction.vertices.len(), self.merged.len());
            if got == expected {
                direction.vertices = self.sum(&direction.vertices);
            } else if got > 0 {
                let field = format!("directions.vertices[{index}]");
                return Err(PanelError::Length { field, got, expected }.into());
            }
        }
        Ok(directions)
    }

    /// Gradients with respect to the caller's vertices: the transpose of [`directions`](Self::directions).
    pub fn gradients(&self, mut gradients: Vec<Inputs>) -> Vec<Inputs> {
        for gradient in &mut gradients {
            let of = |&merged: &u32| {
                let weight = self.weights[merged as usize];
                gradient.vertices[merged as usize].map(|x| weight * x)
            };
            gradient.vertices = self.merged.iter().map(of).collect();
        }
        gradients
    }

    /// An analysis with the caller's vertices.
    pub fn analysis(&self, mut analysis: Analysis) -> Analysis {
        analysis.vertex_cp = self.merged.iter().map(|&merged| analysis.vertex_cp[merged as usize]).collect();
        analysis.sections.iter_mut().for_each(|section| section.edge = section.edge.map(|v| self.first(v)));
        analysis.warnings.iter_mut().for_each(|warning| warning.renumber(&|v| self.first(v)));
        analysis
    }

    /// A summary with the caller's vertices.
    pub fn summary(&self, mut summary: SetupSummary) -> SetupSummary {
        summary.trailing_edges.iter_mut().flatten().for_each(|vertex| *vertex = self.first(*vertex));
        let first = |vertex: &mut u32| *vertex = self.first(*vertex);
        summary.roots.iter_mut().chain(&mut summary.aft_ends).for_each(first);
        let lines =
            summary.lines.iter_mut().chain(summary.left_out.iter_mut().map(|left_out| &mut left_out.line));
        lines.for_each(|line| line.vertices.iter_mut().for_each(first));
        summary.warnings.iter_mut().for_each(|warning| warning.renumber(&|v| self.first(v)));
        summary
    }

    /// Trailing edges for the engine. Vertices that do not exist stay so.
    pub fn trailing_edges(&self, edges: TrailingEdges) -> TrailingEdges {
        let merged = |vertex: u32| self.merged.get(vertex as usize).copied().unwrap_or(vertex);
        match edges {
            TrailingEdges::Edges(edges) => {
                TrailingEdges::Edges(edges.into_iter().map(|edge| edge.map(merged)).collect())
            }
            other => other,
        }
    }

    /// The first vertex of a merged one.
    fn first(&self, merged: u32) -> u32 {
        self.origin.nodes[merged as usize] as u32
    }
}
