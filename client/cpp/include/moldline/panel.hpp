/// \file
/// Client of `moldline panel serve`: subsonic flow over surface meshes by a panel method, with exact derivatives.
///
///     moldline::panel::Client panels("127.0.0.1:50052");
///     auto configuration = panels.create_configuration(mesh.vertices, mesh.cells);
///     auto flow = configuration.analyze(moved.vertices, {0.7, {0.02, 0.0}, {68.2, 3.42, 23.82, {}}});
///     std::vector<double> weights(moldline::panel::Coefficients::count);
///     weights[0] = 1.0;  // of the lift
///     moldline::panel::Seeds seeds;
///     seeds.coefficients = weights;
///     std::vector<moldline::Point> gradient = configuration.vjp(seeds, flow.at(moved.vertices)).vertices;
///
/// Axes: x aft, y starboard, z up; metres, radians.
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

/// The plane y = 0: as the reference vertices are; every cell is solved; the mesh is one half; it has both, and one is solved.
enum class Symmetry { Automatic, None, Half, Mirror };

/// How the system is solved: by its size, by LU in double precision, in single precision with refinement, or by GMRES.
enum class Solver { Automatic, Double, Single, Iterative };

/// Where wakes leave the surface.
struct TrailingEdges {
  /// Bodies without lift.
  struct None {};
  /// Pairs of vertices.
  using Edges = std::vector<std::array<std::uint32_t, 2>>;
  /// Edges with both vertices in one of these vertex groups.
  using Groups = std::vector<std::string>;
  /// Where the outward normal turns by at least so many degrees, pointing downstream.
  using Angle = double;

  std::variant<Angle, None, Edges, Groups> rule = 120.0;
};

/// Of `Client::create_configuration`.
struct ConfigurationOptions : CallOptions {
  /// Parts of the surface whose forces are told.
  IndexGroups cell_groups;
  /// For trailing edges.
  IndexGroups vertex_groups;
  Symmetry symmetry = Symmetry::Automatic;
  TrailingEdges trailing_edges;
  /// Cell groups whose forces are told; all if absent.
  std::optional<std::vector<std::string>> components;
  Solver solver = Solver::Automatic;
  /// Residual relative to the right-hand side; 1e-12 if absent.
  std::optional<double> tolerance;
};

/// What is known of a configuration without asking the server again.
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
  /// Vertices where a trailing edge ends on a body, over which its circulation goes on.
  std::vector<std::uint32_t> roots;
  Solver solver = Solver::Automatic;
  /// Bytes that an analysis takes at its peak, about.
  std::uint64_t memory = 0;
  /// Whose forces are told.
  std::vector<std::string> components;
};

/// Where the wind comes from, rad.
struct Wind {
  double alpha = 0.0;
  /// Positive if it comes from starboard.
  double sideslip = 0.0;
};

/// What coefficients refer to: of the whole aircraft, also for a half model.
struct Reference {
  /// m^2.
  double area = 1.0;
  /// Of the pitching moment, m.
  double chord = 1.0;
  /// Of rolling and yawing moment, m.
  double span = 1.0;
  /// About which moments are taken, m.
  Point point{};
};

/// Mach number, wind, and what coefficients refer to.
struct Flow {
  double mach = 0.0;
  Wind wind;
  Reference reference;
};

/// Scalar outputs, in the order of blocks of coefficients.
struct Coefficients {
  static constexpr std::size_t count = 9;

  /// Lift from the circulation of the wakes.
  double lift = 0.0;
  /// Induced drag from the Trefftz plane.
  double induced_drag = 0.0;
  /// Lift and drag from the pressure.
  double pressure_lift = 0.0;
  double pressure_drag = 0.0;
  /// Pitching moment, nose up positive, from the pressure.
  double moment = 0.0;
  /// Derivatives by the angle of attack, 1/rad.
  double lift_slope = 0.0;
  double moment_slope = 0.0;
  double pressure_lift_slope = 0.0;
  /// x of the neutral point, m; not a number without lift.
  double neutral_point = 0.0;

  std::array<double, count> array() const {
    return {lift, induced_drag, pressure_lift, pressure_drag, moment, lift_slope, moment_slope, pressure_lift_slope, neutral_point};
  }
};

/// Forces and moments of a part of the surface, from the pressure.
struct Loads {
  /// Along x, y, z, by dynamic pressure and reference area.
  Point force{};
  /// About x, y, z, by span, chord and span as well; the second is nose up.
  Point moment{};
  double lift = 0.0;
  double drag = 0.0;
};

/// Loads along the trailing edges of the solved half.
struct Sections {
  /// As vertices.
  std::vector<std::array<std::uint32_t, 2>> edges;
  /// Their middles, m.
  std::vector<Point> middles;
  /// From first to second vertex in y and z, m.
  std::vector<std::array<double, 2>> spans;
  /// Section lift coefficient times chord, m.
  std::vector<double> loads;
};

/// Where a derivative is taken: an analysis and what it comes from.
struct AnalysisPoint {
  /// As an analysis has it; may be empty.
  std::string id;
  /// The reference positions if absent. Views: what they see has to live until the call returns.
  std::optional<View<Point>> vertices;
  Flow flow;
};

/// The flow at one angle of attack.
struct Analysis {
  /// Names configuration, vertices and Mach number; the same at every angle.
  std::string id;
  Flow flow;
  Coefficients coefficients;
  /// Lift coefficient of the wakes: the part of the circulation's lift that acts on them and not on the body.
  double wake_lift = 0.0;
  /// Lift from the pressure and on the wakes over the lift that momentum demands for the circulation, less one: a measure of the
  /// discretisation.
  double disagreement = 0.0;
  Loads total;
  std::map<std::string, Loads> components;
  Sections sections;
  /// Of every cell and at every vertex; empty if they were not wanted.
  std::vector<double> cp;
  std::vector<double> vertex_cp;
  /// Cells where the flow would be supersonic.
  std::size_t supercritical_cells = 0;
  /// Of the linear system, relative to its right-hand side; after each round of refinement, or iteration.
  double residual = 0.0;
  std::vector<double> residuals;
  std::size_t rounds = 0;
  /// Whether the server had it solved already.
  bool reused = false;
  Timings timings;

  /// For derivatives here. `vertices` are those that were analysed, from which the server solves again what it has dropped.
  AnalysisPoint at(View<Point> vertices) const { return {id, vertices, flow}; }
};

/// Of `Configuration::analyze` and `sweep`.
struct AnalyzeOptions : CallOptions {
  /// Whether the pressures of cells and vertices are wanted.
  bool pressures = true;
  Tell progress;
};

/// `count` directions of the inputs, each block (count, ...); what is empty is zero.
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

/// How the outputs change.
struct Tangents {
  std::size_t count = 0;
  /// (count, 9), (count, sections), (count, cells).
  std::vector<double> coefficients;
  std::vector<double> section_loads;
  std::vector<double> cp;
  Timings timings;
};

/// Weights of the outputs, of `count` sums; what is empty is zero.
struct Seeds {
  std::size_t count = 1;
  /// (count, 9) in the order of `Coefficients`, (count, sections), (count, cells).
  View<double> coefficients;
  View<double> section_loads;
  View<double> cp;
};

/// Gradients by the inputs.
struct Gradients {
  std::size_t count = 0;
  /// (count, vertices), per metre.
  std::vector<Point> vertices;
  /// (count,) each.
  std::vector<double> alpha;
  std::vector<double> sideslip;
  std::vector<double> mach;
  std::vector<double> area;
  std::vector<double> chord;
  /// (count,), per metre.
  std::vector<Point> point;
  Timings timings;
};

/// A mesh made ready on the server. Immutable; serves any positions of its vertices.
class Configuration {
 public:
  Configuration(
      std::shared_ptr<internal::PanelConnection> connection, ConfigurationFacts facts,
      std::shared_ptr<const v1::CreateConfigurationRequest> request);

  const ConfigurationFacts& facts() const { return facts_; }
  const ConfigurationFacts* operator->() const { return &facts_; }

  /// The flow over vertices, or over the reference positions if absent. A pure function: a retry is safe. Throws
  /// `InvalidArgument` naming what is wrong, `FailedPrecondition` if the method fails on these vertices, such as a wake that
  /// cuts the body.
  Analysis analyze(std::optional<View<Point>> vertices, const Flow& flow, const AnalyzeOptions& options = {}) const;
  /// The same in several winds, for hardly more than the price of one.
  std::vector<Analysis> sweep(
      std::optional<View<Point>> vertices, double mach, const std::vector<Wind>& winds, const Reference& reference,
      const AnalyzeOptions& options = {}) const;
  /// How the outputs change along directions of the inputs: `J v`, exactly.
  Tangents jvp(const Directions& directions, const AnalysisPoint& at, const CallOptions& options = {}) const;
  /// Gradients of weighted sums of the outputs: `J^T w`, exactly. Several share one pass.
  Gradients vjp(const Seeds& seeds, const AnalysisPoint& at, const CallOptions& options = {}) const;

 private:
  std::shared_ptr<internal::PanelConnection> connection_;
  ConfigurationFacts facts_;
  /// What the server is sent again if it has dropped it; null if another client sent it.
  std::shared_ptr<const v1::CreateConfigurationRequest> request_;
};

/// A connection to `moldline panel serve`. Safe to use from several threads; configurations keep it open.
class Client {
 public:
  explicit Client(const std::string& address = "127.0.0.1:50051", const Options& options = {});

  /// Checks a mesh and finds what does not change with its vertices. The same content again gives the same one.
  /// `vertices`: reference positions, where symmetry, trailing edges and wakes are found. Throws `InvalidArgument` naming the
  /// cell or edge that is wrong, `ResourceExhausted` if an analysis would need more memory than the server gives one.
  Configuration create_configuration(
      View<Point> vertices, View<Cell> cells, const ConfigurationOptions& options = {}) const;
  /// The configuration of that id. Throws `NotFound` if the server keeps it no more.
  Configuration get_configuration(const std::string& id, const CallOptions& options = {}) const;

 private:
  std::shared_ptr<internal::PanelConnection> connection_;
};

/// The cells of each component of a mesh, by name: cell groups of a configuration.
IndexGroups parts(const Mesh& mesh, const std::vector<std::string>& components);

}  // namespace moldline::panel
