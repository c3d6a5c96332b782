//! Web pages and a server on loopback that trusts its callers: any page that a user of the machine visits could call it, by a
//! name of its own that leads to 127.0.0.1 (DNS rebinding), or by a simple request to another origin. So `Host` has to be a name
//! of this machine, and `Origin`, which browsers send and pages cannot change, the same or one of those allowed.

use std::{net::IpAddr, sync::Arc};

use axum::{
    extract::{Request, State},
    http::{HeaderValue, header, uri::Authority},
    middleware::Next,
    response::Response,
};
use moldline_host::{Code, ServiceError, shorten};

use crate::error_response::{is_grpc, reject};

/// Rejects calls of other origins than `allowed`.
pub(crate) async fn layer(
    State(allowed): State<Arc<[HeaderValue]>>,
    request: Request,
    next: Next,
) -> Response {
    match check(&request, &allowed) {
        Ok(()) => next.run(request).await,
        Err(error) => reject(is_grpc(request.headers()), error),
    }
}

fn check(request: &Request, allowed: &[HeaderValue]) -> Result<(), ServiceError> {
    let host = match request.headers().get(header::HOST) {
        Some(host) => host.to_str().ok().and_then(|host| host.parse::<Authority>().ok()),
        None => request.uri().authority().cloned(),
    };
    // HTTP/1.0 has none, and no browser speaks it.
    if let Some(host) = &host
        && !is_local(host.host())
    {
        return Err(refused(format!(
            "`{}` is not a name of this machine; call 127.0.0.1 or localhost, or serve with --tokens",
            shorten(host.as_str())
        )));
    }
    let Some(origin) = request.headers().get(header::ORIGIN) else { return Ok(()) };
    let same = || {
        let authority = origin.to_str().ok()?.split_once("://")?.1.parse::<Authority>().ok()?;
        Some(host.as_ref()? == &authority)
    };
    if allowed.contains(origin) || same() == Some(true) {
        return Ok(());
    }
    let origin = shorten(&String::from_utf8_lossy(origin.as_bytes()));
    Err(refused(format!("pages of `{origin}` may not call this server; allow them with --cors-origin")))
}

fn refused(message: String) -> ServiceError {
    ServiceError::new(Code::PermissionDenied, message)
}

fn is_local(host: &str) -> bool {
    let host = host.to_ascii_lowercase();
    let address = host.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
    host == "localhost" || host.ends_with(".localhost") || address.is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    fn passes(host: &str, origin: Option<&str>) -> bool {
        let mut request = Request::builder().uri("/v1/status").header(header::HOST, host);
        if let Some(origin) = origin {
            request = request.header(header::ORIGIN, origin);
        }
        let allowed = [HeaderValue::from_static("https://example.org")];
        check(&request.body(Body::empty()).unwrap(), &allowed).is_ok()
    }

    #[test]
    fn names_of_this_machine_pass() {
        for host in
            ["127.0.0.1:50051", "localhost:50051", "LOCALHOST", "[::1]:50051", "127.8.9.1", "a.localhost:1"]
        {
            assert!(passes(host, None), "{host}");
        }
        for host in [
            "attacker.example",
            "attacker.example:50051",
            "127.0.0.1.attacker.example",
            "10.0.0.1",
            "0.0.0.0",
        ] {
            assert!(!passes(host, None), "{host}");
        }
    }

    #[test]
    fn pages_of_other_origins_do_not() {
        assert!(passes("127.0.0.1:1", Some("http://127.0.0.1:1")));
        assert!(passes("127.0.0.1:1", Some("https://example.org")));
        for origin in ["http://127.0.0.1:2", "http://localhost:1", "https://attacker.example", "null", ""] {
            assert!(!passes("127.0.0.1:1", Some(origin)), "{origin}");
        }
    }
}
