//! Every RPC with every kind of credential, over real connections, gRPC and HTTP.

use std::time::Duration;

use moldline_host::{Principal, Role, Tenant};
use moldline_mesh_service::Limits;
use moldline_proto::{FILE_DESCRIPTOR_SET, v1, v1::mesh_service_client::MeshServiceClient};
use moldline_transport::{
    Access,
    tokens::{TokenFile, create},
};
use prost::Message;
use serde_json::json;
use tonic::{Request, Status, metadata::MetadataValue, transport::Channel};

use crate::harness::{Answer, Server, ball};

/// A credential, and the answers that it should get.
struct Caller {
    name: &'static str,
    token: Option<String>,
    /// Answers to calls that only read, and to those that change or compute something.
    sees: Expected,
    does: Expected,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Expected {
    Ok,
    /// For objects of another tenant; lists are empty.
    NotFound,
    Denied,
    Unauthenticated,
}

impl Expected {
    fn codes(self) -> (&'static str, u16) {
        match self {
            Self::Ok => ("OK", 200),
            Self::NotFound => ("NOT_FOUND", 404),
            Self::Denied => ("PERMISSION_DENIED", 403),
            Self::Unauthenticated => ("UNAUTHENTICATED", 401),
        }
    }
}

fn rpcs() -> Vec<String> {
    let files = prost_types::FileDescriptorSet::decode(FILE_DESCRIPTOR_SET).unwrap();
    let services = files.file.iter().flat_map(|file| &file.service);
    let methods =
        services.filter(|service| service.name() == "MeshService").flat_map(|service| &service.method);
    methods.map(|method| method.name().to_owned()).collect()
}

fn only_looks(rpc: &str) -> bool {
    rpc.starts_with("Get") || rpc.starts_with("List")
}

/// Calls that name no object of another tenant.
fn names_nothing(rpc: &str) -> bool {
    matches!(rpc, "CreateSetup" | "ListSetups" | "ListSessions" | "GetStatus")
}

fn point() -> Option<v1::LinearisationPoint> {
    let design_point = Some(v1::DesignPoint::default());
    Some(v1::LinearisationPoint { linearisation_id: String::new(), design_point })
}

fn ones(shape: &[u64]) -> Option<v1::Array> {
    let data: Vec<u8> = (0..shape.iter().product()).flat_map(|_| 1.0_f64.to_le_bytes()).collect();
    Some(v1::Array { dtype: v1::DataType::Float64.into(), shape: shape.to_vec(), data: data.into() })
}

fn functions(count: u64) -> Option<v1::Array> {
    ones(&[1, count])
}

/// The ball to upload: anna's while there is no set-up yet; then another one, so that no other tenant becomes an owner of hers.
fn another(setup: &str) -> &'static str {
    if setup.is_empty() { "ball" } else { "another" }
}

/// The call over gRPC.
async fn grpc(
    channel: &Channel,
    token: Option<&str>,
    rpc: &str,
    (setup, session): (&str, &str),
    count: u64,
) -> Result<(), Status> {
    let bearer = token.map(|token| format!("Bearer {token}").parse::<MetadataValue<_>>().unwrap());
    let mut client = MeshServiceClient::with_interceptor(channel.clone(), move |mut request: Request<()>| {
        if let Some(bearer) = &bearer {
            request.metadata_mut().insert("authorization", bearer.clone());
        }
        Ok(request)
    });
    let (setup_id, session_id) = (setup.to_owned(), session.to_owned());
    match rpc {
        "CreateSetup" => {
            let file = ball::setup_file(another(setup));
            let entry = v1::FileEntry { path: "setup.json".to_owned(), size: file.len() as u64 };
            let source = v1::setup_header::Source::Files(v1::FileList { files: vec![entry] });
            let header = v1::SetupHeader { source: Some(source), ..Default::default() };
            let chunk = v1::SetupChunk { file: 0, data: file.into_bytes().into() };
            let parts = [
                v1::create_setup_request::Part::Header(header),
                v1::create_setup_request::Part::Chunk(chunk),
            ];
            let parts = parts.map(|part| v1::CreateSetupRequest { part: Some(part) });
            let mut events = client.create_setup(tokio_stream::iter(parts)).await?.into_inner();
            while events.message().await?.is_some() {}
            Ok(())
        }
        "GetSetup" => {
            let request = v1::GetSetupRequest { setup_id, ..Default::default() };
            client.get_setup(request).await.map(drop)
        }
        "ListSetups" => client.list_setups(v1::ListSetupsRequest::default()).await.map(drop),
        "ShareSetup" => {
            let visibility = v1::Visibility::Private.into();
            let request = v1::ShareSetupRequest { setup_id, visibility, shared_with: Vec::new() };
            client.share_setup(request).await.map(drop)
        }
        "DeleteSetup" => client.delete_setup(v1::DeleteSetupRequest { setup_id }).await.map(drop),
        "OpenSession" => {
            let request = v1::OpenSessionRequest { setup_id, ..Default::default() };
            client.open_session(request).await.map(drop)
        }
        "GetSession" => client.get_session(v1::GetSessionRequest { session_id }).await.map(drop),
        "ListSessions" => client.list_sessions(v1::ListSessionsRequest::default()).await.map(drop),
        "UpdateSession" => {
            let got = v1::UpdateSessionRequest {
                session_id,
                expected_generation: 1,
                label: Some("x".to_owned()),
                ..Default::default()
            };
            client.update_session(got).await.map(drop)
        }
        "CloseSession" => client.close_session(v1::CloseSessionRequest { session_id }).await.map(drop),
        "Deform" => client.deform(v1::DeformRequest { session_id, ..Default::default() }).await.map(drop),
        "ApplyJacobianVector" => {
            let request = v1::ApplyJacobianVectorRequest {
                session_id,
                at: point(),
                design: ones(&[1, 1]),
                control_points: Vec::new(),
            };
            client.apply_jacobian_vector(request).await.map(drop)
        }
        "ApplyAdjoint" => {
            let request = v1::ApplyAdjointRequest {
                session_id,
                at: point(),
                functions: functions(count),
                include_design: true,
                ..Default::default()
            };
            client.apply_adjoint(request).await.map(drop)
        }
        "Jacobian" => {
            let mut blocks =
                client.jacobian(v1::JacobianRequest { session_id, at: point() }).await?.into_inner();
            while blocks.message().await?.is_some() {}
            Ok(())
        }
        "Check" => {
            let request = v1::CheckRequest { setup_id, ..Default::default() };
            let mut events = client.check(request).await?.into_inner();
            while events.message().await?.is_some() {}
            Ok(())
        }
        "GetStatus" => client.get_status(v1::GetStatusRequest {}).await.map(drop),
        other => panic!("{other} is missing in this table"),
    }
}

/// The call over HTTP.
async fn http(
    server: &Server,
    token: Option<&str>,
    rpc: &str,
    (setup, session): (&str, &str),
    count: u64,
) -> Answer {
    let at = json!({ "design_point": {} });
    let ball = ball::setup_file(another(setup));
    let (setup, session) = (format!("/v1/setups/{setup}"), format!("/v1/sessions/{session}"));
    let (method, path, body) = match rpc {
        "CreateSetup" => ("POST", "/v1/setups".to_owned(), ball),
        "GetSetup" => ("GET", setup, String::new()),
        "ListSetups" => ("GET", "/v1/setups".to_owned(), String::new()),
        "ShareSetup" => ("PUT", setup + "/access", json!({ "visibility": "private" }).to_string()),
        "DeleteSetup" => ("DELETE", setup, String::new()),
        "OpenSession" => ("POST", setup + "/sessions", String::new()),
        "GetSession" => ("GET", session, String::new()),
        "ListSessions" => ("GET", "/v1/sessions".to_owned(), String::new()),
        "UpdateSession" => ("PATCH", session, json!({ "expected_generation": 1, "label": "x" }).to_string()),
        "CloseSession" => ("DELETE", session, String::new()),
        "Deform" => ("POST", session + "/deform", "{}".to_owned()),
        "ApplyJacobianVector" => {
            ("POST", session + "/jvp", json!({ "at": at, "design": [[1.0]] }).to_string())
        }
        "ApplyAdjoint" => {
            let functions = vec![vec![1.0; count as usize]];
            ("POST", session + "/vjp", json!({ "at": at, "functions": functions }).to_string())
        }
        "Jacobian" => ("POST", session + "/jacobian", json!({ "at": at }).to_string()),
        "Check" => ("POST", setup + "/check", "{}".to_owned()),
        "GetStatus" => ("GET", "/v1/status".to_owned(), String::new()),
        other => panic!("{other} is missing in this table"),
    };
    let bearer = token.map(|token| format!("Bearer {token}"));
    let mut headers = vec![("content-type", "application/json")];
    headers.extend(bearer.as_deref().map(|bearer| ("authorization", bearer)));
    server.ask(method, &path, &headers, body.as_bytes()).await
}

#[tokio::test]
async fn every_rpc_asks_who_calls_and_whether_they_may() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tokens.json");
    let token = |tenant: &str, role, lifetime| {
        let principal = Principal { tenant: Tenant::new(tenant).unwrap(), role };
        create(&path, &principal, lifetime).unwrap()
    };
    use Expected::{Denied, NotFound, Ok as Fine, Unauthenticated};
    let user = token("anna", Role::User, None);
    let callers = [
        Caller { name: "nobody", token: None, sees: Unauthenticated, does: Unauthenticated },
        Caller {
            name: "made up",
            token: Some(format!("{user}0")),
            sees: Unauthenticated,
            does: Unauthenticated,
        },
        Caller {
            name: "expired",
            token: Some(token("anna", Role::Admin, Some(Duration::ZERO))),
            sees: Unauthenticated,
            does: Unauthenticated,
        },
        Caller { name: "reader", token: Some(token("anna", Role::Reader, None)), sees: Fine, does: Denied },
        Caller { name: "user", token: Some(user.clone()), sees: Fine, does: Fine },
        Caller { name: "admin", token: Some(token("anna", Role::Admin, None)), sees: Fine, does: Fine },
        Caller {
            name: "other",
            token: Some(token("bert", Role::User, None)),
            sees: NotFound,
            does: NotFound,
        },
        Caller {
            name: "other admin",
            token: Some(token("bert", Role::Admin, None)),
            sees: NotFound,
            does: NotFound,
        },
    ];
    let access = Access { tokens: Some(TokenFile::open(&path).unwrap()), certificates: false };
    let server = Server::with(access, Limits::default()).await;
    let channel = server.channel().await;
    let rpcs = rpcs();
    assert!(rpcs.len() >= 15);
    for rpc in &rpcs {
        for Caller { name, token, sees, does } in &callers {
            let expected = match if only_looks(rpc) { sees } else { does } {
                NotFound if names_nothing(rpc) => Fine,
                &expected => expected,
            };
            let (code, status) = expected.codes();
            for transport in ["grpc", "http"] {
                // A new set-up and session of anna's for each call.
                let created = http(&server, Some(&user), "CreateSetup", ("", ""), 0).await.json();
                let setup = created["setup_id"].as_str().unwrap().to_owned();
                let count = created["setup"]["functions"].as_array().unwrap().len() as u64;
                let opened = http(&server, Some(&user), "OpenSession", (&setup, ""), 0).await.json();
                let session = opened["session_id"].as_str().unwrap().to_owned();
                let what = format!("{rpc} over {transport} as {name}");
                if transport == "grpc" {
                    let outcome = grpc(&channel, token.as_deref(), rpc, (&setup, &session), count).await;
                    let told = outcome.as_ref().map_or_else(|status| word(status.code()), |()| "OK");
                    assert_eq!(told, code, "{what}: {outcome:?}");
                    if let (NotFound, Err(refused)) = (expected, outcome) {
                        let unknown =
                            grpc(&channel, token.as_deref(), rpc, ("0000", "0000"), count).await.unwrap_err();
                        let same = refused.message().replace(&setup, "0000").replace(&session, "0000");
                        assert_eq!(same, unknown.message(), "{what} tells that it exists");
                    }
                } else {
                    let answer = http(&server, token.as_deref(), rpc, (&setup, &session), count).await;
                    if expected == Fine {
                        assert!((200..300).contains(&answer.status), "{what}: {answer:?}");
                    } else {
                        let (got, word, _) = answer.problem();
                        assert_eq!((got, word.as_str()), (status, code), "{what}");
                        assert_eq!(answer.headers.contains_key("www-authenticate"), status == 401);
                    }
                    if expected == NotFound {
                        let unknown = http(&server, token.as_deref(), rpc, ("0000", "0000"), count).await;
                        let text = |answer: &Answer| {
                            String::from_utf8_lossy(&answer.body)
                                .replace(&setup, "0000")
                                .replace(&session, "0000")
                        };
                        assert_eq!(text(&answer), text(&unknown), "{what} tells that it exists");
                    }
                    let list = match rpc.as_str() {
                        "ListSetups" => Some("setups"),
                        "ListSessions" => Some("sessions"),
                        _ => None,
                    };
                    if let (Some(list), Fine, "other" | "other admin") = (list, expected, *name) {
                        // Lists of bert's have only objects that bert made in this table.
                        assert!(!String::from_utf8_lossy(&answer.body).contains(&session), "{what}");
                        let all = answer.json();
                        let owned = |entry: &serde_json::Value| {
                            list == "sessions" || entry["access"]["owned"] == true
                        };
                        assert!(all[list].as_array().unwrap().iter().all(owned), "{what}: {all}");
                    }
                }
            }
        }
    }
}

fn word(code: tonic::Code) -> &'static str {
    match code {
        tonic::Code::Unauthenticated => "UNAUTHENTICATED",
        tonic::Code::PermissionDenied => "PERMISSION_DENIED",
        tonic::Code::NotFound => "NOT_FOUND",
        _ => "another",
    }
}

#[tokio::test]
async fn metrics_are_for_administrators_and_probes_for_everybody() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tokens.json");
    let bearer = |role| {
        let principal = Principal { tenant: Tenant::new("anna").unwrap(), role };
        format!("Bearer {}", create(&path, &principal, None).unwrap())
    };
    let (user, admin) = (bearer(Role::User), bearer(Role::Admin));
    let access = Access { tokens: Some(TokenFile::open(&path).unwrap()), certificates: false };
    let server = Server::with(access, Limits::default()).await;
    for path in ["/healthz", "/readyz", "/openapi.json", "/docs", "/", "/page.js"] {
        assert_eq!(server.ask("GET", path, &[], b"").await.status, 200, "{path}");
    }
    assert_eq!(server.ask("GET", "/metrics", &[], b"").await.status, 401);
    assert_eq!(server.ask("GET", "/metrics", &[("authorization", &user)], b"").await.status, 403);
    assert_eq!(server.ask("GET", "/metrics", &[("authorization", &admin)], b"").await.status, 200);
    assert_eq!(server.ask("GET", "/metrics", &[("authorization", "Basic YTpi")], b"").await.status, 401);
    let mut health = tonic_health::pb::health_client::HealthClient::new(server.channel().await);
    health.check(tonic_health::pb::HealthCheckRequest::default()).await.unwrap();
}

#[tokio::test]
async fn names_that_callers_invent_become_no_labels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tokens.json");
    let principal = Principal { tenant: Tenant::new("anna").unwrap(), role: Role::Admin };
    let admin = format!("Bearer {}", create(&path, &principal, None).unwrap());
    let access = Access { tokens: Some(TokenFile::open(&path).unwrap()), certificates: false };
    let server = Server::with(access, Limits::default()).await;
    let metrics = async || {
        let answer = server.ask("GET", "/metrics", &[("authorization", &admin)], b"").await;
        String::from_utf8(answer.body).unwrap()
    };
    let call = async |number: usize, kind: &str, credential: &[(&str, &str)]| {
        let headers = [&[("content-type", kind)], credential].concat();
        for service in ["MeshService", "PanelService", "OtherService"] {
            let path = format!("/moldline.v1.{service}/Invented{number}");
            server.ask("POST", &path, &headers, b"").await;
        }
        server.ask("POST", &format!("/v1/invented{number}"), &headers, b"").await;
        server.ask("POST", &format!("/grpc.health.v1.Health/Invented{number}"), &headers, b"").await;
    };
    let credential = [("authorization", admin.as_str())];
    let round = async |number: usize| {
        for kind in
            ["application/grpc-web", "application/grpc-web-text", "application/grpc", "application/json"]
        {
            call(number, kind, &[]).await;
            call(number, kind, &credential).await;
        }
    };
    for number in 0..4 {
        round(number).await;
    }
    // One recorder has the metrics of all tests here, so that only names can be compared.
    let metrics = metrics().await;
    assert!(!metrics.to_lowercase().contains("invented"), "{metrics}");
    assert!(metrics.contains("rpc=\"unknown\""), "{metrics}");
}

/// A certificate authority that signs certificates.
struct Authority {
    issuer: rcgen::CertifiedIssuer<'static, rcgen::KeyPair>,
}

impl Authority {
    fn new() -> Self {
        let mut params = rcgen::CertificateParams::new(Vec::new()).unwrap();
        params.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
        params.key_usages = vec![rcgen::KeyUsagePurpose::KeyCertSign, rcgen::KeyUsagePurpose::CrlSign];
        let key = rcgen::KeyPair::generate().unwrap();
        Self { issuer: rcgen::CertifiedIssuer::self_signed(params, key).unwrap() }
    }

    /// Certificate and key, PEM.
    fn sign(&self, common_name: &str, uri: Option<&str>, hosts: &[&str]) -> (String, String) {
        self.sign_number(1, common_name, uri, hosts)
    }

    fn sign_number(
        &self,
        number: u64,
        common_name: &str,
        uri: Option<&str>,
        hosts: &[&str],
    ) -> (String, String) {
        let hosts: Vec<String> = hosts.iter().map(|host| (*host).to_owned()).collect();
        let mut params = rcgen::CertificateParams::new(hosts).unwrap();
        params.distinguished_name.push(rcgen::DnType::CommonName, common_name);
        params.subject_alt_names.extend(uri.map(|uri| rcgen::SanType::URI(uri.try_into().unwrap())));
        params.serial_number = Some(number.into());
        let key = rcgen::KeyPair::generate().unwrap();
        (params.signed_by(&key, &self.issuer).unwrap().pem(), key.serialize_pem())
    }

    /// The list with the certificate of that number, PEM.
    fn revoke(&self, number: u64) -> String {
        let revoked = rcgen::RevokedCertParams {
            serial_number: number.into(),
            revocation_time: rcgen::date_time_ymd(2024, 1, 1),
            reason_code: None,
            invalidity_date: None,
        };
        let list = rcgen::CertificateRevocationListParams {
            this_update: rcgen::date_time_ymd(2024, 1, 1),
            next_update: rcgen::date_time_ymd(2999, 1, 1),
            crl_number: 1_u64.into(),
            issuing_distribution_point: None,
            revoked_certs: vec![revoked],
            key_identifier_method: rcgen::KeyIdMethod::Sha256,
        };
        list.signed_by(&self.issuer).unwrap().pem().unwrap()
    }
}

/// The path of a file with a text.
fn written(folder: &std::path::Path, name: &str, text: &str) -> std::path::PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

#[tokio::test]
async fn a_revoked_certificate_is_refused_and_others_are_not() {
    use tonic::transport::{Certificate, ClientTlsConfig, Endpoint, Identity};
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| written(folder.path(), name, text);
    let authority = Authority::new();
    let (certificate, key) = authority.sign("server", None, &["localhost"]);
    let (certificate, key) = (file("server.pem", &certificate), file("server.key", &key));
    let ca = file("ca.pem", &authority.issuer.pem());
    let tls = |revoked: &std::path::Path| {
        moldline_transport::acceptor(moldline_transport::TlsFiles {
            certificate: &certificate,
            key: &key,
            client_authority: Some(&ca),
            client_optional: false,
            revoked: Some(revoked),
        })
    };
    let access = Access { tokens: None, certificates: true };
    let acceptor = tls(&file("revoked.pem", &authority.revoke(7))).unwrap();
    let server = Server::over(access, Limits::default(), Some(acceptor)).await;
    for (number, expected) in [(6, true), (7, false), (8, true)] {
        let (certificate, key) = authority.sign_number(number, "anna", None, &[]);
        let client = ClientTlsConfig::new()
            .domain_name("localhost")
            .ca_certificate(Certificate::from_pem(authority.issuer.pem()))
            .identity(Identity::from_pem(certificate, key));
        let endpoint = Endpoint::from_shared(format!("https://{}", server.address)).unwrap();
        let channel = endpoint.tls_config(client).unwrap().connect_lazy();
        let listed = MeshServiceClient::new(channel).list_setups(v1::ListSetupsRequest::default()).await;
        assert_eq!(listed.is_ok(), expected, "{number}: {listed:?}");
    }
    // A file without a list would revoke nothing without a word.
    assert!(tls(&ca).err().unwrap().to_string().contains("there is no list"));
}

#[tokio::test]
async fn certificates_name_their_tenants_over_tls() {
    use tonic::transport::{Certificate, ClientTlsConfig, Endpoint, Identity};
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| written(folder.path(), name, text);
    let authority = Authority::new();
    let (certificate, key) = authority.sign("server", None, &["localhost"]);
    let ca = file("ca.pem", &authority.issuer.pem());
    let tls = moldline_transport::acceptor(moldline_transport::TlsFiles {
        certificate: &file("server.pem", &certificate),
        key: &file("server.key", &key),
        client_authority: Some(&ca),
        client_optional: false,
        revoked: None,
    });
    let access = Access { tokens: None, certificates: true };
    let server = Server::over(access, Limits::default(), Some(tls.unwrap())).await;
    let ask = async |identity: Option<(String, String)>| {
        let mut tls = ClientTlsConfig::new()
            .domain_name("localhost")
            .ca_certificate(Certificate::from_pem(authority.issuer.pem()));
        if let Some((certificate, key)) = identity {
            tls = tls.identity(Identity::from_pem(certificate, key));
        }
        let endpoint = Endpoint::from_shared(format!("https://{}", server.address)).unwrap();
        let channel = endpoint.tls_config(tls).unwrap().connect_lazy();
        let mut client = MeshServiceClient::new(channel);
        let file = ball::setup_file("ball");
        let source = v1::setup_header::Source::Files(v1::FileList {
            files: vec![v1::FileEntry { path: "setup.json".to_owned(), size: file.len() as u64 }],
        });
        let header = v1::SetupHeader { source: Some(source), ..Default::default() };
        let chunk = v1::SetupChunk { file: 0, data: file.into_bytes().into() };
        let parts =
            [v1::create_setup_request::Part::Header(header), v1::create_setup_request::Part::Chunk(chunk)];
        let parts = parts.map(|part| v1::CreateSetupRequest { part: Some(part) });
        let created = async {
            let mut events = client.create_setup(tokio_stream::iter(parts)).await?.into_inner();
            while events.message().await?.is_some() {}
            Ok::<_, Status>(())
        };
        let created = created.await.map_err(|status| status.code());
        let listed = client.list_setups(v1::ListSetupsRequest::default()).await;
        (created, listed.map(|listed| listed.into_inner().setups.len()).map_err(|status| status.code()))
    };
    let (anna, bert) =
        (authority.sign("anna", None, &[]), authority.sign("x", Some("moldline://bert/reader"), &[]));
    assert_eq!(ask(Some(anna)).await, (Ok(()), Ok(1)));
    // Another tenant may only read, and does not see the set-up.
    assert_eq!(ask(Some(bert)).await, (Err(tonic::Code::PermissionDenied), Ok(0)));
    let nameless = authority.sign("Not A Tenant", None, &[]);
    assert_eq!(ask(Some(nameless)).await.1, Err(tonic::Code::Unauthenticated));
    // Without a certificate, or with one of an unknown authority, the handshake fails.
    let stranger = Authority::new().sign("anna", None, &[]);
    for identity in [None, Some(stranger)] {
        let refused = ask(identity).await;
        assert!(
            refused.0.is_err() && refused.1.is_err() && refused.1 != Err(tonic::Code::Unauthenticated),
            "{refused:?}"
        );
    }
}
