/// \file
/// What the client asks with and is answered: plain data.
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
/// Seconds since 1970-01-01 00:00 UTC, as the server gives them.
using Time = std::chrono::time_point<std::chrono::system_clock, Seconds>;
/// x, y and z: of a vertex or a control point, metres; of a derivative by it, per metre.
using Point = std::array<double, 3>;

/// Values that follow each other and belong to somebody else, who has to outlive the view.
template <class T>
class View {
 public:
  View() = default;
  View(const T* data, std::size_t size) : data_(data), size_(size) {}
  // NOLINTNEXTLINE(google-explicit-constructor): a vector is a view where one is asked for.
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

/// How far something long has come.
struct Progress {
  /// Of a set-up: `receive`, `read`, `queue`, and then the engine's stages. `jacobian` of a Jacobian.
  std::string stage;
  /// Share of the stage, 0 to 1.
  double fraction = 0.0;
  /// For people.
  std::string message;
};

/// Takes each step; an exception of it cancels the call and goes on to the caller.
using Tell = std::function<void(const Progress&)>;

/// One scalar design variable.
struct Variable {
  /// Such as `wing.twist[3]`.
  std::string name;
  /// Of the three numbers and of its entry in a design, such as `m` or `deg`.
  std::string unit;
  double baseline = 0.0;
  /// Bounds; may be infinite.
  double lower = 0.0;
  double upper = 0.0;
};

/// Variables that were declared together.
struct VariableGroup {
  std::string name;
  /// Index of the first one's entry of a design; they follow each other, the last axis of `shape` fastest.
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
  /// For the reference mesh.
  double value = 0.0;
};

/// Who may use a set-up besides its owner: nobody, tenants that are named, or every tenant of the server.
enum class Visibility { Private, Tenants, Public };

/// What a set-up is to the caller.
struct SetupAccess {
  /// Whether the caller has uploaded it.
  bool owned = false;
  /// To the owner: what was chosen. To others: `Tenants` or `Public`, whichever lets them use it.
  Visibility visibility = Visibility::Private;
  /// Tenants; to the owner only.
  std::vector<std::string> shared_with;
};

/// What is known of a set-up without asking the server again.
struct SetupFacts {
  /// Hash of its content.
  std::string id;
  /// Whether it was new to the caller when the call that returned this created it.
  bool built = false;
  /// The title its author gave it.
  std::string name;
  SetupAccess access;
  /// What was found, as text and as a JSON document.
  std::string report_text;
  std::string report_json;
  /// In the order of a design's entries.
  std::vector<Variable> variables;
  std::vector<VariableGroup> groups;
  /// Names of the components, and how many control points each has.
  std::vector<std::string> components;
  std::vector<std::size_t> control_point_counts;
  /// The scalar outputs besides the vertices.
  std::vector<Function> functions;
  std::size_t vertex_count = 0;
  std::size_t cell_count = 0;
  /// Of the engine, to build it.
  Seconds build_time{0.0};
};

/// A set-up in a list.
struct SetupSummary {
  std::string id;
  std::string name;
  std::size_t vertex_count = 0;
  std::size_t cell_count = 0;
  std::size_t variable_count = 0;
  /// When it was first uploaded.
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
  /// By cell: index of the component that owns it.
  std::vector<std::uint32_t> cell_owner;
  /// By vertex: whether it lies on a seam of two components; 0 or 1.
  std::vector<std::uint8_t> seam;
};

/// Control points by component, patch after patch, the second parameter fastest.
using ControlPoints = std::map<std::string, std::vector<Point>>;

/// A design, and control points from elsewhere in place of what the design makes of their components.
struct DesignPoint {
  /// Every entry in its variable's unit.
  using Vector = std::vector<double>;
  /// Variables that are not named stay at their baseline.
  using Named = std::map<std::string, double>;
  /// The baseline.
  using Baseline = std::monostate;

  DesignPoint() = default;
  // NOLINTBEGIN(google-explicit-constructor): all of these are a design where one is asked for.
  DesignPoint(Vector values) : design(std::move(values)) {}
  DesignPoint(Named values) : design(std::move(values)) {}
  DesignPoint(std::initializer_list<Named::value_type> values) : design(Named(values)) {}
  // NOLINTEND(google-explicit-constructor)

  std::variant<Baseline, Vector, Named> design;
  ControlPoints control_points;
};

/// A session as the server has stored it.
struct SessionState {
  std::string id;
  std::string setup_id;
  /// Grows by one with each update.
  std::uint64_t generation = 0;
  /// As stored last: all variables in order, and the control points that were given. Absent in lists.
  std::optional<DesignPoint> design;
  /// For people.
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

/// Measures of some cells.
struct QualitySummary {
  std::size_t cells = 0;
  /// Verdict's aspect ratio.
  Distribution aspect_ratio;
  /// Longest over shortest edge.
  Distribution edge_ratio;
  /// Against the owner surface's current normal; 1 at best, negative where a corner is inverted.
  double min_scaled_jacobian = 0.0;
  /// Interior angles, degrees.
  double min_angle = 0.0;
  double max_angle = 0.0;
  /// Equiangle skew, 0 at best.
  double skew_p95 = 0.0;
  double skew_max = 0.0;
  /// Cells whose area vector points against their owner's normal.
  std::size_t folded = 0;
  /// Cells with a corner that is turned against the owner's normal.
  std::size_t inverted = 0;
};

/// Measures of all cells and of each component's.
struct QualityReport {
  QualitySummary total;
  std::map<std::string, QualitySummary> components;
};

/// Measures of every cell.
struct CellQuality {
  std::vector<double> aspect_ratio;
  std::vector<double> edge_ratio;
  std::vector<double> scaled_jacobian;
  std::vector<double> skew;
};

/// How exactly a mesh lies where it has to.
struct Residuals {
  /// Largest distance of a seam vertex from one of its components before the smooth projection, metres.
  double seam = 0.0;
  /// Largest distance of a protected or stationary vertex from a component that it lies on, metres.
  double held = 0.0;
  /// Largest |Phi| of an active vertex at the end, metres; 0 for a sharp outer mold line.
  double projection = 0.0;
  /// Most projection steps that a vertex took.
  std::uint32_t projection_steps = 0;
};

/// How long requests took on the server.
struct Timings {
  Seconds queue{0.0};
  Seconds engine{0.0};
};

/// Where a derivative is taken: what the server keeps of a deformation, and the design to make it again.
struct Linearisation {
  /// The same for the same set-up and design, on any server.
  std::string id;
  DesignPoint point;
};

/// A deformed mesh.
struct Deformation {
  /// In the set-up mesh's order.
  std::vector<Point> vertices;
  /// The scalar outputs in the order of the set-up's, each in its unit.
  std::vector<double> functions;
  Linearisation linearisation;
  QualityReport quality;
  /// Only if asked for.
  std::optional<CellQuality> cell_quality;
  Residuals residuals;
  Timings timings;
};

/// Where a derivative is taken: a deformation, what is left of it, or a design. Best is a deformation: the server has it.
struct At {
  /// The baseline.
  At() : point(DesignPoint()) {}
  // NOLINTBEGIN(google-explicit-constructor): all of these are a place where one is asked for.
  At(const Deformation& deformation) : At(deformation.linearisation) {}
  At(const Linearisation& linearisation) : id(linearisation.id), point(linearisation.point) {}
  At(DesignPoint design) : point(std::move(design)) {}
  // NOLINTEND(google-explicit-constructor)
  /// What the server has to hold still; it is `NotFound` otherwise.
  static At held(std::string id) {
    At at;
    at.id = std::move(id);
    at.point.reset();
    return at;
  }

  std::string id;
  std::optional<DesignPoint> point;
};

/// k directions of the inputs; what is empty is zero.
struct Directions {
  /// k.
  std::size_t count = 1;
  /// (k, number of variables), the last axis fastest: each entry in its variable's unit.
  View<double> design;
  /// By component: (k, number of its control points), on top of what `design` does to them.
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

/// k weighted sums of the outputs, and by which inputs their gradients are wanted; weights that are empty are zero.
struct Seeds {
  /// k.
  std::size_t count = 1;
  /// (k, number of vertices): weights of the vertices' coordinates, such as the derivative of an objective by them.
  View<Point> vertices;
  /// (k, number of functions): weights of the functions.
  View<double> functions;
  /// Whether gradients by the design variables are wanted.
  bool by_design = true;
  /// Components by whose control points gradients are wanted too.
  std::vector<std::string> by_control_points;
};

/// Gradients of k weighted sums.
struct Gradients {
  std::size_t count = 0;
  /// (k, number of variables), per its variable's unit; empty if not asked for.
  std::vector<double> design;
  /// By component, if asked for: (k, number of its control points), per metre.
  ControlPoints control_points;
  Timings timings;
};

/// Derivatives of all outputs by all design variables.
struct Jacobian {
  /// (number of variables, number of vertices), metres per the variable's unit.
  std::vector<Point> vertices;
  /// (number of variables, number of functions).
  std::vector<double> functions;
  Timings timings;
};

/// Use of one of the server's caches.
struct CacheStatus {
  std::uint64_t entries = 0;
  std::uint64_t bytes = 0;
  /// The server's, for all tenants.
  std::uint64_t budget_bytes = 0;
  /// Since the server started; for administrators, others see 0.
  std::uint64_t hits = 0;
  std::uint64_t misses = 0;
  std::uint64_t evictions = 0;
};

/// A request that computes, or waits for it.
struct Work {
  /// Such as `build`, `deform`, `jvp`, `vjp`, `jacobian`.
  std::string kind;
  std::string tenant;
  /// Empty where there is none (yet).
  std::string setup_id;
  std::string session_id;
  /// Whether it computes; otherwise it waits.
  bool running = false;
  /// Since it came, and since it computes.
  Seconds age{0.0};
  Seconds running_for{0.0};
  /// How far it has come, where that is known.
  std::string stage;
  double fraction = 0.0;
};

/// What the server does and holds.
struct Status {
  std::string version;
  Seconds uptime{0.0};
  /// Whether the figures are those of all tenants (for administrators), or of the caller's only.
  bool all_tenants = false;
  /// Requests that compute and that wait for it, and how many may.
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
  /// Longest first.
  std::vector<Work> work;
};

}  // namespace moldline
