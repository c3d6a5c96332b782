//! Points, directions and seeds of derivatives, and their products.

use moldline_deform::Tangent;
use moldline_host::{Product, ServiceError, Timing};
use moldline_mesh_service::{At, ControlPointVectors, Directions, Gradients, Seeds};
use moldline_proto::v1;

use super::{arrays, sessions, status};

/// The point of a derivative.
pub fn at(point: Option<v1::LinearisationPoint>) -> Result<At, ServiceError> {
    let v1::LinearisationPoint { linearisation_id, design_point: point } = point.unwrap_or_default();
    let design = point.map(|point| sessions::design_point("at.design_point.", point)).transpose()?;
    Ok(At { id: (!linearisation_id.is_empty()).then_some(linearisation_id), design })
}

pub fn directions(
    design: Option<v1::Array>,
    control_points: Vec<v1::ControlPointVectors>,
) -> Result<Directions, ServiceError> {
    let design = design.map(|array| arrays::vectors("design", &array)).transpose()?;
    let control_points = control_points.into_iter().map(|v1::ControlPointVectors { component, vectors }| {
        let field = format!("control_points[\"{component}\"]");
        let array = vectors.ok_or_else(|| ServiceError::invalid(&field, "has no vectors"))?;
        Ok(ControlPointVectors { vectors: arrays::point_vectors(&field, &array)?, component })
    });
    Ok(Directions { design, control_points: control_points.collect::<Result<_, ServiceError>>()? })
}

pub fn seeds(vertices: Option<v1::Array>, functions: Option<v1::Array>) -> Result<Seeds, ServiceError> {
    Ok(Seeds {
        vertices: vertices.map(|array| arrays::point_vectors("vertices", &array)).transpose()?,
        functions: functions.map(|array| arrays::vectors("functions", &array)).transpose()?,
    })
}

pub fn jvp(product: &Product<Vec<Tangent>>) -> v1::ApplyJacobianVectorResponse {
    let (vertices, functions) = tangents(&product.value);
    v1::ApplyJacobianVectorResponse { vertices, functions, timings: Some(status::timings(product.timing)) }
}

pub fn vjp(Product { value, timing }: &Product<Gradients>) -> v1::ApplyAdjointResponse {
    let Gradients { design, control_points } = value;
    let control_points = control_points.iter().map(|ControlPointVectors { component, vectors }| {
        let shape = [vectors.len(), vectors.first().map_or(0, Vec::len), 3];
        let array = arrays::numbers(&shape, vectors.iter().map(|vector| vector.as_flattened()));
        v1::ControlPointVectors { component: component.clone(), vectors: Some(array) }
    });
    v1::ApplyAdjointResponse {
        design: design.as_ref().map(|design| {
            let shape = [design.len(), design.first().map_or(0, Vec::len)];
            arrays::numbers(&shape, design.iter().map(Vec::as_slice))
        }),
        control_points: control_points.collect(),
        timings: Some(status::timings(*timing)),
    }
}

/// Columns of the Jacobian from `first` on, out of `columns`.
pub fn jacobian(first: usize, columns: usize, some: &[Tangent], timing: Timing) -> v1::JacobianResponse {
    let (vertices, functions) = tangents(some);
    let (first, columns) = (first as u32, columns as u32);
    v1::JacobianResponse { first, columns, vertices, functions, timings: Some(status::timings(timing)) }
}

fn tangents(tangents: &[Tangent]) -> (Option<v1::Array>, Option<v1::Array>) {
    let (vertices, functions) = tangents.first().map_or((0, 0), |t| (t.vertices.len(), t.functions.len()));
    let of_vertices = tangents.iter().map(|tangent| tangent.vertices.as_flattened());
    let of_functions = tangents.iter().map(|tangent| &tangent.functions[..]);
    (
        Some(arrays::numbers(&[tangents.len(), vertices, 3], of_vertices)),
        Some(arrays::numbers(&[tangents.len(), functions], of_functions)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use v1::DataType;

    #[test]
    fn blocks_of_vectors_have_the_right_number_of_filled_dimensions() {
        let array = |shape: &[u64]| v1::Array {
            dtype: DataType::Float64.into(),
            shape: shape.to_vec(),
            data: vec![0; 8 * shape.iter().product::<u64>() as usize].into(),
        };
        let field = |error: ServiceError| error.violations[0].field.clone();
        for (shape, expected) in [
            (&[2][..], "design.shape"),
            (&[0, 2], "design.shape[0]"),
            (&[u64::MAX, 0], "design.data"),
            (&[1, 2, 3], "design.shape"),
        ] {
            let empty = v1::Array { data: Vec::new().into(), ..v1::Array::default() };
            let sized = if shape.contains(&0) { empty } else { array(shape) };
            let sized = v1::Array { shape: shape.to_vec(), dtype: DataType::Float64.into(), ..sized };
            assert_eq!(field(directions(Some(sized), Vec::new()).unwrap_err()), expected);
        }
        let error = seeds(Some(array(&[1, 3, 2])), None).unwrap_err();
        assert_eq!(field(error), "vertices.shape[2]");
        let read = seeds(Some(array(&[2, 5, 3])), Some(array(&[2, 4]))).unwrap();
        assert_eq!(read.vertices, Some(vec![vec![[0.0; 3]; 5]; 2]));
        assert_eq!(read.functions, Some(vec![vec![0.0; 4]; 2]));
    }
}
