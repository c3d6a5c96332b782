//! The gRPC transport, with a real client over loopback.

use moldline_proto::v1::{
    self, create_setup_request::Part, create_setup_response::Event, deform_request::Input,
    mesh_service_client::MeshServiceClient,
};
use moldline_transport::Health;
use tokio_stream::StreamExt;
use tonic::{Code, Status, transport::Channel};
use tonic_health::pb::{
    HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient,
};
use tonic_reflection::pb::{v1 as reflection, v1alpha as reflection_alpha};
use tonic_types::StatusExt;

use crate::harness::{Server, ball};

async fn serve() -> (Channel, Health) {
    let server = Server::start().await;
    (server.channel().await, server.health)
}

fn header(file: &str) -> Part {
    let entry = v1::FileEntry { path: "setup.json".to_owned(), size: file.len() as u64 };
    let source = v1::setup_header::Source::Files(v1::FileList { files: vec![entry] });
    Part::Header(v1::SetupHeader { source: Some(source), ..Default::default() })
}

fn chunk(data: &[u8]) -> Part {
    Part::Chunk(v1::SetupChunk { file: 0, data: data.to_vec().into() })
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

    let request = v1::GetSetupRequest {
        setup_id: created.setup_id.clone(),
        include_mesh: true,
        include_control_points: false,
    };
    let got = client.get_setup(request).await.unwrap().into_inner();
    assert_eq!(got.setup, Some(description.clone()));
    let mesh = got.mesh.unwrap();
    assert_eq!(mesh.vertices.unwrap().shape, [description.vertex_count, 3]);
    assert_eq!(mesh.cells.unwrap().data.len() as u64, description.cell_count * 16);

    let request = v1::OpenSessionRequest { setup_id: created.setup_id.clone(), ..Default::default() };
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

    let functions = deformed.functions.unwrap();
    assert_eq!(functions.shape, [description.functions.len() as u64]);
    derivatives(&mut client, &description, &session_id, deformed.linearisation_id).await;

    client.close_session(v1::CloseSessionRequest { session_id }).await.unwrap();
    let status = client.deform(request).await.unwrap_err();
    assert_eq!((status.code(), field(&status)), (Code::NotFound, "session_id".to_owned()));
}

/// The ball moves along x, and all its vertices with it, by one metre per metre.
async fn derivatives(
    client: &mut MeshServiceClient<Channel>,
    description: &v1::SetupDescription,
    session_id: &str,
    linearisation_id: String,
) {
    let (n, f) = (description.vertex_count, description.functions.len() as u64);
    let at = Some(v1::LinearisationPoint { linearisation_id, design_point: None });
    let session_id = session_id.to_owned();
    let ones = |shape: &[u64]| v1::Array {
        dtype: v1::DataType::Float64.into(),
        shape: shape.to_vec(),
        data: (0..shape.iter().product()).flat_map(|_| 1.0_f64.to_le_bytes()).collect(),
    };
    let numbers = |array: &v1::Array| -> Vec<f64> {
        array.data.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()
    };

    let request = v1::ApplyJacobianVectorRequest {
        session_id: session_id.clone(),
        at: at.clone(),
        design: Some(ones(&[2, 1])),
        control_points: Vec::new(),
    };
    let tangents = client.apply_jacobian_vector(request).await.unwrap().into_inner();
    let (of_vertices, of_functions) = (tangents.vertices.unwrap(), tangents.functions.unwrap());
    assert_eq!((of_vertices.shape.clone(), of_functions.shape), (vec![2, n, 3], vec![2, f]));
    assert!(numbers(&of_vertices).chunks(3).all(|x| (x[0] - 1.0).abs() < 1e-12 && x[1].abs() < 1e-12));

    let request = v1::ApplyAdjointRequest {
        session_id: session_id.clone(),
        at: at.clone(),
        vertices: Some(ones(&[1, n, 3])),
        functions: None,
        include_design: true,
        control_points_of: vec!["ball".to_owned()],
    };
    let gradients = client.apply_adjoint(request.clone()).await.unwrap().into_inner();
    assert!((numbers(&gradients.design.unwrap())[0] - n as f64).abs() < 1e-9);
    let by_points = gradients.control_points[0].vectors.clone().unwrap();
    assert_eq!(by_points.shape, [1, description.control_point_counts[0], 3]);
    let status = client
        .apply_adjoint(v1::ApplyAdjointRequest { vertices: Some(ones(&[1, n + 1, 3])), ..request })
        .await
        .unwrap_err();
    assert_eq!((status.code(), field(&status).as_str()), (Code::InvalidArgument, "vertices.shape[1]"));

    let request = v1::JacobianRequest { session_id: session_id.clone(), at };
    let mut blocks = client.jacobian(request).await.unwrap().into_inner();
    let block = blocks.message().await.unwrap().unwrap();
    assert_eq!((block.first, block.columns), (0, 1));
    assert_eq!(numbers(&block.vertices.unwrap()), numbers(&of_vertices)[..3 * n as usize]);
    assert!(blocks.message().await.unwrap().is_none());

    let at = v1::LinearisationPoint { linearisation_id: "none".to_owned(), design_point: None };
    let request = v1::JacobianRequest { session_id, at: Some(at) };
    let status = client.jacobian(request).await.unwrap().into_inner().message().await.unwrap_err();
    assert_eq!((status.code(), field(&status).as_str()), (Code::NotFound, "at.linearisation_id"));
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
