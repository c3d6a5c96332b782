/// \file
/// Client, set-ups and sessions.
#pragma once

#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "moldline/model.hpp"

namespace moldline {

/// How a connection is encrypted; all files are PEM.
struct Tls {
  /// Certificates of the authorities that are trusted; the system's if empty.
  std::filesystem::path authorities;
  /// The client's own certificate and private key, where the server asks for one (mTLS).
  std::filesystem::path certificate;
  std::filesystem::path key;
  /// The name that the server's certificate has to have; that of the address if empty.
  std::string server_name;
};

/// When a call is tried again: with growing pauses, as long as its timeout allows.
///
/// A server that cannot be reached or is about to stop (`Unavailable`) is always worth another try, one that is full
/// (`ResourceExhausted`) if it says when, and not before. All calls are safe to repeat: they change nothing, or carry a
/// request id by which the server recognises them.
///
/// The pause before attempt k + 1 is what the server asks for, plus a random share of `first_pause * 2^(k-1)`, so that
/// those who failed together do not come back together.
struct Retry {
  /// How often a call is tried in all; 1 for never again.
  int attempts = 10;
  Seconds first_pause{0.1};
  /// Beyond which pauses do not grow.
  Seconds longest_pause{5.0};
};

/// No limit of time.
inline constexpr Seconds no_limit{std::numeric_limits<double>::infinity()};

/// Of a connection.
struct Options {
  /// Says who you are; it goes with every call, so use it with `tls` unless the network is your own.
  std::string token;
  /// Plain text without.
  std::optional<Tls> tls;
  /// How long a call other than `create_setup` may take in all, with what is tried again.
  Seconds timeout{600.0};
  Retry retry;
};

/// Ends calls that wait in another thread. Copies are the same one.
class Cancellation {
 public:
  struct State;

  Cancellation();
  /// Calls that are given this end with `Cancelled`: those under way and all later ones.
  void cancel() const;

  const std::shared_ptr<State>& state() const { return state_; }

 private:
  std::shared_ptr<State> state_;
};

/// Of one call.
struct CallOptions {
  /// The connection's (or none, for `create_setup`) if absent.
  std::optional<Seconds> timeout;
  std::optional<Cancellation> cancellation;
};

/// Of `Client::create_setup`.
struct CreateOptions : CallOptions {
  /// The file that describes the set-up; the server's usual names if empty.
  std::string setup_file;
  /// Who else may use it. If absent, nobody if it is new, else as it was.
  std::optional<Visibility> visibility;
  /// Tenants, with `Visibility::Tenants`.
  std::vector<std::string> shared_with;
  Tell progress;
  /// Name of this request, so that a retry is recognised; made up if empty.
  std::string request_id;
};

/// Of `Setup::session`.
struct SessionOptions : CallOptions {
  /// For people.
  std::string label;
  /// As in `CreateOptions`.
  std::string request_id;
};

/// Of `Session::deform`.
struct DeformOptions : CallOptions {
  /// Whether the measures of every cell are wanted too.
  bool cell_quality = false;
};

/// Of `Session::jacobian`.
struct JacobianOptions : CallOptions {
  Tell progress;
};

/// What `Session::update` stores; what is absent stays as it was.
struct SessionUpdate {
  std::optional<DesignPoint> design;
  std::optional<std::string> label;
};

class Setup;
class Session;
namespace internal {
class Connection;
}

/// A connection to a server. Safe to use from several threads; set-ups and sessions keep it open. Everything throws the
/// classes of errors.hpp, and `std::invalid_argument` for arguments that contradict each other.
class Client {
 public:
  /// To an address such as `127.0.0.1:50051`; connects when it is first used.
  explicit Client(const std::string& address = "127.0.0.1:50051", const Options& options = {});

  /// Uploads and builds a set-up; the same content again gives the set-up that exists. `path` is its folder, or an archive
  /// of it (.tar, .tar.gz, .tgz, .zip). Throws `InvalidArgument` naming every field that is wrong.
  Setup create_setup(const std::filesystem::path& path, const CreateOptions& options = {}) const;
  /// The set-up of that id.
  Setup get_setup(const std::string& id, const CallOptions& options = {}) const;
  /// The set-ups that the caller may use: its own, those shared with it, and public ones; in the order of their ids.
  std::vector<SetupSummary> list_setups(const CallOptions& options = {}) const;
  /// The open session of that id, on whichever server it was opened.
  Session resume(const std::string& session_id, const CallOptions& options = {}) const;
  /// The caller's open sessions, without their designs; in the order of their ids.
  std::vector<SessionState> list_sessions(const CallOptions& options = {}) const;
  /// What the server does and holds: of the caller's tenant, or of all for administrators.
  Status status(const CallOptions& options = {}) const;

 private:
  std::shared_ptr<internal::Connection> connection_;
};

/// A set-up on the server: geometry, mesh, design variables and options. Immutable, and shared by all its users.
class Setup {
 public:
  Setup(std::shared_ptr<internal::Connection> connection, SetupFacts facts);

  const SetupFacts& facts() const { return *facts_; }
  const SetupFacts* operator->() const { return facts_.get(); }
  /// The design of the reference geometry.
  std::vector<double> baseline() const;
  /// Index of a design variable, or of a scalar output, by name. Throws `std::invalid_argument` if there is none.
  std::size_t variable(const std::string& name) const;
  std::size_t function(const std::string& name) const;

  /// The reference mesh.
  Mesh mesh(const CallOptions& options = {}) const;
  /// Those of the baseline, metres.
  ControlPoints control_points(const CallOptions& options = {}) const;
  /// Changes who else may use a set-up of the caller's own.
  void share(
      Visibility visibility, const std::vector<std::string>& shared_with = {}, const CallOptions& options = {});
  /// Gives up a set-up of the caller's own. Sessions open on it go on; whoever else uploaded the same content keeps it.
  void remove(const CallOptions& options = {}) const;
  /// Opens a session.
  Session session(const SessionOptions& options = {}) const;

 private:
  std::shared_ptr<internal::Connection> connection_;
  std::shared_ptr<const SetupFacts> facts_;
};

/// Work on one set-up, apart from all other sessions.
///
/// The server keeps it, with the design that was stored last, over restarts and until it is closed: an optimizer stores
/// where it has got to (`update`), and goes on from there (`Client::resume`) when it was interrupted itself. The end of this
/// object does not close it; `close` or a `SessionCloser` does.
class Session {
 public:
  Session(Setup setup, std::shared_ptr<internal::Connection> connection, SessionState state);

  const Setup& setup() const { return setup_; }
  /// The session as it was stored when it was last opened, resumed, updated or refreshed here.
  const SessionState& state() const { return state_; }
  const std::string& id() const { return state_.id; }

  /// Stores the session's design, label or both. When it returns, it is durable. Throws `Aborted` if the session has been
  /// updated elsewhere since: `refresh` reads what is there now.
  void update(const SessionUpdate& update, const CallOptions& options = {});
  /// Reads `state` from the server again.
  void refresh(const CallOptions& options = {});

  /// The mesh at a design. A pure function: the same design gives the same bytes. Throws `InvalidArgument` naming the entry
  /// that is wrong, `FailedPrecondition` if the mesh cannot follow.
  Deformation deform(const DesignPoint& point = {}, const DeformOptions& options = {}) const;
  /// How the outputs change along directions of the inputs: `J v`, exactly. Throws `InvalidArgument` naming the entry that
  /// is wrong, `NotFound` for a bare id of a linearisation that the server does not hold any more.
  Tangents jvp(const Directions& directions, const At& at = {}, const CallOptions& options = {}) const;
  /// Gradients of weighted sums of the outputs by the inputs: `J^T w`, exactly. Throws as `jvp`.
  Gradients vjp(const Seeds& seeds, const At& at = {}, const CallOptions& options = {}) const;
  /// Derivatives of all outputs by all design variables, exactly; received in blocks. Throws as `jvp`.
  Jacobian jacobian(const At& at = {}, const JacobianOptions& options = {}) const;

  /// Closes the session for good; closing it again does nothing.
  void close(const CallOptions& options = {}) const;

 private:
  Setup setup_;
  std::shared_ptr<internal::Connection> connection_;
  SessionState state_;
};

/// Closes a session at the end of its own scope. A failure of that is ignored: the session stays open.
class SessionCloser {
 public:
  explicit SessionCloser(Session& session) : session_(session) {}
  ~SessionCloser();
  SessionCloser(const SessionCloser&) = delete;
  SessionCloser& operator=(const SessionCloser&) = delete;

 private:
  Session& session_;
};

}  // namespace moldline
