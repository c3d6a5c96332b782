//! The transport, with a real client over loopback.

use std::{net::SocketAddr, sync::Arc};

use moldline_proto::v1::{
    self, create_setup_request::Part, create_setup_response::Event, deform_request::Input,
    mesh_service_client::MeshServiceClient,
};
use moldline_service::{Limits, PoolLimits, Service};
use tokio::net::TcpListener;
use tokio_stream::{StreamExt, wrappers::TcpListenerStream};
use tonic::{Code, Status, transport::Channel};
use tonic_health::pb::{
    HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient,
};
use tonic_reflection::pb::{v1 as reflection, v1alpha as reflection_alpha};
use tonic_types::StatusExt;

use super::*;

#[path = "../../../service/tests/ball/mod.rs"]
mod ball;

async fn serve() -> (Channel, Health) {
    let pool = PoolLimits { threads: 2, running: 2, queued: 8 };
    let service = Arc::new(Service::new(pool, Limits::default()).unwrap());
    let (router, health) = router(service, 64 << 20).await.unwrap();
    let listener = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], 0))).await.unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(router.serve_with_incoming(TcpListenerStream::new(listener)));
    let channel = Channel::from_shared(format!("http://{address}")).unwrap().connect().await.unwrap();
    (channel, health)
}

fn header(file: &str) -> Part {
    let entry = v1::FileEntry { path: "setup.json".to_owned(), size: file.len() as u64 };
    let source = v1::setup_header::Source::Files(v1::FileList { files: vec![entry] });
    Part::Header(v1::SetupHeader { source: Some(source), ..Default::default() })
}

fn chunk(data: &[u8]) -> Part {
    Part::Chunk(v1::SetupChunk { file: 0, data: data.to_vec() })
}

async fn create(client: &mut MeshServiceClient<Channel>, parts: Vec<Part>) -> Result<Vec<Event>, Status> {
    let requests = parts.into_iter().map(|part| v1::CreateSetupRequest { part: Some(part) });
    let mut events =
        client.create_setup(tokio_stream::iter(requests.collect::<Vec<_>>())).await?.into_inner();
    let mut seen = Vec::new();
    while let Some(event) = events.message().await? {
        seen.extend(event.event);
    }
    Ok(seen)
}

fn field(status: &Status) -> String {
    status.get_error_details().bad_request().unwrap().field_violations[0].field.clone()
}

#[tokio::test]
async fn a_set_up_goes_up_in_chunks_and_comes_back_described() {
    let (channel, _) = serve().await;
    let mut client = MeshServiceClient::new(channel);
    let file = ball::setup_file("ball");
    let mut parts = vec![header(&file)];
    parts.extend(file.as_bytes().chunks(1000).map(chunk));
    let events = create(&mut client, parts).await.unwrap();
    let Some((Event::Created(created), steps)) = events.split_last() else { panic!("the result comes last") };
    assert!(steps.iter().all(|step| matches!(step, Event::Progress(_))));
    let description = created.setup.clone().unwrap();
    assert_eq!(description.name, "ball");
    assert_eq!(description.variables[0].name, "ball.x");
    assert_eq!(description.variables[0].upper, 2.0);

    let request = v1::GetSetupRequest { setup_id: created.setup_id.clone(), include_mesh: true };
    let got = client.get_setup(request).await.unwrap().into_inner();
    assert_eq!(got.setup, Some(description.clone()));
    let mesh = got.mesh.unwrap();
    assert_eq!(mesh.vertices.unwrap().shape, [description.vertex_count, 3]);
    assert_eq!(mesh.cells.unwrap().data.len() as u64, description.cell_count * 16);

    let request = v1::OpenSessionRequest { setup_id: created.setup_id.clone(), request_id: String::new() };
    let session_id = client.open_session(request).await.unwrap().into_inner().session_id;
    let values = v1::NamedDesign { values: [("ball.x".to_owned(), 0.5)].into() };
    let request = v1::DeformRequest {
        session_id: session_id.clone(),
        input: Some(Input::Named(values)),
        control_points: Vec::new(),
        include_cell_quality: true,
    };
    let deformed = client.deform(request.clone()).await.unwrap().into_inner();
    let vertices = deformed.vertices.unwrap();
    assert_eq!(vertices.data.len() as u64, description.vertex_count * 24);
    assert_eq!(deformed.cell_quality.unwrap().skew.unwrap().shape, [description.cell_count]);
    assert_eq!(deformed.quality.unwrap().total.unwrap().cells, description.cell_count);

    client.close_session(v1::CloseSessionRequest { session_id }).await.unwrap();
    let status = client.deform(request).await.unwrap_err();
    assert_eq!((status.code(), field(&status)), (Code::NotFound, "session_id".to_owned()));
}

#[tokio::test]
async fn uploads_out_of_order_are_refused_by_field() {
    let (channel, _) = serve().await;
    let mut client = MeshServiceClient::new(channel);
    let file = "{}";
    for (parts, expected) in [
        (vec![], "header"),
        (vec![chunk(b"{}")], "header"),
        (vec![header(file), header(file)], "chunk"),
        (vec![header(file), chunk(b"{")], "header.files[0].size"),
        (vec![header(file), chunk(b"{}}")], "chunk.data"),
        (vec![header(file), chunk(&vec![0; (1 << 20) + 1])], "chunk.data"),
        (vec![Part::Header(v1::SetupHeader::default())], "header.source"),
    ] {
        let status = create(&mut client, parts).await.unwrap_err();
        assert_eq!((status.code(), field(&status).as_str()), (Code::InvalidArgument, expected));
    }
}

#[tokio::test]
async fn health_changes_when_the_end_is_near() {
    let (channel, health) = serve().await;
    let mut client = HealthClient::new(channel);
    let services = ["", "moldline.v1.MeshService"];
    for service in services {
        let request = HealthCheckRequest { service: service.to_owned() };
        assert_eq!(client.check(request).await.unwrap().into_inner().status(), ServingStatus::Serving);
    }
    health.end().await;
    for service in services {
        let request = HealthCheckRequest { service: service.to_owned() };
        assert_eq!(client.check(request).await.unwrap().into_inner().status(), ServingStatus::NotServing);
    }
}

#[tokio::test]
async fn both_versions_of_reflection_name_the_service() {
    let (channel, _) = serve().await;
    let name = "moldline.v1.MeshService".to_owned();
    let request = reflection::ServerReflectionRequest {
        host: String::new(),
        message_request: Some(reflection::server_reflection_request::MessageRequest::FileContainingSymbol(
            name.clone(),
        )),
    };
    let mut client = reflection::server_reflection_client::ServerReflectionClient::new(channel.clone());
    let mut answers =
        client.server_reflection_info(tokio_stream::iter([request])).await.unwrap().into_inner();
    let answer = answers.next().await.unwrap().unwrap().message_response.unwrap();
    use reflection::server_reflection_response::MessageResponse;
    assert!(matches!(answer, MessageResponse::FileDescriptorResponse(_)));

    use reflection_alpha::server_reflection_request::MessageRequest;
    let request = reflection_alpha::ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::FileContainingSymbol(name)),
    };
    let mut client = reflection_alpha::server_reflection_client::ServerReflectionClient::new(channel);
    let mut answers =
        client.server_reflection_info(tokio_stream::iter([request])).await.unwrap().into_inner();
    let answer = answers.next().await.unwrap().unwrap().message_response.unwrap();
    use reflection_alpha::server_reflection_response::MessageResponse as Alpha;
    assert!(matches!(answer, Alpha::FileDescriptorResponse(_)));
}
