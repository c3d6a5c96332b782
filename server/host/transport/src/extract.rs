//! Extractors for parts of an HTTP request, which reject invalid ones with problem documents.

use axum::{
    extract::{FromRequestParts, Path},
    http::request::Parts,
};
use moldline_host::{Code, Principal, ServiceError};
use serde::de::DeserializeOwned;

use crate::error_response::ErrorResponse;

/// The query as a struct.
pub struct Query<T>(pub T);

impl<T: DeserializeOwned, S: Sync> FromRequestParts<S> for Query<T> {
    type Rejection = ErrorResponse;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, ErrorResponse> {
        let query = axum::extract::Query::try_from_uri(&parts.uri);
        query
            .map(|axum::extract::Query(query)| Self(query))
            .map_err(|error| ServiceError::invalid("query", error.body_text()).into())
    }
}

/// The variable part of the path.
pub struct Id(pub String);

impl<S: Send + Sync> FromRequestParts<S> for Id {
    type Rejection = ErrorResponse;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ErrorResponse> {
        match Path::<String>::from_request_parts(parts, state).await {
            Ok(Path(id)) => Ok(Self(id)),
            Err(error) => Err(ServiceError::invalid("path", error.body_text()).into()),
        }
    }
}

/// The authenticated caller.
pub struct Caller(pub Principal);

impl<S: Sync> FromRequestParts<S> for Caller {
    type Rejection = ErrorResponse;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, ErrorResponse> {
        parts
            .extensions
            .get()
            .cloned()
            .map(Self)
            .ok_or_else(|| ServiceError::new(Code::Internal, "the request was not authenticated").into())
    }
}
