//! Where the vertices and cells of a mesh come from: the numbers that they have in the user's file.

use std::fmt::Write;

/// The kind of a file, which decides how its numbers are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Numbering {
    /// No file, or one without numbers of its own: vertices and cells are named by their indices.
    #[default]
    Indices,
    /// Tags of nodes and elements, as in MSH.
    Tags,
    /// Indices of the arrays that a caller sent.
    Arrays,
    /// Indices of points and cells from 0, as in VTU.
    Points,
    /// Facets from 0 and their corners, as in STL: corner `k` of facet `f` has the number `3 f + k`.
    Facets,
}

/// Parts of a file that are not in the mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LeftOut {
    /// Nodes that no triangle or quadrilateral uses.
    pub nodes: usize,
    /// Nodes that were merged into others within `merge_tolerance`, or at the borders of pieces.
    pub merged_nodes: usize,
    /// Cells other than triangles and quadrilaterals: volumes, and ghosts of other partitions.
    pub other_cells: usize,
    /// Cells that collapsed when nodes were merged, or were without area because their corners are equal.
    pub collapsed_cells: usize,
}

/// The numbers of vertices and cells in the file that a mesh was read from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Origin {
    /// How numbers are written.
    pub numbering: Numbering,
    /// The number of each vertex; without entries it is the index.
    pub nodes: Vec<u64>,
    /// The number of each cell; without entries it is the index.
    pub cells: Vec<u64>,
    /// Numbers of the nodes that were merged, with the vertices that they became.
    pub merged: Vec<(u64, u32)>,
    /// What is not in the mesh.
    pub left_out: LeftOut,
}

impl Origin {
    /// A vertex in the file's words, unless its index says the same.
    pub fn node(&self, vertex: u32) -> Option<String> {
        let &number = self.nodes.get(vertex as usize)?;
        match self.numbering {
            Numbering::Tags => Some(format!("node {number}")),
            Numbering::Points if number != u64::from(vertex) => Some(format!("points[{number}]")),
            Numbering::Facets => Some(format!("facets[{}][{}]", number / 3, number % 3)),
            Numbering::Arrays if number != u64::from(vertex) => Some(format!("vertex {number} as sent")),
            Numbering::Indices | Numbering::Arrays | Numbering::Points => None,
        }
    }

    /// A cell in the file's words, unless its index says the same.
    pub fn cell(&self, cell: u32) -> Option<String> {
        let &number = self.cells.get(cell as usize)?;
        match self.numbering {
            Numbering::Tags => Some(format!("element {number}")),
            Numbering::Points if number != u64::from(cell) => Some(format!("the file's cells[{number}]")),
            Numbering::Facets => Some(format!("facets[{number}]")),
            Numbering::Arrays if number != u64::from(cell) => Some(format!("cell {number} as sent")),
            Numbering::Indices | Numbering::Arrays | Numbering::Points => None,
        }
    }

    /// A message with its indices in the file's words: after `vertices[10]`, `vertex 10`, `edge [10, 11]`, `cells[4]` and
    /// `cells [4, 5]`, the forms in which all messages name vertices and cells, comes what they are in the file.
    pub fn explain(&self, message: &str) -> String {
        let mut out = String::with_capacity(message.len());
        let mut rest = message;
        while let Some((start, form)) = next_form(rest) {
            let (before, list) = rest.split_at(start + form.word.len());
            out.push_str(before);
            let (indices, length) = indices(list, form.close);
            out.push_str(&list[..length]);
            rest = &list[length..];
            let name = |&index: &u32| if form.cells { self.cell(index) } else { self.node(index) };
            let names: Option<Vec<String>> = indices.iter().map(name).collect();
            if let Some(names) = names.filter(|names| !names.is_empty()) {
                // Writing to a string cannot fail.
                let _ = write!(out, " ({})", names.join(", "));
            }
        }
        out + rest
    }
}

/// A form in which messages name vertices or cells.
struct Form {
    word: &'static str,
    close: &'static str,
    cells: bool,
}

const FORMS: [Form; 5] = [
    Form { word: "vertices[", close: "]", cells: false },
    Form { word: "vertex ", close: "", cells: false },
    Form { word: "edge [", close: "]", cells: false },
    Form { word: "cells[", close: "]", cells: true },
    Form { word: "cells [", close: "]", cells: true },
];

/// The first place where a form begins.
fn next_form(text: &str) -> Option<(usize, &'static Form)> {
    let found = FORMS.iter().filter_map(|form| Some((text.find(form.word)?, form)));
    found.min_by_key(|(start, _)| *start)
}

/// Indices separated by commas up to `close`, and the length of their text; none if something else is there.
fn indices(text: &str, close: &str) -> (Vec<u32>, usize) {
    let end = text.find(|c: char| !c.is_ascii_digit() && c != ',' && c != ' ').unwrap_or(text.len());
    let inside = match close {
        "" => text.split(|c: char| !c.is_ascii_digit()).next().unwrap_or_default(),
        _ => &text[..end],
    };
    let numbers: Result<Vec<u32>, _> = inside.split(", ").map(str::parse).collect();
    match numbers {
        Ok(numbers) if text[inside.len()..].starts_with(close) => (numbers, inside.len() + close.len()),
        _ => (Vec::new(), 0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_speak_the_files_numbers() {
        let origin = Origin {
            numbering: Numbering::Tags,
            nodes: vec![6, 7, 16],
            cells: vec![101, 205],
            ..Origin::default()
        };
        for (message, explained) in [
            (
                "vertices[2]: 1e-3 m, vertices[0]: 2 m",
                "vertices[2] (node 16): 1e-3 m, vertices[0] (node 6): 2 m",
            ),
            ("seam vertex 1 on `a`", "seam vertex 1 (node 7) on `a`"),
            ("edge [0, 2] of cells[1]", "edge [0, 2] (node 6, node 16) of cells[1] (element 205)"),
            ("cells [0, 1] run", "cells [0, 1] (element 101, element 205) run"),
            ("vertices[2][1] = NaN", "vertices[2] (node 16)[1] = NaN"),
            ("vertices[9], cells[x], vertex of, edge [", "vertices[9], cells[x], vertex of, edge ["),
            ("nothing", "nothing"),
        ] {
            assert_eq!(origin.explain(message), explained);
            assert_eq!(Origin::default().explain(message), message);
        }
    }

    #[test]
    fn facets_have_corners() {
        let origin =
            Origin { numbering: Numbering::Facets, nodes: vec![0, 5], cells: vec![3], ..Origin::default() };
        assert_eq!(
            origin.explain("vertices[1], cells[0]"),
            "vertices[1] (facets[1][2]), cells[0] (facets[3])"
        );
    }
}
