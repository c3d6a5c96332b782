//! Errors of an import: what is wrong, where, and the way out.

use moldline_spline::KnotError;

/// Why an aircraft file is not imported.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ImportError {
    /// The file has neither format.
    #[error(
        "the file is neither STEP (it would begin with ISO-10303-21;) nor IGES (an S in column 73 of its first line)"
    )]
    Format,
    /// A count is beyond its limit.
    #[error("the file has {found} {what}, more than the {limit} allowed: export fewer components at a time")]
    Limit {
        /// What is counted.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many may be.
        limit: usize,
    },
    /// The text does not follow the format.
    #[error("line {line}: {message}")]
    Syntax {
        /// Line, from 1.
        line: usize,
        /// What was expected and found.
        message: String,
    },
    /// An entity is not what its place needs.
    #[error("{entity} (line {line}): {message}")]
    Entity {
        /// Its number and type, `#12 B_SPLINE_SURFACE`.
        entity: String,
        /// Line, from 1.
        line: usize,
        /// What is wrong with it.
        message: String,
    },
    /// A reference that leads nowhere.
    #[error("#{number} is referred to, and missing in the file: export it again")]
    Missing {
        /// Number of the instance.
        number: u64,
    },
    /// Loose surfaces and solids in one file.
    #[error(
        "the file has both loose surfaces ('{set}') and solids ('{solid}'), which may be the same parts twice: export either \
         surfaces or solids"
    )]
    Hybrid {
        /// The first set of surfaces.
        set: String,
        /// The first solid or shell.
        solid: String,
    },
    /// Knots that no B-spline has.
    #[error("{entity} (line {line}): knots along {direction}: {source}")]
    Knots {
        /// The surface.
        entity: String,
        /// Line, from 1.
        line: usize,
        /// `u` or `v`.
        direction: char,
        /// What is wrong with them.
        source: KnotError,
    },
    /// Faces that are trimmed.
    #[error(
        "face {face} of '{set}' (line {line}) is trimmed: {reason}. Moldline needs whole surfaces, since it moves them and \
         finds their intersections anew; export untrimmed, before the boolean"
    )]
    Trimmed {
        /// Number of the face in the file.
        face: String,
        /// The solid or shell.
        set: String,
        /// Line, from 1.
        line: usize,
        /// What shows it.
        reason: String,
    },
    /// No surfaces.
    #[error(
        "the file has no surfaces that can be imported{hint}; export the outer surfaces as untrimmed B-splines"
    )]
    NoSurfaces {
        /// What it has instead, from `: `.
        hint: String,
    },
    /// A name that no component has.
    #[error("{option} {name}: no component has this name or ID; the file has {known}")]
    Unknown {
        /// The option.
        option: &'static str,
        /// The name.
        name: String,
        /// Names of the file.
        known: String,
    },
    /// Nothing is left to be written.
    #[error("no component is left to be imported: {reasons}")]
    NothingClosed {
        /// Why each was left out.
        reasons: String,
    },
    /// The caller has lost interest.
    #[error("cancelled")]
    Cancelled,
}
