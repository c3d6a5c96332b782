// Between wire messages and the data of model.hpp.
#pragma once

#include <initializer_list>
#include <string>
#include <vector>

#include "moldline/model.hpp"
#include "moldline/v1/mesh_service.pb.h"

namespace moldline::internal {

/// Writes float64 values with the shape, whose product is their number.
void write(View<double> values, std::initializer_list<std::size_t> shape, v1::Array& array);
void write(View<Point> points, std::initializer_list<std::size_t> shape, v1::Array& array);
/// The same for indices.
void write(View<std::uint32_t> indices, std::initializer_list<std::size_t> shape, v1::Array& array);

/// Values of an array; throws `InternalError` if it contradicts itself or is not of their type.
template <class T>
std::vector<T> read(const v1::Array& array);
/// The same, to the place `to`, where `count` values are expected.
template <class T>
void read_to(const v1::Array& array, T* to, std::size_t count);

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

/// Writes the fields `design` or `named`, and `control_points`, of a DeformRequest or a DesignPoint.
template <class Message>
void write_point(const DesignPoint& point, Message& message) {
  if (const auto* vector = std::get_if<DesignPoint::Vector>(&point.design)) {
    write(*vector, {vector->size()}, *message.mutable_design());
  } else if (const auto* named = std::get_if<DesignPoint::Named>(&point.design)) {
    message.mutable_named()->mutable_values()->insert(named->begin(), named->end());
  }
  for (const auto& [component, points] : point.control_points) {
    v1::ControlPoints& given = *message.add_control_points();
    given.set_component(component);
    write(points, {points.size(), 3}, *given.mutable_points());
  }
}

/// The id where there is one, and the design, from which the server makes what it does not hold.
void write_at(const At& at, v1::LinearisationPoint& message);

}  // namespace moldline::internal
