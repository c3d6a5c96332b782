//! The gRPC transport of the mesh service: it wraps [`MeshApi`].

use std::pin::Pin;

use moldline_host::{Code, Principal, ServiceError};
use moldline_proto::{FILE_DESCRIPTOR_SET, v1};
use moldline_transport::{AnswerBytes, Deadline, Health, status};
use prost::Message;
use tokio::sync::mpsc;
use tokio_stream::{
    Stream, StreamExt,
    wrappers::{ReceiverStream, UnboundedReceiverStream},
};
use tonic::{Request, Response, Status, Streaming, service::Routes};
use tracing::{Instrument, Span};
use v1::{
    create_setup_response::Event,
    mesh_service_server::{MeshService, MeshServiceServer},
};

use crate::{
    api::{self, MeshApi},
    convert,
};

/// The name of the mesh service.
const SERVICE: &str = <MeshServiceServer<Grpc> as tonic::server::NamedService>::NAME;

/// The routes of the mesh service, which need a principal, and the open routes of [`open_routes`].
pub async fn routes(
    api: MeshApi,
    max_message: usize,
) -> Result<(Routes, Routes, Health), tonic_reflection::server::Error> {
    let (open, health) = open_routes(SERVICE).await?;
    let service = MeshServiceServer::new(Grpc { api })
        .max_decoding_message_size(max_message)
        .max_encoding_message_size(usize::MAX);
    let message = "this is Moldline's mesh service, not its panel service; name the address of a `moldline panel serve`";
    Ok((refusing(Routes::new(service), "/moldline.v1.PanelService/{method}", message), open, health))
}

/// The routes, and the answer to calls of the other service: clients that met the wrong one are told so.
pub fn refusing(routes: Routes, other: &str, message: &'static str) -> Routes {
    let refuse = move || async move { Status::unimplemented(message).into_http::<axum::body::Body>() };
    routes.into_axum_router().route(other, axum::routing::any(refuse)).into()
}

/// Routes of a service that need no principal: health, and reflection in both its versions.
pub async fn open_routes(service: &'static str) -> Result<(Routes, Health), tonic_reflection::server::Error> {
    let (health, answers) = Health::new(&[service]).await;
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
            .with_service_name(service)
            .with_service_name("grpc.health.v1.Health")
    };
    let open =
        Routes::new(answers).add_service(reflection().build_v1()?).add_service(reflection().build_v1alpha()?);
    Ok((open, health))
}

/// The mesh service on the wire.
pub struct Grpc {
    api: MeshApi,
}

/// Caller, deadline and message of a request.
pub fn open<T>(mut request: Request<T>) -> Result<(Principal, Deadline, T), Status> {
    let deadline = request.extensions().get().copied().unwrap_or_default();
    let caller = request
        .extensions_mut()
        .remove::<Principal>()
        .ok_or_else(|| status(ServiceError::new(Code::Internal, "the request was not authenticated")))?;
    Ok((caller, deadline, request.into_inner()))
}

type Checks = Pin<Box<dyn Stream<Item = Result<v1::CheckResponse, Status>> + Send>>;
type Columns = Pin<Box<dyn Stream<Item = Result<v1::JacobianResponse, Status>> + Send>>;
type Events = Pin<Box<dyn Stream<Item = Result<v1::CreateSetupResponse, Status>> + Send>>;

#[tonic::async_trait]
impl MeshService for Grpc {
    type CreateSetupStream = Events;

    async fn create_setup(
        &self,
        request: Request<Streaming<v1::CreateSetupRequest>>,
    ) -> Result<Response<Events>, Status> {
        let (caller, deadline, parts) = open(request)?;
        let (sender, events) = mpsc::unbounded_channel();
        let api = self.api.clone();
        let work = async move {
            let outcome = tokio::select! {
                outcome = deadline.limit(create_setup(&api, &caller, parts, &sender), status) => outcome,
                // The client has left: dropping this future cancels the upload and the build.
                () = sender.closed() => return,
            };
            let _ = sender.send(outcome.map(|created| event(Event::Created(created))));
        };
        tokio::spawn(work.instrument(Span::current()));
        Ok(Response::new(Box::pin(UnboundedReceiverStream::new(events))))
    }

    type JacobianStream = Columns;

    async fn jacobian(&self, request: Request<v1::JacobianRequest>) -> Result<Response<Columns>, Status> {
        let (caller, deadline, request) = open(request)?;
        let columns = ReceiverStream::new(self.api.jacobian(caller, deadline, request));
        let columns: Columns = Box::pin(columns.map(|block| block.map_err(status)));
        let mut response = Response::new(columns);
        response.extensions_mut().insert(AnswerBytes(api::WAITING_COLUMNS));
        Ok(response)
    }

    async fn get_setup(
        &self,
        request: Request<v1::GetSetupRequest>,
    ) -> Result<Response<v1::GetSetupResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.get_setup(&caller, request).await)
    }

    async fn list_setups(
        &self,
        request: Request<v1::ListSetupsRequest>,
    ) -> Result<Response<v1::ListSetupsResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.list_setups(&caller, request).await)
    }

    async fn share_setup(
        &self,
        request: Request<v1::ShareSetupRequest>,
    ) -> Result<Response<v1::ShareSetupResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.share_setup(&caller, request).await)
    }

    async fn delete_setup(
        &self,
        request: Request<v1::DeleteSetupRequest>,
    ) -> Result<Response<v1::DeleteSetupResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.delete_setup(&caller, request).await)
    }

    async fn open_session(
        &self,
        request: Request<v1::OpenSessionRequest>,
    ) -> Result<Response<v1::OpenSessionResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.open_session(&caller, request).await)
    }

    async fn get_session(
        &self,
        request: Request<v1::GetSessionRequest>,
    ) -> Result<Response<v1::GetSessionResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.get_session(&caller, request).await)
    }

    async fn list_sessions(
        &self,
        request: Request<v1::ListSessionsRequest>,
    ) -> Result<Response<v1::ListSessionsResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.list_sessions(&caller, request).await)
    }

    async fn update_session(
        &self,
        request: Request<v1::UpdateSessionRequest>,
    ) -> Result<Response<v1::UpdateSessionResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.update_session(&caller, request).await)
    }

    async fn close_session(
        &self,
        request: Request<v1::CloseSessionRequest>,
    ) -> Result<Response<v1::CloseSessionResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.close_session(&caller, request).await)
    }

    async fn deform(
        &self,
        request: Request<v1::DeformRequest>,
    ) -> Result<Response<v1::DeformResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.deform(&caller, request).await)
    }

    async fn apply_jacobian_vector(
        &self,
        request: Request<v1::ApplyJacobianVectorRequest>,
    ) -> Result<Response<v1::ApplyJacobianVectorResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.apply_jacobian_vector(&caller, request).await)
    }

    async fn apply_adjoint(
        &self,
        request: Request<v1::ApplyAdjointRequest>,
    ) -> Result<Response<v1::ApplyAdjointResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.apply_adjoint(&caller, request).await)
    }

    async fn get_status(
        &self,
        request: Request<v1::GetStatusRequest>,
    ) -> Result<Response<v1::GetStatusResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.get_status(&caller, request).await)
    }

    type CheckStream = Checks;

    async fn check(&self, request: Request<v1::CheckRequest>) -> Result<Response<Checks>, Status> {
        let (caller, deadline, request) = open(request)?;
        let events = UnboundedReceiverStream::new(self.api.check(caller, deadline, request));
        Ok(Response::new(Box::pin(events.map(|event| event.map_err(status)))))
    }
}

/// An answer or an error of the service, for tonic. Memory is taken for the answer before it is encoded.
pub fn answer<T: Message>(outcome: Result<T, ServiceError>) -> Result<Response<T>, Status> {
    let mut response = outcome.map(Response::new).map_err(status)?;
    let bytes = response.get_ref().encoded_len() as u64;
    response.extensions_mut().insert(AnswerBytes(bytes));
    Ok(response)
}

fn event(event: Event) -> v1::CreateSetupResponse {
    v1::CreateSetupResponse { event: Some(event) }
}

/// Receives and builds a set-up, and sends progress. The channel is unbounded, since events are few.
async fn create_setup(
    api: &MeshApi,
    caller: &Principal,
    mut parts: Streaming<v1::CreateSetupRequest>,
    events: &mpsc::UnboundedSender<Result<v1::CreateSetupResponse, Status>>,
) -> Result<v1::CreatedSetup, Status> {
    let header = match parts.message().await? {
        Some(part) => convert::setups::header(part).map_err(status)?,
        None => return Err(status(ServiceError::invalid("header", "is missing: nothing was sent"))),
    };
    let parts = parts.map(|part| {
        let chunk = convert::setups::chunk(part?).map_err(status)?;
        Ok((chunk.file as usize, chunk.data))
    });
    let tell = |progress| {
        let _ = events.send(Ok(event(Event::Progress(progress))));
    };
    api.create_setup(caller, header, parts, tell, status).await
}
