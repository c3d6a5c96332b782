//! Aircraft files of other programs, STEP and IGES, as set-up folders.
//!
//! The steps: `step` and `iges` read the file to sets of patches (`model`); `assembly` makes closed components of
//! them, with `knots` and `weld`; `shape` finds wings and bodies; `write` writes geometry files and a
//! set-up that starts useful.
//!
//! Absent on purpose: trimmed surfaces, booleans, meshes, the disk.

mod assembly;
mod error;
mod group;
mod iges;
mod import;
mod knots;
mod limits;
mod measure;
mod model;
mod part21;
mod report;
mod shape;
mod step;
mod weld;
mod write;

pub use error::ImportError;
pub use import::{Import, ImportOptions, ImportStage, import};
pub use limits::ImportLimits;
pub use model::FileUnit;
pub use report::{ComponentReport, ImportReport, LeftOutReport};
