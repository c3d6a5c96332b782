#include "moldline/panel.hpp"

#include <algorithm>
#include <functional>
#include <type_traits>

#include "blocks.hpp"
#include "connection.hpp"
#include "convert.hpp"
#include "moldline/errors.hpp"

namespace moldline::panel {

using internal::append;
using internal::Budget;
using internal::PanelConnection;
using internal::Piece;
using Stub = v1::PanelService::Stub;

namespace {

// Enumerators are those of the protocol, in its order.
static_assert(static_cast<int>(Symmetry::Mirror) == v1::PANEL_SYMMETRY_MIRROR);
static_assert(static_cast<int>(Solver::Iterative) == v1::PANEL_SOLVER_ITERATIVE);

template <std::size_t N>
void write_indices(View<std::array<std::uint32_t, N>> rows, v1::Array& array) {
  std::vector<std::uint32_t> indices;
  indices.reserve(rows.size() * N);
  for (const auto& row : rows) indices.insert(indices.end(), row.begin(), row.end());
  internal::write(indices, {rows.size(), N}, array);
}

void write_groups(const IndexGroups& groups, google::protobuf::RepeatedPtrField<v1::IndexGroup>& messages) {
  for (const auto& [name, indices] : groups) {
    v1::IndexGroup& group = *messages.Add();
    group.set_name(name);
    internal::write(indices, {indices.size()}, *group.mutable_indices());
  }
}

void write(const TrailingEdges& edges, v1::TrailingEdges& message) {
  std::visit(
      [&](const auto& rule) {
        using Rule = std::decay_t<decltype(rule)>;
        if constexpr (std::is_same_v<Rule, TrailingEdges::Angle>) {
          message.set_angle(rule);
        } else if constexpr (std::is_same_v<Rule, TrailingEdges::None>) {
          message.mutable_none();
        } else if constexpr (std::is_same_v<Rule, TrailingEdges::Edges>) {
          write_indices<2>(rule, *message.mutable_edges());
        } else {
          message.mutable_groups()->mutable_names()->Assign(rule.begin(), rule.end());
        }
      },
      edges.rule);
}

void write(const Reference& reference, v1::FlowReference& message) {
  message.set_area(reference.area);
  message.set_chord(reference.chord);
  message.set_span(reference.span);
  message.mutable_point()->Assign(reference.point.begin(), reference.point.end());
}

void write(const Wind& wind, v1::FlowAngles& message) {
  message.set_alpha(wind.alpha);
  message.set_sideslip(wind.sideslip);
}

void write(const AnalysisPoint& at, v1::AnalysisPoint& message) {
  message.set_analysis_id(at.id);
  message.mutable_geometry()->set_mach(at.flow.mach);
  if (at.vertices) internal::write(*at.vertices, {at.vertices->size(), 3}, *message.mutable_geometry()->mutable_vertices());
  write(at.flow.wind, *message.mutable_flow());
  write(at.flow.reference, *message.mutable_reference());
}

std::vector<Warning> warnings(const google::protobuf::RepeatedPtrField<v1::PanelWarning>& messages) {
  std::vector<Warning> warnings;
  for (const auto& each : messages) warnings.push_back({each.kind(), each.text()});
  return warnings;
}

ConfigurationFacts facts(const v1::Configuration& message) {
  ConfigurationFacts facts;
  facts.id = message.configuration_id();
  facts.vertex_count = message.vertex_count();
  facts.cell_count = message.cell_count();
  facts.unknowns = message.unknowns();
  facts.symmetric = message.symmetric();
  facts.trailing_edges = internal::read<std::array<std::uint32_t, 2>>(message.trailing_edges());
  facts.roots = internal::read<std::uint32_t>(message.roots());
  if (message.has_aft_ends()) facts.aft_ends = internal::read<std::uint32_t>(message.aft_ends());
  for (const auto& line : message.left_out()) {
    facts.left_out.push_back({internal::read<std::uint32_t>(line.vertices()), line.length(), line.width(), line.turn(), line.reason()});
  }
  facts.warnings = warnings(message.warnings());
  facts.solver = static_cast<Solver>(message.solver());
  facts.memory = message.memory_bytes();
  facts.components.assign(message.components().begin(), message.components().end());
  return facts;
}

/// The scalar outputs in the order of the protocol: member, and field of the message.
struct Coefficient {
  double Coefficients::*member;
  double (v1::FlowCoefficients::*field)() const;
};
constexpr Coefficient scalar_outputs[] = {
    {&Coefficients::lift, &v1::FlowCoefficients::lift},
    {&Coefficients::induced_drag, &v1::FlowCoefficients::induced_drag},
    {&Coefficients::pressure_lift, &v1::FlowCoefficients::pressure_lift},
    {&Coefficients::pressure_drag, &v1::FlowCoefficients::pressure_drag},
    {&Coefficients::moment, &v1::FlowCoefficients::moment},
    {&Coefficients::lift_slope, &v1::FlowCoefficients::lift_slope},
    {&Coefficients::moment_slope, &v1::FlowCoefficients::moment_slope},
    {&Coefficients::pressure_lift_slope, &v1::FlowCoefficients::pressure_lift_slope},
    {&Coefficients::neutral_point, &v1::FlowCoefficients::neutral_point},
};
static_assert(std::size(scalar_outputs) == Coefficients::count);
static_assert(sizeof(Coefficients) == Coefficients::count * sizeof(double));

Coefficients coefficients(const v1::FlowCoefficients& message) {
  Coefficients coefficients;
  for (const auto& [member, field] : scalar_outputs) coefficients.*member = (message.*field)();
  return coefficients;
}

/// A block of coefficients, (k, 9).
std::vector<Coefficients> coefficients(const v1::Array& array) {
  std::vector<Coefficients> block;
  for (const auto& row : internal::read<std::array<double, Coefficients::count>>(array)) {
    block.push_back(Coefficients::from(row));
  }
  return block;
}

Loads loads(const v1::Loads& message) {
  return {internal::point(message.force()), internal::point(message.moment()), message.lift(), message.drag()};
}

Analysis analysis(const v1::Analysis& answer, const v1::FlowAnalysis& flow, const Flow& requested) {
  Analysis analysis;
  analysis.id = answer.analysis_id();
  analysis.flow = requested;
  analysis.coefficients = coefficients(flow.coefficients());
  analysis.wake_lift = flow.wake_lift();
  analysis.disagreement = flow.disagreement();
  analysis.warnings = warnings(flow.warnings());
  analysis.total = loads(flow.total());
  for (const auto& each : flow.components()) analysis.components.emplace(each.name(), loads(each));
  analysis.sections.edges = internal::read<std::array<std::uint32_t, 2>>(flow.sections().edges());
  analysis.sections.middles = internal::read<Point>(flow.sections().middles());
  analysis.sections.spans = internal::read<std::array<double, 2>>(flow.sections().spans());
  analysis.sections.loads = internal::read<double>(flow.sections().loads());
  if (flow.has_cp()) analysis.cp = internal::read<double>(flow.cp());
  if (flow.has_vertex_cp()) analysis.vertex_cp = internal::read<double>(flow.vertex_cp());
  analysis.supercritical_cells = flow.supercritical_cells();
  analysis.residual = answer.residual();
  analysis.residuals.assign(answer.residuals().begin(), answer.residuals().end());
  analysis.rounds = answer.rounds();
  analysis.reused = answer.reused();
  analysis.timings = internal::timings(answer.timings());
  return analysis;
}

ConfigurationFacts create(
    const PanelConnection& connection, const v1::CreateConfigurationRequest& request, const Budget& budget) {
  return facts(connection.call(&Stub::CreateConfiguration, request, budget).configuration());
}

/// Calls; if the server has dropped the configuration, sends it again and repeats the call.
template <class Call>
auto again(
    const PanelConnection& connection, const v1::CreateConfigurationRequest* request, const std::string& id,
    const Budget& budget, const Call& call) {
  try {
    return call();
  } catch (const NotFound& error) {
    const auto& violations = error.violations();
    const bool dropped = std::any_of(
        violations.begin(), violations.end(), [](const auto& each) { return each.field == "configuration_id"; });
    if (request == nullptr || !dropped) throw;
  }
  if (create(connection, *request, budget).id != id) {
    throw InternalError("the server gives the same configuration another id", {}, std::nullopt);
  }
  return call();
}

}  // namespace

std::array<double, Coefficients::count> Coefficients::array() const {
  std::array<double, count> values{};
  for (std::size_t i = 0; i < count; ++i) values[i] = this->*scalar_outputs[i].member;
  return values;
}

Coefficients Coefficients::from(const std::array<double, count>& values) {
  Coefficients coefficients;
  for (std::size_t i = 0; i < count; ++i) coefficients.*scalar_outputs[i].member = values[i];
  return coefficients;
}

Client::Client(const std::string& address, const Options& options)
    : connection_(std::make_shared<PanelConnection>(address, options)) {}

Configuration Client::create_configuration(
    View<Point> vertices, View<Cell> cells, const ConfigurationOptions& options) const {
  auto request = std::make_shared<v1::CreateConfigurationRequest>();
  internal::write(vertices, {vertices.size(), 3}, *request->mutable_vertices());
  write_indices<4>(cells, *request->mutable_cells());
  write_groups(options.cell_groups, *request->mutable_cell_groups());
  write_groups(options.vertex_groups, *request->mutable_vertex_groups());
  v1::PanelOptions& choices = *request->mutable_options();
  choices.set_symmetry(static_cast<v1::PanelSymmetry>(options.symmetry));
  write(options.trailing_edges, *choices.mutable_trailing_edges());
  if (options.components) {
    choices.mutable_components()->mutable_names()->Assign(options.components->begin(), options.components->end());
  }
  choices.set_solver(static_cast<v1::PanelSolver>(options.solver));
  if (options.tolerance) choices.set_tolerance(*options.tolerance);
  if (options.merge_tolerance) choices.set_merge_tolerance(*options.merge_tolerance);
  choices.set_on_doubt(static_cast<v1::PanelOnDoubt>(options.on_doubt));
  ConfigurationFacts found = create(*connection_, *request, connection_->budget(options));
  return {connection_, std::move(found), std::move(request)};
}

Configuration Client::get_configuration(const std::string& id, const CallOptions& options) const {
  v1::GetConfigurationRequest request;
  request.set_configuration_id(id);
  const auto response = connection_->call(&Stub::GetConfiguration, request, connection_->budget(options));
  return {connection_, facts(response.configuration()), nullptr};
}

Configuration::Configuration(
    std::shared_ptr<PanelConnection> connection, ConfigurationFacts facts,
    std::shared_ptr<const v1::CreateConfigurationRequest> request)
    : connection_(std::move(connection)), facts_(std::move(facts)), request_(std::move(request)) {}

Analysis Configuration::analyze(
    std::optional<View<Point>> vertices, const Flow& flow, const AnalyzeOptions& options) const {
  return std::move(sweep(vertices, flow.mach, {flow.wind}, flow.reference, options).front());
}

std::vector<Analysis> Configuration::sweep(
    std::optional<View<Point>> vertices, double mach, const std::vector<Wind>& winds, const Reference& reference,
    const AnalyzeOptions& options) const {
  v1::AnalyzeRequest request;
  request.set_configuration_id(facts_.id);
  request.set_mach(mach);
  request.set_without_pressures(!options.pressures);
  if (vertices) internal::write(*vertices, {vertices->size(), 3}, *request.mutable_vertices());
  for (const Wind& wind : winds) write(wind, *request.add_flows());
  write(reference, *request.mutable_reference());

  internal::Outcome outcome(
      options.progress, &v1::AnalyzeResponse::has_analysis, &v1::AnalyzeResponse::mutable_analysis);
  const Budget budget = connection_->budget(options);
  again(*connection_, request_.get(), facts_.id, budget, [&] {
    connection_->stream(&Stub::Analyze, request, budget, [] {}, std::ref(outcome));
  });
  const v1::Analysis& answer = outcome.get();
  if (static_cast<std::size_t>(answer.flows_size()) != winds.size()) {
    throw InternalError("the server's answer lacks an analysis for each wind", {}, std::nullopt);
  }
  std::vector<Analysis> analyses;
  for (std::size_t i = 0; i < winds.size(); ++i) {
    analyses.push_back(analysis(answer, answer.flows(static_cast<int>(i)), {mach, winds[i], reference}));
  }
  return analyses;
}

Tangents Configuration::jvp(const Directions& directions, const AnalysisPoint& at, const CallOptions& options) const {
  using Inputs = v1::FlowInputs;
  const Budget budget = connection_->budget(options);
  Tangents tangents;
  tangents.count = directions.count;
  internal::pieces(std::max(facts_.vertex_count, facts_.cell_count), directions.count, [&](const Piece& piece) {
    v1::PanelServiceApplyJacobianVectorRequest request;
    request.set_configuration_id(facts_.id);
    write(at, *request.mutable_at());
    Inputs& inputs = *request.mutable_directions();
    internal::write_vectors(directions.vertices, piece, "vertices", inputs, &Inputs::mutable_vertices);
    internal::write_entries(directions.alpha, piece, "alpha", inputs, &Inputs::mutable_alpha);
    internal::write_entries(directions.sideslip, piece, "sideslip", inputs, &Inputs::mutable_sideslip);
    internal::write_entries(directions.mach, piece, "mach", inputs, &Inputs::mutable_mach);
    internal::write_entries(directions.area, piece, "area", inputs, &Inputs::mutable_area);
    internal::write_entries(directions.chord, piece, "chord", inputs, &Inputs::mutable_chord);
    internal::write_entries(directions.point, piece, "point", inputs, &Inputs::mutable_point);
    const auto response = again(*connection_, request_.get(), facts_.id, budget, [&] {
      return connection_->call(&Stub::ApplyJacobianVector, request, budget);
    });
    append(tangents.coefficients, coefficients(response.changes().coefficients()));
    append(tangents.section_loads, internal::read<double>(response.changes().section_loads()));
    append(tangents.cp, internal::read<double>(response.changes().cp()));
    internal::add(tangents.timings, response.timings());
  });
  return tangents;
}

Gradients Configuration::vjp(const Seeds& seeds, const AnalysisPoint& at, const CallOptions& options) const {
  using Outputs = v1::FlowOutputs;
  const Budget budget = connection_->budget(options);
  std::vector<double> weights;
  for (const Coefficients& each : seeds.coefficients) {
    const auto values = each.array();
    weights.insert(weights.end(), values.begin(), values.end());
  }
  Gradients gradients;
  gradients.count = seeds.count;
  internal::pieces(std::max(facts_.vertex_count, facts_.cell_count), seeds.count, [&](const Piece& piece) {
    v1::PanelServiceApplyAdjointRequest request;
    request.set_configuration_id(facts_.id);
    write(at, *request.mutable_at());
    Outputs& outputs = *request.mutable_seeds();
    internal::write_vectors<double>(weights, piece, "coefficients", outputs, &Outputs::mutable_coefficients);
    internal::write_vectors(seeds.section_loads, piece, "section_loads", outputs, &Outputs::mutable_section_loads);
    internal::write_vectors(seeds.cp, piece, "cp", outputs, &Outputs::mutable_cp);
    const auto response = again(*connection_, request_.get(), facts_.id, budget, [&] {
      return connection_->call(&Stub::ApplyAdjoint, request, budget);
    });
    const v1::FlowInputs& inputs = response.gradients();
    append(gradients.vertices, internal::read<Point>(inputs.vertices()));
    append(gradients.alpha, internal::read<double>(inputs.alpha()));
    append(gradients.sideslip, internal::read<double>(inputs.sideslip()));
    append(gradients.mach, internal::read<double>(inputs.mach()));
    append(gradients.area, internal::read<double>(inputs.area()));
    append(gradients.chord, internal::read<double>(inputs.chord()));
    append(gradients.point, internal::read<Point>(inputs.point()));
    internal::add(gradients.timings, response.timings());
  });
  return gradients;
}

IndexGroups parts(const Mesh& mesh, const std::vector<std::string>& components) {
  IndexGroups groups;
  for (std::size_t cell = 0; cell < mesh.cell_owner.size(); ++cell) {
    groups[components.at(mesh.cell_owner[cell])].push_back(static_cast<std::uint32_t>(cell));
  }
  return groups;
}

}  // namespace moldline::panel
