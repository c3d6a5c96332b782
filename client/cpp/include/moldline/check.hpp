/// \file
/// Reports of derivative checks.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "moldline/model.hpp"

namespace moldline {

/// `W^T (J V)` against `(J^T W)^T V`.
struct DotProduct {
  /// Vectors in the block.
  std::size_t block = 0;
  /// Frobenius norm of the difference over that of the product.
  double error = 0.0;
};

/// Error of a derivative after one stage of the chain.
struct StageError {
  std::string stage;
  double error = 0.0;
};

/// A derivative against central differences of one step.
struct Difference {
  /// Step, relative to the range of the variable.
  double step = 0.0;
  /// Relative error; absent if one of the two designs has no mesh.
  std::optional<double> error;
};

/// Vertices on a crease that they cross: they have two one-sided derivatives instead of one derivative.
struct Kink {
  /// How many vertices.
  std::size_t vertices = 0;
  /// The vertex whose one-sided derivatives differ most.
  std::size_t worst_vertex = 0;
  /// Their difference, metres per unit of the variable.
  double jump = 0.0;
  /// Position of that vertex, metres, and its component.
  Point position{};
  std::string component;
  /// Relative error of the derivative: at these vertices against the nearer one-sided derivative, at all others against
  /// central differences.
  double error = 0.0;
};

/// The errors at one design.
struct CheckedDesign {
  /// All variables in order, each in its unit.
  std::vector<double> design;
  /// For blocks of one vector and of as many as there are variables.
  std::vector<DotProduct> dot_products;
  double dot_product_max = 0.0;
  double dual_max = 0.0;
  double central_difference_max = 0.0;
  /// Largest distance between a vertex and that of the evaluation in dual numbers, relative to the reference length.
  double values_max = 0.0;
};

/// The errors of the derivative with respect to one variable at one design.
struct CheckedVariable {
  /// Index into `Check::designs`.
  std::size_t design = 0;
  std::string variable;
  /// `|J v|` over all vertices, metres per unit of the variable.
  double size = 0.0;
  /// Error against dual numbers, and the vertex that contributes most to it.
  double dual = 0.0;
  std::size_t worst_vertex = 0;
  /// The same error after each stage of the chain, in order.
  std::vector<StageError> stages;
  /// The first stage whose error is too large, if any.
  std::optional<std::string> first_discrepancy;
  /// Errors against central differences, over steps.
  std::vector<Difference> differences;
  /// Largest error of the scalar outputs against central differences at the best step.
  double functions = 0.0;
  /// Searched for where central differences do not agree at any step.
  std::optional<Kink> kink;

  /// The central difference with the smallest error, if any has one.
  std::optional<Difference> best() const;
};

/// Errors of the derivatives of a set-up, all of them relative.
struct Check {
  /// The largest errors over all designs and variables.
  double dot_product_max = 0.0;
  double dual_max = 0.0;
  double central_difference_max = 0.0;
  /// Seed of the random designs and vectors.
  std::uint64_t seed = 0;
  std::vector<CheckedDesign> designs;
  /// One row for each requested variable, design after design.
  std::vector<CheckedVariable> rows;
  /// Definition of the errors, in words.
  std::string definition;
  /// All errors as a table, as `moldline check` prints them.
  std::string table;
  Timings timings;
};

}  // namespace moldline
