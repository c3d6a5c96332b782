//! A set-up small enough to write by hand: a unit ball meshed as an inflated cube, which can be moved along x.

use std::collections::HashMap;

/// Cells along an edge of the cube.
const CELLS: usize = 6;
/// Vertices of the mesh.
pub const VERTICES: usize = 6 * CELLS * CELLS + 2;

/// The set-up file; `title` makes it another set-up.
pub fn setup_file(title: &str) -> String {
    let (vertices, cells) = inflated_cube();
    format!(
        r#"{{
            "format": 1,
            "name": "{title}",
            "mesh": {{ "vertices": {vertices:?}, "cells": {cells:?} }},
            "components": [
                {{ "name": "ball", "primitive": {{ "type": "sphere", "center": [0, 0, 0], "radius": 1 }} }}
            ],
            "parameterisation": {{
                "variables": [{{ "name": "ball.x", "unit": "m", "lower": -1, "upper": 2 }}],
                "operations": [
                    {{ "type": "translation", "components": ["ball"], "direction": [1, 0, 0], "variable": "ball.x" }}
                ]
            }}
        }}"#
    )
}

fn inflated_cube() -> (Vec<[f64; 3]>, Vec<[usize; 4]>) {
    let mut index_of = HashMap::new();
    let (mut vertices, mut cells) = (Vec::new(), Vec::new());
    for axis in 0..3 {
        for side in [0, CELLS] {
            for (i, j) in (0..CELLS).flat_map(|i| (0..CELLS).map(move |j| (i, j))) {
                let mut cell = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]].map(|[a, b]| {
                    let mut corner = [0; 3];
                    corner[axis] = side;
                    corner[(axis + 1) % 3] = a;
                    corner[(axis + 2) % 3] = b;
                    *index_of.entry(corner).or_insert_with(|| {
                        let x = corner.map(|k| 2.0 * k as f64 / CELLS as f64 - 1.0);
                        let length = x.iter().map(|x| x * x).sum::<f64>().sqrt();
                        vertices.push(x.map(|x| x / length));
                        vertices.len() - 1
                    })
                });
                if side == 0 {
                    cell.reverse();
                }
                cells.push(cell);
            }
        }
    }
    (vertices, cells)
}
