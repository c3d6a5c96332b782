//! Whole requests, from their bytes to the bytes of the answer, over gRPC and HTTP: the first byte chooses method and transport, the
//! second one ids and content types, the rest is the body. No answer is a fault of the server, no number in one is not finite, and all
//! memory is given back.
#![no_main]
#![allow(clippy::unwrap_used, reason = "whatever the input, only a fault panics")]

use std::{
    sync::{Arc, LazyLock, Mutex},
    time::Duration,
};

use axum::{
    Router,
    body::Body,
    http::{Method, Request, header},
};
use http_body_util::BodyExt;
use libfuzzer_sys::fuzz_target;
use moldline::{serve, shell::Parts, telemetry};
use moldline_host::{PoolLimits, Principal};
use moldline_mesh_service::{FileEntry, Limits, Service, Upload, UploadHeader, UploadSource};
use moldline_testing::ball;
use moldline_transport::{Access, Surroundings, router, start_metrics};
use prost::Message;
use tokio::runtime::{Builder, Runtime};
use tower::ServiceExt;

/// Longest time for an answer.
const PATIENCE: Duration = Duration::from_secs(10);

struct Server {
    runtime: Runtime,
    service: Arc<Service>,
    app: Router,
    /// Methods and paths over HTTP.
    routes: Vec<(Method, String)>,
    /// Paths over gRPC.
    methods: Vec<String>,
}

static SERVER: LazyLock<Server> = LazyLock::new(|| {
    let runtime = Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let (service, app, routes) = runtime.block_on(start());
    Server { runtime, service, app, routes, methods: methods() }
});

/// A set-up and a session of it, made again if an input before has removed them.
async fn ids(service: &Service) -> [String; 2] {
    static IDS: Mutex<[String; 2]> = Mutex::new([String::new(), String::new()]);
    let caller = Principal::local();
    let [mut setup, mut session] = IDS.lock().unwrap().clone();
    if service.get_setup(&caller, &setup).await.is_err() {
        let file = ball::setup_file("ball");
        let entry = FileEntry { path: "setup.json".to_owned(), size: file.len() as u64 };
        let source = UploadSource::Files(vec![entry]);
        let header = UploadHeader { request_id: String::new(), setup_file: None, visibility: None, source };
        let mut upload = Upload::begin(header, service.limits()).unwrap();
        upload.append(0, file.as_bytes(), service.limits()).unwrap();
        let created = service.create_setup(&caller, upload.finish().unwrap(), |_| {}).await.unwrap();
        setup = created.setup.id.to_string();
    }
    if service.get_session(&caller, &session).await.is_err() {
        session = service.open_session(&caller, &setup, "", "").await.unwrap().id;
    }
    let ids = [setup, session];
    IDS.lock().unwrap().clone_from(&ids);
    ids
}

async fn start() -> (Arc<Service>, Router, Vec<(Method, String)>) {
    let pool = PoolLimits { threads: 1, running: 2, queued: 16, work: Duration::from_secs(5) };
    let limits = Limits {
        memory: 256 << 20,
        setups: 1000,
        sessions: 1_000_000,
        hide_known: false,
        ..Limits::default()
    };
    let service = Arc::new(Service::new(pool, limits).unwrap());

    let Parts { served, health, gauges, .. } = serve::parts(Arc::clone(&service), 1 << 20).await.unwrap();
    let described = served.http.get_openapi().clone();
    let surroundings = Surroundings {
        access: Arc::new(Access::default()),
        health,
        metrics: start_metrics().unwrap(),
        gauges,
        trace: telemetry::follow,
        origins: Vec::new(),
        local: false,
    };
    let mut routes = Vec::new();
    for (path, item) in &described.paths.paths {
        for (method, operation) in [
            (Method::GET, &item.get),
            (Method::POST, &item.post),
            (Method::PATCH, &item.patch),
            (Method::PUT, &item.put),
            (Method::DELETE, &item.delete),
        ] {
            if operation.is_some() {
                routes.push((method, path.clone()));
            }
        }
    }
    (service, router(served, surroundings), routes)
}

/// Methods of the mesh service.
fn methods() -> Vec<String> {
    let set = prost_types::FileDescriptorSet::decode(moldline_proto::FILE_DESCRIPTOR_SET).unwrap();
    let services = set.file.iter().flat_map(|file| {
        file.service.iter().filter(|service| service.name() == "MeshService").flat_map(|service| {
            let path = |method: &str| format!("/{}.{}/{method}", file.package(), service.name());
            service.method.iter().map(move |method| path(method.name()))
        })
    });
    services.collect()
}

/// A request over HTTP. What is not an id in the path stays as it is.
fn http(
    server: &Server,
    [setup, session]: &[String; 2],
    index: usize,
    choice: u8,
    body: &[u8],
) -> Request<Body> {
    const SENT: [&str; 5] = [
        "application/json",
        "application/octet-stream",
        "application/x-npy",
        "application/x-npz",
        "application/x-tar",
    ];
    const WANTED: [&str; 4] =
        ["application/json", "application/octet-stream", "application/x-npz", "text/event-stream"];
    let (method, path) = &server.routes[index % server.routes.len()];
    let path = path.replace("{setup_id}", setup).replace("{session_id}", session);
    Request::builder()
        .method(method)
        .uri(path)
        .header(header::CONTENT_TYPE, SENT[usize::from(choice) % SENT.len()])
        .header(header::ACCEPT, WANTED[usize::from(choice) / SENT.len() % WANTED.len()])
        .body(Body::from(body.to_vec()))
        .unwrap()
}

/// A request over gRPC with one message, to which the id of a session or of a set-up is added: the last value of a field counts.
fn grpc(
    server: &Server,
    [setup, session]: &[String; 2],
    index: usize,
    choice: u8,
    message: &[u8],
) -> Request<Body> {
    let mut message = message.to_vec();
    let id = match choice % 3 {
        0 => "",
        1 => session.as_str(),
        _ => setup.as_str(),
    };
    if !id.is_empty() {
        // Field 1, length-delimited.
        message.extend([1 << 3 | 2, u8::try_from(id.len()).unwrap()]);
        message.extend(id.as_bytes());
    }
    let mut body = vec![0];
    body.extend(u32::try_from(message.len()).unwrap().to_be_bytes());
    body.extend(message);
    Request::builder()
        .method(Method::POST)
        .uri(&server.methods[index % server.methods.len()])
        .header(header::CONTENT_TYPE, "application/grpc")
        .header(header::TE, "trailers")
        .body(Body::from(body))
        .unwrap()
}

fuzz_target!(|input: &[u8]| {
    let &[method, choice, ref body @ ..] = input else { return };
    let server = &*SERVER;
    let (over_grpc, index) = (method % 2 == 1, usize::from(method / 2));
    let ids = server.runtime.block_on(ids(&server.service));
    let request = match over_grpc {
        true => grpc(server, &ids, index, choice, body),
        false => http(server, &ids, index, choice, body),
    };
    let named = format!("{} {}", request.method(), request.uri());
    server.runtime.block_on(async {
        let answer = async {
            let response = server.app.clone().oneshot(request).await.unwrap();
            let (head, body) = response.into_parts();
            let collected = body.collect().await;
            (head, collected)
        };
        let (head, collected) =
            tokio::time::timeout(PATIENCE, answer).await.unwrap_or_else(|_| panic!("{named} hangs"));
        assert_ne!(head.status.as_u16(), 500, "{named}");
        let trailers = collected.as_ref().ok().and_then(|body| body.trailers()).cloned().unwrap_or_default();
        if over_grpc {
            let status = head.headers.get("grpc-status").or_else(|| trailers.get("grpc-status"));
            // Neither UNKNOWN nor INTERNAL.
            assert!(status.is_none_or(|status| !["2", "13"].contains(&status.to_str().unwrap())), "{named}");
        }
        let bytes = collected.map(|body| body.to_bytes()).unwrap_or_default();
        let json = head
            .headers
            .get(header::CONTENT_TYPE)
            .is_some_and(|kind| kind.as_bytes().starts_with(b"application/json"));
        if json && !bytes.is_empty() {
            // NaN and infinity are no JSON.
            serde_json::from_slice::<serde_json::Value>(&bytes)
                .unwrap_or_else(|error| panic!("{named}: {error}"));
        }
        // What still runs for nobody has a moment to end.
        for _ in 0..1000 {
            if server.service.memory().used() == 0 {
                return;
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        panic!("{named} keeps {} bytes", server.service.memory().used());
    });
});
