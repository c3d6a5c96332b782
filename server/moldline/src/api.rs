//! The mesh service in messages of the protocol, called by both transports. `convert` has their meaning.

use std::sync::Arc;

use bytes::Bytes;
use moldline_host::{Principal, Product, Role, ServiceError, shorten};
use moldline_mesh_service::{Service, SetupView, UploadHeader, Wanted};
use moldline_proto::v1;
use moldline_transport::{Deadline, Method, media::beside};
use tokio::sync::mpsc;
use tokio_stream::{Stream, StreamExt};
use tracing::{Instrument, Span};

use crate::convert;

/// Messages with columns of a Jacobian that wait for their receiver.
const WAITING: usize = 4;
/// Bytes of such a message, about.
const MESSAGE: usize = 1 << 20;
/// Bytes of the columns that wait for their receiver.
pub const WAITING_COLUMNS: u64 = ((WAITING + 1) * MESSAGE) as u64;

/// What a method needs, by its name.
pub fn method(name: &str) -> Method {
    let role = match name {
        "GetSetup" | "ListSetups" | "GetSession" | "ListSessions" | "GetStatus" | "GetOperation" => {
            Role::Reader
        }
        _ => Role::User,
    };
    Method { role, streamed: name == "CreateSetup" }
}

/// The RPCs of the mesh service.
#[derive(Clone, Debug)]
pub struct MeshApi {
    service: Arc<Service>,
}

type Answer<T> = Result<T, ServiceError>;

impl MeshApi {
    pub fn new(service: Arc<Service>) -> Self {
        Self { service }
    }

    /// The service that the calls go to.
    pub fn service(&self) -> &Service {
        &self.service
    }

    /// Receives and builds a set-up, and reports progress. `parts` yields the bytes of files, each with the index of its file;
    /// `refuse` makes an error of the transport.
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
        tell(convert::status::progress(receiving.progress()));
        while let Some((file, data)) = parts.next().await.transpose()? {
            receiving.append(file, &data).map_err(&refuse)?;
            let progress = receiving.progress();
            if progress.fraction >= told + 0.01 {
                told = progress.fraction;
                tell(convert::status::progress(progress));
            }
        }
        let uploaded = receiving.finish().map_err(&refuse)?;
        let tell = |progress| tell(convert::status::progress(progress));
        let created = self.service.create_setup(caller, uploaded, tell).await.map_err(refuse)?;
        Span::current().record("setup", created.setup.id.as_str());
        Ok(convert::setups::created(&created))
    }

    pub async fn get_setup(
        &self,
        caller: &Principal,
        request: v1::GetSetupRequest,
    ) -> Answer<v1::GetSetupResponse> {
        record_setup(&request.setup_id);
        let SetupView { setup, access } = self.service.get_setup(caller, &request.setup_id).await?;
        let mesh = match request.include_mesh {
            true => {
                let (setup, bytes) = (Arc::clone(&setup), setup.engine.bytes());
                Some(beside(bytes, move || Ok::<_, ServiceError>(convert::setups::mesh(&setup))).await?)
            }
            false => None,
        };
        let control_points = match request.include_control_points {
            true => convert::setups::control_points(&setup)?,
            false => Vec::new(),
        };
        let setup = Some(convert::setups::description(&setup, &access));
        Ok(v1::GetSetupResponse { setup, mesh, control_points })
    }

    pub async fn list_setups(
        &self,
        caller: &Principal,
        v1::ListSetupsRequest { page_size, page_token }: v1::ListSetupsRequest,
    ) -> Answer<v1::ListSetupsResponse> {
        let page = convert::status::page(page_size, page_token);
        Ok(convert::setups::listed_setups(self.service.list_setups(caller, &page).await?))
    }

    pub async fn share_setup(
        &self,
        caller: &Principal,
        request: v1::ShareSetupRequest,
    ) -> Answer<v1::ShareSetupResponse> {
        record_setup(&request.setup_id);
        let visibility = convert::setups::visibility("", request.visibility, request.shared_with)?;
        let visibility = visibility.ok_or_else(|| ServiceError::invalid("visibility", "is missing"))?;
        let access = self.service.share_setup(caller, &request.setup_id, visibility).await?;
        Ok(v1::ShareSetupResponse { access: Some(convert::setups::access(&access)) })
    }

    pub async fn delete_setup(
        &self,
        caller: &Principal,
        request: v1::DeleteSetupRequest,
    ) -> Answer<v1::DeleteSetupResponse> {
        record_setup(&request.setup_id);
        self.service.delete_setup(caller, &request.setup_id).await?;
        Ok(v1::DeleteSetupResponse {})
    }

    pub async fn open_session(
        &self,
        caller: &Principal,
        v1::OpenSessionRequest { setup_id, request_id, label }: v1::OpenSessionRequest,
    ) -> Answer<v1::OpenSessionResponse> {
        record_setup(&setup_id);
        let session = self.service.open_session(caller, &setup_id, &label, &request_id).await?;
        record_session(&session.id);
        let session_id = session.id.clone();
        Ok(v1::OpenSessionResponse { session_id, session: Some(convert::sessions::session(session)) })
    }

    pub async fn get_session(
        &self,
        caller: &Principal,
        request: v1::GetSessionRequest,
    ) -> Answer<v1::GetSessionResponse> {
        record_session(&request.session_id);
        let session = self.service.get_session(caller, &request.session_id).await?;
        Ok(v1::GetSessionResponse { session: Some(convert::sessions::session(session)) })
    }

    pub async fn list_sessions(
        &self,
        caller: &Principal,
        v1::ListSessionsRequest { page_size, page_token }: v1::ListSessionsRequest,
    ) -> Answer<v1::ListSessionsResponse> {
        let page = convert::status::page(page_size, page_token);
        Ok(convert::sessions::listed_sessions(self.service.list_sessions(caller, &page).await?))
    }

    pub async fn update_session(
        &self,
        caller: &Principal,
        request: v1::UpdateSessionRequest,
    ) -> Answer<v1::UpdateSessionResponse> {
        record_session(&request.session_id);
        let session_id = request.session_id.clone();
        let update = convert::sessions::update(request)?;
        let session = self.service.update_session(caller, &session_id, update).await?;
        Ok(v1::UpdateSessionResponse { session: Some(convert::sessions::session(session)) })
    }

    pub async fn close_session(
        &self,
        caller: &Principal,
        request: v1::CloseSessionRequest,
    ) -> Answer<v1::CloseSessionResponse> {
        record_session(&request.session_id);
        self.service.close_session(caller, &request.session_id).await?;
        Ok(v1::CloseSessionResponse {})
    }

    pub async fn deform(&self, caller: &Principal, request: v1::DeformRequest) -> Answer<v1::DeformResponse> {
        let v1::DeformRequest { session_id, input, control_points, include_cell_quality } = request;
        record_session(&session_id);
        let design = convert::sessions::design(input, control_points)?;
        let deformed = self.service.deform(caller, &session_id, design).await?;
        Ok(convert::sessions::deformed(&deformed, include_cell_quality))
    }

    pub async fn apply_jacobian_vector(
        &self,
        caller: &Principal,
        request: v1::ApplyJacobianVectorRequest,
    ) -> Answer<v1::ApplyJacobianVectorResponse> {
        let v1::ApplyJacobianVectorRequest { session_id, at, design, control_points } = request;
        record_session(&session_id);
        let at = convert::derivatives::at(at)?;
        let directions = convert::derivatives::directions(design, control_points)?;
        Ok(convert::derivatives::jvp(&self.service.jvp(caller, &session_id, at, directions).await?))
    }

    pub async fn apply_adjoint(
        &self,
        caller: &Principal,
        request: v1::ApplyAdjointRequest,
    ) -> Answer<v1::ApplyAdjointResponse> {
        record_session(&request.session_id);
        let at = convert::derivatives::at(request.at)?;
        let seeds = convert::derivatives::seeds(request.vertices, request.functions)?;
        let wanted = Wanted { design: request.include_design, control_points: request.control_points_of };
        Ok(convert::derivatives::vjp(
            &self.service.vjp(caller, &request.session_id, at, seeds, wanted).await?,
        ))
    }

    /// Streams the columns, computed in a task of their own as fast as the receiver takes them. An error ends the stream.
    pub fn jacobian(
        &self,
        caller: Principal,
        deadline: Deadline,
        request: v1::JacobianRequest,
    ) -> mpsc::Receiver<Answer<v1::JacobianResponse>> {
        // Bounded: a client that reads slowly delays its own columns only, and few of them wait.
        let (sender, columns) = mpsc::channel(WAITING);
        let api = self.clone();
        let work = async move {
            let outcome = tokio::select! {
                outcome = deadline.limit(api.columns(&caller, request, &sender), |error| error) => outcome,
                // The client has left: dropping this future cancels the computation.
                () = sender.closed() => return,
            };
            if let Err(error) = outcome {
                let _ = sender.send(Err(error)).await;
            }
        };
        tokio::spawn(work.instrument(Span::current()));
        columns
    }

    /// Computes the columns in large blocks and sends them in messages of about 1 MiB.
    async fn columns(
        &self,
        caller: &Principal,
        v1::JacobianRequest { session_id, at }: v1::JacobianRequest,
        sender: &mpsc::Sender<Answer<v1::JacobianResponse>>,
    ) -> Answer<()> {
        record_session(&session_id);
        let at = convert::derivatives::at(at)?;
        let Product { value: at, mut timing } = self.service.linearised(caller, &session_id, at).await?;
        let columns = at.columns();
        let mut first = 0;
        while first < columns {
            let block = self.service.jacobian(caller, &at, first).await?;
            timing = timing + block.timing;
            let bytes = block.value.first().map_or(1, |column| size_of_val(&column.vertices[..]).max(1));
            for part in block.value.chunks((MESSAGE / bytes).max(1)) {
                let message =
                    convert::derivatives::jacobian(first, columns, part, std::mem::take(&mut timing));
                first += part.len();
                if sender.send(Ok(message)).await.is_err() {
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    /// Checks derivatives in a task of its own. Progress comes first; the report or an error is the last item.
    pub fn check(
        &self,
        caller: Principal,
        deadline: Deadline,
        request: v1::CheckRequest,
    ) -> mpsc::UnboundedReceiver<Answer<v1::CheckResponse>> {
        // Unbounded, since events are few.
        let (sender, events) = mpsc::unbounded_channel();
        let service = Arc::clone(&self.service);
        let work = async move {
            let check = async {
                let (setup_id, request) = convert::check::request(request)?;
                record_setup(&setup_id);
                let tell = |progress| {
                    let _ = sender.send(Ok(convert::check::progress(progress)));
                };
                service.check(&caller, &setup_id, request, tell).await
            };
            let outcome = tokio::select! {
                outcome = deadline.limit(check, |error| error) => outcome,
                // The client has left: dropping this future cancels the check.
                () = sender.closed() => return,
            };
            let _ = sender.send(outcome.map(|report| convert::check::report(&report)));
        };
        tokio::spawn(work.instrument(Span::current()));
        events
    }

    pub async fn get_status(
        &self,
        caller: &Principal,
        v1::GetStatusRequest {}: v1::GetStatusRequest,
    ) -> Answer<v1::GetStatusResponse> {
        Ok(convert::status::status(self.service.status(caller).await?))
    }
}

/// Names the set-up in the request's span.
fn record_setup(id: &str) {
    Span::current().record("setup", shorten(id));
}

/// Names the session in the request's span.
fn record_session(id: &str) {
    Span::current().record("session", shorten(id));
}
