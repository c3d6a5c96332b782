//! Errors of the engine, of set-up files and of the store as answers: code, field and delay.

use moldline_check::CheckError;
use moldline_deform::{DeformError, SetupError, VertexDistance};
use moldline_host::{Code, ServiceError};
use moldline_mesh::{MeshError, io::ReadError};
use moldline_mesh_service::StoreError;
use moldline_parameterisation::{DesignError, ParameterisationError};
use moldline_setup_files::SetupFileError;

/// Code and field of an answer, which carries the text of the error.
fn answer<E: std::fmt::Display>(error: E) -> (Code, String)
where
    ServiceError: From<E>,
{
    let text = error.to_string();
    let answer = ServiceError::from(error);
    let [violation] = &answer.violations[..] else { panic!("{answer:?}") };
    assert_eq!(violation.description, text);
    assert!(answer.message.ends_with(&text));
    (answer.code, violation.field.clone())
}

/// Code of an answer without a field.
fn code<E: std::fmt::Display>(error: E) -> Code
where
    ServiceError: From<E>,
{
    let text = error.to_string();
    let answer = ServiceError::from(error);
    assert_eq!((answer.message, answer.violations), (text, Vec::new()));
    answer.code
}

fn seam_lost() -> DeformError {
    let (reference, target) = ("wing".to_owned(), "body".to_owned());
    DeformError::SeamLost { reference, target, count: 0, worst: Vec::new() }
}

fn invalid(field: &str) -> (Code, String) {
    (Code::InvalidArgument, field.to_owned())
}

#[test]
fn errors_of_set_up_files() {
    let coordinate = || MeshError::Coordinate { vertex: 7, axis: 2, value: f64::NAN, limit: 1e9 };
    assert_eq!(answer(SetupFileError::Mesh(coordinate())), invalid("mesh.vertices[7][2]"));
    assert_eq!(answer(SetupFileError::Mesh(MeshError::Empty { what: "cells" })), invalid("mesh.cells"));
    let file = |source| SetupFileError::MeshFile { file: "mesh.msh".to_owned(), source };
    assert_eq!(
        answer(file(ReadError::Mesh { error: coordinate(), message: coordinate().to_string() })),
        invalid("mesh.vertices[7][2]")
    );
    let syntax = |field: &str| SetupFileError::Syntax {
        file: "setup.toml".to_owned(),
        field: field.to_owned(),
        message: "is wrong".to_owned(),
    };
    assert_eq!(answer(syntax("")), invalid("setup.toml"));
    assert_eq!(answer(syntax("mesh")), invalid("mesh"));
    assert_eq!(answer(SetupFileError::Format { found: 2 }), invalid("format"));
}

#[test]
fn errors_of_a_set_up() {
    let unused = ParameterisationError::UnusedVariable { index: 3, name: "x".to_owned() };
    assert_eq!(answer(SetupError::Parameterisation(unused)), invalid("parameterisation.variables[3]"));
    let empty = ParameterisationError::Empty { field: "operations[1].sections".to_owned() };
    assert_eq!(
        answer(SetupFileError::Parameterisation(empty)),
        invalid("parameterisation.operations[1].sections")
    );
    let patch =
        ParameterisationError::PatchSize { component: 1, patch: 2, what: "weights", found: 3, expected: 4 };
    assert_eq!(answer(SetupError::Parameterisation(patch)), invalid("components[1].patches[2]"));
    let option = SetupError::Option { field: "field.rounding".to_owned(), value: -1.0, low: 0.0, high: 1.0 };
    assert_eq!(answer(option), invalid("options.field.rounding"));
    let off = |worst| SetupError::OffSurface { count: 1, tolerance: 1e-6, misfit: None, worst };
    assert_eq!(answer(off(vec![VertexDistance { vertex: 7, distance: 0.1 }])), invalid("mesh.vertices[7]"));
    assert_eq!(answer(off(Vec::new())), invalid("mesh.vertices"));
    let across = SetupError::CellAcrossSeam { count: 1, first: vec![9] };
    assert_eq!(answer(across), invalid("mesh.cells[9]"));
    assert_eq!(code(SetupError::Cancelled), Code::Cancelled);
}

#[test]
fn errors_of_a_deformation() {
    let length = DesignError::Length { expected: 1, found: 2 };
    assert_eq!(answer(DeformError::Design(length.clone())), invalid("design"));
    assert_eq!(answer(length), invalid("design"));
    let value = DesignError::OverrideNotFinite { component: 0, index: 4, axis: 1, value: f64::NAN };
    assert_eq!(answer(value), invalid("control_points[0][4][1]"));
    assert_eq!(answer(seam_lost()), (Code::FailedPrecondition, "design".to_owned()));
    assert_eq!(code(DeformError::Cancelled), Code::Cancelled);
}

#[test]
fn errors_of_a_check() {
    let design = (Code::FailedPrecondition, "design".to_owned());
    assert_eq!(answer(CheckError::Deform(seam_lost())), design);
    assert_eq!(code(CheckError::Deform(DeformError::Cancelled)), Code::Cancelled);
    let error = DesignError::UnknownName { name: "y".to_owned(), nearest: None };
    assert_eq!(answer(CheckError::Variable { index: 2, error }), invalid("variables[2]"));
    let designs = (Code::FailedPrecondition, "designs".to_owned());
    assert_eq!(answer(CheckError::Vertex { vertex: 5 }), designs);
}

#[test]
fn errors_of_the_store() {
    let (object, reason) = ("blob/x".to_owned(), "because".to_owned());
    let full = StoreError::Full { object: object.clone(), reason: reason.clone() };
    assert_eq!(code(full), Code::ResourceExhausted);
    let corrupt = StoreError::Corrupt { object: object.clone(), reason: reason.clone() };
    assert_eq!(code(corrupt), Code::Internal);
    let read_only = StoreError::ReadOnly { object: object.clone(), reason: reason.clone() };
    assert_eq!(ServiceError::from(read_only.clone()).retry_after, None);
    assert_eq!(code(read_only), Code::Unavailable);
    let unavailable = StoreError::Unavailable { object, reason };
    assert!(ServiceError::from(unavailable.clone()).retry_after.is_some());
    assert_eq!(code(unavailable), Code::Unavailable);
}
