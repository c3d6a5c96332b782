//! Client of Moldline: the mesh service, which deforms surface meshes with their geometry, and the panel service
//! ([`panel`]), which computes the flow over them.
//!
//! ```no_run
//! use moldline_client::{Client, Design, Seeds};
//!
//! # async fn run() -> Result<(), moldline_client::Error> {
//! let client = Client::new("127.0.0.1:50051")?;
//! let setup = client.create_setup("examples/e175", Default::default()).await?;
//! let session = setup.session("first steps").await?;
//! let moved = session.deform(Design::named([("wing.translation", 5.0)])).await?;
//! let seeds = Seeds { vertices: moved.vertices.clone(), ..Seeds::default() };
//! let gradient = session.vjp(&seeds, &moved).await?.design;
//! session.close().await?;
//! # Ok(()) }
//! ```
//!
//! Vertices are in metres, each entry of a design in its variable's unit. Dropping a future cancels its call on the server.

mod blocks;
mod check;
mod client;
mod connection;
mod convert;
mod error;
mod model;
pub mod panel;
mod progress;
mod upload;

pub use check::{Check, CheckedDesign, CheckedVariable, Difference, DotProduct, Kink, StageError};
pub use client::{CheckOptions, Client, CreateOptions, Session, Setup};
pub use connection::{Options, Retry, Tls};
pub use error::{Code, Error, FieldViolation, Origin};
pub use model::{
    At, CacheStatus, CellQuality, ControlPoints, Deformation, Design, DesignPoint, Directions, Distribution,
    Function, Gradients, Jacobian, LeftOut, Linearisation, Mesh, Point, Progress, QualityReport,
    QualitySummary, Residuals, Seeds, SessionState, SessionUpdate, SetupAccess, SetupFacts, SetupSummary,
    Status, Tangents, Timings, Variable, VariableGroup, Visibility, Work,
};
pub use progress::Tell;
