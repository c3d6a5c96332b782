//! Checks of derivatives.

use moldline_host::{Product, Progress, ServiceError};
use moldline_mesh_service::{CheckAt, CheckReport, CheckRequest};
use moldline_proto::v1;
use v1::{check_request::At, check_response::Event, design_point::Input};

use super::{arrays::numbers, sessions::design_point, status::timings};

/// The id of the set-up, and the check.
pub fn request(request: v1::CheckRequest) -> Result<(String, CheckRequest), ServiceError> {
    let v1::CheckRequest { setup_id, at, seed, variables } = request;
    let values = |input| {
        let design = design_point("", v1::DesignPoint { input: Some(input), control_points: Vec::new() })?;
        Ok::<_, ServiceError>(CheckAt::Design(design.values))
    };
    let at = match at {
        None => CheckAt::Number(1),
        Some(At::Designs(count)) => CheckAt::Number(count as usize),
        Some(At::Design(array)) => values(Input::Design(array))?,
        Some(At::Named(named)) => values(Input::Named(named))?,
    };
    Ok((setup_id, CheckRequest { at, seed, variables }))
}

pub fn progress(progress: Progress) -> v1::CheckResponse {
    v1::CheckResponse { event: Some(Event::Progress(super::status::progress(progress))) }
}

pub fn report(Product { value: report, timing }: &Product<CheckReport>) -> v1::CheckResponse {
    let designs = report.designs.iter().map(|check| v1::CheckedDesign {
        design: Some(numbers(&[check.design.len()], [&check.design[..]])),
        dot_products: check
            .dot_products
            .iter()
            .map(|dot| v1::DotProductError { block: dot.block as u32, error: dot.error })
            .collect(),
        dot_product_max: check.dot_product_max(),
        dual_max: check.dual_max(),
        central_difference_max: check.central_difference_max(),
        values_max: check.values,
    });
    let rows = report.rows().map(|(design, variable, row)| v1::CheckedVariable {
        design: design as u32,
        variable: variable.to_owned(),
        size: row.size,
        dual: row.dual,
        worst_vertex: row.worst_vertex as u32,
        steps: row
            .steps
            .iter()
            .map(|(step, error)| v1::StepError { step: step.name().to_owned(), error: *error })
            .collect(),
        first_discrepancy: row.first_off.map(|step| step.name().to_owned()),
        differences: row
            .differences
            .iter()
            .map(|difference| v1::DifferenceError { step: difference.step, error: difference.error })
            .collect(),
        functions: row.functions,
        kink: row.kink.as_ref().map(|kink| v1::Kink {
            vertices: kink.vertices.len() as u32,
            worst_vertex: kink.worst as u32,
            jump: kink.jump,
            position: kink.position.to_vec(),
            component: kink.component.clone(),
            error: kink.error,
        }),
    });
    let [dot_products, dual, central] = report.maxima().map(|maximum| maximum.error);
    let report = v1::CheckReport {
        dot_product_max: dot_products,
        dual_max: dual,
        central_difference_max: central,
        seed: report.seed,
        designs: designs.collect(),
        rows: rows.collect(),
        definition: CheckReport::DEFINITION.to_owned(),
        text: report.to_string(),
        timings: Some(timings(*timing)),
    };
    v1::CheckResponse { event: Some(Event::Report(report)) }
}
