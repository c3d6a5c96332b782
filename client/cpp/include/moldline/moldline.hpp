/// \file
/// Client of a Moldline server, which deforms surface meshes with their geometry.
///
///     moldline::Client client("127.0.0.1:50051");
///     moldline::Setup setup = client.create_setup("examples/e175");
///     moldline::Session session = setup.session();
///     moldline::Deformation moved = session.deform({{"wing.translation", 5.0}});
///     moldline::Seeds seeds;
///     seeds.vertices = weights;  // std::vector<moldline::Point>: the derivative of an objective by the vertices
///     std::vector<double> gradient = session.vjp(seeds, moved).design;
#pragma once

#include "moldline/client.hpp"  // IWYU pragma: export
#include "moldline/errors.hpp"  // IWYU pragma: export
#include "moldline/model.hpp"   // IWYU pragma: export
#include "moldline/panel.hpp"   // IWYU pragma: export
