//! The mesh service in messages: what both transports call. What a message means is in `convert`.

use std::sync::Arc;

use bytes::Bytes;
use moldline_proto::v1;
use moldline_service::{Principal, Product, Service, ServiceError, SetupView, UploadHeader, Wanted};
use moldline_transport::Deadline;
use tokio::sync::mpsc;
use tokio_stream::{Stream, StreamExt};
use tracing::{Instrument, Span};

use crate::convert;

/// The mesh service, message by message.
#[derive(Clone, Debug)]
pub struct Meshes {
    service: Arc<Service>,
}

type Answer<T> = Result<T, ServiceError>;

impl Meshes {
    pub fn new(service: Arc<Service>) -> Self {
        Self { service }
    }

    /// The service behind it.
    pub fn service(&self) -> &Service {
        &self.service
    }

    /// Receives, builds, and tells about it. `parts` are the bytes to come, each with the index of its file; `refuse` makes
    /// an error of the transport.
    pub async fn create_setup<E>(
        &self,
        caller: &Principal,
        header: UploadHeader,
        mut parts: impl Stream<Item = Result<(usize, Bytes), E>> + Unpin,
        mut tell: impl FnMut(v1::Progress),
        refuse: impl Fn(ServiceError) -> E,
    ) -> Result<v1::CreatedSetup, E> {
        let mut receiving = self.service.receive(caller, header).map_err(&refuse)?;
        let mut told = 0.0;
        tell(convert::progress(receiving.progress()));
        while let Some((file, data)) = parts.next().await.transpose()? {
            receiving.append(file, &data).map_err(&refuse)?;
            let progress = receiving.progress();
            if progress.fraction >= told + 0.01 {
                told = progress.fraction;
                tell(convert::progress(progress));
            }
        }
        let uploaded = receiving.finish().map_err(&refuse)?;
        let tell = |progress| tell(convert::progress(progress));
        let created = self.service.create_setup(caller, uploaded, tell).await.map_err(refuse)?;
        Span::current().record("setup", created.setup.id.as_str());
        Ok(convert::created(&created))
    }

    pub async fn get_setup(
        &self,
        caller: &Principal,
        request: v1::GetSetupRequest,
    ) -> Answer<v1::GetSetupResponse> {
        on_setup(&request.setup_id);
        let SetupView { setup, access } = self.service.get_setup(caller, &request.setup_id).await?;
        let mesh = request.include_mesh.then(|| convert::mesh(&setup));
        let control_points = match request.include_control_points {
            true => convert::control_points(&setup)?,
            false => Vec::new(),
        };
        let setup = Some(convert::description(&setup, &access));
        Ok(v1::GetSetupResponse { setup, mesh, control_points })
    }

    pub async fn list_setups(
        &self,
        caller: &Principal,
        v1::ListSetupsRequest { page_size, page_token }: v1::ListSetupsRequest,
    ) -> Answer<v1::ListSetupsResponse> {
        let page = convert::page(page_size, page_token);
        Ok(convert::listed_setups(self.service.list_setups(caller, &page).await?))
    }

    pub async fn share_setup(
        &self,
        caller: &Principal,
        request: v1::ShareSetupRequest,
    ) -> Answer<v1::ShareSetupResponse> {
        on_setup(&request.setup_id);
        let visibility = convert::visibility("", request.visibility, request.shared_with)?;
        let visibility = visibility.ok_or_else(|| ServiceError::invalid("visibility", "is missing"))?;
        let access = self.service.share_setup(caller, &request.setup_id, visibility).await?;
        Ok(v1::ShareSetupResponse { access: Some(convert::access(&access)) })
    }

    pub async fn delete_setup(
        &self,
        caller: &Principal,
        request: v1::DeleteSetupRequest,
    ) -> Answer<v1::DeleteSetupResponse> {
        on_setup(&request.setup_id);
        self.service.delete_setup(caller, &request.setup_id).await?;
        Ok(v1::DeleteSetupResponse {})
    }

    pub async fn open_session(
        &self,
        caller: &Principal,
        v1::OpenSessionRequest { setup_id, request_id, label }: v1::OpenSessionRequest,
    ) -> Answer<v1::OpenSessionResponse> {
        on_setup(&setup_id);
        let session = self.service.open_session(caller, &setup_id, &label, &request_id).await?;
        on_session(&session.id);
        let session_id = session.id.clone();
        Ok(v1::OpenSessionResponse { session_id, session: Some(convert::session(session)) })
    }

    pub async fn get_session(
        &self,
        caller: &Principal,
        request: v1::GetSessionRequest,
    ) -> Answer<v1::GetSessionResponse> {
        on_session(&request.session_id);
        let session = self.service.get_session(caller, &request.session_id).await?;
        Ok(v1::GetSessionResponse { session: Some(convert::session(session)) })
    }

    pub async fn list_sessions(
        &self,
        caller: &Principal,
        v1::ListSessionsRequest { page_size, page_token }: v1::ListSessionsRequest,
    ) -> Answer<v1::ListSessionsResponse> {
        let page = convert::page(page_size, page_token);
        Ok(convert::listed_sessions(self.service.list_sessions(caller, &page).await?))
    }

    pub async fn update_session(
        &self,
        caller: &Principal,
        request: v1::UpdateSessionRequest,
    ) -> Answer<v1::UpdateSessionResponse> {
        on_session(&request.session_id);
        let session_id = request.session_id.clone();
        let update = convert::update(request)?;
        let session = self.service.update_session(caller, &session_id, update).await?;
        Ok(v1::UpdateSessionResponse { session: Some(convert::session(session)) })
    }

    pub async fn close_session(
        &self,
        caller: &Principal,
        request: v1::CloseSessionRequest,
    ) -> Answer<v1::CloseSessionResponse> {
        on_session(&request.session_id);
        self.service.close_session(caller, &request.session_id).await?;
        Ok(v1::CloseSessionResponse {})
    }

    pub async fn deform(&self, caller: &Principal, request: v1::DeformRequest) -> Answer<v1::DeformResponse> {
        let v1::DeformRequest { session_id, input, control_points, include_cell_quality } = request;
        on_session(&session_id);
        let design = convert::design(input, control_points)?;
        let deformed = self.service.deform(caller, &session_id, design).await?;
        Ok(convert::deformed(&deformed, include_cell_quality))
    }

    pub async fn apply_jacobian_vector(
        &self,
        caller: &Principal,
        request: v1::ApplyJacobianVectorRequest,
    ) -> Answer<v1::ApplyJacobianVectorResponse> {
        let v1::ApplyJacobianVectorRequest { session_id, at, design, control_points } = request;
        on_session(&session_id);
        let at = convert::at(at)?;
        let directions = convert::directions(design, control_points)?;
        Ok(convert::jvp(&self.service.jvp(caller, &session_id, at, directions).await?))
    }

    pub async fn apply_adjoint(
        &self,
        caller: &Principal,
        request: v1::ApplyAdjointRequest,
    ) -> Answer<v1::ApplyAdjointResponse> {
        on_session(&request.session_id);
        let at = convert::at(request.at)?;
        let seeds = convert::seeds(request.vertices, request.functions)?;
        let wanted = Wanted { design: request.include_design, control_points: request.control_points_of };
        Ok(convert::vjp(&self.service.vjp(caller, &request.session_id, at, seeds, wanted).await?))
    }

    /// The columns, computed apart from the request as fast as somebody takes them; an error is the last.
    pub fn jacobian(
        &self,
        caller: Principal,
        deadline: Deadline,
        request: v1::JacobianRequest,
    ) -> mpsc::Receiver<Answer<v1::JacobianResponse>> {
        // A client that reads slowly holds up its own columns only, and few of them are waiting.
        let (sender, columns) = mpsc::channel(4);
        let meshes = self.clone();
        let work = async move {
            let outcome = tokio::select! {
                outcome = deadline.limit(meshes.columns(&caller, request, &sender), |error| error) => outcome,
                // The client has gone, and with this future the interest in what is computed.
                () = sender.closed() => return,
            };
            if let Err(error) = outcome {
                let _ = sender.send(Err(error)).await;
            }
        };
        tokio::spawn(work.instrument(Span::current()));
        columns
    }

    /// Computes the columns in large blocks, and sends them in messages of about 1 MiB.
    async fn columns(
        &self,
        caller: &Principal,
        v1::JacobianRequest { session_id, at }: v1::JacobianRequest,
        sender: &mpsc::Sender<Answer<v1::JacobianResponse>>,
    ) -> Answer<()> {
        const MESSAGE: usize = 1 << 20;
        on_session(&session_id);
        let at = convert::at(at)?;
        let Product { value: at, mut timing } = self.service.linearised(caller, &session_id, at).await?;
        let columns = at.columns();
        let mut first = 0;
        while first < columns {
            let block = self.service.jacobian(caller, &at, first).await?;
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

    pub async fn get_status(
        &self,
        caller: &Principal,
        v1::GetStatusRequest {}: v1::GetStatusRequest,
    ) -> Answer<v1::GetStatusResponse> {
        Ok(convert::status(self.service.status(caller).await?))
    }
}

fn on_setup(id: &str) {
    Span::current().record("setup", id);
}

fn on_session(id: &str) {
    Span::current().record("session", id);
}
