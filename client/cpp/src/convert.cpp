#include "convert.hpp"

#include <cstring>
#include <type_traits>

#include "moldline/errors.hpp"

namespace moldline::internal {

namespace {

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "arrays travel as little-endian bytes: big-endian machines are not supported"
#endif

template <class T>
struct Element;
template <>
struct Element<double> {
  static constexpr v1::DataType type = v1::DATA_TYPE_FLOAT64;
  static constexpr std::size_t bytes = sizeof(double);
};
template <>
struct Element<std::uint32_t> {
  static constexpr v1::DataType type = v1::DATA_TYPE_UINT32;
  static constexpr std::size_t bytes = sizeof(std::uint32_t);
};
template <>
struct Element<std::uint8_t> {
  static constexpr v1::DataType type = v1::DATA_TYPE_UINT8;
  static constexpr std::size_t bytes = 1;
};
template <class T, std::size_t N>
struct Element<std::array<T, N>> : Element<T> {};

[[noreturn]] void contradiction() {
  throw InternalError("the server sent an array that contradicts itself", {}, std::nullopt);
}

/// How many values of type T an array has.
template <class T>
std::size_t length(const v1::Array& array) {
  std::size_t bytes = Element<T>::bytes;
  for (const std::uint64_t extent : array.shape()) bytes *= extent;
  if (array.dtype() != Element<T>::type || array.data().size() != bytes || bytes % sizeof(T) != 0) contradiction();
  return bytes / sizeof(T);
}

template <class T>
void write_values(View<T> values, std::initializer_list<std::size_t> shape, v1::Array& array) {
  array.set_dtype(Element<T>::type);
  for (const std::size_t extent : shape) array.add_shape(extent);
  array.set_data(values.data(), values.size() * sizeof(T));
}

Time time(double seconds) { return Time(Seconds(seconds)); }

Distribution distribution(const v1::Distribution& d) { return {d.p50(), d.p95(), d.p99(), d.max(), d.above_5_percent()}; }

QualitySummary quality(const v1::QualitySummary& s) {
  QualitySummary summary;
  summary.cells = s.cells();
  summary.aspect_ratio = distribution(s.aspect_ratio());
  summary.edge_ratio = distribution(s.edge_ratio());
  summary.min_scaled_jacobian = s.min_scaled_jacobian();
  summary.min_angle = s.min_angle();
  summary.max_angle = s.max_angle();
  summary.skew_p95 = s.skew_p95();
  summary.skew_max = s.skew_max();
  summary.folded = s.folded();
  summary.inverted = s.inverted();
  return summary;
}

CacheStatus cache(const v1::CacheStatus& c) {
  return {c.entries(), c.bytes(), c.budget_bytes(), c.hits(), c.misses(), c.evictions()};
}

Work work(const v1::Work& w) {
  return {w.kind(),         w.tenant(),
          w.setup_id(),     w.session_id(),
          w.running(),      Seconds(w.age_seconds()),
          Seconds(w.running_seconds()), w.stage(),
          w.fraction()};
}

}  // namespace

void write(View<double> values, std::initializer_list<std::size_t> shape, v1::Array& array) {
  write_values(values, shape, array);
}

void write(View<Point> points, std::initializer_list<std::size_t> shape, v1::Array& array) {
  write_values(points, shape, array);
}

void write(View<std::uint32_t> indices, std::initializer_list<std::size_t> shape, v1::Array& array) {
  write_values(indices, shape, array);
}

template <class T>
void read_to(const v1::Array& array, T* to, std::size_t count) {
  if (length<T>(array) != count) contradiction();
  if (count > 0) std::memcpy(to, array.data().data(), count * sizeof(T));
}

template <class T>
std::vector<T> read(const v1::Array& array) {
  std::vector<T> values(length<T>(array));
  read_to(array, values.data(), values.size());
  return values;
}

template void read_to(const v1::Array&, double*, std::size_t);
template void read_to(const v1::Array&, Point*, std::size_t);
template std::vector<double> read(const v1::Array&);
template std::vector<Point> read(const v1::Array&);
template std::vector<std::uint32_t> read(const v1::Array&);
template std::vector<std::array<std::uint32_t, 2>> read(const v1::Array&);
template std::vector<std::array<double, 2>> read(const v1::Array&);
template std::vector<std::array<double, 9>> read(const v1::Array&);

Point point(const google::protobuf::RepeatedField<double>& values) {
  if (values.size() != 3) {
    throw InternalError("the server sent a vector that does not have three components", {}, std::nullopt);
  }
  return {values[0], values[1], values[2]};
}

Progress progress(const v1::Progress& message) { return {message.stage(), message.fraction(), message.message()}; }

SetupFacts setup_facts(const v1::SetupDescription& message, bool built) {
  SetupFacts facts;
  facts.id = message.setup_id();
  facts.built = built;
  facts.name = message.name();
  facts.access = access(message.access());
  facts.report_text = message.report_text();
  facts.report_json = message.report_json();
  for (const auto& v : message.variables()) {
    facts.variables.push_back({v.name(), v.unit(), v.baseline(), v.lower(), v.upper()});
  }
  for (const auto& group : message.groups()) {
    facts.groups.push_back({group.name(), group.first(), {group.shape().begin(), group.shape().end()}});
  }
  facts.components.assign(message.components().begin(), message.components().end());
  facts.control_point_counts.assign(message.control_point_counts().begin(), message.control_point_counts().end());
  for (const auto& f : message.functions()) facts.functions.push_back({f.name(), f.unit(), f.value()});
  facts.vertex_count = message.vertex_count();
  facts.cell_count = message.cell_count();
  facts.turned_cell_count = message.turned_cell_count();
  const v1::LeftOut& left_out = message.left_out();
  facts.left_out = {left_out.nodes(), left_out.merged_nodes(), left_out.other_cells(), left_out.collapsed_cells()};
  facts.build_time = Seconds(message.build_seconds());
  return facts;
}

SetupAccess access(const v1::SetupAccess& message) {
  SetupAccess access;
  access.owned = message.owned();
  switch (message.visibility()) {
    case v1::VISIBILITY_TENANTS: access.visibility = Visibility::Tenants; break;
    case v1::VISIBILITY_PUBLIC: access.visibility = Visibility::Public; break;
    default: access.visibility = Visibility::Private; break;
  }
  access.shared_with.assign(message.shared_with().begin(), message.shared_with().end());
  return access;
}

v1::Visibility visibility(Visibility visibility) {
  switch (visibility) {
    case Visibility::Private: return v1::VISIBILITY_PRIVATE;
    case Visibility::Tenants: return v1::VISIBILITY_TENANTS;
    case Visibility::Public: return v1::VISIBILITY_PUBLIC;
  }
  return v1::VISIBILITY_UNSPECIFIED;
}

SetupSummary setup_summary(const v1::SetupSummary& message) {
  return {
      message.setup_id(),       message.name(),
      message.vertex_count(),   message.cell_count(),
      message.variable_count(), time(message.created_time()),
      access(message.access())};
}

Mesh mesh(const v1::Mesh& message) {
  Mesh mesh;
  mesh.vertices = read<Point>(message.vertices());
  mesh.cells = read<std::array<std::uint32_t, 4>>(message.cells());
  mesh.cell_owner = read<std::uint32_t>(message.cell_owner());
  mesh.seam = read<std::uint8_t>(message.seam());
  return mesh;
}

ControlPoints control_points(const google::protobuf::RepeatedPtrField<v1::ControlPoints>& messages) {
  ControlPoints points;
  for (const auto& each : messages) points.emplace(each.component(), read<Point>(each.points()));
  return points;
}

SessionState session_state(const v1::Session& message) {
  SessionState state;
  state.id = message.session_id();
  state.setup_id = message.setup_id();
  state.generation = message.generation();
  if (message.has_design()) {
    state.design.emplace();
    if (message.design().has_design()) state.design->design = read<double>(message.design().design());
    state.design->control_points = control_points(message.design().control_points());
  }
  state.label = message.label();
  state.created = time(message.created_time());
  state.updated = time(message.updated_time());
  return state;
}

Deformation deformation(const v1::DeformResponse& message, const DesignPoint& point) {
  Deformation result;
  result.vertices = read<Point>(message.vertices());
  result.functions = read<double>(message.functions());
  result.linearisation = {message.linearisation_id(), point};
  result.quality.total = quality(message.quality().total());
  for (const auto& entry : message.quality().components()) {
    result.quality.components.emplace(entry.component(), quality(entry.summary()));
  }
  if (message.has_cell_quality()) {
    const auto& cells = message.cell_quality();
    result.cell_quality = {
        read<double>(cells.aspect_ratio()), read<double>(cells.edge_ratio()), read<double>(cells.scaled_jacobian()),
        read<double>(cells.skew())};
  }
  const auto& residuals = message.residuals();
  result.residuals = {residuals.seam(), residuals.held(), residuals.projection(), residuals.projection_steps(),
                      residuals.crossing_pairs()};
  result.timings = timings(message.timings());
  return result;
}

Timings timings(const v1::Timings& message) { return {Seconds(message.queue_seconds()), Seconds(message.engine_seconds())}; }

Status status(const v1::GetStatusResponse& message) {
  Status status;
  status.version = message.version();
  status.uptime = Seconds(message.uptime_seconds());
  status.all_tenants = message.all_tenants();
  status.running = message.running();
  status.queued = message.queued();
  status.running_limit = message.running_limit();
  status.queued_limit = message.queued_limit();
  status.sessions = message.sessions();
  status.setups_resident = message.setups_resident();
  status.setups_stored = message.setups_stored();
  status.stored_bytes = message.stored_bytes();
  status.setup_cache = cache(message.setup_cache());
  status.linearisation_cache = cache(message.linearisation_cache());
  for (const auto& each : message.work()) status.work.push_back(work(each));
  return status;
}

void write_at(const At& at, v1::LinearisationPoint& message) {
  message.set_linearisation_id(at.id);
  if (at.point) write_point(*at.point, *message.mutable_design_point());
}

}  // namespace moldline::internal
