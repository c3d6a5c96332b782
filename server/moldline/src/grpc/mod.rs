//! The gRPC transport: thin. What a message means is in `convert`, what an error becomes in `status`.

mod convert;
mod status;
#[cfg(test)]
mod tests;

use std::{pin::Pin, sync::Arc};

use moldline_proto::{FILE_DESCRIPTOR_SET, v1};
use moldline_service::{At, Principal, Product, Service, ServiceError, SetupView, UploadHeader, Wanted};
use tokio::sync::mpsc;
use tokio_stream::{
    Stream,
    wrappers::{ReceiverStream, UnboundedReceiverStream},
};
use tonic::{Request, Response, Status, Streaming, transport::server::Router};
use tonic_health::server::HealthReporter;
use v1::mesh_service_server::{MeshService, MeshServiceServer};

use status::refuse;

/// All gRPC services of the server: the meshes, health, and reflection in both its versions.
pub async fn router(
    service: Arc<Service>,
    max_message: usize,
) -> Result<(Router, Health), tonic_reflection::server::Error> {
    let (reporter, health) = tonic_health::server::health_reporter();
    reporter.set_serving::<MeshServiceServer<Grpc>>().await;
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    let meshes = MeshServiceServer::new(Grpc { service })
        .max_decoding_message_size(max_message)
        .max_encoding_message_size(usize::MAX);
    let router = tonic::transport::Server::builder()
        // A mesh goes up without waiting for acknowledgements.
        .initial_stream_window_size(Some(4 << 20))
        .initial_connection_window_size(Some(16 << 20))
        // Clients that vanish without a word lose interest in what they asked for.
        .http2_keepalive_interval(Some(std::time::Duration::from_secs(30)))
        .add_service(meshes)
        .add_service(health)
        .add_service(reflection().build_v1()?)
        .add_service(reflection().build_v1alpha()?);
    Ok((router, Health(reporter)))
}

/// What health probes are told.
pub struct Health(HealthReporter);

impl Health {
    /// Not serving any more, as a whole and the mesh service.
    pub async fn end(&self) {
        self.0.set_not_serving::<MeshServiceServer<Grpc>>().await;
        self.0.set_service_status("", tonic_health::ServingStatus::NotServing).await;
    }
}

/// The mesh service on the wire.
pub struct Grpc {
    service: Arc<Service>,
}

/// Who calls, as authentication found it; everybody, where there is none.
fn caller<T>(request: &Request<T>) -> Principal {
    request.extensions().get().cloned().unwrap_or_else(Principal::local)
}

type Columns = Pin<Box<dyn Stream<Item = Result<v1::JacobianResponse, Status>> + Send>>;
type Events = Pin<Box<dyn Stream<Item = Result<v1::CreateSetupResponse, Status>> + Send>>;

#[tonic::async_trait]
impl MeshService for Grpc {
    type CreateSetupStream = Events;

    async fn create_setup(
        &self,
        request: Request<Streaming<v1::CreateSetupRequest>>,
    ) -> Result<Response<Events>, Status> {
        let caller = caller(&request);
        let (sender, events) = mpsc::unbounded_channel();
        let service = Arc::clone(&self.service);
        tokio::spawn(async move {
            let outcome = tokio::select! {
                outcome = create_setup(&service, &caller, request.into_inner(), &sender) => outcome,
                // The client has gone: the upload and the interest in the build go with this future.
                () = sender.closed() => return,
            };
            let _ = sender.send(outcome);
        });
        Ok(Response::new(Box::pin(UnboundedReceiverStream::new(events))))
    }

    async fn get_setup(
        &self,
        request: Request<v1::GetSetupRequest>,
    ) -> Result<Response<v1::GetSetupResponse>, Status> {
        let caller = caller(&request);
        let request = request.into_inner();
        let SetupView { setup, access } =
            self.service.get_setup(&caller, &request.setup_id).await.map_err(refuse)?;
        let mesh = request.include_mesh.then(|| convert::mesh(&setup));
        let control_points = match request.include_control_points {
            true => convert::control_points(&setup).map_err(refuse)?,
            false => Vec::new(),
        };
        let setup = Some(convert::description(&setup, &access));
        Ok(Response::new(v1::GetSetupResponse { setup, mesh, control_points }))
    }

    async fn list_setups(
        &self,
        request: Request<v1::ListSetupsRequest>,
    ) -> Result<Response<v1::ListSetupsResponse>, Status> {
        let caller = caller(&request);
        let v1::ListSetupsRequest { page_size, page_token } = request.into_inner();
        let page = convert::page(page_size, page_token);
        let listed = self.service.list_setups(&caller, &page).await.map_err(refuse)?;
        Ok(Response::new(convert::listed_setups(listed)))
    }

    async fn share_setup(
        &self,
        request: Request<v1::ShareSetupRequest>,
    ) -> Result<Response<v1::ShareSetupResponse>, Status> {
        let caller = caller(&request);
        let request = request.into_inner();
        let visibility = convert::visibility("", request.visibility, request.shared_with).map_err(refuse)?;
        let visibility = visibility.ok_or_else(|| ServiceError::invalid("visibility", "is missing"));
        let access = self.service.share_setup(&caller, &request.setup_id, visibility.map_err(refuse)?).await;
        let access = Some(convert::access(&access.map_err(refuse)?));
        Ok(Response::new(v1::ShareSetupResponse { access }))
    }

    async fn delete_setup(
        &self,
        request: Request<v1::DeleteSetupRequest>,
    ) -> Result<Response<v1::DeleteSetupResponse>, Status> {
        let caller = caller(&request);
        self.service.delete_setup(&caller, &request.into_inner().setup_id).await.map_err(refuse)?;
        Ok(Response::new(v1::DeleteSetupResponse {}))
    }

    async fn open_session(
        &self,
        request: Request<v1::OpenSessionRequest>,
    ) -> Result<Response<v1::OpenSessionResponse>, Status> {
        let caller = caller(&request);
        let v1::OpenSessionRequest { setup_id, request_id, label } = request.into_inner();
        let session = self.service.open_session(&caller, &setup_id, &label, &request_id).await;
        let session = session.map_err(refuse)?;
        let session_id = session.id.clone();
        Ok(Response::new(v1::OpenSessionResponse { session_id, session: Some(convert::session(session)) }))
    }

    async fn get_session(
        &self,
        request: Request<v1::GetSessionRequest>,
    ) -> Result<Response<v1::GetSessionResponse>, Status> {
        let caller = caller(&request);
        let session = self.service.get_session(&caller, &request.into_inner().session_id).await;
        let session = Some(convert::session(session.map_err(refuse)?));
        Ok(Response::new(v1::GetSessionResponse { session }))
    }

    async fn list_sessions(
        &self,
        request: Request<v1::ListSessionsRequest>,
    ) -> Result<Response<v1::ListSessionsResponse>, Status> {
        let caller = caller(&request);
        let v1::ListSessionsRequest { page_size, page_token } = request.into_inner();
        let page = convert::page(page_size, page_token);
        let listed = self.service.list_sessions(&caller, &page).await.map_err(refuse)?;
        Ok(Response::new(convert::listed_sessions(listed)))
    }

    async fn update_session(
        &self,
        request: Request<v1::UpdateSessionRequest>,
    ) -> Result<Response<v1::UpdateSessionResponse>, Status> {
        let caller = caller(&request);
        let request = request.into_inner();
        let session_id = request.session_id.clone();
        let update = convert::update(request).map_err(refuse)?;
        let session = self.service.update_session(&caller, &session_id, update).await.map_err(refuse)?;
        Ok(Response::new(v1::UpdateSessionResponse { session: Some(convert::session(session)) }))
    }

    async fn close_session(
        &self,
        request: Request<v1::CloseSessionRequest>,
    ) -> Result<Response<v1::CloseSessionResponse>, Status> {
        let caller = caller(&request);
        self.service.close_session(&caller, &request.into_inner().session_id).await.map_err(refuse)?;
        Ok(Response::new(v1::CloseSessionResponse {}))
    }

    async fn deform(
        &self,
        request: Request<v1::DeformRequest>,
    ) -> Result<Response<v1::DeformResponse>, Status> {
        let caller = caller(&request);
        let v1::DeformRequest { session_id, input, control_points, include_cell_quality } =
            request.into_inner();
        let design = convert::design(input, control_points).map_err(refuse)?;
        let deformed = self.service.deform(&caller, &session_id, design).await.map_err(refuse)?;
        Ok(Response::new(convert::deformed(&deformed, include_cell_quality)))
    }

    async fn apply_jacobian_vector(
        &self,
        request: Request<v1::ApplyJacobianVectorRequest>,
    ) -> Result<Response<v1::ApplyJacobianVectorResponse>, Status> {
        let caller = caller(&request);
        let v1::ApplyJacobianVectorRequest { session_id, at, design, control_points } = request.into_inner();
        let at = convert::at(at).map_err(refuse)?;
        let directions = convert::directions(design, control_points).map_err(refuse)?;
        let product = self.service.jvp(&caller, &session_id, at, directions).await.map_err(refuse)?;
        Ok(Response::new(convert::jvp(&product)))
    }

    async fn apply_adjoint(
        &self,
        request: Request<v1::ApplyAdjointRequest>,
    ) -> Result<Response<v1::ApplyAdjointResponse>, Status> {
        let caller = caller(&request);
        let request = request.into_inner();
        let at = convert::at(request.at).map_err(refuse)?;
        let seeds = convert::seeds(request.vertices, request.functions).map_err(refuse)?;
        let wanted = Wanted { design: request.include_design, control_points: request.control_points_of };
        let product = self.service.vjp(&caller, &request.session_id, at, seeds, wanted).await;
        Ok(Response::new(convert::vjp(&product.map_err(refuse)?)))
    }

    type JacobianStream = Columns;

    async fn jacobian(&self, request: Request<v1::JacobianRequest>) -> Result<Response<Columns>, Status> {
        let caller = caller(&request);
        let v1::JacobianRequest { session_id, at } = request.into_inner();
        let at = convert::at(at).map_err(refuse)?;
        // A client that reads slowly holds up its own columns only, and few of them are waiting.
        let (sender, columns) = mpsc::channel(4);
        let service = Arc::clone(&self.service);
        tokio::spawn(async move {
            let outcome = tokio::select! {
                outcome = jacobian(&service, &caller, &session_id, at, &sender) => outcome,
                // The client has gone, and with this future the interest in what is computed.
                () = sender.closed() => return,
            };
            if let Err(error) = outcome {
                let _ = sender.send(Err(refuse(error))).await;
            }
        });
        Ok(Response::new(Box::pin(ReceiverStream::new(columns))))
    }

    async fn get_status(
        &self,
        request: Request<v1::GetStatusRequest>,
    ) -> Result<Response<v1::GetStatusResponse>, Status> {
        let status = self.service.status(&caller(&request)).await.map_err(refuse)?;
        Ok(Response::new(convert::status(status)))
    }
}

/// Computes the columns in large blocks, and sends them in messages of about 1 MiB.
async fn jacobian(
    service: &Service,
    caller: &Principal,
    session_id: &str,
    at: At,
    sender: &mpsc::Sender<Result<v1::JacobianResponse, Status>>,
) -> Result<(), ServiceError> {
    const MESSAGE: usize = 1 << 20;
    let Product { value: at, mut timing } = service.linearised(caller, session_id, at).await?;
    let columns = at.columns();
    let mut first = 0;
    while first < columns {
        let block = service.jacobian(caller, &at, first).await?;
        timing = timing + block.timing;
        let bytes = block.value.first().map_or(1, |column| size_of_val(&column.vertices[..]).max(1));
        for some in block.value.chunks((MESSAGE / bytes).max(1)) {
            let message = convert::jacobian(first, columns, some, std::mem::take(&mut timing));
            first += some.len();
            if sender.send(Ok(message)).await.is_err() {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// Receives, builds, and tells about it. Events are few, so the channel need not be bounded.
async fn create_setup(
    service: &Service,
    caller: &Principal,
    mut parts: Streaming<v1::CreateSetupRequest>,
    events: &mpsc::UnboundedSender<Result<v1::CreateSetupResponse, Status>>,
) -> Result<v1::CreateSetupResponse, Status> {
    let tell = |progress| {
        let _ = events.send(Ok(convert::progress(progress)));
    };
    let header = header(parts.message().await?).map_err(refuse)?;
    let mut receiving = service.receive(caller, header).map_err(refuse)?;
    let mut told = 0.0;
    tell(receiving.progress());
    while let Some(part) = parts.message().await? {
        let chunk = convert::chunk(part).map_err(refuse)?;
        receiving.append(chunk.file as usize, &chunk.data).map_err(refuse)?;
        let progress = receiving.progress();
        if progress.fraction >= told + 0.01 {
            told = progress.fraction;
            tell(progress);
        }
    }
    let uploaded = receiving.finish().map_err(refuse)?;
    let created = service.create_setup(caller, uploaded, tell).await.map_err(refuse)?;
    Ok(convert::created(&created))
}

fn header(first: Option<v1::CreateSetupRequest>) -> Result<UploadHeader, ServiceError> {
    match first {
        Some(part) => convert::header(part),
        None => Err(ServiceError::invalid("header", "is missing: nothing was sent")),
    }
}
