#include "moldline/check.hpp"

#include <cmath>

#include "convert.hpp"

namespace moldline {

std::optional<Difference> CheckedVariable::best() const {
  std::optional<Difference> best;
  for (const Difference& each : differences) {
    if (each.error && !std::isnan(*each.error) && (!best || *each.error < *best->error)) best = each;
  }
  return best;
}

namespace internal {

namespace {

CheckedDesign design(const v1::CheckedDesign& message) {
  CheckedDesign design;
  design.design = read<double>(message.design());
  for (const auto& dot : message.dot_products()) design.dot_products.push_back({dot.block(), dot.error()});
  design.dot_product_max = message.dot_product_max();
  design.dual_max = message.dual_max();
  design.central_difference_max = message.central_difference_max();
  design.values_max = message.values_max();
  return design;
}

CheckedVariable row(const v1::CheckedVariable& message) {
  CheckedVariable row;
  row.design = message.design();
  row.variable = message.variable();
  row.size = message.size();
  row.dual = message.dual();
  row.worst_vertex = message.worst_vertex();
  for (const auto& each : message.steps()) row.stages.push_back({each.step(), each.error()});
  if (message.has_first_discrepancy()) row.first_discrepancy = message.first_discrepancy();
  for (const auto& each : message.differences()) {
    row.differences.push_back({each.step(), each.has_error() ? std::optional<double>(each.error()) : std::nullopt});
  }
  row.functions = message.functions();
  if (message.has_kink()) {
    const v1::Kink& kink = message.kink();
    row.kink = Kink{
        kink.vertices(), kink.worst_vertex(), kink.jump(), point(kink.position()), kink.component(), kink.error()};
  }
  return row;
}

}  // namespace

Check check(const v1::CheckReport& message) {
  Check check;
  check.dot_product_max = message.dot_product_max();
  check.dual_max = message.dual_max();
  check.central_difference_max = message.central_difference_max();
  check.seed = message.seed();
  for (const auto& each : message.designs()) check.designs.push_back(design(each));
  for (const auto& each : message.rows()) check.rows.push_back(row(each));
  check.definition = message.definition();
  check.table = message.text();
  check.timings = timings(message.timings());
  return check;
}

}  // namespace internal
}  // namespace moldline
