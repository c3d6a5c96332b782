//! The gRPC transport of the panel method's service: it wraps [`PanelApi`].

use std::pin::Pin;

use moldline_proto::v1;
use moldline_transport::{Health, status};
use tokio::sync::mpsc;
use tokio_stream::{Stream, wrappers::UnboundedReceiverStream};
use tonic::{Request, Response, Status, service::Routes};
use tracing::{Instrument, Span};
use v1::{
    analyze_response::Event,
    panel_service_server::{PanelService, PanelServiceServer},
};

use super::api::PanelApi;
use crate::grpc::{answer, open, open_routes, refusing};

/// The name of the service.
const SERVICE: &str = <PanelServiceServer<Grpc> as tonic::server::NamedService>::NAME;

/// The routes of the service, which need a principal, and the open routes of [`open_routes`].
pub async fn routes(
    api: PanelApi,
    max_message: usize,
) -> Result<(Routes, Routes, Health), tonic_reflection::server::Error> {
    let (open, health) = open_routes(SERVICE).await?;
    let service = PanelServiceServer::new(Grpc { api })
        .max_decoding_message_size(max_message)
        .max_encoding_message_size(usize::MAX);
    let message =
        "this is Moldline's panel service, not its mesh service; name the address of a `moldline serve`";
    Ok((refusing(Routes::new(service), "/moldline.v1.MeshService/{method}", message), open, health))
}

/// The service on the wire.
pub struct Grpc {
    api: PanelApi,
}

type Events = Pin<Box<dyn Stream<Item = Result<v1::AnalyzeResponse, Status>> + Send>>;

#[tonic::async_trait]
impl PanelService for Grpc {
    async fn create_configuration(
        &self,
        request: Request<v1::CreateConfigurationRequest>,
    ) -> Result<Response<v1::CreateConfigurationResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.create_configuration(&caller, request).await)
    }

    async fn get_configuration(
        &self,
        request: Request<v1::GetConfigurationRequest>,
    ) -> Result<Response<v1::GetConfigurationResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.get_configuration(&caller, request).await)
    }

    type AnalyzeStream = Events;

    async fn analyze(&self, request: Request<v1::AnalyzeRequest>) -> Result<Response<Events>, Status> {
        let (caller, deadline, request) = open(request)?;
        // Unbounded, since events are few.
        let (sender, events) = mpsc::unbounded_channel();
        let api = self.api.clone();
        let work = async move {
            let event = |event| v1::AnalyzeResponse { event: Some(event) };
            let tell = |progress| {
                let _ = sender.send(Ok(event(Event::Progress(progress))));
            };
            let analyze = async { api.analyze(&caller, request, tell).await.map_err(status) };
            let outcome = tokio::select! {
                outcome = deadline.limit(analyze, status) => outcome,
                // The client has left: dropping this future cancels the solution.
                () = sender.closed() => return,
            };
            let _ = sender.send(outcome.map(|analysis| event(Event::Analysis(analysis))));
        };
        tokio::spawn(work.instrument(Span::current()));
        Ok(Response::new(Box::pin(UnboundedReceiverStream::new(events))))
    }

    async fn apply_jacobian_vector(
        &self,
        request: Request<v1::PanelServiceApplyJacobianVectorRequest>,
    ) -> Result<Response<v1::PanelServiceApplyJacobianVectorResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.apply_jacobian_vector(&caller, request).await)
    }

    async fn apply_adjoint(
        &self,
        request: Request<v1::PanelServiceApplyAdjointRequest>,
    ) -> Result<Response<v1::PanelServiceApplyAdjointResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.api.apply_adjoint(&caller, request).await)
    }
}
