//! Every route and RPC of the panel method, with plain clients over loopback.

use moldline_proto::v1::{self, panel_service_client::PanelServiceClient};
use moldline_testing::Wing;
use serde_json::{Value, json};
use tokio_stream::StreamExt;

use crate::{harness::Server, http::compare_routes_with_rpcs};

const ROOM: u64 = 256 << 20;

fn wing() -> Value {
    let mesh = Wing { half: true, ..Wing::rectangular(12, 8) }.mesh();
    let cells: Vec<&[u32]> = mesh.cells.iter().map(|cell| cell.vertices()).collect();
    json!({
        "cells": cells,
        "vertices": mesh.vertices,
        "cell_groups": { "wing": (0..cells.len()).collect::<Vec<_>>() },
        "vertex_groups": { "trailing_edge": mesh.vertex_groups[0].indices },
        "options": { "trailing_edges": { "groups": ["trailing_edge"] } },
    })
}

fn reference() -> Value {
    json!({ "area": 8.0, "chord": 1.0, "span": 8.0, "point": [0.25, 0.0, 0.0] })
}

async fn configuration(server: &Server) -> String {
    let created = server.json("POST", "/v1/configurations", wing()).await;
    assert_eq!(created.status, 201, "{}", String::from_utf8_lossy(&created.body));
    created.headers["location"].clone()
}

#[tokio::test]
async fn every_rpc_has_a_route_and_every_route_is_described() {
    compare_routes_with_rpcs(&Server::panels(ROOM).await, "moldline.v1.PanelService").await;
}

#[tokio::test]
async fn the_same_numbers_come_as_documents_arrays_events_and_messages() {
    let server = Server::panels(ROOM).await;
    let path = configuration(&server).await;
    let again = server.json("POST", "/v1/configurations", wing()).await;
    assert_eq!((again.status, &again.headers["location"]), (200, &path));
    let described = server.ask("GET", &path, &[], b"").await.json();
    assert_eq!(described["configuration"]["symmetric"], true);
    assert_eq!(described["configuration"]["components"], json!(["wing"]));

    let body =
        json!({ "mach": 0.3, "flows": [{ "alpha": 0.0 }, { "alpha": 0.05 }], "reference": reference() });
    let document = server.json("POST", &format!("{path}/analyze"), body.clone()).await.json();
    let lift =
        |analysis: &Value, flow: usize| analysis["flows"][flow]["coefficients"]["lift"].as_f64().unwrap();
    // The cells of a flat tip lie across the wing's plane, and are cut along one of their diagonals.
    assert!(lift(&document, 0).abs() < 1e-9 && (0.2..0.3).contains(&lift(&document, 1)), "{document}");
    let query = "mach=0.3&alpha=0,0.05&area=8&chord=1&span=8&point=0.25,0,0";
    let npy = [("accept", "application/x-npy"), ("content-type", "application/octet-stream")];
    let answer = server.ask("POST", &format!("{path}/analyze?{query}"), &npy, b"").await;
    assert_eq!(answer.headers["moldline-analysis-id"], document["analysis_id"].as_str().unwrap());
    let bytes = &answer.body[answer.body.len() - 8..];
    let last = document["flows"][0]["cp"].as_array().unwrap().last().unwrap().as_f64().unwrap();
    assert_eq!(f64::from_le_bytes(bytes.try_into().unwrap()), last);

    let events = [("accept", "text/event-stream"), ("content-type", "application/json")];
    let mut faster = body.clone();
    faster["mach"] = json!(0.4);
    let told = server.ask("POST", &format!("{path}/analyze"), &events, faster.to_string().as_bytes()).await;
    let told = String::from_utf8(told.body).unwrap();
    for stage in ["\"influence\"", "\"factorisation\"", "\"solution\"", "residual"] {
        assert!(told.contains(stage), "{told}");
    }
    assert_eq!(told.matches("event: analysis").count(), 1);

    let mut client = PanelServiceClient::new(server.channel().await);
    let request = v1::AnalyzeRequest {
        configuration_id: path.rsplit('/').next().unwrap().to_owned(),
        mach: 0.3,
        flows: vec![v1::FlowAngles { alpha: 0.05, sideslip: 0.0 }],
        reference: Some(v1::FlowReference { area: 8.0, chord: 1.0, span: 8.0, point: vec![0.25, 0.0, 0.0] }),
        ..Default::default()
    };
    let mut events = client.analyze(request).await.unwrap().into_inner();
    let mut last = None;
    while let Some(event) = events.next().await {
        last = event.unwrap().event;
    }
    let Some(v1::analyze_response::Event::Analysis(analysis)) = last else {
        panic!("the analysis is the last event")
    };
    assert!(analysis.reused);
    assert_eq!(analysis.flows[0].coefficients.unwrap().lift, lift(&document, 1));
}

#[tokio::test]
async fn products_are_each_others_transpose() {
    let server = Server::panels(ROOM).await;
    let path = configuration(&server).await;
    let body = json!({ "mach": 0.3, "flows": [{ "alpha": 0.05 }], "reference": reference() });
    let id = server.json("POST", &format!("{path}/analyze"), body).await.json()["analysis_id"].clone();
    let at = json!({ "analysis_id": id, "flow": { "alpha": 0.05 }, "reference": reference() });
    let seeds = json!([[1.0, -2.0, 0.5, 0.0, 3.0, 0.1, 0.0, 0.0, 0.0]]);
    let vjp = json!({ "at": at, "seeds": { "coefficients": seeds } });
    let vjp = server.json("POST", &format!("{path}/vjp"), vjp).await.json();
    let jvp = json!({ "at": at, "directions": { "alpha": [1.0], "mach": [0.5], "area": [0.25], "point": [[1.0, 0.0, 2.0]] } });
    let jvp = server.json("POST", &format!("{path}/jvp"), jvp).await.json();
    let row = |list: &Value| -> Vec<f64> {
        list.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
    };
    let dot = |one: Vec<f64>, other: Vec<f64>| one.iter().zip(&other).map(|(a, b)| a * b).sum::<f64>();
    let gradients = &vjp["gradients"];
    let one = |name: &str| gradients[name][0].as_f64().unwrap();
    let by_inputs = one("alpha")
        + 0.5 * one("mach")
        + 0.25 * one("area")
        + dot(row(&gradients["point"][0]), vec![1.0, 0.0, 2.0]);
    let by_outputs = dot(row(&seeds[0]), row(&jvp["changes"]["coefficients"][0]));
    assert!((by_inputs - by_outputs).abs() <= 1e-11 * by_outputs.abs(), "{by_inputs} {by_outputs}");
}

#[tokio::test]
async fn faults_are_named() {
    let server = Server::panels(ROOM).await;
    let problem = async |body: Value| server.json("POST", "/v1/configurations", body).await.problem();
    let fault = |code: &str, field: &str| (code.to_owned(), field.to_owned());
    let of = |(_, code, field): (u16, String, String)| (code, field);
    let mut open = wing();
    open["cells"].as_array_mut().unwrap().pop();
    open["cell_groups"] = json!({});
    let (code, field) = of(problem(open).await);
    assert!(code == "INVALID_ARGUMENT" && field.starts_with("cells["), "{field}");
    let mut unknown = wing();
    unknown["options"]["trailing_edges"]["groups"] = json!(["trailing"]);
    assert_eq!(of(problem(unknown).await).0, "INVALID_ARGUMENT");
    let mut short = wing();
    short["cells"][3] = json!([1, 2]);
    assert_eq!(of(problem(short).await), fault("INVALID_ARGUMENT", "cells[3]"));

    let path = configuration(&server).await;
    let analyze =
        async |body: Value| of(server.json("POST", &format!("{path}/analyze"), body).await.problem());
    let flows = json!([{ "alpha": 0.1 }]);
    assert_eq!(analyze(json!({ "flows": flows })).await, fault("INVALID_ARGUMENT", "reference"));
    assert_eq!(analyze(json!({ "reference": reference() })).await, fault("INVALID_ARGUMENT", "flows"));
    let slipping = json!([{ "alpha": 0.1, "sideslip": 0.1 }]);
    let slipping = json!({ "flows": slipping, "reference": reference() });
    assert_eq!(analyze(slipping).await, fault("INVALID_ARGUMENT", "flows[0].sideslip"));
    let fast = json!({ "mach": 1.5, "flows": flows, "reference": reference() });
    assert_eq!(analyze(fast).await, fault("INVALID_ARGUMENT", "mach"));
    let few = json!({ "vertices": [[0.0, 0.0, 0.0]], "flows": flows, "reference": reference() });
    assert_eq!(analyze(few).await, fault("INVALID_ARGUMENT", "vertices"));
    let vjp = json!({ "at": { "analysis_id": "none", "flow": {}, "reference": reference() }, "seeds": { "cp": [[1.0]] } });
    let vjp = server.json("POST", &format!("{path}/vjp"), vjp).await.problem();
    assert_eq!(of(vjp), fault("NOT_FOUND", "at.analysis_id"));
    let missing = server.ask("GET", "/v1/configurations/none", &[], b"").await.problem();
    assert_eq!(of(missing), fault("NOT_FOUND", "configuration_id"));
}

#[tokio::test]
async fn more_memory_than_there_is_is_refused_before_it_is_taken() {
    let server = Server::panels(1 << 16).await;
    let refused = server.json("POST", "/v1/configurations", wing()).await;
    let (status, code, _) = refused.problem();
    assert_eq!((status, code.as_str()), (429, "RESOURCE_EXHAUSTED"));
    assert!(!refused.headers.contains_key("retry-after"));
    let detail = refused.json()["detail"].as_str().unwrap().to_owned();
    assert!(detail.contains("bytes") && detail.contains("65536"), "{detail}");
}

#[tokio::test]
async fn metrics_tell_of_requests_and_memory() {
    let server = Server::panels(ROOM).await;
    configuration(&server).await;
    let metrics = String::from_utf8(server.ask("GET", "/metrics", &[], b"").await.body).unwrap();
    assert!(metrics.contains("rpc=\"CreateConfiguration\""), "{metrics}");
    assert!(metrics.contains("moldline_cache_budget_bytes{cache=\"analyses\"}"));
}
