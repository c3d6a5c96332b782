#include "moldline/client.hpp"

#include <algorithm>
#include <exception>
#include <functional>
#include <stdexcept>
#include <thread>

#include "blocks.hpp"
#include "connection.hpp"
#include "convert.hpp"
#include "moldline/errors.hpp"
#include "upload.hpp"

namespace moldline {

using internal::add;
using internal::append;
using internal::Budget;
using internal::Connection;
using internal::Piece;
using internal::read_all;
using internal::write_vectors;
using Stub = v1::MeshService::Stub;

namespace {

std::string request_id(const std::string& given) { return given.empty() ? internal::new_request_id() : given; }

/// Calls, and ignores that there is nothing to remove: an earlier attempt whose answer was lost may have removed it.
template <class Call>
void gone(const Call& call) {
  try {
    call();
  } catch (const NotFound&) {
  }
}

/// Calls with each piece of a block that fits one request.
template <class Call>
void pieces(const SetupFacts& setup, std::size_t count, const Call& call) {
  std::size_t points = setup.vertex_count;
  for (const std::size_t more : setup.control_point_counts) points += more;
  internal::pieces(points, count, call);
}

template <class Named>
std::size_t index_of(const std::vector<Named>& all, const std::string& name, const char* kind) {
  const auto found = std::find_if(all.begin(), all.end(), [&](const Named& each) { return each.name == name; });
  if (found == all.end()) throw std::invalid_argument(std::string("there is no ") + kind + " " + name);
  return static_cast<std::size_t>(found - all.begin());
}

Setup get_setup_of(const std::shared_ptr<Connection>& connection, const std::string& id, const Budget& budget) {
  v1::GetSetupRequest request;
  request.set_setup_id(id);
  const auto response = connection->call(&Stub::GetSetup, request, budget);
  return {connection, internal::setup_facts(response.setup(), false)};
}

SessionState get_session_of(const Connection& connection, const std::string& id, const Budget& budget) {
  v1::GetSessionRequest request;
  request.set_session_id(id);
  return internal::session_state(connection.call(&Stub::GetSession, request, budget).session());
}

}  // namespace

Client::Client(const std::string& address, const Options& options)
    : connection_(std::make_shared<Connection>(address, options)) {}

Setup Client::create_setup(const std::filesystem::path& path, const CreateOptions& options) const {
  v1::SetupHeader header;
  header.set_request_id(request_id(options.request_id));
  header.set_setup_file(options.setup_file);
  if (options.visibility) header.set_visibility(internal::visibility(*options.visibility));
  for (const std::string& tenant : options.shared_with) header.add_shared_with(tenant);
  const auto files = internal::files(path, header);

  internal::Outcome outcome(
      options.progress, &v1::CreateSetupResponse::has_created, &v1::CreateSetupResponse::mutable_created);
  std::exception_ptr thrown;
  connection_->attempts(connection_->budget(options, no_limit), [&](grpc::ClientContext& context) {
    auto stream = connection_->stub().CreateSetup(&context);
    // Reads progress while files are sent, so that neither side blocks the other.
    std::exception_ptr unreadable;
    std::thread writer([&] {
      try {
        internal::upload(header, files, [&](const v1::CreateSetupRequest& request) { return stream->Write(request); });
        stream->WritesDone();
      } catch (...) {
        unreadable = std::current_exception();
        context.TryCancel();
      }
    });
    v1::CreateSetupResponse event;
    read_all(*stream, context, event, std::ref(outcome), thrown);
    writer.join();
    const grpc::Status status = stream->Finish();
    if (unreadable) std::rethrow_exception(unreadable);
    if (thrown) std::rethrow_exception(thrown);
    return status;
  });
  const v1::CreatedSetup& created = outcome.get();
  return {connection_, internal::setup_facts(created.setup(), created.built())};
}

Setup Client::get_setup(const std::string& id, const CallOptions& options) const {
  return get_setup_of(connection_, id, connection_->budget(options));
}

std::vector<SetupSummary> Client::list_setups(const CallOptions& options) const {
  const Budget budget = connection_->budget(options);
  std::vector<SetupSummary> setups;
  v1::ListSetupsRequest request;
  do {
    const auto page = connection_->call(&Stub::ListSetups, request, budget);
    for (const auto& each : page.setups()) setups.push_back(internal::setup_summary(each));
    request.set_page_token(page.next_page_token());
  } while (!request.page_token().empty());
  return setups;
}

Session Client::resume(const std::string& session_id, const CallOptions& options) const {
  const Budget budget = connection_->budget(options);
  SessionState state = get_session_of(*connection_, session_id, budget);
  Setup setup = get_setup_of(connection_, state.setup_id, budget);
  return {std::move(setup), connection_, std::move(state)};
}

std::vector<SessionState> Client::list_sessions(const CallOptions& options) const {
  const Budget budget = connection_->budget(options);
  std::vector<SessionState> sessions;
  v1::ListSessionsRequest request;
  do {
    const auto page = connection_->call(&Stub::ListSessions, request, budget);
    for (const auto& each : page.sessions()) sessions.push_back(internal::session_state(each));
    request.set_page_token(page.next_page_token());
  } while (!request.page_token().empty());
  return sessions;
}

Status Client::status(const CallOptions& options) const {
  return internal::status(connection_->call(&Stub::GetStatus, {}, connection_->budget(options)));
}

Setup::Setup(std::shared_ptr<Connection> connection, SetupFacts facts)
    : connection_(std::move(connection)), facts_(std::make_shared<const SetupFacts>(std::move(facts))) {}

std::vector<double> Setup::baseline() const {
  std::vector<double> design;
  for (const Variable& variable : facts_->variables) design.push_back(variable.baseline);
  return design;
}

std::size_t Setup::variable(const std::string& name) const { return index_of(facts_->variables, name, "variable"); }

std::size_t Setup::function(const std::string& name) const { return index_of(facts_->functions, name, "function"); }

Mesh Setup::mesh(const CallOptions& options) const {
  v1::GetSetupRequest request;
  request.set_setup_id(facts_->id);
  request.set_include_mesh(true);
  return internal::mesh(connection_->call(&Stub::GetSetup, request, connection_->budget(options)).mesh());
}

ControlPoints Setup::control_points(const CallOptions& options) const {
  v1::GetSetupRequest request;
  request.set_setup_id(facts_->id);
  request.set_include_control_points(true);
  const auto response = connection_->call(&Stub::GetSetup, request, connection_->budget(options));
  return internal::control_points(response.control_points());
}

void Setup::share(
    Visibility visibility, const std::vector<std::string>& shared_with, const CallOptions& options) {
  v1::ShareSetupRequest request;
  request.set_setup_id(facts_->id);
  request.set_visibility(internal::visibility(visibility));
  for (const std::string& tenant : shared_with) request.add_shared_with(tenant);
  const auto response = connection_->call(&Stub::ShareSetup, request, connection_->budget(options));
  SetupFacts facts = *facts_;
  facts.access = internal::access(response.access());
  facts_ = std::make_shared<const SetupFacts>(std::move(facts));
}

void Setup::remove(const CallOptions& options) const {
  v1::DeleteSetupRequest request;
  request.set_setup_id(facts_->id);
  gone([&] { connection_->call(&Stub::DeleteSetup, request, connection_->budget(options)); });
}

Check Setup::check(const CheckOptions& options) const {
  v1::CheckRequest request;
  request.set_setup_id(facts_->id);
  if (options.design) {
    internal::write_design(*options.design, request);
  } else {
    request.set_designs(options.designs);
  }
  request.mutable_variables()->Assign(options.variables.begin(), options.variables.end());
  request.set_seed(options.seed);
  internal::Outcome outcome(options.progress, &v1::CheckResponse::has_report, &v1::CheckResponse::mutable_report);
  connection_->stream(&Stub::Check, request, connection_->budget(options, no_limit), [] {}, std::ref(outcome));
  return internal::check(outcome.get());
}

Session Setup::session(const SessionOptions& options) const {
  v1::OpenSessionRequest request;
  request.set_setup_id(facts_->id);
  request.set_label(options.label);
  request.set_request_id(request_id(options.request_id));
  const auto response = connection_->call(&Stub::OpenSession, request, connection_->budget(options));
  return {*this, connection_, internal::session_state(response.session())};
}

Session::Session(Setup setup, std::shared_ptr<Connection> connection, SessionState state)
    : setup_(std::move(setup)), connection_(std::move(connection)), state_(std::move(state)) {}

void Session::update(const SessionUpdate& update, const CallOptions& options) {
  v1::UpdateSessionRequest request;
  request.set_session_id(state_.id);
  request.set_expected_generation(state_.generation);
  request.set_request_id(internal::new_request_id());
  if (update.design) internal::write_point(*update.design, *request.mutable_design());
  if (update.label) request.set_label(*update.label);
  const auto response = connection_->call(&Stub::UpdateSession, request, connection_->budget(options));
  state_ = internal::session_state(response.session());
}

void Session::refresh(const CallOptions& options) {
  state_ = get_session_of(*connection_, state_.id, connection_->budget(options));
}

Deformation Session::deform(const DesignPoint& point, const DeformOptions& options) const {
  v1::DeformRequest request;
  request.set_session_id(state_.id);
  request.set_include_cell_quality(options.cell_quality);
  internal::write_point(point, request);
  return internal::deformation(connection_->call(&Stub::Deform, request, connection_->budget(options)), point);
}

Tangents Session::jvp(const Directions& directions, const At& at, const CallOptions& options) const {
  const Budget budget = connection_->budget(options);
  Tangents tangents;
  tangents.count = directions.count;
  pieces(setup_.facts(), directions.count, [&](const Piece& piece) {
    v1::ApplyJacobianVectorRequest request;
    request.set_session_id(state_.id);
    internal::write_at(at, *request.mutable_at());
    write_vectors(directions.design, piece, "design", request, &v1::ApplyJacobianVectorRequest::mutable_design);
    for (const auto& [component, vectors] : directions.control_points) {
      v1::ControlPointVectors& given = *request.add_control_points();
      given.set_component(component);
      write_vectors(vectors, piece, "control_points", given, &v1::ControlPointVectors::mutable_vectors);
    }
    const auto response = connection_->call(&Stub::ApplyJacobianVector, request, budget);
    append(tangents.vertices, internal::read<Point>(response.vertices()));
    append(tangents.functions, internal::read<double>(response.functions()));
    add(tangents.timings, response.timings());
  });
  return tangents;
}

Gradients Session::vjp(const Seeds& seeds, const At& at, const CallOptions& options) const {
  const Budget budget = connection_->budget(options);
  Gradients gradients;
  gradients.count = seeds.count;
  pieces(setup_.facts(), seeds.count, [&](const Piece& piece) {
    v1::ApplyAdjointRequest request;
    request.set_session_id(state_.id);
    internal::write_at(at, *request.mutable_at());
    write_vectors(seeds.vertices, piece, "vertices", request, &v1::ApplyAdjointRequest::mutable_vertices);
    write_vectors(seeds.functions, piece, "functions", request, &v1::ApplyAdjointRequest::mutable_functions);
    request.set_include_design(seeds.by_design);
    for (const std::string& component : seeds.by_control_points) request.add_control_points_of(component);
    const auto response = connection_->call(&Stub::ApplyAdjoint, request, budget);
    if (seeds.by_design) append(gradients.design, internal::read<double>(response.design()));
    for (const auto& each : response.control_points()) {
      append(gradients.control_points[each.component()], internal::read<Point>(each.vectors()));
    }
    add(gradients.timings, response.timings());
  });
  return gradients;
}

Jacobian Session::jacobian(const At& at, const JacobianOptions& options) const {
  const std::size_t columns = setup_->variables.size();
  const std::size_t vertices = setup_->vertex_count;
  const std::size_t functions = setup_->functions.size();
  v1::JacobianRequest request;
  request.set_session_id(state_.id);
  internal::write_at(at, *request.mutable_at());
  Jacobian jacobian;
  jacobian.vertices.resize(columns * vertices);
  jacobian.functions.resize(columns * functions);
  std::size_t received = 0;
  const auto take = [&](const v1::JacobianResponse& part) {
    const std::size_t count = part.vertices().shape().empty() ? 0 : part.vertices().shape(0);
    if (part.first() != received || count > columns - received) {
      throw InternalError("the server sent columns that do not follow each other", {}, std::nullopt);
    }
    internal::read_to(part.vertices(), jacobian.vertices.data() + received * vertices, count * vertices);
    internal::read_to(part.functions(), jacobian.functions.data() + received * functions, count * functions);
    add(jacobian.timings, part.timings());
    received += count;
    if (options.progress) {
      const std::string message = "column " + std::to_string(received) + " of " + std::to_string(columns);
      options.progress({"jacobian", static_cast<double>(received) / static_cast<double>(columns), message});
    }
  };
  const auto begin = [&] {
    received = 0;
    jacobian.timings = {};
  };
  connection_->stream(&Stub::Jacobian, request, connection_->budget(options), begin, take);
  if (received != columns) throw InternalError("the server ended before the last column", {}, std::nullopt);
  return jacobian;
}

void Session::close(const CallOptions& options) const {
  v1::CloseSessionRequest request;
  request.set_session_id(state_.id);
  gone([&] { connection_->call(&Stub::CloseSession, request, connection_->budget(options)); });
}

SessionCloser::~SessionCloser() {
  try {
    session_.close();
  } catch (const std::exception&) {
    // A destructor must not throw; the session stays open.
  }
}

}  // namespace moldline
