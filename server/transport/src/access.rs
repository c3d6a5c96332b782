//! Who calls: from a credential to a [`Principal`].

use std::sync::Arc;

use axum::{
    extract::{Request, State},
    http::{HeaderMap, header},
    middleware::Next,
    response::Response,
};
use moldline_service::{Code, Principal, Role, ServiceError};

use crate::{
    refusal::{is_grpc, refuse},
    tokens::{Refused, TokenFile},
};

/// How callers are asked who they are.
#[derive(Debug, Default)]
pub struct Access {
    /// Bearer tokens.
    pub tokens: Option<TokenFile>,
    /// Whether client certificates are asked for.
    pub certificates: bool,
}

/// Whom the certificate of a connection names, in the extensions of its requests.
#[derive(Clone, Debug)]
pub struct Certified(pub Principal);

impl Access {
    /// Whether anybody is asked.
    pub fn asks(&self) -> bool {
        self.tokens.is_some() || self.certificates
    }

    /// Who calls: the bearer token says, or else the connection's certificate.
    ///
    /// # Errors
    /// `Unauthenticated`.
    pub fn principal(
        &self,
        headers: &HeaderMap,
        certified: Option<&Certified>,
    ) -> Result<Principal, ServiceError> {
        if !self.asks() {
            return Ok(Principal::local());
        }
        let refused = |why: &str| Err(ServiceError::new(Code::Unauthenticated, why));
        let Some(authorization) = headers.get(header::AUTHORIZATION) else {
            return match (certified, &self.tokens) {
                (Some(Certified(principal)), _) => Ok(principal.clone()),
                (None, Some(_)) => refused(
                    "no credential came: send `authorization: Bearer TOKEN` with a token of `moldline token create`",
                ),
                (None, None) => refused("no client certificate came"),
            };
        };
        let token = authorization.to_str().ok().and_then(|text| {
            let (scheme, token) = text.split_once(' ')?;
            scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
        });
        let Some(token) = token else { return refused("the header `authorization` is not `Bearer TOKEN`") };
        match self.tokens.as_ref().map(|tokens| tokens.principal(token)) {
            Some(Ok(principal)) => Ok(principal),
            Some(Err(Refused::Expired)) => refused("the token has expired"),
            Some(Err(Refused::Unknown)) => refused("the token is not known, or not any more"),
            None => refused("this server takes client certificates, and no tokens"),
        }
    }
}

/// Puts the [`Principal`] into the request, or refuses it.
pub async fn layer(State(access): State<Arc<Access>>, mut request: Request, next: Next) -> Response {
    match access.principal(request.headers(), request.extensions().get::<Certified>()) {
        Ok(principal) => {
            tracing::Span::current().record("tenant", principal.tenant.as_str());
            request.extensions_mut().insert(principal);
            next.run(request).await
        }
        Err(error) => refuse(is_grpc(request.headers()), error),
    }
}

/// Lets administrators of the server through; after [`layer`].
pub async fn administrators(request: Request, next: Next) -> Response {
    match request.extensions().get::<Principal>() {
        Some(principal) if principal.role == Role::Admin => next.run(request).await,
        _ => {
            let error = ServiceError::new(Code::PermissionDenied, "this is for the role `admin`");
            refuse(is_grpc(request.headers()), error)
        }
    }
}

/// The role of that name.
pub fn role(name: &str) -> Option<Role> {
    [Role::Reader, Role::User, Role::Admin].into_iter().find(|role| role.name() == name)
}
