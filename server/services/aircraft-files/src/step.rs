//! STEP files to surfaces: units, sets of loose surfaces (OpenVSP's layout), solids and shells.

mod entity;
mod face;
mod spline;
mod unit;

use std::collections::HashSet;

use crate::{
    error::ImportError,
    limits::ImportLimits,
    model::{Model, SurfaceSet, split_label},
    part21::{Exchange, Value},
};
use entity::Entity;
use spline::{SPLINES, spline_surface};

/// Instances that hold faces.
const SHELLS: [&str; 2] = ["CLOSED_SHELL", "OPEN_SHELL"];

/// Counts of what has been read.
pub(crate) struct Budget<'l> {
    limits: &'l ImportLimits,
    patches: usize,
    control_points: usize,
}

impl<'l> Budget<'l> {
    pub(crate) fn new(limits: &'l ImportLimits) -> Self {
        Self { limits, patches: 0, control_points: 0 }
    }

    /// Counts one more patch, before it is read.
    pub(crate) fn take(&mut self, control_points: usize) -> Result<(), ImportError> {
        self.patches += 1;
        self.control_points = self.control_points.saturating_add(control_points);
        let ImportLimits { patches, control_points, .. } = *self.limits;
        if self.patches > patches {
            return Err(ImportError::Limit { what: "patches", found: self.patches, limit: patches });
        }
        if self.control_points > control_points {
            let found = self.control_points;
            return Err(ImportError::Limit { what: "control points", found, limit: control_points });
        }
        Ok(())
    }
}

/// Reads the surfaces of a STEP file.
pub(crate) fn read(text: &str, limits: &ImportLimits) -> Result<Model, ImportError> {
    let exchange = Exchange::scan(text, limits)?;
    let mut budget = Budget::new(limits);
    let loose = loose_sets(&exchange, &mut budget)?;
    let shells = exchange.of_type(&SHELLS);
    if let (Some(set), Some(&shell)) = (loose.first(), shells.first()) {
        let solid = format!("#{shell} {}", exchange.keyword(shell));
        return Err(ImportError::Hybrid { set: set.name.clone(), solid });
    }
    let sets = if !loose.is_empty() {
        loose
    } else if !shells.is_empty() {
        face::shells(&exchange, &shells, &mut budget)?
    } else {
        ungrouped(&exchange, &mut budget)?
    };
    Ok(Model { unit: unit::length_unit(&exchange)?, sets })
}

/// Geometric sets with surfaces in them.
fn loose_sets(exchange: &Exchange<'_>, budget: &mut Budget<'_>) -> Result<Vec<SurfaceSet>, ImportError> {
    let mut sets = Vec::new();
    let mut seen = HashSet::new();
    for number in exchange.of_type(&["GEOMETRIC_SET"]) {
        let set = Entity::parse(exchange, number)?;
        let Ok(record) = set.record("GEOMETRIC_SET") else { continue };
        let label = set.text(record, 0)?;
        let mut patches = Vec::new();
        for item in set.list(record, 1)? {
            let &Value::Reference(item) = item else { continue };
            let surface = Entity::parse(exchange, item)?;
            if surface.is_any(&SPLINES) {
                if !seen.insert(item) {
                    return Err(exchange.entity(item, "belongs to two sets; one is possible".into()));
                }
                patches.push(spline_surface(&surface, budget)?);
            }
        }
        if !patches.is_empty() {
            let (id, name) = split_label(label);
            let id = id.map_or_else(|| format!("#{number}"), str::to_owned);
            let name = if name.is_empty() { format!("set {number}") } else { name.to_owned() };
            sets.push(SurfaceSet { id, name, patches });
        }
    }
    Ok(sets)
}

/// Surfaces of a file without sets.
fn ungrouped(exchange: &Exchange<'_>, budget: &mut Budget<'_>) -> Result<Vec<SurfaceSet>, ImportError> {
    let mut patches = Vec::new();
    for number in exchange.of_type(&SPLINES) {
        let surface = Entity::parse(exchange, number)?;
        if surface.is_any(&SPLINES) {
            patches.push(spline_surface(&surface, budget)?);
        }
    }
    Ok(crate::group::by_label_or_contact(patches))
}
