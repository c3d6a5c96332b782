//! Every route, with a plain client over loopback.

use moldline_mesh_service::Limits;
use moldline_transport::Access;
use serde_json::{Value, json};

use crate::harness::{Answer, Server, ball};

const NPY: &str = "application/x-npy";
const NPZ: &str = "application/x-npz";
const OCTETS: &str = "application/octet-stream";

/// A set-up of a ball that moves along x, and a session on it.
async fn session(server: &Server) -> (Value, String) {
    let created = upload(server, &[]).await;
    assert!(matches!(created.status, 200 | 201), "{created:?}");
    let created = created.json();
    let path = format!("/v1/setups/{}/sessions", created["setup_id"].as_str().unwrap());
    let opened = server.ask("POST", &path, &[], b"").await;
    assert_eq!(opened.status, 201);
    let id = opened.json()["session_id"].as_str().unwrap().to_owned();
    assert_eq!(opened.headers["location"], format!("/v1/sessions/{id}"));
    (created["setup"].clone(), format!("/v1/sessions/{id}"))
}

async fn upload(server: &Server, headers: &[(&str, &str)]) -> Answer {
    let mut headers = headers.to_vec();
    headers.push(("content-type", "application/json"));
    server.ask("POST", "/v1/setups", &headers, ball::setup_file("ball").as_bytes()).await
}

fn numbers(bytes: &[u8]) -> Vec<f64> {
    assert_eq!(bytes.len() % 8, 0);
    bytes.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()
}

fn little_endian(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

fn flat(list: &Value) -> Vec<f64> {
    match list {
        Value::Array(list) => list.iter().flat_map(flat).collect(),
        number => vec![number.as_f64().unwrap()],
    }
}

#[tokio::test]
async fn all_kinds_of_bodies_give_the_same_numbers() {
    let server = Server::start().await;
    let (setup, session) = session(&server).await;
    let (n, f) = (setup["vertex_count"].as_u64().unwrap(), setup["functions"].as_array().unwrap().len());
    let deform = format!("{session}/deform");

    let document =
        server.json("POST", &deform, json!({ "design": [0.5], "include_cell_quality": true })).await;
    assert_eq!(document.status, 200);
    let document = document.json();
    let vertices = flat(&document["vertices"]);
    assert_eq!(vertices.len() as u64, 3 * n);
    assert_eq!(document["cell_quality"]["skew"].as_array().unwrap().len() as u64, setup["cell_count"]);
    let named = server.json("POST", &deform, json!({ "design": { "ball.x": 0.5 } })).await.json();
    assert_eq!(flat(&named["vertices"]), vertices);

    // Plain bytes both ways.
    let design = little_endian(&[0.5]);
    let octets = server.ask("POST", &deform, &[("content-type", OCTETS), ("accept", OCTETS)], &design).await;
    assert_eq!(numbers(&octets.body), vertices);
    assert_eq!(octets.headers["moldline-shape"], format!("{n},3"));
    let id = octets.headers["moldline-linearisation-id"].clone();
    assert_eq!(id, document["linearisation_id"]);
    assert!(octets.headers["server-timing"].contains("engine;dur="));

    // .npy both ways: the same bytes follow the header.
    let mut file = moldline_transport::npy::header(moldline_proto::v1::DataType::Float64, &[1]);
    file.extend(&design);
    let npy = server.ask("POST", &deform, &[("content-type", NPY), ("accept", NPY)], &file).await;
    assert_eq!(npy.headers["content-type"], NPY);
    assert!(npy.body.starts_with(b"\x93NUMPY"));
    assert_eq!(npy.body[npy.body.len() - octets.body.len()..], octets.body);

    // All arrays in one file.
    let npz = server.ask("POST", &deform, &[("content-type", OCTETS), ("accept", NPZ)], &design).await;
    let mut archive = zip::ZipArchive::new(std::io::Cursor::new(npz.body)).unwrap();
    let mut member = |name: &str| {
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut archive.by_name(name).unwrap(), &mut bytes).unwrap();
        bytes
    };
    assert_eq!(member("vertices.npy"), npy.body);
    assert_eq!(numbers(&member("functions.npy")[128..]).len(), f);
    let info: Value = serde_json::from_slice(&member("info.json")).unwrap();
    assert_eq!(info["linearisation_id"], id.as_str());
    assert!(info.get("vertices").is_none());

    // The ball moves along x, and all its vertices with it.
    let jvp = format!("{session}/jvp?linearisation_id={id}");
    let tangent = server
        .ask("POST", &jvp, &[("content-type", OCTETS), ("accept", OCTETS)], &little_endian(&[1.0]))
        .await;
    assert_eq!(tangent.headers["moldline-shape"], format!("1,{n},3"));
    let tangent = numbers(&tangent.body);
    assert!(
        tangent.chunks(3).all(|x| (x[0] - 1.0).abs() < 1e-12 && x[1].abs() < 1e-12 && x[2].abs() < 1e-12)
    );
    let two = json!({ "at": { "linearisation_id": id }, "design": [[1.0], [2.0]] });
    let two = server.json("POST", &format!("{session}/jvp"), two).await.json();
    assert_eq!(flat(&two["vertices"][0]), tangent);
    assert_eq!(two["functions"].as_array().unwrap().len(), 2);

    let vjp = format!("{session}/vjp?linearisation_id={id}&include_design=true&control_points_of=ball");
    let ones = little_endian(&vec![1.0; 3 * n as usize]);
    let gradient = server.ask("POST", &vjp, &[("content-type", OCTETS)], &ones).await.json();
    assert!((gradient["design"][0][0].as_f64().unwrap() - n as f64).abs() < 1e-9);
    assert_eq!(gradient["control_points"][0]["component"], "ball");

    let at = json!({ "at": { "linearisation_id": id } });
    let whole = server.json("POST", &format!("{session}/jacobian"), at.clone()).await.json();
    assert_eq!((&whole["columns"], flat(&whole["vertices"])), (&json!(1), tangent.clone()));
    let text = at.to_string();
    let headers = [("content-type", "application/json"), ("accept", NPY)];
    let streamed = server.ask("POST", &format!("{session}/jacobian"), &headers, text.as_bytes()).await;
    assert_eq!(streamed.headers["content-length"], streamed.body.len().to_string());
    assert_eq!(numbers(&streamed.body[128..]), tangent);
}

#[tokio::test]
async fn a_set_up_and_its_sessions_live_and_end() {
    let server = Server::start().await;
    let created = upload(&server, &[]).await;
    assert_eq!(created.status, 201);
    let location = created.headers["location"].clone();
    assert_eq!(upload(&server, &[]).await.status, 200);

    let described = server.ask("GET", &location, &[], b"").await.json();
    assert_eq!(described["setup"], created.json()["setup"]);
    assert!(described.get("mesh").is_none());
    let cells = described["setup"]["cell_count"].as_u64().unwrap();
    let with_mesh = server.ask("GET", &format!("{location}?include_mesh=true"), &[], b"").await.json();
    assert_eq!(with_mesh["mesh"]["cells"].as_array().unwrap().len() as u64, cells);
    let shared = json!({ "visibility": "tenants", "shared_with": ["bert"] });
    let shared = server.json("PUT", &format!("{location}/access"), shared).await.json();
    assert_eq!(shared["access"], json!({ "owned": true, "visibility": "tenants", "shared_with": ["bert"] }));
    let listed = server.ask("GET", "/v1/setups", &[], b"").await.json();
    assert_eq!(listed["setups"].as_array().unwrap().len(), 1);

    let open = format!("{location}/sessions");
    let opened = server.json("POST", &open, json!({ "label": "one" })).await;
    let session = opened.headers["location"].clone();
    let generation = opened.json()["session"]["generation"].as_u64().unwrap();
    let update = json!({ "expected_generation": generation, "design": { "design": [0.25] } });
    let updated = server.json("PATCH", &session, update.clone()).await.json();
    assert_eq!(updated["session"]["generation"], generation + 1);
    let lost = server.json("PATCH", &session, update).await.problem();
    assert_eq!((lost.0, lost.1.as_str()), (409, "ABORTED"));
    let got = server.ask("GET", &session, &[], b"").await.json();
    assert_eq!(got["session"]["design"]["design"], json!([0.25]));
    assert_eq!(got["session"]["label"], "one");
    let design = server.ask("GET", &session, &[("accept", OCTETS)], b"").await;
    assert_eq!(numbers(&design.body), [0.25]);
    assert_eq!(
        server.ask("GET", "/v1/sessions", &[], b"").await.json()["sessions"].as_array().unwrap().len(),
        1
    );
    let status = server.ask("GET", "/v1/status", &[], b"").await.json();
    assert_eq!((&status["sessions"], &status["all_tenants"]), (&json!(1), &json!(true)));

    assert_eq!(server.ask("DELETE", &session, &[], b"").await.status, 204);
    let gone = server.ask("GET", &session, &[], b"").await.problem();
    assert_eq!((gone.0, gone.1.as_str()), (404, "NOT_FOUND"));
    assert_eq!(server.ask("DELETE", &location, &[], b"").await.status, 204);
    assert_eq!(server.ask("GET", &location, &[], b"").await.problem().0, 404);
}

#[tokio::test]
async fn progress_is_told_in_events() {
    let server = Server::start().await;
    let answer = upload(&server, &[("accept", "text/event-stream")]).await;
    assert_eq!((answer.status, answer.headers["content-type"].as_str()), (200, "text/event-stream"));
    let text = String::from_utf8(answer.body).unwrap();
    let events: Vec<(&str, Value)> = text
        .split_terminator("\n\n")
        .map(|event| {
            let (name, data) = event.split_once('\n').unwrap();
            let data = serde_json::from_str(data.strip_prefix("data: ").unwrap()).unwrap();
            (name.strip_prefix("event: ").unwrap(), data)
        })
        .collect();
    let (last, steps) = events.split_last().unwrap();
    assert_eq!(last.0, "created");
    assert!(last.1["setup_id"].is_string());
    assert!(steps.iter().all(|(name, _)| *name == "progress"));
    for stage in ["receive", "read", "seams"] {
        assert!(steps.iter().any(|(_, progress)| progress["stage"] == stage), "{stage}: {text}");
    }
    let refused = server
        .ask(
            "POST",
            "/v1/setups",
            &[("content-type", "application/json"), ("accept", "text/event-stream")],
            b"{}",
        )
        .await;
    assert!(String::from_utf8(refused.body).unwrap().contains("event: problem\ndata: {"));
}

#[tokio::test]
async fn an_operation_can_be_polled() {
    let server = Server::start().await;
    let accepted = upload(&server, &[("prefer", "respond-async")]).await;
    assert_eq!(accepted.status, 202);
    let location = accepted.headers["location"].clone();
    let done = server.eventually(&location, |operation| operation.json()["done"] == true).await.json();
    let setup = done["created"]["setup_id"].as_str().unwrap();
    assert_eq!(server.ask("GET", &format!("/v1/setups/{setup}"), &[], b"").await.status, 200);
    assert_eq!(server.ask("DELETE", &location, &[], b"").await.status, 204);
    assert_eq!(server.ask("GET", &location, &[], b"").await.problem().0, 404);

    let headers = [("content-type", "application/json"), ("prefer", "respond-async")];
    let refused = server.ask("POST", "/v1/setups", &headers, b"{\"format\": 99}").await;
    assert_eq!(refused.status, 202);
    let location = &refused.headers["location"];
    let operation = server.eventually(location, |operation| operation.json()["done"] == true).await.json();
    assert_eq!(operation["problem"]["code"], "INVALID_ARGUMENT");
}

#[tokio::test]
async fn bad_bodies_are_refused_before_they_cost_anything() {
    let limits = Limits { upload_bytes: 100_000, ..Limits::default() };
    let server = Server::with(Access::default(), limits).await;
    let json = ("content-type", "application/json");
    for (headers, body, expected) in [
        (&[json, ("content-length", "100001")][..], &b""[..], (413, "body")),
        (&[json, ("transfer-encoding", "chunked")], b"2\r\n{}\r\n0\r\n\r\n", (411, "content-length")),
        (&[("content-type", "text/plain")], b"{}", (415, "content-type")),
        (&[], b"{}", (415, "content-type")),
        (&[json, ("accept", "text/html")], b"{}", (406, "accept")),
        (&[json], b"{", (400, "setup.json")),
        (&[("content-type", "application/zip")], b"PK", (400, "archive")),
        (&[("content-type", "application/gzip")], b"\x1f\x8b", (400, "archive")),
    ] {
        let answer = server.ask("POST", "/v1/setups", headers, body).await;
        let (status, _, field) = answer.problem();
        assert_eq!((status, field.as_str()), expected, "{headers:?}");
    }

    let server = Server::start().await;
    let (_, session) = session(&server).await;
    let deform = format!("{session}/deform");
    let long = little_endian(&[0.0, 0.0]);
    let nan = little_endian(&[f64::NAN]);
    for (path, kind, body, expected) in [
        (deform.as_str(), "application/json", &b"{\"design\": [1, 2]}"[..], (400, "design")),
        (&deform, "application/json", b"{\"design\": [\"a\"]}", (400, "design[0]")),
        (&deform, "application/json", b"{\"design\": {\"a\": 1}}", (400, "design[\"a\"]")),
        (&deform, "application/json", b"{\"colour\": 1}", (400, "colour")),
        (&deform, "application/json", b"\xff\xfe", (400, "body")),
        (&deform, OCTETS, &long, (400, "design")),
        (&deform, OCTETS, b"1234567", (400, "design.data")),
        (&deform, OCTETS, &nan, (400, "design[0]")),
        (&deform, NPY, b"\x93NUMPY", (400, "design")),
        (&deform, NPZ, b"PK\x05\x06", (400, "body")),
        (&deform, "image/png", b"x", (415, "content-type")),
        (&format!("{deform}?shape=9999999999,9999999999"), OCTETS, &nan, (400, "design.shape")),
        (&format!("{deform}?shape=x"), OCTETS, &nan, (400, "shape")),
        (&format!("{deform}?colour=x"), OCTETS, &nan, (400, "query")),
        ("/v1/sessions/%ff/deform", "application/json", b"{}", (400, "path")),
        ("/v1/sessions/none/deform", "application/json", b"{}", (404, "session_id")),
        (&format!("{session}/vjp"), "application/json", b"{}", (400, "at")),
        (
            &format!("{session}/vjp"),
            "application/json",
            b"{\"at\": {\"design_point\": {}}}",
            (400, "vertices"),
        ),
        (&format!("{session}/jacobian"), "application/json", b"{}", (400, "at")),
    ] {
        let answer = server.ask("POST", path, &[("content-type", kind)], body).await;
        let (status, _, field) = answer.problem();
        assert_eq!(
            (status, field.as_str()),
            expected,
            "{path} {kind} {}",
            String::from_utf8_lossy(&answer.body)
        );
    }
    // Other requests are still served.
    assert_eq!(server.json("POST", &deform, serde_json::json!({})).await.status, 200);
}

#[tokio::test]
async fn what_is_around_the_service_answers() {
    let server = Server::start().await;
    assert_eq!(server.ask("GET", "/healthz", &[], b"").await.status, 200);
    assert_eq!(server.ask("GET", "/readyz", &[], b"").await.status, 200);
    server.health.end().await;
    assert_eq!(server.ask("GET", "/healthz", &[], b"").await.status, 200);
    assert_eq!(server.ask("GET", "/readyz", &[], b"").await.status, 503);

    let unknown = server.ask("GET", "/v1/nothing", &[("x-request-id", "mine-1")], b"").await;
    assert_eq!(unknown.problem().0, 404);
    assert_eq!(unknown.headers["x-request-id"], "mine-1");
    let odd = server.ask("GET", "/v1/status", &[("x-request-id", "a b\"c")], b"").await;
    assert_eq!(odd.headers["x-request-id"].len(), 32);
    assert_eq!(server.ask("PUT", "/v1/status", &[], b"").await.problem().0, 405);

    let metrics = String::from_utf8(server.ask("GET", "/metrics", &[], b"").await.body).unwrap();
    for line in [
        "moldline_requests_total{rpc=\"GetStatus\",transport=\"http\",code=\"OK\"}",
        "moldline_request_duration_seconds_bucket{rpc=\"GetStatus\",transport=\"http\",le=\"0.001\"}",
        "moldline_compute_running_limit 2",
        "moldline_cache_budget_bytes{cache=\"linearisations\"}",
    ] {
        assert!(metrics.contains(line), "{line}\n{metrics}");
    }
    assert!(!metrics.contains("/v1/nothing"), "names that nobody serves are not counted one by one");

    let docs = server.ask("GET", "/docs", &[], b"").await;
    let page = String::from_utf8(docs.body).unwrap();
    assert!(!page.contains("https://") && !page.contains("http://"), "the page needs no network");
}

#[tokio::test]
async fn pages_of_named_origins_may_call() {
    let server = Server::start().await;
    let preflight = async |origin| {
        let headers = [
            ("origin", origin),
            ("access-control-request-method", "POST"),
            ("access-control-request-headers", "content-type,x-grpc-web"),
        ];
        server.ask("OPTIONS", "/moldline.v1.MeshService/GetStatus", &headers, b"").await
    };
    let allowed = preflight("https://example.org").await;
    assert_eq!(allowed.headers["access-control-allow-origin"], "https://example.org");
    assert!(!preflight("https://example.com").await.headers.contains_key("access-control-allow-origin"));

    // gRPC-Web over HTTP/1.1: an empty message, and the status in the body's last frame.
    let headers = [("content-type", "application/grpc-web+proto"), ("x-grpc-web", "1")];
    let answer = server.ask("POST", "/moldline.v1.MeshService/GetStatus", &headers, &[0; 5]).await;
    assert_eq!(answer.status, 200);
    assert!(String::from_utf8_lossy(&answer.body).contains("grpc-status:0"));
}

#[tokio::test]
async fn deadlines_are_kept() {
    let server = Server::start().await;
    let late = upload(&server, &[("request-timeout", "0.000001")]).await.problem();
    assert_eq!((late.0, late.1.as_str()), (504, "DEADLINE_EXCEEDED"));
    let nonsense = upload(&server, &[("request-timeout", "soon")]).await.problem();
    assert_eq!((nonsense.0, nonsense.2.as_str()), (400, "request-timeout"));
    assert_eq!(upload(&server, &[("request-timeout", "60")]).await.status, 201);
    let late = upload(&server, &[("request-timeout", "0"), ("accept", "text/event-stream")]).await;
    assert_eq!(late.problem().0, 504);
}

#[tokio::test]
async fn every_rpc_has_a_route_and_every_route_is_described() {
    let server = Server::start().await;
    compare_routes_with_rpcs(&server, "moldline.v1.MeshService").await;
}

/// Checks that every RPC has a route. (The description is made from the routes, so it has them all.)
pub async fn compare_routes_with_rpcs(server: &Server, service: &str) {
    let described = server.ask("GET", "/openapi.json", &[], b"").await.json();
    assert!(described["openapi"].as_str().unwrap().starts_with("3.1"));
    let mut operations: Vec<String> = Vec::new();
    for (path, item) in described["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            operations.push(operation["operationId"].as_str().unwrap().to_owned());
            // A described route exists: it does not answer 404 or 405 for want of a route.
            let concrete = path.split('/').map(|part| if part.starts_with('{') { "x" } else { part });
            let concrete = concrete.collect::<Vec<_>>().join("/");
            let answer = server.ask(&method.to_uppercase(), &concrete, &[], b"").await;
            assert_ne!(answer.status, 405, "{method} {path}");
            let nothing = String::from_utf8_lossy(&answer.body).contains("there is nothing at this path");
            assert!(!nothing, "{method} {path}");
        }
    }
    use prost::Message;
    let files = prost_types::FileDescriptorSet::decode(moldline_proto::FILE_DESCRIPTOR_SET).unwrap();
    let services = files.file.iter().flat_map(|file| &file.service);
    let named = services.filter(|known| service.ends_with(&format!(".{}", known.name()))).collect::<Vec<_>>();
    assert_eq!(named.len(), 1);
    for rpc in &named[0].method {
        assert!(operations.iter().any(|name| name == rpc.name()), "{} has no route", rpc.name());
    }
}

/// The page is open to everybody, runs nothing but its own files, and is not sent twice.
#[tokio::test]
async fn the_page_is_served_under_a_strict_policy() {
    let server = Server::start().await;
    let page = server.ask("GET", "/", &[], b"").await;
    assert_eq!(page.status, 200);
    assert_eq!(page.headers["content-type"], "text/html; charset=utf-8");
    let policy = &page.headers["content-security-policy"];
    assert!(policy.starts_with("default-src 'none'") && !policy.contains("unsafe"), "{policy}");
    let text = String::from_utf8(page.body.clone()).unwrap();
    assert!(!text.contains("://") && !text.contains("<style") && !text.contains("style="), "{text}");
    for link in ["page.js", "page.css"] {
        assert!(text.contains(&format!("\"./{link}\"")), "{text}");
        let file = server.ask("GET", &format!("/{link}"), &[], b"").await;
        assert_eq!(file.status, 200, "{link}");
        assert_eq!(file.headers["cache-control"], "no-cache");
        let tag = &file.headers["etag"];
        let again = server.ask("GET", &format!("/{link}"), &[("if-none-match", tag)], b"").await;
        assert_eq!((again.status, again.body.len()), (304, 0), "{link}");
    }
}
