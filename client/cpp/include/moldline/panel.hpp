/// \file
/// Client of the panel service: subsonic flow over surface meshes by a panel method, with exact derivatives.
///
///     moldline::panel::Client panels("127.0.0.1:50052");
///     auto configuration = panels.create_configuration(mesh.vertices, mesh.cells);
///     auto flow = configuration.analyze(moved.vertices, {0.7, {0.02, 0.0}, {68.2, 3.42, 23.82, {}}});
///     moldline::panel::Coefficients weights;
///     weights.lift = 1.0;
///     moldline::panel::Seeds seeds;
///     seeds.coefficients = {&weights, 1};
///     std::vector<moldline::Point> gradient = configuration.vjp(seeds, flow.at(moved.vertices)).vertices;
///
/// Axes: x aft, y starboard, z up; metres and radians. The service stores nothing durably: a configuration or an analysis that
/// it has dropped is sent again, with the same results to the last bit.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "moldline/client.hpp"

namespace moldline::internal {
class PanelConnection;
}
namespace moldline::v1 {
class CreateConfigurationRequest;
}

namespace moldline::panel {

/// Vertices of a cell, counter-clockwise from outside; a triangle's fourth is `Mesh::no_vertex`.
using Cell = std::array<std::uint32_t, 4>;
/// Cells or vertices by name.
using IndexGroups = std::map<std::string, std::vector<std::uint32_t>>;

/// Symmetry with respect to the plane y = 0.
enum class Symmetry {
  /// Found from the reference positions.
  Automatic,
  /// Every cell is solved; the flow may have sideslip.
  None,
  /// The mesh is one half, open on the plane.
  Half,
  /// The mesh has both halves, and one is solved.
  Mirror
};

/// Solver of the linear system.
enum class Solver {
  /// Chosen by the number of unknowns.
  Automatic,
  /// LU in double precision.
  Double,
  /// LU in single precision, refined in double precision.
  Single,
  /// GMRES with a block preconditioner.
  Iterative
};

/// What becomes of an answer that a check finds wrong.
enum class OnDoubt {
  /// Refused beyond the check's second limit; a warning beyond its first.
  Refuse = 1,
  /// A warning only.
  Warn
};

/// A reason to doubt a configuration or an answer.
struct Warning {
  /// Of a configuration `no_wake` or `left_out`; of an answer `near_pass`, `lift`, `drag`, `span_efficiency`, `stagnation` or
  /// `circulation`.
  std::string kind;
  /// What is wrong, where, and the way out.
  std::string text;
};

/// A line of edges that looks like a trailing edge, but was not taken as one.
struct LineLeftOut {
  /// Its vertices in order.
  std::vector<std::uint32_t> vertices;
  /// m.
  double length = 0.0;
  /// Length as seen along the flow, m.
  double width = 0.0;
  /// Angle by which the outward normal turns across it, degrees: the mean.
  double turn = 0.0;
  /// `flat`, `smooth`, `along_the_flow`, `base` or `not_named`.
  std::string reason;
};

/// Trailing edges, where wakes leave the surface.
struct TrailingEdges {
  /// None: bodies without lift.
  struct None {};
  /// Pairs of vertices.
  using Edges = std::vector<std::array<std::uint32_t, 2>>;
  /// Edges with both vertices in one of these vertex groups.
  using Groups = std::vector<std::string>;
  /// Edges that point downstream and across which the outward normal turns by at least this angle, degrees (60 to 180).
  using Angle = double;

  std::variant<Angle, None, Edges, Groups> rule = 120.0;
};

/// Options of `Client::create_configuration`.
struct ConfigurationOptions : CallOptions {
  /// Parts of the surface, for forces; `parts` makes them from a mesh.
  IndexGroups cell_groups;
  /// Vertices by name, for trailing edges.
  IndexGroups vertex_groups;
  Symmetry symmetry = Symmetry::Automatic;
  TrailingEdges trailing_edges;
  /// Cell groups whose forces are returned; all if absent.
  std::optional<std::vector<std::string>> components;
  Solver solver = Solver::Automatic;
  /// Residual relative to the right-hand side; 1e-12 if absent.
  std::optional<double> tolerance;
  /// Distance within which vertices become one, at their mean, m; none if absent. All arrays keep the vertices given.
  std::optional<double> merge_tolerance;
  /// Answers that contradict themselves.
  OnDoubt on_doubt = OnDoubt::Refuse;
};

/// Description of a configuration.
struct ConfigurationFacts {
  /// Hash of its content.
  std::string id;
  std::size_t vertex_count = 0;
  std::size_t cell_count = 0;
  /// Unknowns of the linear system.
  std::size_t unknowns = 0;
  /// Whether one half is solved for both.
  bool symmetric = false;
  /// Trailing edges of the solved half, in the order of section loads.
  std::vector<std::array<std::uint32_t, 2>> trailing_edges;
  /// Vertices where a trailing edge ends on a body, across which its circulation continues.
  std::vector<std::uint32_t> roots;
  /// For each of them the vertex at the body's aft end where its circulation leaves the body.
  std::vector<std::uint32_t> aft_ends;
  /// What looks like a trailing edge, but was not taken as one; the longest of each reason first.
  std::vector<LineLeftOut> left_out;
  /// Reasons to doubt the configuration.
  std::vector<Warning> warnings;
  Solver solver = Solver::Automatic;
  /// Approximate peak memory of an analysis, bytes.
  std::uint64_t memory = 0;
  /// Names of the parts whose forces are returned.
  std::vector<std::string> components;
};

/// Direction of the wind, rad.
struct Wind {
  /// Angle of attack.
  double alpha = 0.0;
  /// Positive if the wind comes from starboard.
  double sideslip = 0.0;
};

/// Reference values of the coefficients: of the whole aircraft, also for a half model.
struct Reference {
  /// Reference area, m^2.
  double area = 1.0;
  /// Reference length of the pitching moment, m.
  double chord = 1.0;
  /// Reference length of rolling and yawing moment, m.
  double span = 1.0;
  /// Moment reference point, m.
  Point point{};
};

/// Mach number, wind and reference values.
struct Flow {
  double mach = 0.0;
  Wind wind;
  Reference reference;
};

/// Scalar outputs, their changes along a direction, or their weights in a sum.
struct Coefficients {
  static constexpr std::size_t count = 9;

  /// Lift from the circulation of the wakes.
  double lift = 0.0;
  /// Induced drag from the Trefftz plane.
  double induced_drag = 0.0;
  /// Lift and drag from the pressure.
  double pressure_lift = 0.0;
  double pressure_drag = 0.0;
  /// Pitching moment from the pressure, nose up positive.
  double moment = 0.0;
  /// Derivatives with respect to the angle of attack, 1/rad.
  double lift_slope = 0.0;
  double moment_slope = 0.0;
  double pressure_lift_slope = 0.0;
  /// x of the neutral point, m; not a number without lift.
  double neutral_point = 0.0;

  /// The values in this order.
  std::array<double, count> array() const;
  /// The inverse of `array`.
  static Coefficients from(const std::array<double, count>& values);
};

/// Force and moment coefficients of a part of the surface, from the pressure.
struct Loads {
  /// Force along x, y, z over dynamic pressure and reference area.
  Point force{};
  /// Moment about x, y, z over dynamic pressure, reference area, and span, chord and span; the second is nose up.
  Point moment{};
  double lift = 0.0;
  double drag = 0.0;
};

/// Loads along the trailing edges of the solved half.
struct Sections {
  /// The trailing edges, as pairs of vertices.
  std::vector<std::array<std::uint32_t, 2>> edges;
  /// Their midpoints, m.
  std::vector<Point> middles;
  /// y and z of the vector from first to second vertex, m.
  std::vector<std::array<double, 2>> spans;
  /// Section lift coefficient times chord, m.
  std::vector<double> loads;
};

/// Point of linearisation: vertices and flow, and the id of their analysis, whose factored system the server may hold.
struct AnalysisPoint {
  /// Id of the analysis; may be empty.
  std::string id;
  /// A view of the positions, m, which must live until the call returns; the reference positions if absent.
  std::optional<View<Point>> vertices;
  Flow flow;
};

/// The flow in one wind.
struct Analysis {
  /// Determined by configuration, vertices and Mach number: the same in every wind.
  std::string id;
  Flow flow;
  Coefficients coefficients;
  /// Lift coefficient of the wakes: the part of the circulation's lift that acts on them and not on the body.
  double wake_lift = 0.0;
  /// A measure of the discretisation error: lift from the pressure and on the wakes, over the lift that momentum requires for
  /// the circulation, minus one.
  double disagreement = 0.0;
  /// Reasons to doubt the answer.
  std::vector<Warning> warnings;
  Loads total;
  std::map<std::string, Loads> components;
  Sections sections;
  /// Pressure coefficients of cells and at vertices; empty if not requested.
  std::vector<double> cp;
  std::vector<double> vertex_cp;
  /// Number of cells where the flow would be supersonic.
  std::size_t supercritical_cells = 0;
  /// Residual of the linear system relative to its right-hand side: at the end, and after each round of refinement or iteration.
  double residual = 0.0;
  std::vector<double> residuals;
  std::size_t rounds = 0;
  /// Whether the server had the solution already.
  bool reused = false;
  Timings timings;

  /// For derivatives at this point. `vertices` are the analysed ones, from which the server solves again what it has dropped.
  AnalysisPoint at(View<Point> vertices) const { return {id, vertices, flow}; }
};

/// Options of `Configuration::analyze` and `sweep`.
struct AnalyzeOptions : CallOptions {
  /// Whether to return the pressures of cells and vertices.
  bool pressures = true;
  Tell progress;
};

/// `count` directions of the inputs, each block (count, ...); empty blocks are zero.
struct Directions {
  std::size_t count = 1;
  /// (count, vertices), m.
  View<Point> vertices;
  /// (count,) each: rad, rad, 1, m^2, m.
  View<double> alpha;
  View<double> sideslip;
  View<double> mach;
  View<double> area;
  View<double> chord;
  /// (count,), m.
  View<Point> point;
};

/// Changes of the outputs along `count` directions.
struct Tangents {
  std::size_t count = 0;
  /// (count,), (count, sections), (count, cells).
  std::vector<Coefficients> coefficients;
  std::vector<double> section_loads;
  std::vector<double> cp;
  Timings timings;
};

/// Weights of `count` sums of the outputs; empty blocks are zero.
struct Seeds {
  std::size_t count = 1;
  /// (count,), (count, sections), (count, cells).
  View<Coefficients> coefficients;
  View<double> section_loads;
  View<double> cp;
};

/// Gradients of `count` weighted sums with respect to the inputs.
struct Gradients {
  std::size_t count = 0;
  /// (count, vertices), per metre.
  std::vector<Point> vertices;
  /// (count,) each, per rad, rad, 1, m^2 and m.
  std::vector<double> alpha;
  std::vector<double> sideslip;
  std::vector<double> mach;
  std::vector<double> area;
  std::vector<double> chord;
  /// (count,), per metre.
  std::vector<Point> point;
  Timings timings;
};

/// A mesh prepared for analyses on the server. Immutable; valid for all positions of its vertices.
class Configuration {
 public:
  Configuration(
      std::shared_ptr<internal::PanelConnection> connection, ConfigurationFacts facts,
      std::shared_ptr<const v1::CreateConfigurationRequest> request);

  const ConfigurationFacts& facts() const { return facts_; }
  const ConfigurationFacts* operator->() const { return &facts_; }

  /// The flow over the mesh with its vertices at given positions, or at the reference positions if absent. A pure function:
  /// the same input gives the same bytes. Throws `InvalidArgument` naming the wrong field, `FailedPrecondition` if the method
  /// fails on these vertices, such as a wake that cuts the body.
  Analysis analyze(std::optional<View<Point>> vertices, const Flow& flow, const AnalyzeOptions& options = {}) const;
  /// Analyses in several winds at little more than the cost of one.
  std::vector<Analysis> sweep(
      std::optional<View<Point>> vertices, double mach, const std::vector<Wind>& winds, const Reference& reference,
      const AnalyzeOptions& options = {}) const;
  /// Jacobian-vector products `J v`, exactly: changes of the outputs along directions of the inputs.
  Tangents jvp(const Directions& directions, const AnalysisPoint& at, const CallOptions& options = {}) const;
  /// Vector-Jacobian products `J^T w`, exactly: gradients of weighted sums of the outputs. Several sums share one pass.
  Gradients vjp(const Seeds& seeds, const AnalysisPoint& at, const CallOptions& options = {}) const;

 private:
  std::shared_ptr<internal::PanelConnection> connection_;
  ConfigurationFacts facts_;
  /// Sent again if the server has dropped the configuration; null if another client created it.
  std::shared_ptr<const v1::CreateConfigurationRequest> request_;
};

/// A connection to a panel service (`moldline panel serve`). Thread-safe; configurations keep it open.
class Client {
 public:
  explicit Client(const std::string& address = "127.0.0.1:50051", const Options& options = {});

  /// Checks a mesh and finds everything that does not depend on the positions of its vertices; identical content returns the
  /// same configuration. `vertices` are the reference positions, where symmetry, trailing edges and wakes are found. Throws
  /// `InvalidArgument` naming the wrong cell or edge, `ResourceExhausted` if an analysis would need more memory than the
  /// server allows.
  Configuration create_configuration(
      View<Point> vertices, View<Cell> cells, const ConfigurationOptions& options = {}) const;
  /// The configuration with this id. Throws `NotFound` if the server does not hold it, or no longer.
  Configuration get_configuration(const std::string& id, const CallOptions& options = {}) const;

 private:
  std::shared_ptr<internal::PanelConnection> connection_;
};

/// The cells of each component of a mesh, by name: cell groups of a configuration.
IndexGroups parts(const Mesh& mesh, const std::vector<std::string>& components);

}  // namespace moldline::panel
