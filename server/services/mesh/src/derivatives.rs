//! Methods of deformations and their derivatives: deform, products, Jacobian.

use std::sync::Arc;

use moldline_deform::Tangent;
use moldline_host::{
    Cache, Code, Completed, ComputePool, Joined, Principal, Product, Role, ServiceError, Task, Tenant,
    Ticket, Timing, shorten,
};

use crate::{
    linearisation::{Design, Directions, Gradients, Linearised, Resolved, Seeds, Wanted},
    progress::reporter,
    service::Service,
    setup_cache::StoredSetup,
};

/// The point of a derivative: the id of a linearisation, a design, or preferably both.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct At {
    /// Id of a linearisation, from a deformation.
    pub id: Option<String>,
    /// A design, linearised again if the linearisation is not in memory; that of the id, if there is one.
    pub design: Option<Design>,
}

impl At {
    /// The point of a linearisation in memory.
    pub fn id(id: impl Into<String>) -> Self {
        Self { id: Some(id.into()), design: None }
    }

    /// The point of a design.
    pub fn design(design: Design) -> Self {
        Self { id: None, design: Some(design) }
    }

    /// # Errors
    /// `InvalidArgument` if it has neither id nor design.
    fn check(&self) -> Result<(), ServiceError> {
        match self {
            Self { id: None, design: None } => Err(ServiceError::invalid(
                "at",
                "is missing: name a linearisation, send a design point, or both",
            )),
            _ => Ok(()),
        }
    }
}

impl Service {
    /// Deforms the session's mesh, and keeps the linearisation. The same set-up and design always give the same bits.
    ///
    /// # Errors
    /// `NotFound` for the session, `InvalidArgument` naming the entry of the design, `FailedPrecondition` if the engine
    /// cannot reach it, `ResourceExhausted` if the queue is full.
    pub async fn deform(
        &self,
        caller: &Principal,
        session_id: &str,
        design: Design,
    ) -> Result<Arc<Linearised>, ServiceError> {
        caller.need(Role::User)?;
        let setup = self.session_setup(caller, session_id).await?;
        let design = Resolved::new(setup.engine.parameterisation(), design)?;
        let id = design.id(&setup.id);
        let task = Task {
            memory: setup.engine.deformation_memory(),
            ..self.task("deform", caller, &setup, session_id)
        };
        let linearised = Arc::new(linearise(&self.pool, task, setup, design, id).await?);
        keep(&self.linearisations, &caller.tenant, &linearised);
        Ok(linearised)
    }

    /// The linearisation at a point: one in memory that belongs to the caller's tenant or, if the design is given, one computed
    /// now to the same bits, once for all concurrent requests.
    ///
    /// # Errors
    /// As [`Service::deform`]; `NotFound` for an id without design whose linearisation is not in memory.
    pub async fn linearised(
        &self,
        caller: &Principal,
        session_id: &str,
        at: At,
    ) -> Result<Product<Arc<Linearised>>, ServiceError> {
        caller.need(Role::User)?;
        let setup = self.session_setup(caller, session_id).await?;
        let found = |value| Product { value, timing: Timing::default() };
        at.check()?;
        let design = match at.design {
            Some(design) => design,
            None => {
                let id = at.id.unwrap_or_default();
                let held = self.linearisations.get(&(caller.tenant.clone(), id.clone()));
                // Linearisations of another set-up are invalid in this session.
                let held = held.filter(|linearised| *linearised.setup_id() == setup.id);
                return held.map(found).ok_or_else(|| not_kept(&id));
            }
        };
        const FIELD: &str = "at.design_point";
        let design =
            Resolved::new(setup.engine.parameterisation(), design).map_err(|error| error.within(FIELD))?;
        let id = design.id(&setup.id);
        if let Some(given) = at.id.filter(|given| *given != id) {
            let description =
                format!("`{}` is not the linearisation of the design that came with it", shorten(&given));
            return Err(ServiceError::invalid("at.linearisation_id", description));
        }
        let key = (caller.tenant.clone(), id.clone());
        let find = || self.linearisations.get(&key);
        let kept = {
            let (cache, tenant) = (Arc::clone(&self.linearisations), caller.tenant.clone());
            move |linearised: &Arc<Linearised>| keep(&cache, &tenant, linearised)
        };
        let task = Task {
            memory: setup.engine.deformation_memory(),
            ..self.task("linearise", caller, &setup, session_id)
        };
        let work = |_| {
            let pool = Arc::clone(&self.pool);
            async move { linearise(&pool, task, setup, design, id).await }
        };
        let follower = match self.linearising.join(key.clone(), find, work, kept) {
            Joined::Found(linearised) => return Ok(found(linearised)),
            Joined::Following(follower) | Joined::Started(follower) => follower,
        };
        let value = follower.wait(|_| {}).await.map_err(|error| error.within(FIELD))?;
        Ok(Product { timing: value.timing(), value })
    }

    /// Changes of the outputs along directions of the inputs (forward mode).
    ///
    /// # Errors
    /// As [`Service::linearised`]; `InvalidArgument` for directions that do not fit.
    pub async fn jvp(
        &self,
        caller: &Principal,
        session_id: &str,
        at: At,
        directions: Directions,
    ) -> Result<Product<Vec<Tangent>>, ServiceError> {
        caller.need(Role::User)?;
        let setup = self.session_setup(caller, session_id).await?;
        at.check()?;
        let directions = directions.check(&setup.engine, &self.limits)?;
        let at = self.linearised(caller, session_id, at).await?;
        let memory = 4 * (at.value.vector_bytes() * directions.count()) as u64;
        let task = Task { memory, ..self.task("jvp", caller, &setup, session_id) };
        self.product(task, at, move |linearised| linearised.jvp(&directions)).await
    }

    /// Gradients of weighted sums of the outputs (reverse mode).
    ///
    /// # Errors
    /// As [`Service::linearised`]; `InvalidArgument` for seeds that do not fit.
    pub async fn vjp(
        &self,
        caller: &Principal,
        session_id: &str,
        at: At,
        seeds: Seeds,
        wanted: Wanted,
    ) -> Result<Product<Gradients>, ServiceError> {
        caller.need(Role::User)?;
        let setup = self.session_setup(caller, session_id).await?;
        at.check()?;
        let wanted = wanted.check(setup.engine.parameterisation())?;
        let seeds = seeds.check(&setup.engine, &self.limits)?;
        let at = self.linearised(caller, session_id, at).await?;
        let memory = 4 * (at.value.vector_bytes() * seeds.len()) as u64;
        let task = Task { memory, ..self.task("vjp", caller, &setup, session_id) };
        self.product(task, at, move |linearised| linearised.vjp(&seeds, &wanted)).await
    }

    /// Columns of the Jacobian from the `first` one on: at least one, and as many as one block may have.
    ///
    /// # Errors
    /// `ResourceExhausted` if the queue is full.
    pub async fn jacobian(
        &self,
        caller: &Principal,
        at: &Arc<Linearised>,
        first: usize,
    ) -> Result<Product<Vec<Tangent>>, ServiceError> {
        caller.need(Role::User)?;
        let count = self.limits.vector_bytes / at.vector_bytes().max(1);
        let count = count.clamp(1, self.limits.vectors.max(1));
        // The block, and the motion of the vertices in every step of the chain.
        let memory = 4 * (at.vector_bytes() * count) as u64;
        let at = Product { value: Arc::clone(at), timing: Timing::default() };
        let tenant = caller.tenant.clone();
        let task = Task { kind: "jacobian", tenant, setup: None, session: None, memory };
        self.product(task, at, move |linearised| linearised.jacobian(first, count)).await
    }

    async fn product<T: Send + 'static>(
        &self,
        task: Task,
        Product { value: at, timing }: Product<Arc<Linearised>>,
        work: impl FnOnce(&Linearised) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<Product<T>, ServiceError> {
        let Completed { value, queued, ran } = self.pool.run(task, move |_| work(&at)).await?;
        Ok(Product { value, timing: timing + Timing { queued, engine: ran } })
    }
}

async fn linearise(
    pool: &ComputePool,
    task: Task,
    setup: Arc<StoredSetup>,
    design: Resolved,
    id: String,
) -> Result<Linearised, ServiceError> {
    let work = move |ticket: &Ticket| {
        let monitor = reporter(ticket.cancellation().clone(), |progress| ticket.progress(&progress));
        design.linearise(id, setup.id.clone(), &setup.engine, &monitor)
    };
    let Completed { value, queued, ran } = pool.run(task, work).await?;
    Ok(value.taking(Timing { queued, engine: ran }))
}

fn keep(cache: &Cache<(Tenant, String), Linearised>, tenant: &Tenant, linearised: &Arc<Linearised>) {
    let key = (tenant.clone(), linearised.id().to_owned());
    cache.insert(key, tenant.as_str(), Arc::clone(linearised), linearised.bytes());
}

fn not_kept(id: &str) -> ServiceError {
    let description = format!(
        "the server holds no linearisation `{}` (any more); Deform again, or send the design with the id",
        shorten(id)
    );
    ServiceError::new(Code::NotFound, "").at("at.linearisation_id", description)
}
