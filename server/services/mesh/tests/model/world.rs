//! Servers on one store, beside a model of what they have to answer. The fuzz target `calls` uses it too.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use moldline_host::{Code, PoolLimits, Principal, Role, ServiceError, Tenant};
use moldline_mesh_service::{
    Design, FileEntry, Limits, Page, Service, Session, SessionUpdate, Store, Upload, UploadHeader,
    UploadSource, Values, Visibility,
};
use moldline_testing::ball;

pub const TENANTS: [&str; 3] = ["one", "two", "three"];
pub const TITLES: [&str; 3] = ["first", "second", "third"];
/// Quotas so small that they matter.
const SETUPS: usize = 2;
const SESSIONS: usize = 3;
/// Generations of a session that are kept.
const KEPT: u64 = 8;

/// A call; numbers are taken modulo what there is.
#[derive(Clone, Debug)]
pub enum Call {
    Upload {
        title: usize,
        visibility: Option<Shared>,
    },
    Share {
        title: usize,
        visibility: Shared,
    },
    Delete {
        title: usize,
    },
    Open {
        title: usize,
        request: usize,
    },
    Update {
        session: usize,
        behind: u64,
        x: i8,
        request: usize,
    },
    /// An update that was carried out, once more.
    Retry {
        session: usize,
        back: usize,
    },
    Close {
        session: usize,
    },
    Get {
        session: usize,
    },
    Deform {
        session: usize,
        x: i8,
    },
    List,
    Collect,
    Restart,
}

#[derive(Clone, Copy, Debug)]
pub enum Shared {
    Private,
    With(usize),
    Public,
}

/// A session of the model.
#[derive(Clone, Debug)]
struct Modelled {
    tenant: usize,
    title: usize,
    id: String,
    open: bool,
    /// Whether its tenant had uploaded the set-up when it was opened.
    own: bool,
    opened_by: usize,
    generation: u64,
    /// The design of each generation.
    designs: BTreeMap<u64, f64>,
    /// Request, its content, and the generation that it wrote, as far as they are remembered.
    updates: Vec<(usize, (u64, i8), u64)>,
    /// All of them.
    history: Vec<(usize, (u64, i8))>,
}

#[derive(Default)]
struct Model {
    /// By owner and title; `owned` is false once it has been deleted.
    access: BTreeMap<(usize, usize), (bool, Option<Shared>)>,
    sessions: Vec<Modelled>,
}

impl Model {
    fn owned(&self, tenant: usize, title: usize) -> bool {
        self.access.get(&(tenant, title)).is_some_and(|(owned, _)| *owned)
    }

    fn granted(&self, tenant: usize, title: usize) -> bool {
        (0..TENANTS.len()).filter(|&owner| self.owned(owner, title)).any(|owner| {
            match self.access[&(owner, title)].1 {
                Some(Shared::Public) => true,
                Some(Shared::With(other)) => other == tenant,
                _ => false,
            }
        })
    }

    fn visible(&self, tenant: usize, title: usize) -> bool {
        self.owned(tenant, title) || self.granted(tenant, title)
    }

    fn usable(&self, session: &Modelled) -> bool {
        session.own
            || self.access.contains_key(&(session.tenant, session.title))
            || self.granted(session.tenant, session.title)
    }

    fn open_of(&self, tenant: usize) -> BTreeSet<String> {
        let open = self.sessions.iter().filter(|session| session.tenant == tenant && session.open);
        open.map(|session| session.id.clone()).collect()
    }
}

pub struct World {
    store: Store,
    servers: Vec<Service>,
    model: Model,
    ids: Vec<String>,
}

fn service(store: &Store) -> Service {
    let limits = Limits { setups: SETUPS, sessions: SESSIONS, hide_known: false, ..Limits::default() };
    let pool = PoolLimits { threads: 1, running: 1, queued: 16, work: PoolLimits::WORK };
    Service::with_store(store.clone(), pool, limits).unwrap()
}

fn caller(tenant: usize) -> Principal {
    Principal { tenant: Tenant::new(TENANTS[tenant]).unwrap(), role: Role::User }
}

fn visibility(shared: Shared) -> Visibility {
    match shared {
        Shared::Private => Visibility::Private,
        Shared::With(other) => Visibility::Tenants([Tenant::new(TENANTS[other]).unwrap()].into()),
        Shared::Public => Visibility::Public,
    }
}

fn design(x: f64) -> Design {
    Design { values: Values::Vector(vec![x]), control_points: Vec::new() }
}

fn name(request: usize) -> String {
    if request == 0 { String::new() } else { format!("request {request}") }
}

/// The outcome of a call: what it gave, or its code.
fn code<T>(outcome: Result<T, ServiceError>) -> Result<T, Code> {
    outcome.map_err(|error| {
        assert!(error.code != Code::Internal, "{error}");
        error.code
    })
}

fn x_of(session: &Session) -> f64 {
    match &session.design.as_ref().unwrap().values {
        Values::Vector(values) => values[0],
        Values::Named(_) => f64::NAN,
    }
}

impl World {
    pub async fn new(store: Store) -> Self {
        let servers = vec![service(&store), service(&store)];
        Self { store, servers, model: Model::default(), ids: vec![String::new(); TITLES.len()] }
    }

    /// Mostly one of the first two sessions, so that rows grow; or any.
    fn session(&self, number: usize) -> Option<usize> {
        let count = self.model.sessions.len();
        let among = if number.is_multiple_of(4) { count } else { count.min(2) };
        (count > 0).then(|| number / 4 % among)
    }

    pub async fn call(&mut self, server: usize, tenant: usize, call: Call) {
        match call {
            Call::Upload { title, visibility } => self.upload(server, tenant, title, visibility).await,
            Call::Share { title, visibility: shared } => {
                let expected = if self.model.owned(tenant, title) { Ok(()) } else { Err(Code::NotFound) };
                let id = self.ids[title].clone();
                let outcome =
                    self.servers[server].share_setup(&caller(tenant), &id, visibility(shared)).await;
                assert_eq!(code(outcome).map(drop), expected);
                if expected.is_ok() {
                    self.model.access.insert((tenant, title), (true, Some(shared)));
                }
            }
            Call::Delete { title } => {
                let expected = if self.model.owned(tenant, title) { Ok(()) } else { Err(Code::NotFound) };
                let outcome = self.servers[server].delete_setup(&caller(tenant), &self.ids[title]).await;
                assert_eq!(code(outcome), expected);
                if let Some(access) = self.model.access.get_mut(&(tenant, title)) {
                    access.0 = false;
                }
            }
            Call::Open { title, request } => self.open(server, tenant, title, request).await,
            Call::Update { session, behind, x, request } => {
                if let Some(number) = self.session(session) {
                    let generation = self.model.sessions[number].generation;
                    let expected = generation.saturating_sub(behind).max(1);
                    self.update(server, number, expected, x, request).await;
                }
            }
            Call::Retry { session, back } => {
                let Some(number) = self.session(session) else { return };
                let history = &self.model.sessions[number].history;
                if let Some(&(request, (expected, x))) = history.iter().rev().nth(back) {
                    self.update(server, number, expected, x, request).await;
                }
            }
            Call::Close { session } => {
                let Some(number) = self.session(session) else { return };
                let session = &mut self.model.sessions[number];
                let by = caller(session.tenant);
                let outcome = self.servers[server].close_session(&by, &session.id).await;
                assert_eq!(code(outcome), if session.open { Ok(()) } else { Err(Code::NotFound) });
                session.open = false;
            }
            Call::Get { session } => {
                let Some(number) = self.session(session) else { return };
                self.check_session(server, number).await;
                // It is nobody else's.
                let session = &self.model.sessions[number];
                let other = caller((session.tenant + 1) % TENANTS.len());
                let outcome = self.servers[server].get_session(&other, &session.id).await;
                assert_eq!(code(outcome), Err(Code::NotFound));
            }
            Call::Deform { session, x } => {
                let Some(number) = self.session(session) else { return };
                self.deform(server, number, f64::from(x) / 4.0, false).await;
            }
            Call::List => self.check_lists(server, tenant).await,
            Call::Collect => {
                // At once: nothing is being written.
                self.store.collect(Duration::ZERO, false).await.unwrap();
                let Model { access, sessions } = &mut self.model;
                access.retain(|&(tenant, title), (owned, _)| {
                    *owned || sessions.iter().any(|s| s.open && s.tenant == tenant && s.title == title)
                });
            }
            Call::Restart => self.servers[server] = service(&self.store),
        }
    }

    async fn upload(&mut self, server: usize, tenant: usize, title: usize, shared: Option<Shared>) {
        let (file, limits) = (ball::setup_file(TITLES[title]), Limits::default());
        let entry = FileEntry { path: "setup.json".to_owned(), size: file.len() as u64 };
        let header = UploadHeader {
            request_id: String::new(),
            setup_file: None,
            visibility: shared.map(visibility),
            source: UploadSource::Files(vec![entry]),
        };
        let mut upload = Upload::begin(header, &limits).unwrap();
        upload.append(0, file.as_bytes(), &limits).unwrap();
        let service = &self.servers[server];
        let outcome = service.create_setup(&caller(tenant), upload.finish().unwrap(), |_| {}).await;
        let owned = self.model.owned(tenant, title);
        let held = (0..TITLES.len()).filter(|&title| self.model.owned(tenant, title)).count();
        if !owned && held >= SETUPS {
            assert_eq!(code(outcome).map(drop), Err(Code::ResourceExhausted));
            return;
        }
        let created = code(outcome).unwrap();
        assert_eq!(created.built, !owned);
        self.ids[title] = created.setup.id.to_string();
        let access = self.model.access.entry((tenant, title)).or_insert((true, None));
        let before = access.1.filter(|_| owned);
        *access = (true, shared.or(before));
    }

    async fn open(&mut self, server: usize, tenant: usize, title: usize, request: usize) {
        let outcome =
            self.servers[server].open_session(&caller(tenant), &self.ids[title], "", &name(request)).await;
        let outcome = code(outcome);
        if !self.model.visible(tenant, title) {
            assert_eq!(outcome, Err(Code::NotFound));
            return;
        }
        let same =
            |session: &&Modelled| session.tenant == tenant && session.opened_by == request && request > 0;
        if let Some(before) = self.model.sessions.iter().find(same) {
            match outcome {
                Ok(session) => {
                    assert!(before.open && before.title == title);
                    assert_eq!((&session.id, session.generation), (&before.id, before.generation));
                }
                Err(Code::AlreadyExists) => assert_ne!(before.title, title),
                Err(Code::NotFound) => assert!(!before.open && before.title == title),
                Err(other) => panic!("{other:?}"),
            }
            return;
        }
        if self.model.open_of(tenant).len() >= SESSIONS {
            assert_eq!(outcome, Err(Code::ResourceExhausted));
            return;
        }
        let session = outcome.unwrap();
        self.model.sessions.push(Modelled {
            tenant,
            title,
            id: session.id.clone(),
            open: true,
            own: self.model.owned(tenant, title),
            opened_by: request,
            generation: 1,
            designs: [(1, x_of(&session))].into(),
            updates: Vec::new(),
            history: Vec::new(),
        });
    }

    async fn update(
        &mut self,
        server: usize,
        number: usize,
        expected_generation: u64,
        x: i8,
        request: usize,
    ) {
        let session = self.model.sessions[number].clone();
        let update = SessionUpdate {
            expected_generation,
            design: Some(design(f64::from(x) / 4.0)),
            label: None,
            request_id: name(request),
        };
        let by = caller(session.tenant);
        let outcome = self.servers[server].update_session(&by, &session.id, update).await;
        let outcome = code(outcome).map(|session| (session.generation, x_of(&session)));
        let content = (expected_generation, x);
        let before = session.updates.iter().find(|(by, ..)| *by == request && request > 0);
        let kept = |generation: u64| generation + KEPT > session.generation;
        let expected = if !session.open {
            Err(Code::NotFound)
        } else if !self.model.usable(&session) {
            Err(Code::PermissionDenied)
        } else if before.is_some_and(|(_, known, _)| *known != content) {
            Err(Code::AlreadyExists)
        } else if let Some((_, _, generation)) = before.filter(|(.., generation)| kept(*generation)) {
            Ok((*generation, session.designs[generation]))
        } else if expected_generation != session.generation {
            Err(Code::Aborted)
        } else {
            Ok((session.generation + 1, f64::from(x) / 4.0))
        };
        assert_eq!(outcome, expected, "{session:?}");
        let Ok((generation, value)) = expected else { return };
        let session = &mut self.model.sessions[number];
        if generation > session.generation {
            session.generation = generation;
            session.designs.insert(generation, value);
            session.history.push((request, content));
            if request > 0 {
                session.updates.retain(|(.., of)| of + KEPT > generation);
                session.updates.push((request, content, generation));
            }
        }
    }

    async fn check_session(&self, server: usize, number: usize) {
        let session = &self.model.sessions[number];
        let by = caller(session.tenant);
        let outcome = code(self.servers[server].get_session(&by, &session.id).await);
        match session.open {
            false => assert_eq!(outcome, Err(Code::NotFound)),
            true => {
                let found = outcome.unwrap();
                assert_eq!(found.generation, session.generation);
                assert_eq!(x_of(&found), session.designs[&session.generation]);
                assert_eq!(found.setup_id, self.ids[session.title]);
            }
        }
    }

    /// `strict`: the server has not seen the session before. Otherwise it may take up to a second to see what changed.
    async fn deform(&self, server: usize, number: usize, x: f64, strict: bool) {
        let session = &self.model.sessions[number];
        let by = caller(session.tenant);
        let outcome = code(self.servers[server].deform(&by, &session.id, design(x)).await);
        let expected = match (session.open, self.model.usable(session)) {
            (false, _) => Some(Code::NotFound),
            (true, false) => Some(Code::PermissionDenied),
            (true, true) => None,
        };
        match (outcome, expected) {
            (Ok(deformed), expected) => {
                assert!(expected.is_none() || !strict, "{expected:?}");
                for [px, py, pz] in &deformed.deformation().vertices {
                    assert!((((px - x).powi(2) + py * py + pz * pz).sqrt() - 1.0).abs() < 1e-12);
                }
            }
            (Err(found), expected) => assert_eq!(Some(found), expected),
        }
    }

    async fn check_lists(&self, server: usize, tenant: usize) {
        let (service, by) = (&self.servers[server], caller(tenant));
        let sessions = service.list_sessions(&by, &Page::default()).await.unwrap().entries;
        let sessions: BTreeSet<String> = sessions.into_iter().map(|session| session.id).collect();
        assert_eq!(sessions, self.model.open_of(tenant));
        let setups = service.list_setups(&by, &Page::default()).await.unwrap().entries;
        let setups: BTreeSet<(String, bool)> =
            setups.into_iter().map(|setup| (setup.id, setup.access.owned)).collect();
        let expected = (0..TITLES.len()).filter(|&title| self.model.visible(tenant, title));
        let expected = expected.map(|title| (self.ids[title].clone(), self.model.owned(tenant, title)));
        assert_eq!(setups, expected.collect());
        let status = service.status(&by).await.unwrap();
        assert_eq!(status.sessions, sessions.len());
        assert_eq!(status.setups_stored, setups.iter().filter(|(_, owned)| *owned).count());
    }

    /// Everything, as a server sees it that starts now; and the store is sound.
    pub async fn check_all(&mut self) {
        self.servers.push(service(&self.store));
        let fresh = self.servers.len() - 1;
        for number in 0..self.model.sessions.len() {
            self.check_session(fresh, number).await;
            self.deform(fresh, number, 0.25, true).await;
        }
        for tenant in 0..TENANTS.len() {
            self.check_lists(fresh, tenant).await;
        }
        assert_eq!(self.store.verify().await.unwrap().faults, []);
        let survey = self.store.survey().await.unwrap();
        assert_eq!(survey.sessions, self.model.sessions.iter().filter(|session| session.open).count());
    }
}
