//! Parts of an HTTP request, refused as problems where they are wrong.

use axum::{
    extract::{FromRequestParts, Path},
    http::request::Parts,
};
use moldline_service::{Code, Principal, ServiceError};
use serde::de::DeserializeOwned;

use crate::refusal::Refusal;

/// The query, into a struct.
pub struct Query<T>(pub T);

impl<T: DeserializeOwned, S: Sync> FromRequestParts<S> for Query<T> {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Refusal> {
        let query = axum::extract::Query::try_from_uri(&parts.uri);
        query
            .map(|axum::extract::Query(query)| Self(query))
            .map_err(|error| ServiceError::invalid("query", error.body_text()).into())
    }
}

/// The one variable part of the path.
pub struct Id(pub String);

impl<S: Send + Sync> FromRequestParts<S> for Id {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Refusal> {
        match Path::<String>::from_request_parts(parts, state).await {
            Ok(Path(id)) => Ok(Self(id)),
            Err(error) => Err(ServiceError::invalid("path", error.body_text()).into()),
        }
    }
}

/// Who calls.
pub struct Caller(pub Principal);

impl<S: Sync> FromRequestParts<S> for Caller {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Refusal> {
        parts.extensions.get().cloned().map(Self).ok_or_else(|| {
            ServiceError::new(Code::Internal, "the request came past the question who sent it").into()
        })
    }
}
