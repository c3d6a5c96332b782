//! The arrays and headers of the panel method's answers.

use moldline_proto::v1::{self, Array};

use crate::http::replies::{Reply, named, server_timing};

impl Reply for v1::Analysis {
    fn take_arrays(&mut self) -> Vec<(String, Array)> {
        let mut arrays = Vec::new();
        for (index, flow) in self.flows.iter_mut().enumerate() {
            arrays.extend(named(&format!("cp.{index}"), flow.cp.take()));
            arrays.extend(named(&format!("vertex_cp.{index}"), flow.vertex_cp.take()));
            if let Some(v1::SectionLoads { edges, middles, spans, loads }) = flow.sections.take() {
                arrays.extend(named(&format!("sections.edges.{index}"), edges));
                arrays.extend(named(&format!("sections.middles.{index}"), middles));
                arrays.extend(named(&format!("sections.spans.{index}"), spans));
                arrays.extend(named(&format!("sections.loads.{index}"), loads));
            }
        }
        arrays
    }

    fn headers(&self) -> Vec<(&'static str, String)> {
        let id = ("moldline-analysis-id", self.analysis_id.clone());
        std::iter::once(id).chain(server_timing(self.timings)).collect()
    }
}

impl Reply for v1::PanelServiceApplyJacobianVectorResponse {
    fn take_arrays(&mut self) -> Vec<(String, Array)> {
        let v1::FlowOutputs { coefficients, section_loads, cp } = self.changes.take().unwrap_or_default();
        let parts = [("coefficients", coefficients), ("section_loads", section_loads), ("cp", cp)];
        parts.into_iter().filter_map(|(name, array)| named(name, array)).collect()
    }

    fn headers(&self) -> Vec<(&'static str, String)> {
        server_timing(self.timings).into_iter().collect()
    }
}

impl Reply for v1::PanelServiceApplyAdjointResponse {
    fn take_arrays(&mut self) -> Vec<(String, Array)> {
        let v1::FlowInputs { vertices, alpha, sideslip, mach, area, chord, point } =
            self.gradients.take().unwrap_or_default();
        let parts = [
            ("vertices", vertices),
            ("alpha", alpha),
            ("sideslip", sideslip),
            ("mach", mach),
            ("area", area),
            ("chord", chord),
            ("point", point),
        ];
        parts.into_iter().filter_map(|(name, array)| named(name, array)).collect()
    }

    fn headers(&self) -> Vec<(&'static str, String)> {
        server_timing(self.timings).into_iter().collect()
    }
}
