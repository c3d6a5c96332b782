//! The error of a command.

use std::{io, path::PathBuf};

use moldline_aircraft_files::ImportError;
use moldline_check::CheckError;
use moldline_host::ServiceError;
use moldline_mesh::io::Format;

use crate::{shell::ServeError, status::StatusError};

/// Why a command fails, in words for its user.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The server does not start, or ends badly.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// The server's status cannot be shown.
    #[error(transparent)]
    Status(#[from] StatusError),
    /// Tokens cannot be changed.
    #[error(transparent)]
    Tokens(#[from] moldline_transport::tokens::TokenFileError),
    /// The set-up or the design is refused.
    #[error("{}", .0.message)]
    Refused(#[from] ServiceError),
    /// A file cannot be read or written.
    #[error("{}: {error}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The cause.
        error: io::Error,
    },
    /// An aircraft file is refused.
    #[error("{}: {error}", path.display())]
    Import {
        /// The file.
        path: PathBuf,
        /// The cause.
        error: ImportError,
    },
    /// A set-up is in the way.
    #[error("{} exists; import into another folder, or give --force to replace it", path.display())]
    Exists {
        /// The set-up file.
        path: PathBuf,
    },
    /// A file to write whose ending is none of a format.
    #[error("{}: its ending is none of a format that can be written; name a {} file", path.display(), Format::ENDINGS)]
    OutputFormat {
        /// The file.
        path: PathBuf,
    },
    /// The design file has another content.
    #[error("{}: {reason}", path.display())]
    DesignFile {
        /// The file.
        path: PathBuf,
        /// The cause.
        reason: String,
    },
    /// The check cannot be carried out.
    #[error(transparent)]
    Check(#[from] CheckError),
    /// The derivatives are wrong.
    #[error("the derivatives do not pass: {0}")]
    Derivatives(String),
    /// A figure cannot be drawn.
    #[cfg(feature = "plot")]
    #[error("cannot draw the figure: {0}")]
    Plot(#[from] crate::plot::PlotError),
    /// The program was built without plotting.
    #[cfg(not(feature = "plot"))]
    #[error(
        "--plots: this program was built without the feature `plot`; build it with `--features plot`, or write the errors with \
         --json"
    )]
    NoPlots,
    /// There is no store, or it cannot be opened.
    #[error("{0}; give --store the store of `moldline serve`")]
    NoStore(#[source] moldline_mesh_service::StoreError),
    /// The store fails.
    #[error(transparent)]
    Store(#[from] moldline_mesh_service::StoreError),
    /// Objects of the store are not what was written.
    #[error("{0} objects of the store are damaged")]
    Damaged(usize),
    /// The compute threads do not start.
    #[error("cannot start the compute threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// Standard output is closed.
    #[error("standard output: {0}")]
    Output(#[from] io::Error),
}
