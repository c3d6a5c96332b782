// Driver of the C++ client for the end-to-end tests: see README.md.
#include <google/protobuf/struct.pb.h>
#include <google/protobuf/util/json_util.h>

#include <array>
#include <cstring>
#include <iostream>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>

#include "moldline/moldline.hpp"

namespace {

using google::protobuf::Struct;
using google::protobuf::Value;
using Fields = google::protobuf::Map<std::string, Value>;

constexpr char alphabet[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

std::string base64(const std::string& bytes) {
  std::string text;
  for (std::size_t at = 0; at < bytes.size(); at += 3) {
    std::uint32_t group = 0;
    const std::size_t count = std::min<std::size_t>(3, bytes.size() - at);
    for (std::size_t i = 0; i < 3; ++i) group = group << 8 | (i < count ? static_cast<unsigned char>(bytes[at + i]) : 0u);
    for (std::size_t i = 0; i < 4; ++i) text += i <= count ? alphabet[group >> (18 - 6 * i) & 63u] : '=';
  }
  return text;
}

std::string bytes_of(const std::string& text) {
  std::string bytes;
  std::uint32_t bits = 0;
  int held = 0;
  for (const char c : text) {
    const char* digit = std::strchr(alphabet, c);
    if (c == '=' || digit == nullptr) break;
    bits = bits << 6 | static_cast<std::uint32_t>(digit - alphabet);
    held += 6;
    if (held >= 8) {
      held -= 8;
      bytes += static_cast<char>(bits >> held & 255u);
    }
  }
  return bytes;
}

Value value(const std::string& text) {
  Value value;
  value.set_string_value(text);
  return value;
}
Value value(const char* text) { return value(std::string(text)); }
Value value(bool truth) {
  Value value;
  value.set_bool_value(truth);
  return value;
}
Value value(double number) {
  Value value;
  value.set_number_value(number);
  return value;
}
Value value(std::size_t count) { return value(static_cast<double>(count)); }
Value value(Struct fields) {
  Value value;
  *value.mutable_struct_value() = std::move(fields);
  return value;
}
template <class T, class Convert>
Value list(const std::vector<T>& items, const Convert& convert) {
  Value value;
  value.mutable_list_value();
  for (const T& item : items) *value.mutable_list_value()->add_values() = convert(item);
  return value;
}
Value value(const std::vector<std::string>& texts) {
  return list(texts, [](const std::string& text) { return value(text); });
}

Struct fields(std::initializer_list<std::pair<const char*, Value>> all) {
  Struct made;
  for (const auto& [name, each] : all) (*made.mutable_fields())[name] = each;
  return made;
}

/// An array of this type and shape.
template <class T>
Value array(const std::vector<T>& values, const char* dtype, std::vector<std::size_t> shape) {
  std::string bytes(values.size() * sizeof(T), '\0');
  if (!values.empty()) std::memcpy(bytes.data(), values.data(), bytes.size());
  return value(fields(
      {{"dtype", value(dtype)}, {"shape", list(shape, [](std::size_t extent) { return value(extent); })},
       {"data", value(base64(bytes))}}));
}
Value array(const std::vector<double>& values) { return array(values, "<f8", {values.size()}); }
template <std::size_t N>
Value array(const std::vector<std::array<double, N>>& rows) { return array(rows, "<f8", {rows.size(), N}); }
Value array(std::initializer_list<double> values) { return array(std::vector<double>(values)); }
Value index_array(const std::vector<std::array<std::uint32_t, 2>>& pairs) {
  return array(pairs, "<u4", {pairs.size(), 2});
}
Value index_array(const std::vector<std::uint32_t>& indices) { return array(indices, "<u4", {indices.size()}); }
/// k vectors.
Value block(const std::vector<double>& values, std::size_t k) { return array(values, "<f8", {k, values.size() / k}); }
Value block(const std::vector<moldline::Point>& points, std::size_t k) {
  return array(points, "<f8", {k, points.size() / k, 3});
}

/// A command's arguments.
class Arguments {
 public:
  explicit Arguments(const Struct& fields) : fields_(fields.fields()) {}

  bool has(const std::string& name) const { return fields_.count(name) > 0; }
  const Value& at(const std::string& name) const {
    const auto found = fields_.find(name);
    if (found == fields_.end()) throw std::invalid_argument("the command lacks " + name);
    return found->second;
  }
  std::string text(const std::string& name) const { return has(name) ? at(name).string_value() : std::string(); }
  double number(const std::string& name) const { return at(name).number_value(); }
  bool truth(const std::string& name, bool otherwise) const { return has(name) ? at(name).bool_value() : otherwise; }
  Arguments part(const std::string& name) const { return Arguments(at(name).struct_value()); }
  const Fields& all() const { return fields_; }
  std::vector<std::string> texts(const std::string& name) const {
    std::vector<std::string> texts;
    if (!has(name)) return texts;
    for (const Value& each : at(name).list_value().values()) texts.push_back(each.string_value());
    return texts;
  }

 private:
  Fields fields_;
};

template <class T>
std::vector<T> values_of(const Value& array) {
  const std::string bytes = bytes_of(Arguments(array.struct_value()).text("data"));
  std::vector<T> values(bytes.size() / sizeof(T));
  if (!values.empty()) std::memcpy(values.data(), bytes.data(), values.size() * sizeof(T));
  return values;
}

std::size_t vectors_in(const Value& array) {
  const auto& shape = array.struct_value().fields().at("shape").list_value();
  return static_cast<std::size_t>(shape.values(0).number_value());
}

/// k, as the first array among the arguments of these names has it.
std::size_t count_of(const Arguments& arguments, std::initializer_list<const char*> names) {
  for (const char* name : names) {
    if (arguments.has(name)) return vectors_in(arguments.at(name));
  }
  return 1;
}

template <class T = double>
std::vector<T> optional_values(const Arguments& arguments, const std::string& name) {
  return arguments.has(name) ? values_of<T>(arguments.at(name)) : std::vector<T>();
}

moldline::panel::IndexGroups groups_of(const Arguments& arguments, const std::string& name) {
  moldline::panel::IndexGroups groups;
  if (!arguments.has(name)) return groups;
  const Arguments given = arguments.part(name);
  for (const auto& [group, each] : given.all()) groups[group] = values_of<std::uint32_t>(each);
  return groups;
}

moldline::panel::Reference reference_of(const Arguments& arguments) {
  const Arguments given = arguments.part("reference");
  const auto& point = given.at("point").list_value();
  return {
      given.number("area"),
      given.number("chord"),
      given.number("span"),
      {point.values(0).number_value(), point.values(1).number_value(), point.values(2).number_value()}};
}

/// `design`, an array or values by name, and `control_points`.
moldline::DesignPoint point_of(const Arguments& arguments) {
  moldline::DesignPoint point;
  if (arguments.has("design")) {
    const Arguments design = arguments.part("design");
    if (design.has("data")) {
      point.design = values_of<double>(arguments.at("design"));
    } else {
      moldline::DesignPoint::Named named;
      for (const auto& [name, each] : design.all()) named[name] = each.number_value();
      point.design = named;
    }
  }
  if (arguments.has("control_points")) {
    const Arguments given = arguments.part("control_points");
    for (const auto& [component, each] : given.all()) {
      point.control_points[component] = values_of<moldline::Point>(each);
    }
  }
  return point;
}

template <class Options = moldline::CallOptions>
Options call_options(const Arguments& arguments) {
  Options options;
  if (arguments.has("timeout")) options.timeout = moldline::Seconds(arguments.number("timeout"));
  return options;
}

moldline::Visibility visibility_of(const std::string& word) {
  if (word == "private") return moldline::Visibility::Private;
  if (word == "tenants") return moldline::Visibility::Tenants;
  if (word == "public") return moldline::Visibility::Public;
  throw std::invalid_argument("there is no visibility " + word);
}

Value access(const moldline::SetupAccess& access) {
  static constexpr const char* words[] = {"private", "tenants", "public"};
  return value(fields(
      {{"owned", value(access.owned)}, {"visibility", value(words[static_cast<int>(access.visibility)])},
       {"shared_with", value(access.shared_with)}}));
}

Struct describe(const moldline::Setup& setup) {
  std::vector<double> lower, upper;
  for (const auto& variable : setup->variables) {
    lower.push_back(variable.lower);
    upper.push_back(variable.upper);
  }
  std::vector<double> reference;
  for (const auto& function : setup->functions) reference.push_back(function.value);
  return fields({
      {"setup", value(setup->id)},
      {"built", value(setup->built)},
      {"name", value(setup->name)},
      {"access", access(setup->access)},
      {"report_text", value(setup->report_text)},
      {"variables", list(setup->variables, [](const auto& v) { return value(v.name); })},
      {"units", list(setup->variables, [](const auto& v) { return value(v.unit); })},
      {"baseline", array(setup.baseline())},
      {"lower", array(lower)},
      {"upper", array(upper)},
      {"groups", list(setup->groups, [](const auto& group) { return value(group.name); })},
      {"components", value(setup->components)},
      {"control_point_counts", list(setup->control_point_counts, [](std::size_t count) { return value(count); })},
      {"functions", list(setup->functions, [](const auto& function) { return value(function.name); })},
      {"function_values", array(reference)},
      {"vertex_count", value(setup->vertex_count)},
      {"cell_count", value(setup->cell_count)},
  });
}

Struct by_component(const moldline::ControlPoints& points, std::size_t k = 0) {
  Struct made;
  for (const auto& [component, each] : points) (*made.mutable_fields())[component] = k == 0 ? array(each) : block(each, k);
  return made;
}

Struct describe(const moldline::SessionState& state) {
  Struct made = fields(
      {{"session", value(state.id)}, {"setup", value(state.setup_id)},
       {"generation", value(static_cast<double>(state.generation))}, {"label", value(state.label)},
       {"updated", value(state.updated.time_since_epoch().count())}});
  if (state.design) {
    if (const auto* vector = std::get_if<moldline::DesignPoint::Vector>(&state.design->design)) {
      (*made.mutable_fields())["design"] = array(*vector);
    }
    (*made.mutable_fields())["control_points"] = value(by_component(state.design->control_points));
  }
  return made;
}

std::vector<double> difference(const moldline::Difference& each) {
  return {each.step, each.error.value_or(std::numeric_limits<double>::quiet_NaN())};
}

Struct describe(const moldline::CheckedVariable& row) {
  std::vector<double> errors;
  for (const auto& each : row.stages) errors.push_back(each.error);
  std::vector<std::array<double, 2>> differences;
  for (const auto& each : row.differences) {
    const auto pair = difference(each);
    differences.push_back({pair[0], pair[1]});
  }
  const auto best = row.best();
  Struct made = fields(
      {{"design", value(row.design)},
       {"variable", value(row.variable)},
       {"numbers", array({row.size, row.dual, static_cast<double>(row.worst_vertex), row.functions})},
       {"stages", list(row.stages, [](const auto& each) { return value(each.stage); })},
       {"stage_errors", array(errors)},
       {"first_discrepancy", value(row.first_discrepancy.value_or(""))},
       {"differences", array(differences)},
       {"best", array(best ? difference(*best) : std::vector<double>())}});
  if (const auto& kink = row.kink) {
    (*made.mutable_fields())["crease"] = value(kink->component);
    (*made.mutable_fields())["kink"] = array(
        {static_cast<double>(kink->vertices), static_cast<double>(kink->worst_vertex), kink->jump, kink->position[0],
         kink->position[1], kink->position[2], kink->error});
  }
  return made;
}

Struct describe(const moldline::CheckedDesign& checked) {
  std::vector<std::array<double, 2>> dots;
  for (const auto& dot : checked.dot_products) dots.push_back({static_cast<double>(dot.block), dot.error});
  return fields(
      {{"design", array(checked.design)},
       {"dot_products", array(dots)},
       {"maxima",
        array({checked.dot_product_max, checked.dual_max, checked.central_difference_max, checked.values_max})}});
}

Struct describe(const moldline::Check& check) {
  return fields(
      {{"maxima", array({check.dot_product_max, check.dual_max, check.central_difference_max})},
       {"seed", value(static_cast<double>(check.seed))},
       {"designs", list(check.designs, [](const auto& each) { return value(describe(each)); })},
       {"rows", list(check.rows, [](const auto& each) { return value(describe(each)); })},
       {"definition", value(check.definition)},
       {"table", value(check.table)}});
}

Struct describe(const moldline::panel::Configuration& configuration) {
  static constexpr const char* solvers[] = {"automatic", "double", "single", "iterative"};
  return fields(
      {{"configuration", value(configuration->id)},
       {"vertex_count", value(configuration->vertex_count)},
       {"cell_count", value(configuration->cell_count)},
       {"unknowns", value(configuration->unknowns)},
       {"symmetric", value(configuration->symmetric)},
       {"trailing_edges", index_array(configuration->trailing_edges)},
       {"roots", index_array(configuration->roots)},
       {"solver", value(solvers[static_cast<int>(configuration->solver)])},
       {"memory", value(static_cast<double>(configuration->memory))},
       {"components", value(configuration->components)}});
}

Value loads(const moldline::panel::Loads& loads) {
  const auto& [force, moment, lift, drag] = loads;
  return array({force[0], force[1], force[2], moment[0], moment[1], moment[2], lift, drag});
}

Struct describe(const moldline::panel::Analysis& analysis) {
  const auto coefficients = analysis.coefficients.array();
  Struct components;
  for (const auto& [name, each] : analysis.components) (*components.mutable_fields())[name] = loads(each);
  return fields(
      {{"id", value(analysis.id)},
       {"coefficients", array(std::vector<double>(coefficients.begin(), coefficients.end()))},
       {"numbers", array({analysis.wake_lift, analysis.disagreement, analysis.residual})},
       {"residuals", array(analysis.residuals)},
       {"total", loads(analysis.total)},
       {"components", value(components)},
       {"sections", value(fields(
                        {{"edges", index_array(analysis.sections.edges)},
                         {"middles", array(analysis.sections.middles)},
                         {"spans", array(analysis.sections.spans)},
                         {"loads", array(analysis.sections.loads)}}))},
       {"cp", array(analysis.cp)},
       {"vertex_cp", array(analysis.vertex_cp)},
       {"supercritical_cells", value(analysis.supercritical_cells)},
       {"rounds", value(analysis.rounds)},
       {"reused", value(analysis.reused)}});
}

/// Notes the stages of a long call, and cancels it at one of them.
class Watch {
 public:
  template <class Options>
  Watch(const Arguments& arguments, Options& options) {
    options.cancellation = cancellation_;
    options.progress = [this, cancel_at = arguments.text("cancel_at")](const moldline::Progress& progress) {
      if (stages_.empty() || stages_.back() != progress.stage) stages_.push_back(progress.stage);
      if (progress.stage == cancel_at) cancellation_.cancel();
    };
  }
  Watch(const Watch&) = delete;
  Watch& operator=(const Watch&) = delete;

  Struct with_stages(Struct made) const {
    (*made.mutable_fields())["stages"] = value(stages_);
    return made;
  }

 private:
  moldline::Cancellation cancellation_;
  std::vector<std::string> stages_;
};

class Driver {
 public:
  Struct run(const std::string& what, const Arguments& arguments) {
    if (what == "connect") return connect(arguments);
    if (what == "create_setup") return create_setup(arguments);
    if (what == "get_setup") return remember(client_->get_setup(arguments.text("setup")));
    if (what == "mesh") return mesh(setup(arguments).mesh());
    if (what == "control_points") return by_component(setup(arguments).control_points());
    if (what == "list_setups") {
      return fields({{"setups", list(client_->list_setups(), [](const auto& each) {
                        return value(fields({{"setup", value(each.id)}, {"name", value(each.name)},
                                             {"vertex_count", value(each.vertex_count)},
                                             {"variable_count", value(each.variable_count)},
                                             {"created", value(each.created.time_since_epoch().count())},
                                             {"access", access(each.access)}}));
                      })}});
    }
    if (what == "share") {
      moldline::Setup& shared = setup(arguments);
      shared.share(visibility_of(arguments.text("visibility")), arguments.texts("shared_with"));
      return fields({{"access", access(shared->access)}});
    }
    if (what == "delete_setup") {
      setup(arguments).remove();
      return {};
    }
    if (what == "open") {
      auto options = call_options<moldline::SessionOptions>(arguments);
      options.label = arguments.text("label");
      options.request_id = arguments.text("request_id");
      return remember(setup(arguments).session(options));
    }
    if (what == "resume") return remember(client_->resume(arguments.text("session")));
    if (what == "list_sessions") {
      return fields({{"sessions", list(client_->list_sessions(), [](const auto& each) { return value(describe(each)); })}});
    }
    if (what == "update") {
      moldline::SessionUpdate update;
      if (arguments.has("design") || arguments.has("control_points")) update.design = point_of(arguments);
      if (arguments.has("label")) update.label = arguments.text("label");
      session(arguments).update(update);
      return describe(session(arguments).state());
    }
    if (what == "refresh") {
      session(arguments).refresh();
      return describe(session(arguments).state());
    }
    if (what == "close") {
      session(arguments).close();
      return {};
    }
    if (what == "deform") return deform(arguments);
    if (what == "jvp") return jvp(arguments);
    if (what == "vjp") return vjp(arguments);
    if (what == "jacobian") return jacobian(arguments);
    if (what == "status") return status();
    if (what == "check") return check(arguments);
    if (what == "create_configuration") return create_configuration(arguments);
    if (what == "get_configuration") return remember(panels_->get_configuration(arguments.text("configuration")));
    if (what == "analyze") return analyze(arguments);
    if (what == "panel_jvp") return panel_jvp(arguments);
    if (what == "panel_vjp") return panel_vjp(arguments);
    throw std::invalid_argument("there is no command " + what);
  }

 private:
  Struct connect(const Arguments& arguments) {
    moldline::Options options;
    options.token = arguments.text("token");
    if (arguments.has("tls")) {
      const Arguments tls = arguments.part("tls");
      options.tls = moldline::Tls{
          tls.text("authorities"), tls.text("certificate"), tls.text("key"), tls.text("server_name")};
    }
    if (arguments.has("timeout")) options.timeout = moldline::Seconds(arguments.number("timeout"));
    if (arguments.has("attempts")) options.retry.attempts = static_cast<int>(arguments.number("attempts"));
    if (arguments.has("losses")) options.retry.losses = static_cast<int>(arguments.number("losses"));
    if (arguments.has("first_pause")) options.retry.first_pause = moldline::Seconds(arguments.number("first_pause"));
    setups_.clear();
    sessions_.clear();
    configurations_.clear();
    // Connections are made on first use.
    panels_ = std::make_unique<moldline::panel::Client>(arguments.text("address"), options);
    client_ = std::make_unique<moldline::Client>(arguments.text("address"), options);
    return {};
  }

  Struct create_setup(const Arguments& arguments) {
    auto options = call_options<moldline::CreateOptions>(arguments);
    options.setup_file = arguments.text("setup_file");
    options.request_id = arguments.text("request_id");
    if (arguments.has("visibility")) options.visibility = visibility_of(arguments.text("visibility"));
    options.shared_with = arguments.texts("shared_with");
    const Watch watch(arguments, options);
    return watch.with_stages(remember(client_->create_setup(arguments.text("path"), options)));
  }

  Struct check(const Arguments& arguments) {
    auto options = call_options<moldline::CheckOptions>(arguments);
    if (arguments.has("designs")) options.designs = static_cast<std::uint32_t>(arguments.number("designs"));
    if (arguments.has("design")) options.design = point_of(arguments).design;
    options.variables = arguments.texts("variables");
    if (arguments.has("seed")) options.seed = static_cast<std::uint64_t>(arguments.number("seed"));
    const Watch watch(arguments, options);
    return watch.with_stages(describe(setup(arguments).check(options)));
  }

  Struct create_configuration(const Arguments& arguments) {
    using moldline::panel::Solver;
    using moldline::panel::Symmetry;
    auto options = call_options<moldline::panel::ConfigurationOptions>(arguments);
    options.cell_groups = groups_of(arguments, "cell_groups");
    options.vertex_groups = groups_of(arguments, "vertex_groups");
    if (arguments.has("components")) options.components = arguments.texts("components");
    if (arguments.has("tolerance")) options.tolerance = arguments.number("tolerance");
    options.symmetry = std::map<std::string, Symmetry>{
        {"", Symmetry::Automatic}, {"none", Symmetry::None}, {"half", Symmetry::Half}, {"mirror", Symmetry::Mirror}}
        .at(arguments.text("symmetry"));
    options.solver = std::map<std::string, Solver>{
        {"", Solver::Automatic}, {"double", Solver::Double}, {"single", Solver::Single}, {"iterative", Solver::Iterative}}
        .at(arguments.text("solver"));
    if (arguments.has("trailing_edges")) {
      using moldline::panel::TrailingEdges;
      const Arguments edges = arguments.part("trailing_edges");
      if (edges.has("angle")) {
        options.trailing_edges.rule = edges.number("angle");
      } else if (edges.has("groups")) {
        options.trailing_edges.rule = edges.texts("groups");
      } else if (edges.has("edges")) {
        options.trailing_edges.rule = values_of<std::array<std::uint32_t, 2>>(edges.at("edges"));
      } else {
        options.trailing_edges.rule = TrailingEdges::None{};
      }
    }
    return remember(panels_->create_configuration(
        values_of<moldline::Point>(arguments.at("vertices")), values_of<moldline::panel::Cell>(arguments.at("cells")),
        options));
  }

  Struct analyze(const Arguments& arguments) {
    auto options = call_options<moldline::panel::AnalyzeOptions>(arguments);
    options.pressures = arguments.truth("pressures", true);
    const Watch watch(arguments, options);
    Vertices vertices;
    if (arguments.has("vertices")) vertices = values_of<moldline::Point>(arguments.at("vertices"));
    std::vector<moldline::panel::Wind> winds;
    const double sideslip = arguments.has("sideslip") ? arguments.number("sideslip") : 0.0;
    for (const Value& alpha : arguments.at("alphas").list_value().values()) {
      winds.push_back({alpha.number_value(), sideslip});
    }
    const double mach = arguments.has("mach") ? arguments.number("mach") : 0.0;
    const auto analyses =
        configuration(arguments).sweep(view(vertices), mach, winds, reference_of(arguments), options);
    for (const auto& each : analyses) analyses_.insert_or_assign(each.id, std::pair(each, vertices));
    return watch.with_stages(
        fields({{"analyses", list(analyses, [](const auto& each) { return value(describe(each)); })}}));
  }

  Struct panel_jvp(const Arguments& arguments) {
    moldline::panel::Directions directions;
    directions.count = count_of(arguments, {"vertices", "alpha", "sideslip", "mach", "area", "chord", "point"});
    const auto vertices = optional_values<moldline::Point>(arguments, "vertices");
    const auto alpha = optional_values(arguments, "alpha");
    const auto sideslip = optional_values(arguments, "sideslip");
    const auto mach = optional_values(arguments, "mach");
    const auto area = optional_values(arguments, "area");
    const auto chord = optional_values(arguments, "chord");
    const auto point = optional_values<moldline::Point>(arguments, "point");
    directions.vertices = vertices;
    directions.alpha = alpha;
    directions.sideslip = sideslip;
    directions.mach = mach;
    directions.area = area;
    directions.chord = chord;
    directions.point = point;
    Vertices kept;
    const auto tangents =
        configuration(arguments).jvp(directions, analysed(arguments, kept), call_options(arguments));
    std::vector<std::array<double, moldline::panel::Coefficients::count>> coefficients;
    for (const auto& each : tangents.coefficients) coefficients.push_back(each.array());
    return fields(
        {{"coefficients", array(coefficients)},
         {"section_loads", block(tangents.section_loads, tangents.count)},
         {"cp", block(tangents.cp, tangents.count)}});
  }

  Struct panel_vjp(const Arguments& arguments) {
    moldline::panel::Seeds seeds;
    seeds.count = count_of(arguments, {"coefficients", "section_loads", "cp"});
    std::vector<moldline::panel::Coefficients> coefficients;
    using Row = std::array<double, moldline::panel::Coefficients::count>;
    for (const Row& row : optional_values<Row>(arguments, "coefficients")) {
      coefficients.push_back(moldline::panel::Coefficients::from(row));
    }
    const auto section_loads = optional_values(arguments, "section_loads");
    const auto cp = optional_values(arguments, "cp");
    seeds.coefficients = coefficients;
    seeds.section_loads = section_loads;
    seeds.cp = cp;
    Vertices kept;
    const auto gradients = configuration(arguments).vjp(seeds, analysed(arguments, kept), call_options(arguments));
    return fields(
        {{"vertices", block(gradients.vertices, gradients.count)},
         {"alpha", array(gradients.alpha)},
         {"sideslip", array(gradients.sideslip)},
         {"mach", array(gradients.mach)},
         {"area", array(gradients.area)},
         {"chord", array(gradients.chord)},
         {"point", array(gradients.point)}});
  }

  Struct deform(const Arguments& arguments) {
    auto options = call_options<moldline::DeformOptions>(arguments);
    options.cell_quality = arguments.truth("cell_quality", false);
    const moldline::Deformation result = session(arguments).deform(point_of(arguments), options);
    deformations_[result.linearisation.id] = result.linearisation;
    const auto& total = result.quality.total;
    Struct made = fields(
        {{"vertices", array(result.vertices)},
         {"functions", array(result.functions)},
         {"id", value(result.linearisation.id)},
         {"quality", array({static_cast<double>(total.cells), total.aspect_ratio.p95, total.edge_ratio.max,
                            total.min_scaled_jacobian, total.min_angle, total.skew_p95,
                            static_cast<double>(total.folded), static_cast<double>(total.inverted)})},
         {"seam_residual", value(result.residuals.seam)},
         {"engine_seconds", value(result.timings.engine.count())}});
    if (const auto& cells = result.cell_quality) {
      (*made.mutable_fields())["cell_quality"] = value(fields(
          {{"aspect_ratio", array(cells->aspect_ratio)},
           {"edge_ratio", array(cells->edge_ratio)},
           {"scaled_jacobian", array(cells->scaled_jacobian)},
           {"skew", array(cells->skew)}}));
    }
    return made;
  }

  Struct jvp(const Arguments& arguments) {
    moldline::Directions directions;
    std::vector<double> design;
    moldline::ControlPoints points;
    if (arguments.has("directions")) {
      directions.count = vectors_in(arguments.at("directions"));
      design = values_of<double>(arguments.at("directions"));
      directions.design = design;
    }
    if (arguments.has("control_points")) {
      const Arguments given = arguments.part("control_points");
      for (const auto& [component, each] : given.all()) {
        directions.count = vectors_in(each);
        directions.control_points[component] = points[component] = values_of<moldline::Point>(each);
      }
    }
    const auto tangents = session(arguments).jvp(directions, at(arguments), call_options(arguments));
    return fields(
        {{"vertices", block(tangents.vertices, tangents.count)}, {"functions", block(tangents.functions, tangents.count)}});
  }

  Struct vjp(const Arguments& arguments) {
    moldline::Seeds seeds;
    std::vector<moldline::Point> vertices;
    std::vector<double> functions;
    if (arguments.has("vertices")) {
      seeds.count = vectors_in(arguments.at("vertices"));
      vertices = values_of<moldline::Point>(arguments.at("vertices"));
      seeds.vertices = vertices;
    }
    if (arguments.has("functions")) {
      seeds.count = vectors_in(arguments.at("functions"));
      functions = values_of<double>(arguments.at("functions"));
      seeds.functions = functions;
    }
    seeds.by_design = arguments.truth("by_design", true);
    seeds.by_control_points = arguments.texts("by_control_points");
    const auto gradients = session(arguments).vjp(seeds, at(arguments), call_options(arguments));
    Struct made = fields({{"control_points", value(by_component(gradients.control_points, gradients.count))}});
    if (seeds.by_design) (*made.mutable_fields())["design"] = block(gradients.design, gradients.count);
    return made;
  }

  Struct jacobian(const Arguments& arguments) {
    auto options = call_options<moldline::JacobianOptions>(arguments);
    double last = 0.0;
    options.progress = [&](const moldline::Progress& progress) { last = progress.fraction; };
    const auto result = session(arguments).jacobian(at(arguments), options);
    const std::size_t columns = session(arguments).setup()->variables.size();
    return fields(
        {{"vertices", block(result.vertices, columns)}, {"functions", block(result.functions, columns)},
         {"fraction", value(last)}});
  }

  Struct status() {
    const auto status = client_->status();
    return fields(
        {{"version", value(status.version)},
         {"uptime_seconds", value(status.uptime.count())},
         {"sessions", value(static_cast<double>(status.sessions))},
         {"setups_stored", value(static_cast<double>(status.setups_stored))},
         {"running", value(static_cast<double>(status.running))},
         {"queued", value(static_cast<double>(status.queued))},
         {"linearisation_budget", value(static_cast<double>(status.linearisation_cache.budget_bytes))},
         {"work", list(status.work, [](const auto& work) { return value(work.kind); })}});
  }

  static Struct mesh(const moldline::Mesh& mesh) {
    return fields(
        {{"vertices", array(mesh.vertices)},
         {"cells", array(mesh.cells, "<u4", {mesh.cells.size(), 4})},
         {"cell_owner", array(mesh.cell_owner, "<u4", {mesh.cell_owner.size()})},
         {"seam", array(mesh.seam, "|u1", {mesh.seam.size()})}});
  }

  moldline::At at(const Arguments& arguments) const {
    if (!arguments.has("at")) return {};
    const Arguments at = arguments.part("at");
    if (at.has("deformation")) return deformations_.at(at.text("deformation"));
    if (at.has("id")) return moldline::At::held(at.text("id"));
    return point_of(at);
  }

  Struct remember(moldline::Setup setup) {
    Struct made = describe(setup);
    setups_.insert_or_assign(setup->id, std::move(setup));
    return made;
  }
  Struct remember(moldline::Session session) {
    Struct made = describe(session.state());
    sessions_.insert_or_assign(session.id(), std::move(session));
    return made;
  }
  moldline::Setup& setup(const Arguments& arguments) { return setups_.at(arguments.text("setup")); }
  moldline::Session& session(const Arguments& arguments) { return sessions_.at(arguments.text("session")); }

  using Vertices = std::optional<std::vector<moldline::Point>>;

  static std::optional<moldline::View<moldline::Point>> view(const Vertices& vertices) {
    if (!vertices) return std::nullopt;
    return *vertices;
  }

  /// The point of a derivative; `kept` owns its vertices.
  moldline::panel::AnalysisPoint analysed(const Arguments& arguments, Vertices& kept) const {
    const Arguments at = arguments.part("at");
    if (at.has("analysis")) {
      const auto& [analysis, vertices] = analyses_.at(at.text("analysis"));
      kept = vertices;
      return {analysis.id, view(kept), analysis.flow};
    }
    if (at.has("vertices")) kept = values_of<moldline::Point>(at.at("vertices"));
    return {"", view(kept), {at.number("mach"), {at.number("alpha"), at.number("sideslip")}, reference_of(at)}};
  }

  Struct remember(moldline::panel::Configuration configuration) {
    Struct made = describe(configuration);
    configurations_.insert_or_assign(configuration->id, std::move(configuration));
    return made;
  }
  moldline::panel::Configuration& configuration(const Arguments& arguments) {
    return configurations_.at(arguments.text("configuration"));
  }

  std::unique_ptr<moldline::Client> client_;
  std::unique_ptr<moldline::panel::Client> panels_;
  std::map<std::string, moldline::panel::Configuration> configurations_;
  std::map<std::string, std::pair<moldline::panel::Analysis, Vertices>> analyses_;
  std::map<std::string, moldline::Setup> setups_;
  std::map<std::string, moldline::Session> sessions_;
  std::map<std::string, moldline::Linearisation> deformations_;
};

Struct failed(const moldline::Error& error) {
  Struct made = fields(
      {{"code", value(error.code())},
       {"message", value(error.what())},
       {"violations", list(error.violations(), [](const auto& fault) {
          return value(fields({{"field", value(fault.field)}, {"description", value(fault.description)}}));
        })}});
  if (error.retry_after()) (*made.mutable_fields())["retry_after"] = value(error.retry_after()->count());
  return made;
}

}  // namespace

int main() {
  Driver driver;
  for (std::string line; std::getline(std::cin, line);) {
    Struct answer;
    try {
      Struct command;
      if (!google::protobuf::util::JsonStringToMessage(line, &command).ok()) throw std::invalid_argument("no JSON");
      const Arguments arguments(command);
      answer = fields({{"ok", value(driver.run(arguments.text("do"), arguments))}});
    } catch (const moldline::Error& error) {
      answer = fields({{"error", value(failed(error))}});
    } catch (const std::exception& error) {
      answer = fields({{"error", value(fields({{"code", value("CLIENT")}, {"message", value(error.what())}}))}});
    }
    std::string text;
    if (!google::protobuf::util::MessageToJsonString(answer, &text).ok()) return 1;
    std::cout << text << std::endl;
  }
  return 0;
}
