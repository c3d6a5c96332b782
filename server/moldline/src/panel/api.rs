//! The panel method's service in messages of the protocol, called by both transports.

use std::sync::Arc;

use moldline_host::{Principal, Role, ServiceError};
use moldline_panel_service::PanelService;
use moldline_proto::v1;
use moldline_transport::Method;

use super::convert;
use crate::convert::status;

/// What a method needs, by its name.
pub fn method(name: &str) -> Method {
    let role = if name == "GetConfiguration" { Role::Reader } else { Role::User };
    Method { role, streamed: false }
}

/// The RPCs of the panel method's service.
#[derive(Clone, Debug)]
pub struct PanelApi {
    service: Arc<PanelService>,
}

type Answer<T> = Result<T, ServiceError>;

impl PanelApi {
    pub fn new(service: Arc<PanelService>) -> Self {
        Self { service }
    }

    pub async fn create_configuration(
        &self,
        caller: &Principal,
        request: v1::CreateConfigurationRequest,
    ) -> Answer<v1::CreateConfigurationResponse> {
        let definition = convert::definition(request, &self.service.limits().mesh)?;
        let created = self.service.create_configuration(caller, definition).await?;
        let configuration = Some(convert::configuration(&created.configuration));
        Ok(v1::CreateConfigurationResponse { configuration, created: created.created })
    }

    pub async fn get_configuration(
        &self,
        caller: &Principal,
        request: v1::GetConfigurationRequest,
    ) -> Answer<v1::GetConfigurationResponse> {
        let configuration = self.service.configuration(caller, &request.configuration_id)?;
        Ok(v1::GetConfigurationResponse { configuration: Some(convert::configuration(&configuration)) })
    }

    pub async fn analyze(
        &self,
        caller: &Principal,
        request: v1::AnalyzeRequest,
        mut tell: impl FnMut(v1::Progress),
    ) -> Answer<v1::Analysis> {
        let id = request.configuration_id;
        let geometry =
            convert::geometry("", v1::AnalysisGeometry { vertices: request.vertices, mach: request.mach })?;
        let reference = convert::reference("", request.reference)?;
        let flows = request.flows.iter().map(|angles| convert::flow(*angles, reference)).collect();
        let tell = |progress| tell(status::progress(progress));
        let analysed = self.service.analyse(caller, &id, geometry, flows, tell).await?;
        Ok(convert::analysis(&analysed, &request.flows, !request.without_pressures))
    }

    pub async fn apply_jacobian_vector(
        &self,
        caller: &Principal,
        request: v1::PanelServiceApplyJacobianVectorRequest,
    ) -> Answer<v1::PanelServiceApplyJacobianVectorResponse> {
        let at = convert::at(request.at)?;
        let directions = convert::inputs("directions", request.directions.unwrap_or_default())?;
        let product = self.service.jvp(caller, &request.configuration_id, at, directions).await?;
        let timings = Some(status::timings(product.timing));
        Ok(v1::PanelServiceApplyJacobianVectorResponse {
            changes: Some(convert::outputs(&product.value)),
            timings,
        })
    }

    pub async fn apply_adjoint(
        &self,
        caller: &Principal,
        request: v1::PanelServiceApplyAdjointRequest,
    ) -> Answer<v1::PanelServiceApplyAdjointResponse> {
        let at = convert::at(request.at)?;
        let seeds = convert::seeds(request.seeds.unwrap_or_default())?;
        let product = self.service.vjp(caller, &request.configuration_id, at, seeds).await?;
        let timings = Some(status::timings(product.timing));
        Ok(v1::PanelServiceApplyAdjointResponse {
            gradients: Some(convert::gradients(&product.value)),
            timings,
        })
    }
}
