//! Driver of the Rust client for the end-to-end tests: see README.md.

use std::{
    collections::BTreeMap,
    io::{BufRead, Write},
    sync::{Arc, Mutex},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use base64::{Engine, prelude::BASE64_STANDARD};
use moldline_client::{
    At, Check, CheckOptions, CheckedVariable, Client, ControlPoints, CreateOptions, Design, DesignPoint,
    Difference, Directions, Error, Linearisation, Options, Seeds, Session, SessionState, SessionUpdate,
    Setup, SetupAccess, Tell, Tls, Visibility, panel,
};
use serde_json::{Map, Value, json};
use tokio::sync::Notify;

/// Failure of a command.
enum Failure {
    Refused(Error),
    Cancelled,
    /// The command itself is wrong.
    Wrong(String),
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self::Refused(error)
    }
}

type Answer = Result<Value, Failure>;

fn wrong(what: impl Into<String>) -> Failure {
    Failure::Wrong(what.into())
}

fn encoded(dtype: &str, shape: &[usize], bytes: &[u8]) -> Value {
    json!({"dtype": dtype, "shape": shape, "data": BASE64_STANDARD.encode(bytes)})
}

fn numbers(values: &[f64], shape: &[usize]) -> Value {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    encoded("<f8", shape, &bytes)
}

fn integers(values: &[u32], shape: &[usize]) -> Value {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    encoded("<u4", shape, &bytes)
}

fn array(values: &[f64]) -> Value {
    numbers(values, &[values.len()])
}

fn points(values: &[[f64; 3]]) -> Value {
    numbers(values.as_flattened(), &[values.len(), 3])
}

/// k vectors.
fn block(values: &[f64], k: usize) -> Value {
    numbers(values, &[k, values.len() / k])
}

fn point_block(values: &[[f64; 3]], k: usize) -> Value {
    numbers(values.as_flattened(), &[k, values.len() / k, 3])
}

fn by_component(given: &ControlPoints, array: impl Fn(&[[f64; 3]]) -> Value) -> Value {
    given.iter().map(|(component, points)| (component.clone(), array(points))).collect::<Map<_, _>>().into()
}

/// A command's arguments.
struct Arguments(Value);

impl Arguments {
    fn has(&self, name: &str) -> bool {
        self.0.get(name).is_some()
    }

    fn at(&self, name: &str) -> Result<&Value, Failure> {
        self.0.get(name).ok_or_else(|| wrong(format!("the command lacks {name}")))
    }

    fn text(&self, name: &str) -> String {
        self.0[name].as_str().unwrap_or_default().to_owned()
    }

    fn optional(&self, name: &str) -> Option<String> {
        self.has(name).then(|| self.text(name))
    }

    fn seconds(&self, name: &str) -> Option<Duration> {
        self.0[name].as_f64().map(Duration::from_secs_f64)
    }

    fn texts(&self, name: &str) -> Vec<String> {
        let texts = self.0[name].as_array().map(Vec::as_slice).unwrap_or_default();
        texts.iter().map(|text| text.as_str().unwrap_or_default().to_owned()).collect()
    }

    fn visibility(&self) -> Result<Visibility, Failure> {
        match self.text("visibility").as_str() {
            "private" => Ok(Visibility::Private),
            "tenants" => Ok(Visibility::Tenants),
            "public" => Ok(Visibility::Public),
            other => Err(wrong(format!("there is no visibility {other}"))),
        }
    }

    fn part(&self, name: &str) -> Result<Self, Failure> {
        Ok(Self(self.at(name)?.clone()))
    }

    fn number(&self, name: &str) -> f64 {
        self.0[name].as_f64().unwrap_or_default()
    }

    fn values(&self, name: &str) -> Result<Vec<f64>, Failure> {
        if self.has(name) { values_of(self.at(name)?) } else { Ok(Vec::new()) }
    }

    fn points(&self, name: &str) -> Result<Vec<[f64; 3]>, Failure> {
        if self.has(name) { points_of(self.at(name)?) } else { Ok(Vec::new()) }
    }

    /// k, as the first array among the arguments of these names has it.
    fn count(&self, names: &[&str]) -> usize {
        names.iter().find_map(|&name| self.0.get(name)).map_or(1, vectors_in)
    }

    fn index_groups(&self, name: &str) -> Result<panel::IndexGroups, Failure> {
        let given = self.0[name].as_object().cloned().unwrap_or_default();
        given.iter().map(|(name, each)| Ok((name.clone(), indices_of(each)?))).collect()
    }

    fn reference(&self) -> Result<panel::Reference, Failure> {
        let given = self.part("reference")?;
        let point = given.at("point")?.as_array().ok_or_else(|| wrong("a point is a list"))?;
        let point = point.iter().map(|part| part.as_f64().unwrap_or(f64::NAN)).collect::<Vec<_>>();
        Ok(panel::Reference {
            area: given.number("area"),
            chord: given.number("chord"),
            span: given.number("span"),
            point: point.try_into().map_err(|_| wrong("a point has three parts"))?,
        })
    }

    fn control_points(&self) -> Result<ControlPoints, Failure> {
        let given = self.0["control_points"].as_object().cloned().unwrap_or_default();
        given.iter().map(|(component, each)| Ok((component.clone(), points_of(each)?))).collect()
    }

    fn point(&self) -> Result<DesignPoint, Failure> {
        let design = match &self.0["design"] {
            Value::Null => Design::Baseline,
            array if array.get("data").is_some() => Design::Vector(values_of(array)?),
            named => {
                let named = named.as_object().ok_or_else(|| wrong("a design is an array or an object"))?;
                Design::named(
                    named.iter().map(|(name, value)| (name.as_str(), value.as_f64().unwrap_or(f64::NAN))),
                )
            }
        };
        Ok(DesignPoint { design, control_points: self.control_points()? })
    }
}

fn values_of(array: &Value) -> Result<Vec<f64>, Failure> {
    let text = array["data"].as_str().ok_or_else(|| wrong("an array has data"))?;
    let bytes = BASE64_STANDARD.decode(text).map_err(|error| wrong(error.to_string()))?;
    Ok(bytes.as_chunks().0.iter().map(|&bytes| f64::from_le_bytes(bytes)).collect())
}

fn points_of(array: &Value) -> Result<Vec<[f64; 3]>, Failure> {
    Ok(values_of(array)?.as_chunks().0.to_vec())
}

fn indices_of(array: &Value) -> Result<Vec<u32>, Failure> {
    let text = array["data"].as_str().ok_or_else(|| wrong("an array has data"))?;
    let bytes = BASE64_STANDARD.decode(text).map_err(|error| wrong(error.to_string()))?;
    Ok(bytes.as_chunks().0.iter().map(|&bytes| u32::from_le_bytes(bytes)).collect())
}

fn vectors_in(array: &Value) -> usize {
    array["shape"][0].as_u64().unwrap_or_default() as usize
}

fn access(access: &SetupAccess) -> Value {
    let visibility = match access.visibility {
        Visibility::Private => "private",
        Visibility::Tenants => "tenants",
        Visibility::Public => "public",
    };
    json!({"owned": access.owned, "visibility": visibility, "shared_with": access.shared_with})
}

fn timestamp(time: SystemTime) -> f64 {
    time.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64()
}

fn describe_setup(setup: &Setup) -> Value {
    let of = |value: fn(&moldline_client::Variable) -> f64| -> Vec<f64> {
        setup.variables.iter().map(value).collect()
    };
    let values: Vec<f64> = setup.functions.iter().map(|function| function.value).collect();
    json!({
        "setup": setup.id,
        "built": setup.built,
        "name": setup.name,
        "access": access(&setup.access),
        "report_text": setup.report_text,
        "variables": setup.variables.iter().map(|variable| &variable.name).collect::<Vec<_>>(),
        "units": setup.variables.iter().map(|variable| &variable.unit).collect::<Vec<_>>(),
        "baseline": array(&setup.baseline()),
        "lower": array(&of(|variable| variable.lower)),
        "upper": array(&of(|variable| variable.upper)),
        "groups": setup.groups.iter().map(|group| &group.name).collect::<Vec<_>>(),
        "components": setup.components,
        "control_point_counts": setup.control_point_counts,
        "functions": setup.functions.iter().map(|function| &function.name).collect::<Vec<_>>(),
        "function_values": array(&values),
        "vertex_count": setup.vertex_count,
        "cell_count": setup.cell_count,
    })
}

fn describe_session(state: &SessionState) -> Value {
    let mut made = json!({
        "session": state.id,
        "setup": state.setup_id,
        "generation": state.generation,
        "label": state.label,
        "updated": timestamp(state.updated),
    });
    if let Some(point) = &state.design {
        if let Design::Vector(values) = &point.design {
            made["design"] = array(values);
        }
        made["control_points"] = by_component(&point.control_points, points);
    }
    made
}

fn difference(each: &Difference) -> [f64; 2] {
    [each.step, each.error.unwrap_or(f64::NAN)]
}

fn describe_row(row: &CheckedVariable) -> Value {
    let differences: Vec<[f64; 2]> = row.differences.iter().map(difference).collect();
    let errors: Vec<f64> = row.stages.iter().map(|each| each.error).collect();
    let mut made = json!({
        "design": row.design,
        "variable": row.variable,
        "numbers": array(&[row.size, row.dual, row.worst_vertex as f64, row.functions]),
        "stages": row.stages.iter().map(|each| &each.stage).collect::<Vec<_>>(),
        "stage_errors": array(&errors),
        "first_discrepancy": row.first_discrepancy.clone().unwrap_or_default(),
        "differences": numbers(differences.as_flattened(), &[differences.len(), 2]),
        "best": array(row.best().as_ref().map(difference).as_ref().map_or(&[], |best| best)),
    });
    if let Some(kink) = &row.kink {
        let [x, y, z] = kink.position;
        let (vertices, worst_vertex) = (kink.vertices as f64, kink.worst_vertex as f64);
        made["crease"] = json!(kink.component);
        made["kink"] = array(&[vertices, worst_vertex, kink.jump, x, y, z, kink.error]);
    }
    made
}

fn describe_check(check: &Check) -> Value {
    let design = |each: &moldline_client::CheckedDesign| {
        let dots: Vec<[f64; 2]> = each.dot_products.iter().map(|dot| [dot.block as f64, dot.error]).collect();
        let maxima = [each.dot_product_max, each.dual_max, each.central_difference_max, each.values_max];
        json!({
            "design": array(&each.design),
            "dot_products": numbers(dots.as_flattened(), &[dots.len(), 2]),
            "maxima": array(&maxima),
        })
    };
    json!({
        "maxima": array(&[check.dot_product_max, check.dual_max, check.central_difference_max]),
        "seed": check.seed,
        "designs": check.designs.iter().map(design).collect::<Vec<_>>(),
        "rows": check.rows.iter().map(describe_row).collect::<Vec<_>>(),
        "definition": check.definition,
        "table": check.table,
    })
}

fn describe_configuration(configuration: &panel::Configuration) -> Value {
    let edges = &configuration.trailing_edges;
    let solver = match configuration.solver {
        panel::Solver::Automatic => "automatic",
        panel::Solver::Double => "double",
        panel::Solver::Single => "single",
        panel::Solver::Iterative => "iterative",
    };
    json!({
        "configuration": configuration.id,
        "vertex_count": configuration.vertex_count,
        "cell_count": configuration.cell_count,
        "unknowns": configuration.unknowns,
        "symmetric": configuration.symmetric,
        "trailing_edges": integers(edges.as_flattened(), &[edges.len(), 2]),
        "roots": integers(&configuration.roots, &[configuration.roots.len()]),
        "solver": solver,
        "memory": configuration.memory,
        "components": configuration.components,
    })
}

fn loads(loads: &panel::Loads) -> Value {
    array(&[loads.force.as_slice(), &loads.moment, &[loads.lift, loads.drag]].concat())
}

fn describe_analysis(analysis: &panel::Analysis) -> Value {
    let sections = &analysis.sections;
    let components: Map<_, _> =
        analysis.components.iter().map(|(name, each)| (name.clone(), loads(each))).collect();
    json!({
        "id": analysis.id,
        "coefficients": array(&analysis.coefficients.to_array()),
        "numbers": array(&[analysis.wake_lift, analysis.disagreement, analysis.residual]),
        "residuals": array(&analysis.residuals),
        "total": loads(&analysis.total),
        "components": components,
        "sections": {
            "edges": integers(sections.edges.as_flattened(), &[sections.edges.len(), 2]),
            "middles": points(&sections.middles),
            "spans": numbers(sections.spans.as_flattened(), &[sections.spans.len(), 2]),
            "loads": array(&sections.loads),
        },
        "cp": array(&analysis.cp),
        "vertex_cp": array(&analysis.vertex_cp),
        "supercritical_cells": analysis.supercritical_cells,
        "rounds": analysis.rounds,
        "reused": analysis.reused,
    })
}

/// Notes the stages of a long call, and tells when to cancel it.
struct Watch {
    stages: Arc<Mutex<Vec<String>>>,
    cancelled: Arc<Notify>,
}

impl Watch {
    fn new(arguments: &Arguments) -> (Self, Tell) {
        let watch = Self { stages: Arc::default(), cancelled: Arc::default() };
        let (stages, cancelled) = (watch.stages.clone(), watch.cancelled.clone());
        let cancel_at = arguments.text("cancel_at");
        let tell = move |progress: moldline_client::Progress| {
            let mut stages = stages.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
            if stages.last() != Some(&progress.stage) {
                stages.push(progress.stage.clone());
            }
            if progress.stage == cancel_at {
                cancelled.notify_one();
            }
        };
        (watch, Box::new(tell))
    }

    /// The result of a call, whose future is dropped if it is to be cancelled.
    async fn result<T>(&self, call: impl Future<Output = Result<T, Error>>) -> Result<T, Failure> {
        tokio::select! {
            biased;
            () = self.cancelled.notified() => Err(Failure::Cancelled),
            result = call => Ok(result?),
        }
    }

    fn stages(&self) -> Value {
        json!(*self.stages.lock().unwrap_or_else(|poisoned| poisoned.into_inner()))
    }
}

#[derive(Default)]
struct Driver {
    client: Option<Client>,
    panels: Option<panel::Client>,
    configurations: BTreeMap<String, panel::Configuration>,
    analyses: BTreeMap<String, panel::Analysis>,
    setups: BTreeMap<String, Setup>,
    sessions: BTreeMap<String, Session>,
    deformations: BTreeMap<String, Linearisation>,
}

impl Driver {
    async fn run(&mut self, what: &str, arguments: &Arguments) -> Answer {
        match what {
            "connect" => self.connect(arguments),
            "create_setup" => self.create_setup(arguments).await,
            "get_setup" => {
                let setup = self.client()?.get_setup(&arguments.text("setup")).await?;
                Ok(self.remember_setup(setup))
            }
            "mesh" => {
                let mesh = self.setup(arguments)?.mesh().await?;
                let seam: Vec<u8> = mesh.seam.iter().map(|&seam| seam.into()).collect();
                Ok(json!({
                    "vertices": points(&mesh.vertices),
                    "cells": integers(mesh.cells.as_flattened(), &[mesh.cells.len(), 4]),
                    "cell_owner": integers(&mesh.cell_owner, &[mesh.cell_owner.len()]),
                    "seam": encoded("|u1", &[seam.len()], &seam),
                }))
            }
            "control_points" => Ok(by_component(&self.setup(arguments)?.control_points().await?, points)),
            "list_setups" => {
                let setups = self.client()?.list_setups().await?;
                let summary = |each: &moldline_client::SetupSummary| {
                    json!({
                        "setup": each.id,
                        "name": each.name,
                        "vertex_count": each.vertex_count,
                        "variable_count": each.variable_count,
                        "created": timestamp(each.created),
                        "access": access(&each.access),
                    })
                };
                Ok(json!({"setups": setups.iter().map(summary).collect::<Vec<_>>()}))
            }
            "share" => {
                let tenants = arguments.texts("shared_with");
                let tenants: Vec<&str> = tenants.iter().map(String::as_str).collect();
                let visibility = arguments.visibility()?;
                let setup =
                    self.setups.get_mut(&arguments.text("setup")).ok_or_else(|| wrong("no such set-up"))?;
                setup.share(visibility, &tenants).await?;
                Ok(json!({"access": access(&setup.access)}))
            }
            "delete_setup" => {
                self.setup(arguments)?.delete().await?;
                Ok(json!({}))
            }
            "open" => {
                let setup = self.setup(arguments)?;
                let session =
                    setup.session_as(&arguments.text("label"), arguments.optional("request_id")).await?;
                Ok(self.remember_session(session))
            }
            "resume" => {
                let session = self.client()?.resume(&arguments.text("session")).await?;
                Ok(self.remember_session(session))
            }
            "list_sessions" => {
                let sessions = self.client()?.list_sessions().await?;
                Ok(json!({"sessions": sessions.iter().map(describe_session).collect::<Vec<_>>()}))
            }
            "update" => {
                let given = arguments.has("design") || arguments.has("control_points");
                let update = SessionUpdate {
                    design: if given { Some(arguments.point()?) } else { None },
                    label: arguments.optional("label"),
                };
                let session = self.session_mut(arguments)?;
                session.update(&update).await?;
                Ok(describe_session(session.state()))
            }
            "refresh" => {
                let session = self.session_mut(arguments)?;
                session.refresh().await?;
                Ok(describe_session(session.state()))
            }
            "close" => {
                self.session(arguments)?.close().await?;
                Ok(json!({}))
            }
            "deform" => self.deform(arguments).await,
            "jvp" => self.jvp(arguments).await,
            "vjp" => self.vjp(arguments).await,
            "jacobian" => self.jacobian(arguments).await,
            "check" => self.check(arguments).await,
            "create_configuration" => self.create_configuration(arguments).await,
            "get_configuration" => {
                let panels = self.panels.clone().ok_or_else(|| wrong("not connected"))?;
                let configuration = panels.get_configuration(&arguments.text("configuration")).await?;
                Ok(self.remember_configuration(configuration))
            }
            "analyze" => self.analyze(arguments).await,
            "panel_jvp" => self.panel_jvp(arguments).await,
            "panel_vjp" => self.panel_vjp(arguments).await,
            "status" => {
                let status = self.client()?.status().await?;
                Ok(json!({
                    "version": status.version,
                    "uptime_seconds": status.uptime.as_secs_f64(),
                    "sessions": status.sessions,
                    "setups_stored": status.setups_stored,
                    "running": status.running,
                    "queued": status.queued,
                    "linearisation_budget": status.linearisation_cache.budget_bytes,
                    "work": status.work.iter().map(|work| &work.kind).collect::<Vec<_>>(),
                }))
            }
            other => Err(wrong(format!("there is no command {other}"))),
        }
    }

    fn connect(&mut self, arguments: &Arguments) -> Answer {
        let mut options = Options { token: arguments.optional("token"), ..Options::default() };
        if arguments.has("tls") {
            let tls = Arguments(arguments.at("tls")?.clone());
            let path = |name| tls.optional(name).map(Into::into);
            options.tls = Some(Tls {
                authorities: path("authorities"),
                identity: path("certificate").zip(path("key")),
                server_name: tls.optional("server_name"),
            });
        }
        if let Some(timeout) = arguments.seconds("timeout") {
            options.timeout = Some(timeout);
        }
        if let Some(attempts) = arguments.0["attempts"].as_f64() {
            options.retry.attempts = attempts as u32;
        }
        if let Some(losses) = arguments.0["losses"].as_f64() {
            options.retry.losses = losses as u32;
        }
        if let Some(pause) = arguments.seconds("first_pause") {
            options.retry.first_pause = pause;
        }
        let address = arguments.text("address");
        *self = Self {
            client: Some(Client::with(&address, &options)?),
            panels: Some(panel::Client::with(&address, &options)?),
            ..Self::default()
        };
        Ok(json!({}))
    }

    async fn create_setup(&mut self, arguments: &Arguments) -> Answer {
        let (watch, tell) = Watch::new(arguments);
        let options = CreateOptions {
            setup_file: arguments.text("setup_file"),
            visibility: if arguments.has("visibility") { Some(arguments.visibility()?) } else { None },
            shared_with: arguments.texts("shared_with"),
            progress: Some(tell),
            request_id: arguments.optional("request_id"),
            timeout: arguments.seconds("timeout"),
        };
        let client = self.client()?;
        let setup = watch.result(client.create_setup(arguments.text("path"), options)).await?;
        let mut made = self.remember_setup(setup);
        made["stages"] = watch.stages();
        Ok(made)
    }

    async fn check(&self, arguments: &Arguments) -> Answer {
        let (watch, tell) = Watch::new(arguments);
        let mut options = CheckOptions {
            design: if arguments.has("design") { Some(arguments.point()?.design) } else { None },
            variables: arguments.texts("variables"),
            progress: Some(tell),
            timeout: arguments.seconds("timeout"),
            ..CheckOptions::default()
        };
        if arguments.has("designs") {
            options.designs = arguments.number("designs") as u32;
        }
        if arguments.has("seed") {
            options.seed = arguments.number("seed") as u64;
        }
        let check = watch.result(self.setup(arguments)?.check(options)).await?;
        let mut made = describe_check(&check);
        made["stages"] = watch.stages();
        Ok(made)
    }

    async fn create_configuration(&mut self, arguments: &Arguments) -> Answer {
        let mut options = panel::ConfigurationOptions {
            cell_groups: arguments.index_groups("cell_groups")?,
            vertex_groups: arguments.index_groups("vertex_groups")?,
            components: arguments.has("components").then(|| arguments.texts("components")),
            tolerance: arguments.0["tolerance"].as_f64(),
            ..Default::default()
        };
        options.symmetry = match arguments.text("symmetry").as_str() {
            "" => panel::Symmetry::Automatic,
            "none" => panel::Symmetry::None,
            "half" => panel::Symmetry::Half,
            "mirror" => panel::Symmetry::Mirror,
            other => return Err(wrong(format!("there is no symmetry {other}"))),
        };
        options.solver = match arguments.text("solver").as_str() {
            "" => panel::Solver::Automatic,
            "double" => panel::Solver::Double,
            "single" => panel::Solver::Single,
            "iterative" => panel::Solver::Iterative,
            other => return Err(wrong(format!("there is no solver {other}"))),
        };
        if arguments.has("trailing_edges") {
            let edges = arguments.part("trailing_edges")?;
            options.trailing_edges = if edges.has("angle") {
                panel::TrailingEdges::Angle(edges.number("angle"))
            } else if edges.has("groups") {
                panel::TrailingEdges::Groups(edges.texts("groups"))
            } else if edges.has("edges") {
                panel::TrailingEdges::Edges(indices_of(edges.at("edges")?)?.as_chunks().0.to_vec())
            } else {
                panel::TrailingEdges::None
            };
        }
        let panels = self.panels.clone().ok_or_else(|| wrong("not connected"))?;
        let vertices = points_of(arguments.at("vertices")?)?;
        let cells = indices_of(arguments.at("cells")?)?;
        let configuration = panels.create_configuration(&vertices, cells.as_chunks().0, &options).await?;
        Ok(self.remember_configuration(configuration))
    }

    fn remember_configuration(&mut self, configuration: panel::Configuration) -> Value {
        let made = describe_configuration(&configuration);
        self.configurations.insert(configuration.id.clone(), configuration);
        made
    }

    fn configuration(&self, arguments: &Arguments) -> Result<panel::Configuration, Failure> {
        let known = self.configurations.get(&arguments.text("configuration"));
        let known = known.ok_or_else(|| wrong("no such configuration"))?;
        Ok(match arguments.seconds("timeout") {
            Some(timeout) => known.with_timeout(Some(timeout)),
            None => known.clone(),
        })
    }

    async fn analyze(&mut self, arguments: &Arguments) -> Answer {
        let (watch, tell) = Watch::new(arguments);
        let vertices = if arguments.has("vertices") { Some(arguments.points("vertices")?) } else { None };
        let alphas = arguments.at("alphas")?.as_array().cloned().unwrap_or_default();
        let sideslip = arguments.number("sideslip");
        let wind = |alpha: &Value| panel::Wind { alpha: alpha.as_f64().unwrap_or(f64::NAN), sideslip };
        let winds: Vec<panel::Wind> = alphas.iter().map(wind).collect();
        let pressures = arguments.0["pressures"].as_bool().unwrap_or(true);
        let options = panel::AnalyzeOptions { pressures, progress: Some(tell) };
        let (configuration, reference) = (self.configuration(arguments)?, arguments.reference()?);
        let mach = arguments.number("mach");
        let call = configuration.sweep(vertices.as_deref(), mach, &winds, &reference, options);
        let analyses = watch.result(call).await?;
        let described: Vec<Value> = analyses.iter().map(describe_analysis).collect();
        self.analyses.extend(analyses.into_iter().map(|each| (each.id.clone(), each)));
        Ok(json!({"analyses": described, "stages": watch.stages()}))
    }

    fn analysed(&self, arguments: &Arguments) -> Result<panel::At, Failure> {
        let at = arguments.part("at")?;
        if let Some(id) = at.optional("analysis") {
            return Ok(self.analyses.get(&id).ok_or_else(|| wrong("no such analysis"))?.into());
        }
        let vertices = if at.has("vertices") { Some(at.points("vertices")?.into()) } else { None };
        let wind = panel::Wind { alpha: at.number("alpha"), sideslip: at.number("sideslip") };
        let flow = panel::Flow { mach: at.number("mach"), wind, reference: at.reference()? };
        Ok(panel::AnalysisPoint { vertices, flow }.into())
    }

    async fn panel_jvp(&self, arguments: &Arguments) -> Answer {
        let directions = panel::Directions {
            count: arguments.count(&["vertices", "alpha", "sideslip", "mach", "area", "chord", "point"]),
            vertices: arguments.points("vertices")?,
            alpha: arguments.values("alpha")?,
            sideslip: arguments.values("sideslip")?,
            mach: arguments.values("mach")?,
            area: arguments.values("area")?,
            chord: arguments.values("chord")?,
            point: arguments.points("point")?,
        };
        let tangents = self.configuration(arguments)?.jvp(&directions, self.analysed(arguments)?).await?;
        let coefficients: Vec<f64> =
            tangents.coefficients.iter().flat_map(panel::Coefficients::to_array).collect();
        Ok(json!({
            "coefficients": block(&coefficients, tangents.count),
            "section_loads": block(&tangents.section_loads, tangents.count),
            "cp": block(&tangents.cp, tangents.count),
        }))
    }

    async fn panel_vjp(&self, arguments: &Arguments) -> Answer {
        let coefficients = arguments.values("coefficients")?;
        let seeds = panel::Seeds {
            count: arguments.count(&["coefficients", "section_loads", "cp"]),
            coefficients: coefficients.as_chunks().0.iter().map(|&each| each.into()).collect(),
            section_loads: arguments.values("section_loads")?,
            cp: arguments.values("cp")?,
        };
        let gradients = self.configuration(arguments)?.vjp(&seeds, self.analysed(arguments)?).await?;
        Ok(json!({
            "vertices": point_block(&gradients.vertices, gradients.count),
            "alpha": array(&gradients.alpha),
            "sideslip": array(&gradients.sideslip),
            "mach": array(&gradients.mach),
            "area": array(&gradients.area),
            "chord": array(&gradients.chord),
            "point": points(&gradients.point),
        }))
    }

    async fn deform(&mut self, arguments: &Arguments) -> Answer {
        let mut session = self.session(arguments)?.clone();
        if let Some(timeout) = arguments.seconds("timeout") {
            session = session.with_timeout(Some(timeout));
        }
        let measured = arguments.0["cell_quality"].as_bool().unwrap_or_default();
        let result = session.deform_measured(arguments.point()?, measured).await?;
        let q = &result.quality.total;
        let quality = [
            q.cells as f64,
            q.aspect_ratio.p95,
            q.edge_ratio.max,
            q.min_scaled_jacobian,
            q.min_angle,
            q.skew_p95,
            q.folded as f64,
            q.inverted as f64,
        ];
        let mut made = json!({
            "vertices": points(&result.vertices),
            "functions": array(&result.functions),
            "id": result.linearisation.id,
            "quality": array(&quality),
            "seam_residual": result.residuals.seam,
            "engine_seconds": result.timings.engine.as_secs_f64(),
        });
        if let Some(cells) = &result.cell_quality {
            made["cell_quality"] = json!({
                "aspect_ratio": array(&cells.aspect_ratio),
                "edge_ratio": array(&cells.edge_ratio),
                "scaled_jacobian": array(&cells.scaled_jacobian),
                "skew": array(&cells.skew),
            });
        }
        self.deformations.insert(result.linearisation.id.clone(), result.linearisation);
        Ok(made)
    }

    async fn jvp(&self, arguments: &Arguments) -> Answer {
        let mut directions =
            Directions { control_points: arguments.control_points()?, ..Directions::default() };
        if let Some(each) = arguments.0["control_points"].as_object().and_then(|given| given.values().next())
        {
            directions.count = vectors_in(each);
        }
        if arguments.has("directions") {
            directions.count = vectors_in(arguments.at("directions")?);
            directions.design = values_of(arguments.at("directions")?)?;
        }
        let tangents = self.session(arguments)?.jvp(&directions, self.at(arguments)?).await?;
        Ok(json!({
            "vertices": point_block(&tangents.vertices, tangents.count),
            "functions": block(&tangents.functions, tangents.count),
        }))
    }

    async fn vjp(&self, arguments: &Arguments) -> Answer {
        let mut seeds = Seeds {
            by_design: arguments.0["by_design"].as_bool().unwrap_or(true),
            by_control_points: arguments.texts("by_control_points"),
            ..Seeds::default()
        };
        if arguments.has("vertices") {
            seeds.count = vectors_in(arguments.at("vertices")?);
            seeds.vertices = points_of(arguments.at("vertices")?)?;
        }
        if arguments.has("functions") {
            seeds.count = vectors_in(arguments.at("functions")?);
            seeds.functions = values_of(arguments.at("functions")?)?;
        }
        let gradients = self.session(arguments)?.vjp(&seeds, self.at(arguments)?).await?;
        let control_points =
            by_component(&gradients.control_points, |each| point_block(each, gradients.count));
        let mut made = json!({"control_points": control_points});
        if seeds.by_design {
            made["design"] = block(&gradients.design, gradients.count);
        }
        Ok(made)
    }

    async fn jacobian(&self, arguments: &Arguments) -> Answer {
        let session = self.session(arguments)?;
        let last = Arc::new(Mutex::new(0.0));
        let told = last.clone();
        let tell = Box::new(move |progress: moldline_client::Progress| {
            *told.lock().unwrap_or_else(|poisoned| poisoned.into_inner()) = progress.fraction;
        });
        let result = session.jacobian(self.at(arguments)?, Some(tell)).await?;
        let columns = session.setup().variables.len();
        let fraction = *last.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        Ok(json!({
            "vertices": point_block(&result.vertices, columns),
            "functions": block(&result.functions, columns),
            "fraction": fraction,
        }))
    }

    fn at(&self, arguments: &Arguments) -> Result<At, Failure> {
        if !arguments.has("at") {
            return Ok(At::Baseline);
        }
        let at = Arguments(arguments.at("at")?.clone());
        if let Some(id) = at.optional("deformation") {
            let known = self.deformations.get(&id).ok_or_else(|| wrong("no such deformation"))?;
            return Ok(known.into());
        }
        Ok(match at.optional("id") {
            Some(id) => At::Held(id),
            None => At::Point(at.point()?),
        })
    }

    fn remember_setup(&mut self, setup: Setup) -> Value {
        let made = describe_setup(&setup);
        self.setups.insert(setup.id.clone(), setup);
        made
    }

    fn remember_session(&mut self, session: Session) -> Value {
        let made = describe_session(session.state());
        self.sessions.insert(session.state().id.clone(), session);
        made
    }

    fn client(&self) -> Result<Client, Failure> {
        self.client.clone().ok_or_else(|| wrong("not connected"))
    }

    fn setup(&self, arguments: &Arguments) -> Result<&Setup, Failure> {
        self.setups.get(&arguments.text("setup")).ok_or_else(|| wrong("no such set-up"))
    }

    fn session(&self, arguments: &Arguments) -> Result<&Session, Failure> {
        self.sessions.get(&arguments.text("session")).ok_or_else(|| wrong("no such session"))
    }

    fn session_mut(&mut self, arguments: &Arguments) -> Result<&mut Session, Failure> {
        self.sessions.get_mut(&arguments.text("session")).ok_or_else(|| wrong("no such session"))
    }
}

fn failed(failure: Failure) -> Value {
    match failure {
        Failure::Refused(error) => {
            let fault = |each: &moldline_client::FieldViolation| json!({"field": each.field, "description": each.description});
            let mut made = json!({
                "code": error.code.name(),
                "message": error.message,
                "violations": error.violations.iter().map(fault).collect::<Vec<_>>(),
            });
            if let Some(delay) = error.retry_after {
                made["retry_after"] = json!(delay.as_secs_f64());
            }
            made
        }
        Failure::Cancelled => {
            json!({"code": "CANCELLED", "message": "cancelled by the driver", "violations": []})
        }
        Failure::Wrong(message) => json!({"code": "CLIENT", "message": message, "violations": []}),
    }
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut driver = Driver::default();
    for line in std::io::stdin().lock().lines() {
        let command: Value = serde_json::from_str(&line?)?;
        let what = command["do"].as_str().unwrap_or_default().to_owned();
        let answer = match driver.run(&what, &Arguments(command)).await {
            Ok(ok) => json!({"ok": ok}),
            Err(failure) => json!({"error": failed(failure)}),
        };
        let mut output = std::io::stdout().lock();
        writeln!(output, "{answer}")?;
        output.flush()?;
    }
    Ok(())
}
