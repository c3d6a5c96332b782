//! Authentication: from a credential to a [`Principal`].

use std::sync::Arc;

use axum::{
    extract::{Request, State},
    http::{HeaderMap, header},
    middleware::Next,
    response::Response,
};
use moldline_host::{Code, Principal, Role, ServiceError};

use crate::{
    error_response::{is_grpc, reject},
    tokens::{InvalidToken, TokenFile},
};

/// Accepted kinds of credentials.
#[derive(Debug, Default)]
pub struct Access {
    /// Bearer tokens.
    pub tokens: Option<TokenFile>,
    /// Whether client certificates are requested.
    pub certificates: bool,
}

/// The principal of a connection's certificate, in the extensions of its requests.
#[derive(Clone, Debug)]
pub struct Certified(pub Principal);

impl Access {
    /// Whether callers have to authenticate.
    pub fn asks(&self) -> bool {
        self.tokens.is_some() || self.certificates
    }

    /// The caller, by its bearer token or else by the certificate of its connection.
    ///
    /// # Errors
    /// `Unauthenticated` without a valid credential.
    pub fn principal(
        &self,
        headers: &HeaderMap,
        certified: Option<&Certified>,
    ) -> Result<Principal, ServiceError> {
        if !self.asks() {
            return Ok(Principal::local());
        }
        let reject = |why: &str| Err(ServiceError::new(Code::Unauthenticated, why));
        let Some(authorization) = headers.get(header::AUTHORIZATION) else {
            return match (certified, &self.tokens) {
                (Some(Certified(principal)), _) => Ok(principal.clone()),
                (None, Some(_)) => reject(
                    "no credential came: send `authorization: Bearer TOKEN` with a token of `moldline token create`",
                ),
                (None, None) => reject("no client certificate came"),
            };
        };
        let token = authorization.to_str().ok().and_then(|text| {
            let (scheme, token) = text.split_once(' ')?;
            scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
        });
        let Some(token) = token else { return reject("the header `authorization` is not `Bearer TOKEN`") };
        match self.tokens.as_ref().map(|tokens| tokens.principal(token)) {
            Some(Ok(principal)) => Ok(principal),
            Some(Err(InvalidToken::Expired)) => reject("the token has expired"),
            Some(Err(InvalidToken::Unknown)) => reject("the token is not known, or not any more"),
            None => reject("this server takes client certificates, and no tokens"),
        }
    }
}

/// Adds the [`Principal`] to the request, or rejects it.
pub async fn layer(State(access): State<Arc<Access>>, mut request: Request, next: Next) -> Response {
    match access.principal(request.headers(), request.extensions().get::<Certified>()) {
        Ok(principal) => {
            tracing::Span::current().record("tenant", principal.tenant.as_str());
            request.extensions_mut().insert(principal);
            next.run(request).await
        }
        Err(error) => reject(is_grpc(request.headers()), error),
    }
}

/// Admits administrators only; after [`layer`].
pub async fn administrators(request: Request, next: Next) -> Response {
    match request.extensions().get::<Principal>() {
        Some(principal) if principal.role == Role::Admin => next.run(request).await,
        _ => {
            let error = ServiceError::new(Code::PermissionDenied, "this is for the role `admin`");
            reject(is_grpc(request.headers()), error)
        }
    }
}
