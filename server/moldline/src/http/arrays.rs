//! Requests whose bodies are arrays, as messages of the protocol.
//!
//! | call | main array | further arrays of a .npz file |
//! |---|---|---|
//! | Deform | `design` (n) | `control_points.COMPONENT` (p, 3) |
//! | ApplyJacobianVector | `design` (k, n) | `control_points.COMPONENT` (k, p, 3), `at.design`, `at.control_points.COMPONENT` |
//! | ApplyAdjoint | `vertices` (k, m, 3) | `functions` (k, f), `at.design`, `at.control_points.COMPONENT` |
//! | Jacobian | `at.design` (n) | `at.control_points.COMPONENT` |
//!
//! A single vector may omit its first dimension.

use moldline_host::ServiceError;
use moldline_proto::v1::{self, Array, deform_request, design_point};

/// Arrays by name. All must be used.
pub struct Arrays(Vec<(String, Array)>);

impl Arrays {
    pub fn new(arrays: Vec<(String, Array)>) -> Self {
        Self(arrays)
    }

    /// Takes the array of this name.
    pub fn take(&mut self, name: &str) -> Option<Array> {
        let index = self.0.iter().position(|(known, _)| known == name)?;
        Some(self.0.swap_remove(index).1)
    }

    /// Takes all arrays whose names begin with `prefix`, by the rest of their names, in order.
    pub fn take_all(&mut self, prefix: &str) -> Vec<(String, Array)> {
        let mut found = Vec::new();
        for (name, array) in std::mem::take(&mut self.0) {
            match name.strip_prefix(prefix) {
                Some(rest) => found.push((rest.to_owned(), array)),
                None => self.0.push((name, array)),
            }
        }
        found.sort_by(|(one, _), (other, _)| one.cmp(other));
        found
    }

    /// Checks that no array is left.
    ///
    /// # Errors
    /// `InvalidArgument` for an array of an unknown name.
    pub fn end(self) -> Result<(), ServiceError> {
        match self.0.first() {
            None => Ok(()),
            Some((name, _)) => {
                let name: String = name.chars().take(64).collect();
                Err(ServiceError::invalid(name, "this request has no array of that name"))
            }
        }
    }

    fn control_points(&mut self, prefix: &str) -> Vec<v1::ControlPoints> {
        let message = |(component, points)| v1::ControlPoints { component, points: Some(points) };
        self.take_all(prefix).into_iter().map(message).collect()
    }

    /// The point of a derivative: the id, and the design if it was sent.
    fn at(&mut self, linearisation_id: Option<String>) -> v1::LinearisationPoint {
        let design = self.take("at.design");
        let control_points = self.control_points("at.control_points.");
        let given = design.is_some() || !control_points.is_empty();
        let input = design.map(design_point::Input::Design);
        v1::LinearisationPoint {
            linearisation_id: linearisation_id.unwrap_or_default(),
            design_point: given.then_some(v1::DesignPoint { input, control_points }),
        }
    }

    pub fn deform(mut self, session_id: String, cells: bool) -> Result<v1::DeformRequest, ServiceError> {
        let input = self.take("design").map(deform_request::Input::Design);
        let control_points = self.control_points("control_points.");
        self.end()?;
        Ok(v1::DeformRequest { session_id, input, control_points, include_cell_quality: cells })
    }

    pub fn jvp(
        mut self,
        session_id: String,
        linearisation_id: Option<String>,
    ) -> Result<v1::ApplyJacobianVectorRequest, ServiceError> {
        let at = Some(self.at(linearisation_id));
        let design = self.take("design").map(block);
        let control_points = self.take_all("control_points.").into_iter().map(|(component, vectors)| {
            v1::ControlPointVectors { component, vectors: Some(point_block(vectors)) }
        });
        let control_points = control_points.collect();
        self.end()?;
        Ok(v1::ApplyJacobianVectorRequest { session_id, at, design, control_points })
    }

    pub fn vjp(
        mut self,
        session_id: String,
        linearisation_id: Option<String>,
        include_design: bool,
        control_points_of: Vec<String>,
    ) -> Result<v1::ApplyAdjointRequest, ServiceError> {
        let at = Some(self.at(linearisation_id));
        let vertices = self.take("vertices").map(point_block);
        let functions = self.take("functions").map(block);
        self.end()?;
        Ok(v1::ApplyAdjointRequest { session_id, at, vertices, functions, include_design, control_points_of })
    }

    pub fn jacobian(
        mut self,
        session_id: String,
        linearisation_id: Option<String>,
    ) -> Result<v1::JacobianRequest, ServiceError> {
        let at = Some(self.at(linearisation_id));
        self.end()?;
        Ok(v1::JacobianRequest { session_id, at })
    }
}

/// A vector as a block of one.
pub fn block(mut array: Array) -> Array {
    if array.shape.len() == 1 {
        array.shape.insert(0, 1);
    }
    array
}

/// Points, or the coordinates of points one after the other, as a block of one vector.
pub fn point_block(mut array: Array) -> Array {
    match array.shape[..] {
        [coordinates] if coordinates % 3 == 0 => array.shape = vec![1, coordinates / 3, 3],
        [_, 3] => array.shape.insert(0, 1),
        _ => {}
    }
    array
}

#[cfg(test)]
mod tests {
    use super::*;

    fn array(shape: &[u64]) -> Array {
        Array { shape: shape.to_vec(), ..Array::default() }
    }

    #[test]
    fn arrays_find_their_places_and_strangers_are_refused() {
        let named = |names: &[(&str, &[u64])]| {
            Arrays::new(names.iter().map(|&(name, shape)| (name.to_owned(), array(shape))).collect())
        };
        let request = named(&[
            ("control_points.wing.tip", &[4, 3]),
            ("at.control_points.tail", &[5, 3]),
            ("design", &[7]),
            ("at.design", &[7]),
        ]);
        let request = request.jvp("s".to_owned(), Some("id".to_owned())).unwrap();
        assert_eq!(request.design.unwrap().shape, [1, 7]);
        assert_eq!(request.control_points[0].component, "wing.tip");
        assert_eq!(request.control_points[0].vectors.as_ref().unwrap().shape, [1, 4, 3]);
        let at = request.at.unwrap();
        assert_eq!(at.linearisation_id, "id");
        let point = at.design_point.unwrap();
        assert!(point.input.is_some());
        assert_eq!(point.control_points[0].component, "tail");

        let vjp = |shape| {
            let request = named(&[("vertices", shape)]).vjp("s".to_owned(), None, false, Vec::new()).unwrap();
            assert!(request.at.unwrap().design_point.is_none());
            request.vertices.unwrap().shape
        };
        assert_eq!(vjp(&[12]), [1, 4, 3]);
        assert_eq!(vjp(&[4, 3]), [1, 4, 3]);
        assert_eq!(vjp(&[2, 4, 3]), [2, 4, 3]);
        assert_eq!(vjp(&[13]), [13]);
        let error = named(&[("design", &[1]), ("desing", &[1])]).deform("s".to_owned(), false).unwrap_err();
        assert_eq!(error.violations[0].field, "desing");
    }
}
