//! Answers with arrays: the names of the arrays, and the headers of binary answers.

use axum::response::Response;
use moldline_proto::v1::{self, Array, design_point};
use moldline_transport::{
    Answer,
    media::{self, Media},
};
use prost::Message;
use serde::Serialize;

/// An answer with arrays.
pub trait Reply: Message + Serialize + Sized + 'static {
    /// Takes the arrays out of the answer, each with its name, the main array first.
    fn take_arrays(&mut self) -> Vec<(String, Array)>;

    /// Headers of an answer that consists of the main array only.
    fn headers(&self) -> Vec<(&'static str, String)>;

    /// Responds with the type that the client accepts.
    fn respond(self, media: Media) -> impl Future<Output = Answer<Response>> + Send {
        let headers = self.headers();
        media::beside(self.encoded_len(), move || media::reply(media, self, Self::take_arrays, &headers))
    }
}

/// The header with the id of an answer's linearisation.
const LINEARISATION_ID: &str = "moldline-linearisation-id";

/// An array with its name, if there is one.
pub fn named(name: &str, array: Option<Array>) -> Option<(String, Array)> {
    array.map(|array| (name.to_owned(), array))
}

fn of_components(control_points: Vec<v1::ControlPoints>) -> impl Iterator<Item = (String, Array)> {
    control_points.into_iter().filter_map(|v1::ControlPoints { component, points }| {
        named(&format!("control_points.{component}"), points)
    })
}

/// The header with queue and engine times, which browsers show.
pub fn server_timing(timings: Option<v1::Timings>) -> Option<(&'static str, String)> {
    let v1::Timings { queue_seconds, engine_seconds } = timings?;
    let (queue, engine) = (1e3 * queue_seconds, 1e3 * engine_seconds);
    Some(("server-timing", format!("queue;dur={queue:.3}, engine;dur={engine:.3}")))
}

impl Reply for v1::GetSetupResponse {
    fn take_arrays(&mut self) -> Vec<(String, Array)> {
        let mut arrays = Vec::new();
        if let Some(v1::Mesh { vertices, cells, cell_owner, seam }) = self.mesh.take() {
            arrays.extend(named("vertices", vertices));
            arrays.extend(named("cells", cells));
            arrays.extend(named("cell_owner", cell_owner));
            arrays.extend(named("seam", seam));
        }
        arrays.extend(of_components(std::mem::take(&mut self.control_points)));
        arrays
    }

    fn headers(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }
}

impl Reply for v1::GetSessionResponse {
    fn take_arrays(&mut self) -> Vec<(String, Array)> {
        let Some(session) = &mut self.session else { return Vec::new() };
        let Some(v1::DesignPoint { input, control_points }) = session.design.take() else {
            return Vec::new();
        };
        let design = match input {
            Some(design_point::Input::Design(design)) => Some(design),
            _ => None,
        };
        named("design", design).into_iter().chain(of_components(control_points)).collect()
    }

    fn headers(&self) -> Vec<(&'static str, String)> {
        let generation = self.session.iter().map(|session| session.generation.to_string());
        generation.map(|generation| ("moldline-generation", generation)).collect()
    }
}

impl Reply for v1::DeformResponse {
    fn take_arrays(&mut self) -> Vec<(String, Array)> {
        let mut arrays = Vec::new();
        arrays.extend(named("vertices", self.vertices.take()));
        arrays.extend(named("functions", self.functions.take()));
        if let Some(quality) = self.cell_quality.take() {
            let v1::CellQuality { aspect_ratio, edge_ratio, scaled_jacobian, skew } = quality;
            arrays.extend(named("cell_quality.aspect_ratio", aspect_ratio));
            arrays.extend(named("cell_quality.edge_ratio", edge_ratio));
            arrays.extend(named("cell_quality.scaled_jacobian", scaled_jacobian));
            arrays.extend(named("cell_quality.skew", skew));
        }
        arrays
    }

    fn headers(&self) -> Vec<(&'static str, String)> {
        let id = (LINEARISATION_ID, self.linearisation_id.clone());
        std::iter::once(id).chain(server_timing(self.timings)).collect()
    }
}

impl Reply for v1::ApplyJacobianVectorResponse {
    fn take_arrays(&mut self) -> Vec<(String, Array)> {
        let vertices = named("vertices", self.vertices.take());
        vertices.into_iter().chain(named("functions", self.functions.take())).collect()
    }

    fn headers(&self) -> Vec<(&'static str, String)> {
        server_timing(self.timings).into_iter().collect()
    }
}

impl Reply for v1::ApplyAdjointResponse {
    fn take_arrays(&mut self) -> Vec<(String, Array)> {
        let vectors = |v1::ControlPointVectors { component, vectors }| {
            named(&format!("control_points.{component}"), vectors)
        };
        let of_points = std::mem::take(&mut self.control_points).into_iter().filter_map(vectors);
        named("design", self.design.take()).into_iter().chain(of_points).collect()
    }

    fn headers(&self) -> Vec<(&'static str, String)> {
        server_timing(self.timings).into_iter().collect()
    }
}

impl Reply for v1::JacobianResponse {
    fn take_arrays(&mut self) -> Vec<(String, Array)> {
        let vertices = named("vertices", self.vertices.take());
        vertices.into_iter().chain(named("functions", self.functions.take())).collect()
    }

    fn headers(&self) -> Vec<(&'static str, String)> {
        server_timing(self.timings).into_iter().collect()
    }
}
