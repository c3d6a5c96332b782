//! Errors of mesh generation: what is wrong, where, and the way out.

use moldline_foundation::{Class, Failure};
use thiserror::Error;

/// The reason why no mesh was generated.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum MesherError {
    /// There is nothing to mesh.
    #[error("there are no components; name at least one")]
    Empty,
    /// The number of cells is out of range.
    #[error("cells = {cells} is out of range; give {least} to {most}")]
    Cells {
        /// As asked.
        cells: usize,
        /// Least number.
        least: usize,
        /// Most.
        most: usize,
    },
    /// A size is not a positive length.
    #[error("the size of component '{component}' is {size} m; give a positive length")]
    Size {
        /// Name.
        component: String,
        /// Metres.
        size: f64,
    },
    /// A size names no component.
    #[error("a size is given for '{name}', which is no component; the components are {known}")]
    UnknownComponent {
        /// As given.
        name: String,
        /// Names, separated by commas.
        known: String,
    },
    /// A component has a boundary.
    #[error("component '{component}' is an open shell; close it, or leave it out")]
    Open {
        /// Name.
        component: String,
    },
    /// The triangles of a component do not close.
    #[error(
        "the patches of component '{component}' give no closed orientable triangulation ({reason}); check its patches for \
         overlaps and sides without length"
    )]
    NotManifold {
        /// Name.
        component: String,
        /// In the words of the union.
        reason: String,
    },
    /// The union of the components failed.
    #[error("the union of the components failed ({reason}); move the components so that they cross properly")]
    Union {
        /// In the words of the union.
        reason: String,
    },
    /// A component has nothing on the outside.
    #[error("component '{component}' lies inside the others; leave it out, or move it")]
    Hidden {
        /// Name.
        component: String,
    },
    /// Components that touch nothing.
    #[error(
        "the union is in {pieces} pieces: '{component}' touches no other component; move it, or allow pieces"
    )]
    Pieces {
        /// Number of pieces.
        pieces: usize,
        /// A component of a piece that does not contain the first component.
        component: String,
    },
    /// No point of the intersection near a place: components that touch tangentially.
    #[error(
        "no intersection of {components} near ({:.6}, {:.6}, {:.6}) m, though their triangles cross there: they touch without \
         crossing properly; move one of them",
        .place[0], .place[1], .place[2]
    )]
    Tangential {
        /// Names, separated by commas.
        components: String,
        /// Metres.
        place: [f64; 3],
    },
    /// A cell that faces inwards is left.
    #[error(
        "a cell of component '{component}' at ({:.6}, {:.6}, {:.6}) m would be folded; ask for more cells or for a smaller size \
         of that component",
        .place[0], .place[1], .place[2]
    )]
    Folded {
        /// Name.
        component: String,
        /// Metres.
        place: [f64; 3],
    },
    /// The caller cancelled.
    #[error("cancelled")]
    Cancelled,
}

impl Failure for MesherError {
    fn class(&self) -> Class {
        match self {
            Self::Union { .. } | Self::Tangential { .. } | Self::Folded { .. } => Class::Computation,
            Self::Cancelled => Class::Cancelled,
            _ => Class::Input,
        }
    }

    fn field(&self) -> Option<String> {
        match self {
            Self::Cells { .. } => Some("cells".into()),
            Self::Size { component, .. } => Some(format!("sizes[{component:?}]")),
            Self::UnknownComponent { name, .. } => Some(format!("sizes[{name:?}]")),
            _ => None,
        }
    }
}
