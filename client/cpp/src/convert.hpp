// Conversions between messages of the protocol and the data model.
#pragma once

#include <initializer_list>
#include <string>
#include <vector>

#include "moldline/check.hpp"
#include "moldline/model.hpp"
#include "moldline/v1/mesh_service.pb.h"

namespace moldline::internal {

/// Writes float64 values; the product of `shape` is their number.
void write(View<double> values, std::initializer_list<std::size_t> shape, v1::Array& array);
void write(View<Point> points, std::initializer_list<std::size_t> shape, v1::Array& array);
/// The same for indices.
void write(View<std::uint32_t> indices, std::initializer_list<std::size_t> shape, v1::Array& array);

/// Values of an array; throws `InternalError` if it contradicts itself or has another type.
template <class T>
std::vector<T> read(const v1::Array& array);
/// The same, of `count` values written to `to`.
template <class T>
void read_to(const v1::Array& array, T* to, std::size_t count);

/// A point given as a list.
Point point(const google::protobuf::RepeatedField<double>& values);
Progress progress(const v1::Progress& message);

SetupFacts setup_facts(const v1::SetupDescription& message, bool built);
SetupAccess access(const v1::SetupAccess& message);
v1::Visibility visibility(Visibility visibility);
SetupSummary setup_summary(const v1::SetupSummary& message);
Mesh mesh(const v1::Mesh& message);
ControlPoints control_points(const google::protobuf::RepeatedPtrField<v1::ControlPoints>& messages);
SessionState session_state(const v1::Session& message);
Deformation deformation(const v1::DeformResponse& message, const DesignPoint& point);
Timings timings(const v1::Timings& message);
Status status(const v1::GetStatusResponse& message);
Check check(const v1::CheckReport& message);

/// Writes the field `design` or `named` of a CheckRequest, a DeformRequest or a DesignPoint; neither for the baseline.
template <class Message>
void write_design(const DesignPoint::Design& design, Message& message) {
  if (const auto* vector = std::get_if<DesignPoint::Vector>(&design)) {
    write(*vector, {vector->size()}, *message.mutable_design());
  } else if (const auto* named = std::get_if<DesignPoint::Named>(&design)) {
    message.mutable_named()->mutable_values()->insert(named->begin(), named->end());
  }
}

/// Writes the same, and the field `control_points`, of a DeformRequest or a DesignPoint.
template <class Message>
void write_point(const DesignPoint& point, Message& message) {
  write_design(point.design, message);
  for (const auto& [component, points] : point.control_points) {
    v1::ControlPoints& given = *message.add_control_points();
    given.set_component(component);
    write(points, {points.size(), 3}, *given.mutable_points());
  }
}

/// Writes the id, if any, and the design, from which the server recomputes a linearisation that it no longer holds.
void write_at(const At& at, v1::LinearisationPoint& message);

}  // namespace moldline::internal
