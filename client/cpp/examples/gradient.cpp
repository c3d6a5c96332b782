// Lift of a deformed aircraft and its gradient with respect to the design variables, from a mesh service and a panel service:
//
//     moldline-gradient 127.0.0.1:50051 127.0.0.1:50052 examples/e175 0.7 0.02
//
// with Mach number and angle of attack (rad). Two calls forward and two back, whatever the number of variables.
#include <cstdio>
#include <exception>
#include <string>
#include <vector>

#include "moldline/moldline.hpp"

namespace {

void run(const std::string& mesh_server, const std::string& panel_server, const std::string& folder, double mach, double alpha) {
  const moldline::Client meshes(mesh_server);
  const moldline::Setup setup = meshes.create_setup(folder);
  moldline::Session session = setup.session();
  const moldline::SessionCloser closer(session);
  const moldline::Mesh mesh = setup.mesh();

  const moldline::panel::Client panels(panel_server);
  moldline::panel::ConfigurationOptions options;
  options.cell_groups = moldline::panel::parts(mesh, setup->components);
  const auto configuration = panels.create_configuration(mesh.vertices, mesh.cells, options);

  // Forward: design, vertices, coefficients.
  const moldline::Deformation moved = session.deform(setup.baseline());
  const moldline::panel::Flow flow{mach, {alpha, 0.0}, {}};
  const auto analysis = configuration.analyze(moved.vertices, flow);
  std::printf("lift %.17g\n", analysis.coefficients.lift);

  // Back: weights of the coefficients, gradient with respect to the vertices, gradient with respect to the design.
  moldline::panel::Coefficients weights;
  weights.lift = 1.0;
  moldline::panel::Seeds seeds;
  seeds.coefficients = {&weights, 1};
  const auto by_vertices = configuration.vjp(seeds, analysis.at(moved.vertices)).vertices;
  moldline::Seeds back;
  back.vertices = by_vertices;
  const std::vector<double> by_design = session.vjp(back, moved).design;
  for (std::size_t i = 0; i < by_design.size(); ++i) {
    std::printf("%-28s %.17g per %s\n", setup->variables[i].name.c_str(), by_design[i], setup->variables[i].unit.c_str());
  }
}

}  // namespace

int main(int count, char** arguments) {
  if (count != 6) {
    std::fprintf(stderr, "usage: %s MESH_SERVER PANEL_SERVER FOLDER MACH ALPHA\n", arguments[0]);
    return 2;
  }
  try {
    run(arguments[1], arguments[2], arguments[3], std::stod(arguments[4]), std::stod(arguments[5]));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "error: %s\n", error.what());
    return 1;
  }
  return 0;
}
