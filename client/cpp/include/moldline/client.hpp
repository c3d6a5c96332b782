/// \file
/// Client, set-ups and sessions of the mesh service.
#pragma once

#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "moldline/check.hpp"
#include "moldline/model.hpp"

namespace moldline {

/// TLS settings of a connection; all files are PEM.
struct Tls {
  /// Certificates of the trusted authorities; the system's if empty.
  std::filesystem::path authorities;
  /// The client's own certificate and private key, for servers that require one (mTLS).
  std::filesystem::path certificate;
  std::filesystem::path key;
  /// Server name that the certificate must carry; that of the address if empty.
  std::string server_name;
};

/// Retry policy: exponential backoff with jitter, within the timeout of the call.
///
/// Calls are repeated if the server cannot be reached, or answers that it is stopping (`Unavailable`) or is full and names a
/// delay (`ResourceExhausted`): it has not begun with them. All calls are safe to repeat: they change nothing, or carry a
/// request id by which the server recognises them.
///
/// A call whose connection broke after it was sent may be what the server died of. It is repeated once, after a longer pause,
/// unless `losses` says otherwise.
///
/// The pause before attempt k + 1 is the delay that the server names, plus a random share of `first_pause * 2^(k-1)`, so
/// that clients that failed together do not return together.
struct Retry {
  /// Number of attempts, including the first; 1 for no retry. By default as many as the timeout allows (without a timeout: as
  /// are made within 10 minutes).
  int attempts = std::numeric_limits<int>::max();
  /// Upper bound of the first random pause.
  Seconds first_pause{0.1};
  /// Upper bound of all random pauses.
  Seconds longest_pause{5.0};
  /// How often a call is repeated whose connection broke after it was sent.
  int losses = 1;
};

/// No timeout.
inline constexpr Seconds no_limit{std::numeric_limits<double>::infinity()};

/// Options of a connection.
struct Options {
  /// Bearer token, sent with every call; use it with `tls` unless the network is trusted.
  std::string token;
  /// TLS settings; plain text if absent.
  std::optional<Tls> tls;
  /// Timeout of a call over all its attempts. Set-ups and checks have none by default.
  Seconds timeout{600.0};
  Retry retry;
};

/// Cancels calls that run in other threads. Copies share one state.
class Cancellation {
 public:
  struct State;

  Cancellation();
  /// Ends running and later calls that are given this with `Cancelled`.
  void cancel() const;

  const std::shared_ptr<State>& state() const { return state_; }

 private:
  std::shared_ptr<State> state_;
};

/// Options of a call.
struct CallOptions {
  /// Timeout over all attempts; the connection's (none for set-ups and checks) if absent.
  std::optional<Seconds> timeout;
  std::optional<Cancellation> cancellation;
};

/// Options of `Client::create_setup`.
struct CreateOptions : CallOptions {
  /// The file that describes the set-up; the server's usual names if empty.
  std::string setup_file;
  /// Who else may use it. If absent, nobody if it is new, else unchanged.
  std::optional<Visibility> visibility;
  /// Names of tenants, with `Visibility::Tenants`.
  std::vector<std::string> shared_with;
  Tell progress;
  /// Name of this request, by which a retry is recognised; random if empty.
  std::string request_id;
};

/// Options of `Setup::session`.
struct SessionOptions : CallOptions {
  /// Descriptive label.
  std::string label;
  /// As in `CreateOptions`.
  std::string request_id;
};

/// Options of `Session::deform`.
struct DeformOptions : CallOptions {
  /// Whether to return the quality measures of every cell.
  bool cell_quality = false;
};

/// Options of `Session::jacobian`.
struct JacobianOptions : CallOptions {
  Tell progress;
};

/// Options of `Setup::check`.
struct CheckOptions : CallOptions {
  /// Number of designs: the baseline, then random ones far from it.
  std::uint32_t designs = 1;
  /// The only design to check at, in their place.
  std::optional<DesignPoint::Design> design;
  /// Names of variables or of groups of them whose derivatives are compared with dual numbers and central differences; all if
  /// empty.
  std::vector<std::string> variables;
  /// Seed of the random designs and vectors.
  std::uint64_t seed = 1;
  Tell progress;
};

/// Update of a session; absent fields stay unchanged.
struct SessionUpdate {
  std::optional<DesignPoint> design;
  std::optional<std::string> label;
};

class Setup;
class Session;
namespace internal {
class Connection;
}

/// A connection to a mesh service. Thread-safe; set-ups and sessions keep it open. All methods throw the classes of errors.hpp,
/// and `std::invalid_argument` for arguments that contradict each other.
class Client {
 public:
  /// A client of the server at an address such as `127.0.0.1:50051`; connects on first use.
  explicit Client(const std::string& address = "127.0.0.1:50051", const Options& options = {});

  /// Uploads and builds a set-up; identical content returns the existing set-up. `path` is its folder, or an archive of it
  /// (.tar, .tar.gz, .tgz, .zip). Throws `InvalidArgument` naming every wrong field.
  Setup create_setup(const std::filesystem::path& path, const CreateOptions& options = {}) const;
  /// The set-up with this id.
  Setup get_setup(const std::string& id, const CallOptions& options = {}) const;
  /// The set-ups that the caller may use (its own, shared and public ones), ordered by id.
  std::vector<SetupSummary> list_setups(const CallOptions& options = {}) const;
  /// The open session with this id, on whichever server of the store it was opened.
  Session resume(const std::string& session_id, const CallOptions& options = {}) const;
  /// The caller's open sessions without their designs, ordered by id.
  std::vector<SessionState> list_sessions(const CallOptions& options = {}) const;
  /// Load, caches and store of the server: the caller's tenant's share, or all of it for administrators.
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
  /// Control points of all components at the baseline, metres.
  ControlPoints control_points(const CallOptions& options = {}) const;
  /// Changes who else may use a set-up that the caller owns.
  void share(
      Visibility visibility, const std::vector<std::string>& shared_with = {}, const CallOptions& options = {});
  /// Gives up the caller's ownership. Open sessions continue, and other owners of the same content keep the set-up.
  void remove(const CallOptions& options = {}) const;
  /// Checks the derivatives: products against their transposes, dual numbers and central differences. A check of a large
  /// set-up takes minutes. Throws `InvalidArgument` naming the wrong field, `ResourceExhausted` while other checks are running.
  Check check(const CheckOptions& options = {}) const;
  /// Opens a session.
  Session session(const SessionOptions& options = {}) const;

 private:
  std::shared_ptr<internal::Connection> connection_;
  std::shared_ptr<const SetupFacts> facts_;
};

/// A session: work on one set-up, isolated from all other sessions.
///
/// The server keeps it with the design stored last, across restarts and until it is closed: an optimizer stores its accepted
/// designs (`update`), and continues from the last one after an interruption (`Client::resume`). Destroying this object does
/// not close the session; `close` or a `SessionCloser` does.
class Session {
 public:
  Session(Setup setup, std::shared_ptr<internal::Connection> connection, SessionState state);

  const Setup& setup() const { return setup_; }
  /// The stored state, as of the last opening, resumption, update or refresh here.
  const SessionState& state() const { return state_; }
  const std::string& id() const { return state_.id; }

  /// Stores the session's design, label or both, durably. Throws `Aborted` if the session has been updated elsewhere since:
  /// `refresh` reads the current state.
  void update(const SessionUpdate& update, const CallOptions& options = {});
  /// Reads `state` from the server again.
  void refresh(const CallOptions& options = {});

  /// The mesh at a design. A pure function: the same design gives the same bytes. Throws `InvalidArgument` naming the wrong
  /// entry, `FailedPrecondition` if the mesh cannot follow.
  Deformation deform(const DesignPoint& point = {}, const DeformOptions& options = {}) const;
  /// Jacobian-vector products `J v`, exactly: changes of the outputs along directions of the inputs. Throws `InvalidArgument`
  /// naming the wrong entry, `NotFound` for a bare id of a linearisation that the server no longer holds.
  Tangents jvp(const Directions& directions, const At& at = {}, const CallOptions& options = {}) const;
  /// Vector-Jacobian products `J^T w`, exactly: gradients of weighted sums of the outputs with respect to the inputs. Throws as
  /// `jvp`.
  Gradients vjp(const Seeds& seeds, const At& at = {}, const CallOptions& options = {}) const;
  /// The Jacobian, exactly: derivatives of all outputs with respect to all design variables, received in blocks. Throws as
  /// `jvp`.
  Jacobian jacobian(const At& at = {}, const JacobianOptions& options = {}) const;

  /// Closes the session for good; closing it again does nothing.
  void close(const CallOptions& options = {}) const;

 private:
  Setup setup_;
  std::shared_ptr<internal::Connection> connection_;
  SessionState state_;
};

/// Closes a session at the end of its scope. If that fails, the session stays open, and the failure is ignored.
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
