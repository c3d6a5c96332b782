/// \file
/// Data model of the mesh service: arguments and results.
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <initializer_list>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace moldline {

using Seconds = std::chrono::duration<double>;
/// A time in seconds since 1970-01-01 00:00 UTC.
using Time = std::chrono::time_point<std::chrono::system_clock, Seconds>;
/// x, y and z of a vertex or a control point, metres; or a derivative with respect to it, per metre.
using Point = std::array<double, 3>;

/// A view of contiguous values, whose owner must outlive it.
template <class T>
class View {
 public:
  View() = default;
  View(const T* data, std::size_t size) : data_(data), size_(size) {}
  // NOLINTNEXTLINE(google-explicit-constructor): a vector converts to a view.
  View(const std::vector<T>& values) : data_(values.data()), size_(values.size()) {}

  const T* data() const { return data_; }
  std::size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }
  const T* begin() const { return data_; }
  const T* end() const { return data_ + size_; }
  const T& operator[](std::size_t index) const { return data_[index]; }
  /// `count` values from `first` on.
  View sub(std::size_t first, std::size_t count) const { return {data_ + first, count}; }

 private:
  const T* data_ = nullptr;
  std::size_t size_ = 0;
};

/// Progress of a long call.
struct Progress {
  /// Name of the stage: of a set-up, `receive`, `read`, `queue`, then the engine's stages; of a Jacobian, `jacobian`.
  std::string stage;
  /// Fraction of the stage that is done, 0 to 1.
  double fraction = 0.0;
  /// Description for display.
  std::string message;
};

/// Callback for progress; its exceptions cancel the call and are thrown by it.
using Tell = std::function<void(const Progress&)>;

/// One scalar design variable.
struct Variable {
  /// Such as `wing.twist[3]`.
  std::string name;
  /// Unit of its values and bounds, such as `m` or `deg`.
  std::string unit;
  double baseline = 0.0;
  /// Bounds; may be infinite.
  double lower = 0.0;
  double upper = 0.0;
};

/// Variables that were declared together.
struct VariableGroup {
  std::string name;
  /// Index of the first variable in a design; the others follow, the last axis of `shape` fastest.
  std::size_t first = 0;
  /// Empty for a scalar.
  std::vector<std::size_t> shape;
};

/// A scalar output besides the vertices.
struct Function {
  /// Such as `wing.wetted_area`.
  std::string name;
  /// Such as `m^2`.
  std::string unit;
  /// Value for the reference mesh.
  double value = 0.0;
};

/// Who may use a set-up besides its owner: nobody, named tenants, or every tenant of the server.
enum class Visibility { Private, Tenants, Public };

/// Access of the caller, and of others, to a set-up.
struct SetupAccess {
  /// Whether the caller has uploaded it.
  bool owned = false;
  /// For the owner, the chosen visibility; for others, the one that gives them access: `Tenants` or `Public`.
  Visibility visibility = Visibility::Private;
  /// Names of tenants; shown to the owner only.
  std::vector<std::string> shared_with;
};

/// Parts of a mesh file that are not in the mesh.
struct LeftOut {
  /// Nodes that no triangle or quadrilateral uses.
  std::size_t nodes = 0;
  /// Nodes that were merged into others.
  std::size_t merged_nodes = 0;
  /// Cells other than triangles and quadrilaterals.
  std::size_t other_cells = 0;
  /// Cells that collapsed when nodes were merged.
  std::size_t collapsed_cells = 0;
};

/// Description of a set-up.
struct SetupFacts {
  /// Hash of its content.
  std::string id;
  /// Whether the call that returned this created the set-up for the caller.
  bool built = false;
  /// Title given by its author.
  std::string name;
  SetupAccess access;
  /// Report of the build, as text and as a JSON document.
  std::string report_text;
  std::string report_json;
  /// Design variables, in the order of a design's entries.
  std::vector<Variable> variables;
  std::vector<VariableGroup> groups;
  /// Names of the components, and their numbers of control points.
  std::vector<std::string> components;
  std::vector<std::size_t> control_point_counts;
  /// The scalar outputs besides the vertices.
  std::vector<Function> functions;
  std::size_t vertex_count = 0;
  std::size_t cell_count = 0;
  /// Cells of closed pieces that pointed inwards and were turned.
  std::size_t turned_cell_count = 0;
  LeftOut left_out;
  /// Time that the engine took to build it.
  Seconds build_time{0.0};
};

/// A set-up in a list.
struct SetupSummary {
  std::string id;
  std::string name;
  std::size_t vertex_count = 0;
  std::size_t cell_count = 0;
  std::size_t variable_count = 0;
  /// Time of the first upload.
  Time created;
  SetupAccess access;
};

/// A surface mesh of triangles and quadrilaterals.
struct Mesh {
  /// Fourth vertex of a triangle.
  static constexpr std::uint32_t no_vertex = 0xFFFFFFFF;

  std::vector<Point> vertices;
  /// Vertices of each cell, counter-clockwise from outside.
  std::vector<std::array<std::uint32_t, 4>> cells;
  /// Index of the component that owns each cell.
  std::vector<std::uint32_t> cell_owner;
  /// Whether each vertex lies on a seam of two components; 0 or 1.
  std::vector<std::uint8_t> seam;
};

/// Control points by component, patch after patch, the second parameter fastest.
using ControlPoints = std::map<std::string, std::vector<Point>>;

/// A design, and external control points that replace those of their components.
struct DesignPoint {
  /// Every entry in its variable's unit.
  using Vector = std::vector<double>;
  /// Values by name; all others stay at their baseline.
  using Named = std::map<std::string, double>;
  /// The baseline.
  using Baseline = std::monostate;
  using Design = std::variant<Baseline, Vector, Named>;

  DesignPoint() = default;
  // NOLINTBEGIN(google-explicit-constructor): all of these convert to a design.
  DesignPoint(Vector values) : design(std::move(values)) {}
  DesignPoint(Named values) : design(std::move(values)) {}
  DesignPoint(std::initializer_list<Named::value_type> values) : design(Named(values)) {}
  // NOLINTEND(google-explicit-constructor)

  Design design;
  ControlPoints control_points;
};

/// Stored state of a session.
struct SessionState {
  std::string id;
  std::string setup_id;
  /// Grows by one with each update.
  std::uint64_t generation = 0;
  /// The design stored last: all variables in order, and external control points. Absent in lists.
  std::optional<DesignPoint> design;
  /// Descriptive label.
  std::string label;
  Time created;
  Time updated;
};

/// Percentiles over cells.
struct Distribution {
  double p50 = 0.0;
  double p95 = 0.0;
  double p99 = 0.0;
  double max = 0.0;
  /// Share of the cells above 5, in percent.
  double above_5_percent = 0.0;
};

/// Quality measures of a set of cells.
struct QualitySummary {
  std::size_t cells = 0;
  /// Verdict's aspect ratio.
  Distribution aspect_ratio;
  /// Longest over shortest edge.
  Distribution edge_ratio;
  /// With respect to the owner surface's current normal; 1 at best, negative where a corner is inverted.
  double min_scaled_jacobian = 0.0;
  /// Interior angles, degrees.
  double min_angle = 0.0;
  double max_angle = 0.0;
  /// Equiangle skew, 0 at best.
  double skew_p95 = 0.0;
  double skew_max = 0.0;
  /// Cells whose area vector points against their owner's normal.
  std::size_t folded = 0;
  /// Cells with a corner whose normal points against their owner's normal.
  std::size_t inverted = 0;
};

/// Quality measures of all cells, and of the cells of each component.
struct QualityReport {
  QualitySummary total;
  std::map<std::string, QualitySummary> components;
};

/// Quality measures of every cell.
struct CellQuality {
  std::vector<double> aspect_ratio;
  std::vector<double> edge_ratio;
  std::vector<double> scaled_jacobian;
  std::vector<double> skew;
};

/// Residuals of the constraints on a deformed mesh.
struct Residuals {
  /// Largest distance of a seam vertex from one of its components before the smooth projection, metres.
  double seam = 0.0;
  /// Largest distance of a protected or stationary vertex from a component that it lies on, metres.
  double held = 0.0;
  /// Largest final |Phi| of an active vertex, metres; 0 for a sharp outer mold line.
  double projection = 0.0;
  /// Largest number of projection steps of a vertex.
  std::uint32_t projection_steps = 0;
  /// Pairs of cells that pass through each other and did not in the set-up's mesh, at most 1000 (option `on_event`).
  std::uint32_t crossing_pairs = 0;
};

/// Time that requests took on the server, in the queue and in the engine.
struct Timings {
  Seconds queue{0.0};
  Seconds engine{0.0};
};

/// Point of linearisation: the id of a linearisation on the server, and the design to recompute it from.
struct Linearisation {
  /// Determined by set-up and design: the same on every server.
  std::string id;
  DesignPoint point;
};

/// A deformed mesh.
struct Deformation {
  /// In the order of the set-up's mesh, metres.
  std::vector<Point> vertices;
  /// Scalar outputs in the set-up's order, each in its unit.
  std::vector<double> functions;
  Linearisation linearisation;
  QualityReport quality;
  /// If requested.
  std::optional<CellQuality> cell_quality;
  Residuals residuals;
  Timings timings;
};

/// Point of linearisation: a deformation, which is best since the server holds its linearisation, or a design.
struct At {
  /// The baseline.
  At() : point(DesignPoint()) {}
  // NOLINTBEGIN(google-explicit-constructor): all of these convert to a point of linearisation.
  At(const Deformation& deformation) : At(deformation.linearisation) {}
  At(const Linearisation& linearisation) : id(linearisation.id), point(linearisation.point) {}
  At(DesignPoint design) : point(std::move(design)) {}
  // NOLINTEND(google-explicit-constructor)
  /// The id of a linearisation alone; `NotFound` if the server no longer holds it.
  static At held(std::string id) {
    At at;
    at.id = std::move(id);
    at.point.reset();
    return at;
  }

  std::string id;
  std::optional<DesignPoint> point;
};

/// k directions of the inputs; empty blocks are zero.
struct Directions {
  /// k.
  std::size_t count = 1;
  /// (k, number of variables), the last axis fastest, each entry in its variable's unit.
  View<double> design;
  /// By component: (k, number of its control points), metres, in addition to the effect of `design` on them.
  std::map<std::string, View<Point>> control_points;
};

/// Changes of the outputs along k directions.
struct Tangents {
  std::size_t count = 0;
  /// (k, number of vertices), metres.
  std::vector<Point> vertices;
  /// (k, number of functions), each in its unit.
  std::vector<double> functions;
  Timings timings;
};

/// Weights of k sums of the outputs (empty blocks are zero), and the inputs that their gradients are taken with respect to.
struct Seeds {
  /// k.
  std::size_t count = 1;
  /// (k, number of vertices): weights of the vertices' coordinates, such as the gradient of an objective with respect to them.
  View<Point> vertices;
  /// (k, number of functions): weights of the functions.
  View<double> functions;
  /// Whether to take gradients with respect to the design variables.
  bool by_design = true;
  /// Components whose control points to take gradients with respect to.
  std::vector<std::string> by_control_points;
};

/// Gradients of k weighted sums.
struct Gradients {
  std::size_t count = 0;
  /// (k, number of variables), per unit of the variable; empty if not requested.
  std::vector<double> design;
  /// By requested component: (k, number of its control points), per metre.
  ControlPoints control_points;
  Timings timings;
};

/// Derivatives of all outputs with respect to all design variables.
struct Jacobian {
  /// (number of variables, number of vertices), metres per unit of the variable.
  std::vector<Point> vertices;
  /// (number of variables, number of functions).
  std::vector<double> functions;
  Timings timings;
};

/// Usage of a cache of the server.
struct CacheStatus {
  std::uint64_t entries = 0;
  std::uint64_t bytes = 0;
  /// Budget of all tenants together.
  std::uint64_t budget_bytes = 0;
  /// Since the start of the server; 0 unless the caller is an administrator.
  std::uint64_t hits = 0;
  std::uint64_t misses = 0;
  std::uint64_t evictions = 0;
};

/// A request that is computing or queued.
struct Work {
  /// Such as `build`, `deform`, `jvp`, `vjp`, `jacobian`.
  std::string kind;
  std::string tenant;
  /// Empty if there is none (yet).
  std::string setup_id;
  std::string session_id;
  /// Whether it is computing; otherwise it is queued.
  bool running = false;
  /// Time since its arrival, and since its computation began.
  Seconds age{0.0};
  Seconds running_for{0.0};
  /// Current stage, and fraction of it that is done, where known.
  std::string stage;
  double fraction = 0.0;
};

/// Load, caches and store of a server.
struct Status {
  std::string version;
  Seconds uptime{0.0};
  /// Whether the figures cover all tenants (for administrators), or the caller's only.
  bool all_tenants = false;
  /// Requests that are computing and queued, and the limits of both.
  std::uint64_t running = 0;
  std::uint64_t queued = 0;
  std::uint64_t running_limit = 0;
  std::uint64_t queued_limit = 0;
  /// Open sessions.
  std::uint64_t sessions = 0;
  /// Set-ups in memory, and in the store.
  std::uint64_t setups_resident = 0;
  std::uint64_t setups_stored = 0;
  /// Bytes in the store.
  std::uint64_t stored_bytes = 0;
  CacheStatus setup_cache;
  CacheStatus linearisation_cache;
  /// Requests that are computing or queued, oldest first.
  std::vector<Work> work;
};

}  // namespace moldline
