//! The panel service without a transport: ids, sharing, limits, cancellation.
#![allow(clippy::unwrap_used, reason = "helpers of tests may panic")]

use std::sync::Arc;

use moldline_host::{Code, ComputePool, PoolLimits, Principal, Role, ServiceError, Tenant};
use moldline_mesh::MeshError;
use moldline_panel::{
    Flow, Inputs, Options, Outputs, PanelError, PanelSetup, Reference, Scalars, TrailingEdges,
};
use moldline_panel_service::{AnalysisPoint, Definition, Geometry, Limits, PanelService};
use moldline_testing::{Wing, eventually, sphere};

fn service(limits: Limits) -> Arc<PanelService> {
    let pool = ComputePool::new(
        PoolLimits { threads: 2, running: 2, queued: 8, work: PoolLimits::WORK },
        usize::MAX,
    )
    .unwrap();
    Arc::new(PanelService::new(Arc::new(pool), limits))
}

fn wing() -> Definition {
    let mesh = Wing { half: true, ..Wing::rectangular(12, 8) }.mesh();
    Definition {
        cells: mesh.cells,
        vertices: mesh.vertices,
        cell_groups: mesh.cell_groups,
        vertex_groups: mesh.vertex_groups,
        options: Options {
            trailing_edges: TrailingEdges::Groups(vec!["trailing_edge".to_owned()]),
            ..Options::default()
        },
        merge_tolerance: None,
    }
}

fn flow(alpha: f64) -> Flow {
    let reference = Reference { area: 8.0, chord: 1.0, span: 8.0, point: [0.25, 0.0, 0.0] };
    Flow { alpha, sideslip: 0.0, reference }
}

fn still(mach: f64) -> Geometry {
    Geometry { vertices: None, mach }
}

#[tokio::test]
async fn analyses_and_products_are_those_of_the_panel_method() {
    let service = service(Limits::default());
    let caller = Principal::local();
    let made = service.create_configuration(&caller, wing()).await.unwrap();
    assert!(made.created);
    let id = &made.configuration.id;
    let flows = vec![flow(0.0), flow(0.05)];
    let mut stages = Vec::new();
    let analysed = service
        .analyse(&caller, id, still(0.3), flows, |progress| stages.push(progress.stage))
        .await
        .unwrap();
    stages.dedup();
    assert_eq!(stages, ["influence", "factorisation", "solution"]);

    let mesh = Wing { half: true, ..Wing::rectangular(12, 8) }.mesh();
    let setup = PanelSetup::new(&mesh, wing().options).unwrap();
    let solution = Arc::new(setup.solve(&mesh.vertices, 0.3, &moldline_panel::NoMonitor).unwrap());
    assert_eq!(analysed.analyses[1], solution.analyse(&flow(0.05)).unwrap());
    assert_eq!(analysed.solved.residuals.last(), Some(&analysed.analyses[0].residual));

    let seed = Outputs { scalars: Scalars { lift: 1.0, ..Scalars::default() }, ..Outputs::default() };
    let at = |id: &str, geometry| AnalysisPoint { analysis_id: id.to_owned(), geometry, flow: flow(0.05) };
    let expected = solution
        .linearise(&flow(0.05))
        .unwrap()
        .vjp(std::slice::from_ref(&seed), &moldline_panel::NoMonitor)
        .unwrap();
    let by_id = service.vjp(&caller, id, at(&analysed.solved.id, None), vec![seed.clone()]).await.unwrap();
    assert_eq!(by_id.value, expected);
    // Solved again by a service without the solution.
    let other = self::service(Limits::default());
    other.create_configuration(&caller, wing()).await.unwrap();
    let again = other.vjp(&caller, id, at(&analysed.solved.id, Some(still(0.3))), vec![seed]).await.unwrap();
    assert_eq!(again.value, expected);
    let direction = Inputs { alpha: 1.0, ..Inputs::default() };
    let changes = service.jvp(&caller, id, at(&analysed.solved.id, None), vec![direction]).await.unwrap();
    assert!((changes.value[0].scalars.lift - analysed.analyses[1].scalars.lift_slope).abs() < 1e-12);

    let wrong =
        service.vjp(&caller, id, at(&analysed.solved.id, Some(still(0.2))), vec![Outputs::default()]).await;
    assert_eq!(wrong.unwrap_err().violations[0].field, "at.analysis_id");
    let nothing = service.vjp(&caller, id, at("", None), vec![Outputs::default()]).await.unwrap_err();
    assert_eq!(nothing.violations[0].field, "at");
    let none = service.vjp(&caller, id, at(&analysed.solved.id, None), Vec::new()).await.unwrap_err();
    assert_eq!(none.violations[0].field, "seeds");
}

/// The wing with the vertices of its upper row of cells double, as files of single patches have them.
fn cracked() -> Definition {
    let mut wing = wing();
    let double = wing.cells.len() / 2;
    let mut copies = std::collections::HashMap::new();
    for cell in &mut wing.cells[double..] {
        *cell = cell.map(|vertex| {
            *copies.entry(vertex).or_insert_with(|| {
                // A bit beside the original.
                let [x, y, z] = wing.vertices[vertex as usize];
                wing.vertices.push([x, y, z + 1e-12]);
                wing.vertices.len() as u32 - 1
            })
        });
    }
    // Vertices that only the second half has are now its copies' alone.
    let mut used = vec![false; wing.vertices.len()];
    wing.cells.iter().flat_map(|cell| cell.vertices()).for_each(|&vertex| used[vertex as usize] = true);
    let mut number = vec![0; used.len()];
    let mut next = 0;
    for (number, &used) in number.iter_mut().zip(&used) {
        *number = next;
        next += u32::from(used);
    }
    wing.cells.iter_mut().for_each(|cell| *cell = cell.map(|vertex| number[vertex as usize]));
    let edge = &mut wing.vertex_groups;
    for group in edge {
        let original = std::mem::take(&mut group.indices);
        let all = original.iter().chain(original.iter().filter_map(|vertex| copies.get(vertex)));
        group.indices = all.filter(|v| used[**v as usize]).map(|&v| number[v as usize]).collect();
        group.indices.sort_unstable();
    }
    let mut keep = used.iter();
    wing.vertices.retain(|_| keep.next() == Some(&true));
    wing
}

#[tokio::test]
async fn merged_vertices_keep_their_places_in_arrays_and_derivatives() {
    let service = service(Limits::default());
    let caller = Principal::local();
    let open = service.create_configuration(&caller, cracked()).await.unwrap_err();
    assert!(open.message.contains("merge_tolerance") && open.message.contains("double"), "{}", open.message);
    let definition = Definition { merge_tolerance: Some(1e-9), ..cracked() };
    let n = definition.vertices.len();
    let configuration = service.create_configuration(&caller, definition).await.unwrap().configuration;
    let whole = service.create_configuration(&caller, wing()).await.unwrap().configuration;
    assert_eq!(configuration.merging.as_ref().unwrap().count(), n - whole.vertices.len());
    let analyse = |id: String| {
        let service = &service;
        async move {
            service.analyse(&Principal::local(), &id, still(0.3), vec![flow(0.05)], |_| {}).await.unwrap()
        }
    };
    let (merged, expected) = (analyse(configuration.id.clone()).await, analyse(whole.id.clone()).await);
    let lift = |analysed: &moldline_panel_service::Analysed| analysed.analyses[0].scalars.lift;
    assert!((lift(&merged) - lift(&expected)).abs() < 1e-9);
    assert_eq!((merged.analyses[0].vertex_cp.len(), merged.analyses[0].cp.len()), (n, whole.cells));
    let of_group = &cracked().vertex_groups[0].indices;
    assert!(merged.analyses[0].sections.iter().flat_map(|s| s.edge).all(|vertex| of_group.contains(&vertex)));

    let at = || AnalysisPoint { analysis_id: merged.solved.id.clone(), geometry: None, flow: flow(0.05) };
    let wave = |k: usize| [0, 1, 2].map(|axis| (0.7 * k as f64 + axis as f64).sin());
    let direction = Inputs { vertices: (0..n).map(wave).collect(), ..Inputs::default() };
    let seed =
        Outputs { scalars: Scalars { lift: 1.0, moment: -0.5, ..Scalars::default() }, ..Outputs::default() };
    let id = &configuration.id;
    let change = service.jvp(&caller, id, at(), vec![direction.clone()]).await.unwrap().value.remove(0);
    let gradient = service.vjp(&caller, id, at(), vec![seed]).await.unwrap().value.remove(0);
    assert_eq!(gradient.vertices.len(), n);
    let dot = |a: &[[f64; 3]], b: &[[f64; 3]]| -> f64 {
        a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| a * b).sum()
    };
    let (forwards, backwards) =
        (change.scalars.lift - 0.5 * change.scalars.moment, dot(&gradient.vertices, &direction.vertices));
    assert!((forwards - backwards).abs() < 1e-10 * forwards.abs(), "{forwards} and {backwards}");

    let wrong = Inputs { vertices: vec![[0.0; 3]; n - 1], ..Inputs::default() };
    assert!(service.jvp(&caller, id, at(), vec![wrong]).await.is_err());
    let mut apart = configuration.vertices.to_vec();
    let near = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
    let double = (0..n).position(|v| (v + 1..n).any(|w| near(&apart[v], &apart[w]))).unwrap();
    apart[double][2] += 1.0;
    let torn = Geometry { vertices: Some(apart), mach: 0.3 };
    let error = service.analyse(&caller, id, torn, vec![flow(0.05)], |_| {}).await.err().unwrap();
    assert!(error.message.contains("merged with"), "{}", error.message);
    let coarse = Definition { merge_tolerance: Some(0.5), ..cracked() };
    let error = service.create_configuration(&caller, coarse).await.unwrap_err();
    assert_eq!(error.violations[0].field, "options.merge_tolerance");
}

#[tokio::test]
async fn ids_follow_content_and_concurrent_requests_share_their_work() {
    let service = service(Limits::default());
    let caller = Principal::local();
    let first = service.create_configuration(&caller, wing()).await.unwrap();
    let second = service.create_configuration(&caller, wing()).await.unwrap();
    assert!(!second.created && Arc::ptr_eq(&first.configuration, &second.configuration));
    let mut other = wing();
    other.options.tolerance = 1e-10;
    assert_ne!(other.id(), first.configuration.id);
    let mut other = wing();
    other.vertices[3][2] += 1e-12;
    assert_ne!(other.id(), first.configuration.id);

    let id = &first.configuration.id;
    let ask = || service.analyse(&caller, id, still(0.3), vec![flow(0.05)], |_| {});
    let (one, two) = tokio::join!(ask(), ask());
    let (one, two) = (one.unwrap(), two.unwrap());
    assert!(Arc::ptr_eq(&one.solved, &two.solved) && one.reused != two.reused);
    let explicit = Geometry { vertices: Some(wing().vertices), mach: 0.3 };
    assert!(service.analyse(&caller, id, explicit, vec![flow(0.1)], |_| {}).await.unwrap().reused);
}

#[tokio::test]
async fn a_derivative_names_an_analysis_of_its_own_configuration() {
    let service = service(Limits::default());
    let caller = Principal::local();
    let mut other = wing();
    other.options.tolerance = 1e-10;
    let one = service.create_configuration(&caller, wing()).await.unwrap().configuration.id.clone();
    let two = service.create_configuration(&caller, other).await.unwrap().configuration.id.clone();
    let analysed = service.analyse(&caller, &one, still(0.2), vec![flow(0.05)], |_| {}).await.unwrap();
    let at = || AnalysisPoint { analysis_id: analysed.solved.id.clone(), geometry: None, flow: flow(0.05) };
    service.vjp(&caller, &one, at(), vec![Outputs::default()]).await.unwrap();
    let error = service.vjp(&caller, &two, at(), vec![Outputs::default()]).await.unwrap_err();
    assert_eq!((error.code, error.violations[0].field.as_str()), (Code::InvalidArgument, "at.analysis_id"));
    assert!(error.message.contains(&one), "{error}");
    let error = service.jvp(&caller, &two, at(), vec![Inputs::default()]).await.unwrap_err();
    assert_eq!(error.code, Code::InvalidArgument);
}

#[tokio::test]
async fn a_tenant_sees_its_own_and_a_reader_computes_nothing() {
    let service = service(Limits::default());
    let caller = Principal::local();
    let id = service.create_configuration(&caller, wing()).await.unwrap().configuration.id.clone();
    let stranger = Principal { tenant: Tenant::new("other").unwrap(), role: Role::User };
    assert_eq!(service.configuration(&stranger, &id).unwrap_err().code, Code::NotFound);
    let reader = Principal { role: Role::Reader, ..caller };
    assert!(service.configuration(&reader, &id).is_ok());
    let rejected = service.analyse(&reader, &id, still(0.0), vec![flow(0.0)], |_| {}).await.unwrap_err();
    assert_eq!(rejected.code, Code::PermissionDenied);
}

#[tokio::test]
async fn older_solutions_are_evicted() {
    let caller = Principal::local();
    // Room for one solution being computed, but not for another that is kept beside it.
    let room = {
        let probe = service(Limits::default());
        let configuration = probe.create_configuration(&caller, wing()).await.unwrap().configuration;
        probe.analyse(&caller, &configuration.id, still(0.1), vec![flow(0.0)], |_| {}).await.unwrap();
        configuration.summary.memory + probe.status().solutions.bytes as u64 / 2
    };
    let service = service(Limits { solution_bytes: room, ..Limits::default() });
    let id = service.create_configuration(&caller, wing()).await.unwrap().configuration.id.clone();
    let mut names = Vec::new();
    for mach in [0.1, 0.2, 0.3, 0.4] {
        let analysed = service.analyse(&caller, &id, still(mach), vec![flow(0.0)], |_| {}).await.unwrap();
        names.push(analysed.solved.id.clone());
        assert!(service.status().solutions.bytes as u64 <= room);
    }
    assert!(service.status().solutions.evictions > 0);
    let at = AnalysisPoint { analysis_id: names[0].clone(), geometry: None, flow: flow(0.0) };
    let dropped = service.vjp(&caller, &id, at, vec![Outputs::default()]).await.unwrap_err();
    assert_eq!((dropped.code, dropped.violations[0].field.as_str()), (Code::NotFound, "at.analysis_id"));
}

#[tokio::test]
async fn dropping_a_request_stops_its_work() {
    let service = service(Limits::default());
    let caller = Principal::local();
    let mesh = sphere(20);
    let definition = Definition {
        cells: mesh.cells,
        vertices: mesh.vertices,
        cell_groups: Vec::new(),
        vertex_groups: Vec::new(),
        options: Options { trailing_edges: TrailingEdges::None, ..Options::default() },
        merge_tolerance: None,
    };
    let id = service.create_configuration(&caller, definition).await.unwrap().configuration.id.clone();
    let (started, has_started) = tokio::sync::oneshot::channel();
    let mut started = Some(started);
    let work = tokio::spawn({
        let (service, id) = (Arc::clone(&service), id.clone());
        async move {
            let tell = |_| {
                if let Some(started) = started.take() {
                    let _ = started.send(());
                }
            };
            service.analyse(&Principal::local(), &id, still(0.0), vec![flow(0.0)], tell).await
        }
    });
    has_started.await.unwrap();
    work.abort();
    eventually("idle pool", async || (service.load() == 0).then_some(())).await;
    let status = service.status();
    assert_eq!((status.solutions.entries, status.solutions.bytes), (0, 0));
}

#[tokio::test]
async fn invalid_vertices_have_their_class() {
    let service = service(Limits::default());
    let caller = Principal::local();
    let id = service.create_configuration(&caller, wing()).await.unwrap().configuration.id.clone();
    let ask = async |change: &dyn Fn(&mut Vec<[f64; 3]>)| {
        let mut vertices = wing().vertices;
        change(&mut vertices);
        let geometry = Geometry { vertices: Some(vertices), mach: 0.0 };
        service.analyse(&caller, &id, geometry, vec![flow(0.0)], |_| {}).await.unwrap_err()
    };
    let nan = ask(&|vertices| vertices[5][1] = f64::NAN).await;
    assert_eq!((nan.code, nan.violations[0].field.as_str()), (Code::InvalidArgument, "vertices[5][1]"));
    let flat = ask(&|vertices| vertices[17] = vertices[16]).await;
    assert_eq!(flat.code, Code::FailedPrecondition, "{flat}");
}

#[test]
fn errors_of_the_panel_method_have_code_and_field() {
    let answer = |error: PanelError| {
        let text = error.to_string();
        let answer = ServiceError::from(error);
        assert!(answer.message.ends_with(&text));
        (answer.code, answer.violations.first().map(|violation| violation.field.clone()))
    };
    let at = |code, field: &str| (code, Some(field.to_owned()));
    let cuts = PanelError::WakeCutsBody { edge: [0, 1], cell: 5, x: 1.0 };
    assert_eq!(answer(cuts), at(Code::FailedPrecondition, "vertices"));
    let edge = PanelError::NotAnEdge { index: 2, edge: [0, 1] };
    assert_eq!(answer(edge), at(Code::InvalidArgument, "options.trailing_edges[2]"));
    let open = PanelError::Open { count: 1, edge: [0, 1], cell: 3 };
    assert_eq!(answer(open), at(Code::InvalidArgument, "cells[3]"));
    let groups = MeshError::DuplicateGroup { kind: "cell", group: "wing".to_owned() };
    assert_eq!(answer(PanelError::Mesh(groups)), at(Code::InvalidArgument, "cell_groups"));
    let memory = PanelError::Memory { unknowns: 10, needed: 800, limit: 100, advice: "use fewer cells" };
    assert_eq!(answer(memory), (Code::ResourceExhausted, None));
    assert_eq!(answer(PanelError::Cancelled), (Code::Cancelled, None));
}

#[tokio::test]
async fn numbers_that_are_not_finite_never_leave() {
    let service = service(Limits::default());
    let caller = Principal::local();
    let id = service.create_configuration(&caller, wing()).await.unwrap().configuration.id.clone();
    let at = || AnalysisPoint { analysis_id: String::new(), geometry: Some(still(0.3)), flow: flow(0.05) };
    let seed = Outputs {
        scalars: Scalars { moment: f64::MAX, lift: f64::MAX, ..Scalars::default() },
        ..Outputs::default()
    };
    let refused = service.vjp(&caller, &id, at(), vec![seed]).await.unwrap_err();
    assert!(refused.code == Code::FailedPrecondition && refused.message.contains("scale them"), "{refused}");
    let vertices = vec![[1e308; 3]; wing().vertices.len()];
    let direction = Inputs { vertices, alpha: 1e308, ..Inputs::default() };
    let refused = service.jvp(&caller, &id, at(), vec![direction]).await.unwrap_err();
    assert!(refused.message.contains("scale them"), "{refused}");
}

#[tokio::test]
async fn names_of_groups_are_bounded() {
    let service = service(Limits::default());
    let mut definition = wing();
    definition.vertex_groups[0].name = "n".repeat(257);
    let refused = service.create_configuration(&Principal::local(), definition).await.unwrap_err();
    assert_eq!(refused.code, Code::InvalidArgument);
    assert!(refused.message.contains("257") && refused.message.len() < 300, "{refused}");
}
