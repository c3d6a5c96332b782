// Fits the design variables of a set-up to a given mesh: f(x) = 1/2 sum |vertex_i(x) - target_i|^2, within the bounds.
//
//     moldline-optimizer 127.0.0.1:50051 examples/e175 setup-motions.toml
//
// A quasi-Newton method (BFGS with projection onto the bounds) takes the mesh from Deform and the gradient from ApplyAdjoint.
// It stores every accepted design, so that it can be killed and continued: pass the session's id in place of the folder.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <functional>
#include <numeric>
#include <string>
#include <vector>

#include "moldline/moldline.hpp"

namespace {

using Vector = std::vector<double>;

double dot(const Vector& a, const Vector& b) { return std::inner_product(a.begin(), a.end(), b.begin(), 0.0); }

/// Variables on a common scale: 0 at the lower bound, 1 at the upper one. Without bounds, one unit about the baseline.
class Box {
 public:
  explicit Box(const std::vector<moldline::Variable>& variables) {
    for (const auto& variable : variables) {
      lower_.push_back(std::isfinite(variable.lower) ? variable.lower : variable.baseline - 1.0);
      const double upper = std::isfinite(variable.upper) ? variable.upper : variable.baseline + 1.0;
      range_.push_back(upper - lower_.back());
    }
  }

  /// The design at scaled variables; exactly within the bounds.
  Vector design(const Vector& scaled) const {
    Vector design(scaled.size());
    for (std::size_t i = 0; i < scaled.size(); ++i) {
      design[i] = std::clamp(lower_[i] + scaled[i] * range_[i], lower_[i], lower_[i] + range_[i]);
    }
    return design;
  }

  Vector scaled(const Vector& design) const {
    Vector scaled(design.size());
    for (std::size_t i = 0; i < scaled.size(); ++i) scaled[i] = range_[i] > 0 ? (design[i] - lower_[i]) / range_[i] : 0.0;
    return scaled;
  }

  /// Gradient with respect to the scaled variables, from that with respect to the design.
  Vector gradient(const Vector& by_design) const {
    Vector gradient(by_design.size());
    for (std::size_t i = 0; i < gradient.size(); ++i) gradient[i] = by_design[i] * range_[i];
    return gradient;
  }

 private:
  Vector lower_;
  Vector range_;
};

struct Evaluation {
  double value;
  Vector gradient;
};

/// Minimises over the unit box; `accepted` is called with each point that is better than the one before.
void minimise(
    Vector x, const std::function<Evaluation(const Vector&)>& evaluate,
    const std::function<void(int, const Vector&, double, double)>& accepted) {
  const std::size_t n = x.size();
  // Approximates the inverse of the Hessian.
  std::vector<Vector> inverse;
  const auto restart = [&](double scale) {
    inverse.assign(n, Vector(n, 0.0));
    for (std::size_t i = 0; i < n; ++i) inverse[i][i] = scale;
  };
  Evaluation here = evaluate(x);
  restart(0.1 / std::max(std::sqrt(dot(here.gradient, here.gradient)), 1e-300));
  std::vector<bool> fixed;
  for (int iteration = 0; iteration < 200; ++iteration) {
    // Variables that lie on a bound and want to leave the box stay where they are.
    std::vector<bool> now_fixed(n);
    double steepest = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
      now_fixed[i] = (x[i] <= 0.0 && here.gradient[i] > 0.0) || (x[i] >= 1.0 && here.gradient[i] < 0.0);
      if (!now_fixed[i]) steepest = std::max(steepest, std::abs(here.gradient[i]));
    }
    accepted(iteration, x, here.value, steepest);
    if (steepest <= 1e-8) return;
    if (iteration > 0 && now_fixed != fixed) restart(inverse[0][0] > 0.0 ? inverse[0][0] : 1.0);
    fixed = now_fixed;

    Vector direction(n, 0.0);
    for (std::size_t i = 0; i < n; ++i) {
      if (fixed[i]) continue;
      for (std::size_t j = 0; j < n; ++j) {
        if (!fixed[j]) direction[i] -= inverse[i][j] * here.gradient[j];
      }
    }
    // Halve the step until the value falls enough.
    Vector next;
    Evaluation there{};
    Vector step(n);
    double length = 1.0;
    for (;; length *= 0.5) {
      if (length < 1e-10) return;
      next = x;
      for (std::size_t i = 0; i < n; ++i) {
        next[i] = std::clamp(x[i] + length * direction[i], 0.0, 1.0);
        step[i] = next[i] - x[i];
      }
      there = evaluate(next);
      if (there.value <= here.value + 1e-4 * dot(here.gradient, step)) break;
    }
    // BFGS: H = (1 - r s y^T) H (1 - r y s^T) + r s s^T.
    Vector change(n);
    for (std::size_t i = 0; i < n; ++i) change[i] = there.gradient[i] - here.gradient[i];
    const double curvature = dot(step, change);
    if (curvature > 1e-12 * std::sqrt(dot(step, step) * dot(change, change))) {
      if (iteration == 0) restart(curvature / dot(change, change));
      Vector product(n, 0.0);
      for (std::size_t i = 0; i < n; ++i) product[i] = dot(inverse[i], change);
      const double scale = (1.0 + dot(change, product) / curvature) / curvature;
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t j = 0; j < n; ++j) {
          inverse[i][j] += scale * step[i] * step[j] - (product[i] * step[j] + step[i] * product[j]) / curvature;
        }
      }
    }
    x = next;
    here = there;
  }
}

void run(const std::string& address, const std::string& source, const std::string& setup_file) {
  const moldline::Client client(address);
  const bool fresh = source.find('/') != std::string::npos || std::filesystem::exists(source);
  moldline::CreateOptions create;
  create.setup_file = setup_file;
  moldline::Session session = fresh ? client.create_setup(source, create).session() : client.resume(source);
  const moldline::Setup& setup = session.setup();
  std::printf("session %s: %zu variables, %zu vertices\n", session.id().c_str(), setup->variables.size(),
              setup->vertex_count);

  const Box box(setup->variables);
  // The target mesh: halfway between the baseline and a third of the way through the box.
  Vector aim = box.scaled(setup.baseline());
  for (double& entry : aim) entry = 0.5 * entry + 0.5 / 3.0;
  const std::vector<moldline::Point> target = session.deform(box.design(aim)).vertices;

  const auto evaluate = [&](const Vector& x) -> Evaluation {
    const moldline::Deformation mesh = session.deform(box.design(x));
    double value = 0.0;
    std::vector<moldline::Point> weights(mesh.vertices.size());
    for (std::size_t vertex = 0; vertex < weights.size(); ++vertex) {
      for (std::size_t axis = 0; axis < 3; ++axis) {
        weights[vertex][axis] = mesh.vertices[vertex][axis] - target[vertex][axis];
        value += 0.5 * weights[vertex][axis] * weights[vertex][axis];
      }
    }
    moldline::Seeds seeds;
    seeds.vertices = weights;
    return {value, box.gradient(session.vjp(seeds, mesh).design)};
  };
  const auto accepted = [&](int iteration, const Vector& x, double value, double steepest) {
    moldline::SessionUpdate update;
    update.design = box.design(x);
    session.update(update);
    std::printf("%3d  f = %.6e m^2  |g| = %.2e\n", iteration, value, steepest);
  };
  Vector start = setup.baseline();
  if (const auto& stored = session.state().design) {
    if (const auto* design = std::get_if<moldline::DesignPoint::Vector>(&stored->design)) start = *design;
  }
  minimise(box.scaled(start), evaluate, accepted);
  session.close();
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3 || argc > 4) {
    std::fprintf(stderr, "usage: %s ADDRESS FOLDER [SETUP_FILE]  or  %s ADDRESS SESSION\n", argv[0], argv[0]);
    return 2;
  }
  // Line buffering, for files too.
  std::setvbuf(stdout, nullptr, _IOLBF, BUFSIZ);
  try {
    run(argv[1], argv[2], argc > 3 ? argv[3] : "");
    return 0;
  } catch (const moldline::Error& error) {
    std::fprintf(stderr, "%s: %s\n", error.code(), error.what());
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
  }
  return 1;
}
