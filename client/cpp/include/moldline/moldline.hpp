/// \file
/// Client of Moldline: the mesh service, which deforms surface meshes with their geometry, and the panel service.
///
///     moldline::Client client("127.0.0.1:50051");
///     moldline::Setup setup = client.create_setup("examples/e175");
///     moldline::Session session = setup.session();
///     moldline::Deformation moved = session.deform({{"wing.translation", 5.0}});
///     moldline::Seeds seeds;
///     seeds.vertices = weights;  // std::vector<moldline::Point>: the gradient of an objective with respect to the vertices
///     std::vector<double> gradient = session.vjp(seeds, moved).design;
#pragma once

#include "moldline/check.hpp"   // IWYU pragma: export
#include "moldline/client.hpp"  // IWYU pragma: export
#include "moldline/errors.hpp"  // IWYU pragma: export
#include "moldline/model.hpp"   // IWYU pragma: export
#include "moldline/panel.hpp"   // IWYU pragma: export
