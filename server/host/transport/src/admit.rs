//! Admission of a request before its body is read: the role that its method needs, and memory for what comes and for the answer.
//!
//! ```text
//! credential -> role -> body (memory before each message, pace) -> handler -> answer (memory until its last piece)
//! ```

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::{
    body::Body,
    extract::{Request, State},
    middleware::Next,
    response::Response,
};
use http_body::Body as _;
use moldline_host::{Code, Principal, Role, ServiceError, Share, Supply};

use crate::{
    error_response::{is_grpc, reject},
    observe::Rpc,
    received::{Held, Received},
};

/// What a method needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Method {
    /// The least role that may call it.
    pub role: Role,
    /// Whether its body is kept by the service, which takes the memory for it, and not read as a whole.
    pub streamed: bool,
}

/// Admission to a service.
#[derive(Clone, Debug)]
pub struct Admission {
    /// Memory of all requests under way.
    pub memory: Arc<Supply>,
    /// What the method of that name needs, by the name of its RPC.
    pub methods: fn(&str) -> Method,
    /// Largest message, bytes.
    pub max_message: usize,
}

/// Bytes of an answer that has been made but not yet encoded, in the extensions of its response.
#[derive(Clone, Copy, Debug)]
pub struct AnswerBytes(pub u64);

/// The memory of one request, shared by its body and its answer.
#[derive(Clone, Debug)]
pub(crate) struct Account(Arc<Mutex<Share>>);

impl Account {
    pub(crate) fn of(share: Share) -> Self {
        Self(Arc::new(Mutex::new(share)))
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, Share> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Admits a request or rejects it; after the credential.
pub(crate) async fn layer(State(admission): State<Admission>, request: Request, next: Next) -> Response {
    let grpc = is_grpc(request.headers());
    let name = request.extensions().get::<Rpc>().map(|Rpc(name)| name.as_str()).unwrap_or_default();
    let method = (admission.methods)(name);
    let Some(principal) = request.extensions().get::<Principal>() else {
        return reject(grpc, ServiceError::new(Code::Internal, "the request was not authenticated"));
    };
    if let Err(error) = principal.need(method.role) {
        return reject(grpc, error);
    }
    let share = match admission.memory.take(&principal.tenant, "the request", 0) {
        Ok(share) => share,
        Err(error) => return reject(grpc, error),
    };
    let account = Account::of(share);
    let (head, body) = request.into_parts();
    let received = match Received::new(body, &head.headers, account.clone(), method, admission.max_message) {
        Ok(received) => received,
        Err(error) => return reject(grpc, error),
    };
    let response = next.run(Request::from_parts(head, Body::new(received))).await;

    // The answer, and a copy of it while it is encoded.
    let made = response.extensions().get::<AnswerBytes>().map(|AnswerBytes(bytes)| *bytes);
    let bytes = made.map_or_else(|| response.body().size_hint().lower(), |bytes| 2 * bytes);
    if let Err(error) = account.lock().grow("the answer", bytes) {
        return reject(grpc, error);
    }
    response.map(|body| Body::new(Held::new(body, account)))
}
