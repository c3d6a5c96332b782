//! The gRPC transport of the panel method: thin.

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

use super::Panels;
use crate::grpc::{answer, open, open_routes};

/// The name of the service.
pub const PANELS: &str = <PanelServiceServer<Grpc> as tonic::server::NamedService>::NAME;

/// The service, whose callers are asked who they are; and for everybody health and reflection.
pub async fn routes(
    panels: Panels,
    max_message: usize,
) -> Result<(Routes, Routes, Health), tonic_reflection::server::Error> {
    let (open, health) = open_routes(PANELS).await?;
    let panels = PanelServiceServer::new(Grpc { panels })
        .max_decoding_message_size(max_message)
        .max_encoding_message_size(usize::MAX);
    Ok((Routes::new(panels), open, health))
}

/// The service on the wire.
pub struct Grpc {
    panels: Panels,
}

type Events = Pin<Box<dyn Stream<Item = Result<v1::AnalyzeResponse, Status>> + Send>>;

#[tonic::async_trait]
impl PanelService for Grpc {
    async fn create_configuration(
        &self,
        request: Request<v1::CreateConfigurationRequest>,
    ) -> Result<Response<v1::CreateConfigurationResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.panels.create_configuration(&caller, request).await)
    }

    async fn get_configuration(
        &self,
        request: Request<v1::GetConfigurationRequest>,
    ) -> Result<Response<v1::GetConfigurationResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.panels.get_configuration(&caller, request).await)
    }

    type AnalyzeStream = Events;

    async fn analyze(&self, request: Request<v1::AnalyzeRequest>) -> Result<Response<Events>, Status> {
        let (caller, deadline, request) = open(request)?;
        // Events are few, so the channel need not be bounded.
        let (sender, events) = mpsc::unbounded_channel();
        let panels = self.panels.clone();
        let work = async move {
            let event = |event| v1::AnalyzeResponse { event: Some(event) };
            let tell = |progress| {
                let _ = sender.send(Ok(event(Event::Progress(progress))));
            };
            let analyze = async { panels.analyze(&caller, request, tell).await.map_err(status) };
            let outcome = tokio::select! {
                outcome = deadline.limit(analyze, status) => outcome,
                // The client has gone: the interest in the solution goes with this future.
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
        answer(self.panels.apply_jacobian_vector(&caller, request).await)
    }

    async fn apply_adjoint(
        &self,
        request: Request<v1::PanelServiceApplyAdjointRequest>,
    ) -> Result<Response<v1::PanelServiceApplyAdjointResponse>, Status> {
        let (caller, _, request) = open(request)?;
        answer(self.panels.apply_adjoint(&caller, request).await)
    }
}
