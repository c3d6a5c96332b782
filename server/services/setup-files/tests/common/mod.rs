//! A small set-up to spoil: a box of bilinear patches and a sphere, with an inline mesh.
#![allow(dead_code)]
// Helpers of tests fail by panicking, like the tests themselves.
#![allow(clippy::unwrap_used)]

use moldline_setup_files::{Files, Limits, SetupContent, SetupFileError, read_setup};
use serde_json::{Value, json};

/// A bilinear patch over four corners.
fn face(name: &str, corners: [[f64; 3]; 4]) -> Value {
    let [a, b, c, d] = corners;
    json!({
        "name": name,
        "degree_u": 1, "degree_v": 1,
        "knots_u": [0.0, 0.0, 1.0, 1.0], "knots_v": [0.0, 0.0, 1.0, 1.0],
        "control_points": [[a, b], [c, d]],
    })
}

/// The unit cube, faces outward.
pub fn cube() -> Vec<Value> {
    let p = |i: u32| [f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)];
    let face = |name, a, b, c, d| face(name, [p(a), p(b), p(c), p(d)]);
    vec![
        face("bottom", 0, 2, 1, 3),
        face("top", 4, 5, 6, 7),
        face("front", 0, 4, 2, 6),
        face("back", 1, 3, 5, 7),
        face("port", 0, 1, 4, 5),
        face("starboard", 2, 6, 3, 7),
    ]
}

/// The document.
pub fn document() -> Value {
    json!({
        "format": 1,
        "name": "box and ball",
        "mesh": {
            "vertices": [
                [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0],
                [0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1.0, 1.0]
            ],
            "cells": [[0, 2, 3, 1], [4, 5, 7, 6], [0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7], [2, 7, 3]],
            "vertex_groups": [{ "name": "corner", "indices": [7] }],
        },
        "components": [
            { "name": "ball", "primitive": { "type": "sphere", "center": [9.0, 0.0, 0.0], "radius": 1.0 } },
            { "name": "box", "patches": cube() },
        ],
        "parameterisation": {
            "variables": [{ "name": "dx", "unit": "m", "lower": -1.0, "upper": 1.0 }],
            "operations": [{ "type": "translation", "components": ["box"], "variable": "dx" }],
        },
        "options": { "protected_groups": ["corner"] },
    })
}

/// The set-up as files, from a document.
pub fn files(document: &Value) -> Files {
    Files::from([("setup.json".to_owned(), document.to_string().into_bytes())])
}

/// Reads it with the usual limits.
pub fn read(document: &Value) -> Result<SetupContent, SetupFileError> {
    read_setup(&files(document), None, &Limits::default())
}

/// The message with which a document is refused.
pub fn refused(document: &Value) -> String {
    read(document).expect_err("must be refused").to_string()
}

/// The message after setting the value at a JSON pointer.
pub fn refused_with(pointer: &str, value: Value) -> String {
    let mut document = document();
    *document.pointer_mut(pointer).expect("the pointer leads somewhere") = value;
    refused(&document)
}
