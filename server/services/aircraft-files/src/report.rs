//! What an import found, for people and programs.

use std::fmt;

use serde::Serialize;

use crate::model::FileUnit;

/// What an import found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImportReport {
    /// The unit that the file names.
    pub file_unit: Option<FileUnit>,
    /// Metres per unit, as it was read.
    pub metres_per_unit: f64,
    /// Smallest coordinates of all components, m.
    pub low: [f64; 3],
    /// Largest coordinates of all components, m.
    pub high: [f64; 3],
    /// What was imported.
    pub components: Vec<ComponentReport>,
    /// What was not.
    pub left_out: Vec<LeftOutReport>,
}

/// An imported component.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComponentReport {
    /// Its name in the set-up.
    pub name: String,
    /// Its ID in the file.
    pub id: String,
    /// `wing`, `body` or `other`.
    pub shape: &'static str,
    /// Sets of the file that it was made of: mirrored copies.
    pub sets: usize,
    /// Separate closed shells.
    pub shells: usize,
    /// Patches in the file.
    pub patches_in_file: usize,
    /// Patches that were kept: coincident ones of mirrored copies are dropped in pairs.
    pub patches: usize,
    /// Smooth pieces of the file's patches.
    pub pieces_in_file: usize,
    /// Smooth pieces once false corners are taken out.
    pub pieces: usize,
    /// Knots that were taken out.
    pub knots_removed: usize,
    /// Change of the surface by that at most, m.
    pub removal_change: f64,
    /// Largest move of a control point that closes gaps, m.
    pub weld: f64,
    /// Patch edges within this distance of each other, relative to its size, are one.
    pub edge_tolerance: f64,
    /// Wetted area, m^2.
    pub area: f64,
    /// Volume, m^3.
    pub volume: f64,
    /// Smallest coordinates, m.
    pub low: [f64; 3],
    /// Largest coordinates, m.
    pub high: [f64; 3],
    /// Design variables that the set-up gives it, as scalars.
    pub variables: usize,
}

/// Something that was left out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LeftOutReport {
    /// Its name.
    pub name: String,
    /// Its ID in the file.
    pub id: String,
    /// Its patches.
    pub patches: usize,
    /// Why.
    pub reason: String,
}

impl fmt::Display for ImportReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let extent = [0, 1, 2].map(|k| self.high[k] - self.low[k]);
        let size = |scale: f64| {
            let [x, y, z] = extent.map(|e| e * scale);
            format!("{x:.4} x {y:.4} x {z:.4} m")
        };
        match &self.file_unit {
            Some(unit) if unit.metres == self.metres_per_unit => {
                writeln!(f, "unit          {}, as the file says: {} (x, y, z)", unit.label, size(1.0))?;
                if unit.metres != 1.0 {
                    writeln!(f, "              in metres it would be {}: --unit m", size(1.0 / unit.metres))?;
                }
            }
            Some(unit) => {
                writeln!(
                    f,
                    "unit          {} m, as asked for: {} (x, y, z)",
                    self.metres_per_unit,
                    size(1.0)
                )?;
                let scale = unit.metres / self.metres_per_unit;
                writeln!(f, "              the file says {}, which would be {}", unit.label, size(scale))?;
            }
            None => {
                let unit = self.metres_per_unit;
                writeln!(f, "unit          {unit} m; the file names none: {} (x, y, z)", size(1.0))?;
            }
        }
        writeln!(f, "components    {}", self.components.len())?;
        for c in &self.components {
            let [x, y, z] = [0, 1, 2].map(|k| c.high[k] - c.low[k]);
            writeln!(
                f,
                "  {} ({}, {}): closed, {:.3} x {:.3} x {:.3} m, wetted {:.3} m^2, volume {:.4} m^3",
                c.name, c.id, c.shape, x, y, z, c.area, c.volume
            )?;
            write!(f, "    {} patches of {} in the file", c.patches, c.patches_in_file)?;
            if c.sets > 1 {
                write!(f, ", {} copies", c.sets)?;
            }
            if c.shells > 1 {
                write!(f, ", {} shells", c.shells)?;
            }
            writeln!(
                f,
                "; {} smooth pieces of {} ({} knots out, surface changed by {:.0e} m)",
                c.pieces, c.pieces_in_file, c.knots_removed, c.removal_change
            )?;
            if c.weld > 0.0 {
                writeln!(f, "    gaps closed by moves up to {:.1e} m", c.weld)?;
            }
            writeln!(f, "    {} design variables", c.variables)?;
        }
        if !self.left_out.is_empty() {
            writeln!(f, "left out      {}", self.left_out.len())?;
        }
        for l in &self.left_out {
            writeln!(f, "  {} ({}): {} patches, {}", l.name, l.id, l.patches, l.reason)?;
        }
        Ok(())
    }
}
