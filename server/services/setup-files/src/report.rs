//! Reports as JSON. Field names and units are those of the engine's structs.

use moldline_deform::{SetupReport, Symmetry};
use moldline_mesh::quality::{Distribution, QualityReport, Summary};
use serde_json::{Value, json};

use crate::OptionsDocument;

/// A set-up report as JSON: lengths in metres, angles in degrees.
pub fn report_json(report: &SetupReport) -> Value {
    json!({
        "vertices": report.vertices,
        "quadrilaterals": report.quadrilaterals,
        "triangles": report.triangles,
        "length": report.length,
        "surface_tolerance": report.surface_tolerance,
        "components": report.components.iter().map(|c| json!({
            "name": c.name,
            "patches": c.patches,
            "vertices": c.vertices,
            "cells": c.cells,
            "largest_distance": c.largest_distance,
            "rms_distance": c.rms_distance,
        })).collect::<Vec<_>>(),
        "seams": report.seams.iter().map(|s| json!({
            "components": s.components,
            "vertices": s.vertices,
            "reference": s.reference,
            "direction": s.direction,
            "transversality": s.transversality,
            "bracket": s.bracket,
        })).collect::<Vec<_>>(),
        "seam_residual": report.seam_residual,
        "watertight": report.watertight,
        "open_edges": report.open_edges,
        "turned_cells": report.turned_cells,
        "left_out": {
            "nodes": report.left_out.nodes,
            "merged_nodes": report.left_out.merged_nodes,
            "other_cells": report.left_out.other_cells,
            "collapsed_cells": report.left_out.collapsed_cells,
        },
        "euler": report.euler,
        "pieces": report.pieces,
        "volume": report.volume,
        "symmetry": match report.symmetry {
            Symmetry::None => "none",
            Symmetry::Full => "full",
            Symmetry::Half => "half",
        },
        "against_normal": report.against_normal,
        "least_normal_agreement": report.least_normal_agreement,
        "protected": {
            "on_edges": report.protected.on_edges,
            "fixed": report.protected.fixed,
            "in_plane": report.protected.in_plane,
            "stationary": report.protected.stationary,
        },
        "fields": report.fields.iter().map(|f| json!({
            "region": f.region,
            "training_vertices": f.training_vertices,
            "seam_vertices": f.seam_vertices,
            "bytes": f.bytes,
        })).collect::<Vec<_>>(),
        "rho": report.rho,
        "options": OptionsDocument::from(&report.options),
        "quality": quality_json(&report.quality),
    })
}

/// A quality report as JSON.
pub fn quality_json(report: &QualityReport) -> Value {
    let components: Vec<Value> = report
        .per_component
        .iter()
        .map(|(name, summary)| json!({ "name": name, "summary": summary_json(summary) }))
        .collect();
    json!({ "total": summary_json(&report.total), "components": components })
}

fn summary_json(summary: &Summary) -> Value {
    json!({
        "cells": summary.cells,
        "aspect_ratio": distribution_json(&summary.aspect_ratio),
        "edge_ratio": distribution_json(&summary.edge_ratio),
        "min_scaled_jacobian": summary.min_scaled_jacobian,
        "min_angle": summary.min_angle,
        "max_angle": summary.max_angle,
        "skew_p95": summary.skew_p95,
        "skew_max": summary.skew_max,
        "folded": summary.folded,
        "inverted": summary.inverted,
    })
}

fn distribution_json(d: &Distribution) -> Value {
    json!({ "p50": d.p50, "p95": d.p95, "p99": d.p99, "max": d.max, "above_5_percent": d.above_5_percent })
}
