//! Requests whose bodies are arrays, as messages of the protocol. Their other fields are in the query.

use moldline_host::ServiceError;
use moldline_proto::v1::{self, Array};
use serde::Deserialize;
use utoipa::IntoParams;

use crate::http::arrays::{Arrays, block, point_block};

/// The options of a configuration that comes as arrays.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct OptionsQuery {
    /// The options as JSON, as in a document.
    options: Option<String>,
}

impl OptionsQuery {
    fn options(&self) -> Result<v1::PanelOptions, ServiceError> {
        let text = self.options.as_deref().unwrap_or("{}");
        serde_json::from_str(text).map_err(|error| ServiceError::invalid("options", error.to_string()))
    }

    /// A configuration of the arrays `cells`, `vertices`, `cell_groups.NAME` and `vertex_groups.NAME`.
    pub fn create_configuration(
        &self,
        mut arrays: Arrays,
    ) -> Result<v1::CreateConfigurationRequest, ServiceError> {
        let options = self.options()?;
        let group = |(name, list)| v1::IndexGroup { name, indices: Some(list) };
        let request = v1::CreateConfigurationRequest {
            cells: arrays.take("cells"),
            vertices: arrays.take("vertices"),
            cell_groups: arrays.take_all("cell_groups.").into_iter().map(group).collect(),
            vertex_groups: arrays.take_all("vertex_groups.").into_iter().map(group).collect(),
            options: Some(options),
        };
        arrays.end()?;
        Ok(request)
    }
}

/// The fields of a request with arrays. (In JSON, fields of the document.)
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct FlowQuery {
    /// Extents of an `application/octet-stream` body, such as `14824,3`.
    pub shape: Option<String>,
    /// For derivatives: from the answer of Analyze.
    analysis_id: Option<String>,
    /// Mach number.
    mach: Option<f64>,
    /// Angles of attack, rad, separated by commas; a single one for derivatives.
    alpha: Option<String>,
    /// Sideslip, rad.
    #[serde(default)]
    sideslip: f64,
    /// Reference area, m^2.
    area: Option<f64>,
    /// Reference chord, m.
    chord: Option<f64>,
    /// Reference span, m.
    span: Option<f64>,
    /// Reference point `x,y,z`, m.
    point: Option<String>,
    /// For analyses: leaves out the pressures of cells and vertices.
    #[serde(default)]
    without_pressures: bool,
}

impl FlowQuery {
    fn flows(&self) -> Result<Vec<v1::FlowAngles>, ServiceError> {
        let alphas = list("alpha", self.alpha.as_deref().unwrap_or("0"))?;
        Ok(alphas.into_iter().map(|alpha| v1::FlowAngles { alpha, sideslip: self.sideslip }).collect())
    }

    fn reference(&self) -> Result<v1::FlowReference, ServiceError> {
        let given =
            |name: &str, value: Option<f64>| value.ok_or_else(|| ServiceError::invalid(name, "is missing"));
        Ok(v1::FlowReference {
            area: given("area", self.area)?,
            chord: given("chord", self.chord)?,
            span: given("span", self.span)?,
            point: self.point.as_deref().map_or(Ok(Vec::new()), |point| list("point", point))?,
        })
    }

    fn at(&self, vertices: Option<Array>) -> Result<v1::AnalysisPoint, ServiceError> {
        let flows = self.flows()?;
        let [flow] = flows[..] else {
            return Err(ServiceError::invalid("alpha", "a derivative is taken at a single angle"));
        };
        let geometry = match (vertices, self.mach) {
            (None, None) => None,
            (vertices, mach) => Some(v1::AnalysisGeometry { vertices, mach: mach.unwrap_or(0.0) }),
        };
        Ok(v1::AnalysisPoint {
            analysis_id: self.analysis_id.clone().unwrap_or_default(),
            geometry,
            flow: Some(flow),
            reference: Some(self.reference()?),
        })
    }

    pub fn analyze(
        &self,
        mut arrays: Arrays,
        configuration_id: String,
    ) -> Result<v1::AnalyzeRequest, ServiceError> {
        if self.analysis_id.is_some() {
            return Err(ServiceError::invalid(
                "analysis_id",
                "is for derivatives; an analysis takes vertices",
            ));
        }
        let vertices = arrays.take("vertices");
        arrays.end()?;
        Ok(v1::AnalyzeRequest {
            configuration_id,
            vertices,
            mach: self.mach.unwrap_or(0.0),
            flows: self.flows()?,
            reference: Some(self.reference()?),
            without_pressures: self.without_pressures,
        })
    }

    pub fn jvp(
        &self,
        mut arrays: Arrays,
        configuration_id: String,
    ) -> Result<v1::PanelServiceApplyJacobianVectorRequest, ServiceError> {
        let at = Some(self.at(arrays.take("at.vertices"))?);
        let directions = v1::FlowInputs {
            vertices: arrays.take("vertices").map(point_block),
            alpha: arrays.take("alpha"),
            sideslip: arrays.take("sideslip"),
            mach: arrays.take("mach"),
            area: arrays.take("area"),
            chord: arrays.take("chord"),
            point: arrays.take("point"),
        };
        arrays.end()?;
        Ok(v1::PanelServiceApplyJacobianVectorRequest { configuration_id, at, directions: Some(directions) })
    }

    pub fn vjp(
        &self,
        mut arrays: Arrays,
        configuration_id: String,
    ) -> Result<v1::PanelServiceApplyAdjointRequest, ServiceError> {
        let at = Some(self.at(arrays.take("at.vertices"))?);
        let seeds = v1::FlowOutputs {
            coefficients: arrays.take("coefficients").map(block),
            section_loads: arrays.take("section_loads").map(block),
            cp: arrays.take("cp").map(block),
        };
        arrays.end()?;
        Ok(v1::PanelServiceApplyAdjointRequest { configuration_id, at, seeds: Some(seeds) })
    }
}

fn list(field: &str, text: &str) -> Result<Vec<f64>, ServiceError> {
    let numbers: Result<_, _> = text.split(',').map(|number| number.trim().parse()).collect();
    numbers.map_err(|_| ServiceError::invalid(field, "is not a list of numbers separated by commas"))
}
