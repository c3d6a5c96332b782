#include "moldline/panel.hpp"

#include <algorithm>
#include <type_traits>

#include "blocks.hpp"
#include "connection.hpp"
#include "convert.hpp"
#include "moldline/errors.hpp"

namespace moldline::panel {

using internal::append;
using internal::Budget;
using internal::length;
using internal::PanelConnection;
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

ConfigurationFacts facts(const v1::Configuration& message) {
  ConfigurationFacts facts;
  facts.id = message.configuration_id();
  facts.vertex_count = message.vertex_count();
  facts.cell_count = message.cell_count();
  facts.unknowns = message.unknowns();
  facts.symmetric = message.symmetric();
  facts.trailing_edges = internal::read<std::array<std::uint32_t, 2>>(message.trailing_edges());
  facts.roots = internal::read<std::uint32_t>(message.roots());
  facts.solver = static_cast<Solver>(message.solver());
  facts.memory = message.memory_bytes();
  facts.components.assign(message.components().begin(), message.components().end());
  return facts;
}

Point point(const google::protobuf::RepeatedField<double>& values) {
  if (values.size() != 3) throw InternalError("the server sent a vector that has not three parts", {}, std::nullopt);
  return {values[0], values[1], values[2]};
}

Loads loads(const v1::Loads& message) {
  return {point(message.force()), point(message.moment()), message.lift(), message.drag()};
}

Analysis analysis(const v1::Analysis& answer, const v1::FlowAnalysis& flow, const Flow& asked) {
  Analysis analysis;
  analysis.id = answer.analysis_id();
  analysis.flow = asked;
  const v1::FlowCoefficients& c = flow.coefficients();
  analysis.coefficients = {c.lift(),       c.induced_drag(), c.pressure_lift(),       c.pressure_drag(), c.moment(),
                           c.lift_slope(), c.moment_slope(), c.pressure_lift_slope(), c.neutral_point()};
  analysis.wake_lift = flow.wake_lift();
  analysis.disagreement = flow.disagreement();
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

/// Calls; a configuration that the server has dropped is sent again, and the call repeated.
template <class Call>
auto again(
    const PanelConnection& connection, const v1::CreateConfigurationRequest* request, const Budget& budget,
    const Call& call) {
  try {
    return call();
  } catch (const NotFound& error) {
    const auto& violations = error.violations();
    const bool dropped = std::any_of(
        violations.begin(), violations.end(), [](const auto& each) { return each.field == "configuration_id"; });
    if (request == nullptr || !dropped) throw;
  }
  create(connection, *request, budget);
  return call();
}

/// Writes the part of a block that a request takes; `alone`: whether a vector is one value, which has no axis.
template <class T, class Target>
void write_block(
    View<T> block, std::size_t all, std::size_t first, std::size_t count, const char* name, bool alone,
    const Target& array) {
  const std::size_t each = length(block, all, name);
  if (each == 0) return;
  const auto part = block.sub(first * each, count * each);
  v1::Array& target = *array();
  if constexpr (std::is_same_v<T, Point>) {
    if (alone) {
      internal::write(part, {count, 3}, target);
    } else {
      internal::write(part, {count, each, 3}, target);
    }
  } else if (alone) {
    internal::write(part, {count}, target);
  } else {
    internal::write(part, {count, each}, target);
  }
}

}  // namespace

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

  std::optional<v1::Analysis> found;
  const auto take = [&](v1::AnalyzeResponse& event) {
    if (event.has_analysis()) {
      found = std::move(*event.mutable_analysis());
    } else if (options.progress) {
      options.progress({event.progress().stage(), event.progress().fraction(), event.progress().message()});
    }
  };
  const Budget budget = connection_->budget(options);
  again(*connection_, request_.get(), budget, [&] {
    std::exception_ptr thrown;
    connection_->attempts(budget, [&](grpc::ClientContext& context) {
      auto stream = connection_->stub().Analyze(&context, request);
      v1::AnalyzeResponse event;
      internal::read_all(*stream, context, event, take, thrown);
      const grpc::Status status = stream->Finish();
      if (thrown) std::rethrow_exception(thrown);
      return status;
    });
  });
  if (!found || static_cast<std::size_t>(found->flows_size()) != winds.size()) {
    throw InternalError("the server ended without a result", {}, std::nullopt);
  }
  std::vector<Analysis> analyses;
  for (std::size_t i = 0; i < winds.size(); ++i) {
    analyses.push_back(analysis(*found, found->flows(static_cast<int>(i)), {mach, winds[i], reference}));
  }
  return analyses;
}

Tangents Configuration::jvp(const Directions& directions, const AnalysisPoint& at, const CallOptions& options) const {
  const Budget budget = connection_->budget(options);
  const std::size_t all = directions.count;
  Tangents tangents;
  tangents.count = all;
  internal::pieces(std::max(facts_.vertex_count, facts_.cell_count), all, [&](std::size_t first, std::size_t count) {
    v1::PanelServiceApplyJacobianVectorRequest request;
    request.set_configuration_id(facts_.id);
    write(at, *request.mutable_at());
    v1::FlowInputs& inputs = *request.mutable_directions();
    const auto block = [&](auto view, const char* name, bool alone, v1::Array* (v1::FlowInputs::*array)()) {
      write_block(view, all, first, count, name, alone, [&] { return (inputs.*array)(); });
    };
    block(directions.vertices, "vertices", false, &v1::FlowInputs::mutable_vertices);
    block(directions.alpha, "alpha", true, &v1::FlowInputs::mutable_alpha);
    block(directions.sideslip, "sideslip", true, &v1::FlowInputs::mutable_sideslip);
    block(directions.mach, "mach", true, &v1::FlowInputs::mutable_mach);
    block(directions.area, "area", true, &v1::FlowInputs::mutable_area);
    block(directions.chord, "chord", true, &v1::FlowInputs::mutable_chord);
    block(directions.point, "point", true, &v1::FlowInputs::mutable_point);
    const auto response = again(*connection_, request_.get(), budget, [&] {
      return connection_->call(&Stub::ApplyJacobianVector, request, budget);
    });
    append(tangents.coefficients, internal::read<double>(response.changes().coefficients()));
    append(tangents.section_loads, internal::read<double>(response.changes().section_loads()));
    append(tangents.cp, internal::read<double>(response.changes().cp()));
    internal::add(tangents.timings, response.timings());
  });
  return tangents;
}

Gradients Configuration::vjp(const Seeds& seeds, const AnalysisPoint& at, const CallOptions& options) const {
  const Budget budget = connection_->budget(options);
  const std::size_t all = seeds.count;
  Gradients gradients;
  gradients.count = all;
  internal::pieces(std::max(facts_.vertex_count, facts_.cell_count), all, [&](std::size_t first, std::size_t count) {
    v1::PanelServiceApplyAdjointRequest request;
    request.set_configuration_id(facts_.id);
    write(at, *request.mutable_at());
    v1::FlowOutputs& outputs = *request.mutable_seeds();
    const auto block = [&](View<double> view, const char* name, v1::Array* (v1::FlowOutputs::*array)()) {
      write_block(view, all, first, count, name, false, [&] { return (outputs.*array)(); });
    };
    block(seeds.coefficients, "coefficients", &v1::FlowOutputs::mutable_coefficients);
    block(seeds.section_loads, "section_loads", &v1::FlowOutputs::mutable_section_loads);
    block(seeds.cp, "cp", &v1::FlowOutputs::mutable_cp);
    const auto response = again(*connection_, request_.get(), budget, [&] {
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
