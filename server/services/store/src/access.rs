//! Who may use a set-up: the records of its owners, and grants, which only say where to look.

use std::collections::BTreeSet;

use bytes::Bytes;

use crate::{
    error::{StoreError, unless_damaged},
    index::Kind,
    records::{AccessRecord, Shared},
    rows::{Generation, numbered},
    store::Store,
};

/// Stands for all tenants. No tenant can have this name.
const EVERYBODY: &str = "@public";
/// Content of a grant.
const GRANT: &[u8] = b"look at the owner's record";

fn row(tenant: &str, setup: &str) -> String {
    format!("access/{tenant}/{setup}")
}

/// Names of the grants that a record needs.
pub(crate) fn grants(owner: &str, setup: &str, record: &AccessRecord) -> BTreeSet<String> {
    let grantees: Vec<&str> = match &record.shared {
        _ if !record.owned => Vec::new(),
        Shared::Private => Vec::new(),
        Shared::Tenants(tenants) => tenants.iter().map(String::as_str).collect(),
        Shared::Public => vec![EVERYBODY],
    };
    grantees.into_iter().map(|grantee| format!("grant/{grantee}/{setup}/{owner}")).collect()
}

impl Store {
    /// The access of a tenant that uploaded a set-up.
    ///
    /// # Errors
    /// If the store does not answer or the record is damaged.
    pub async fn access(
        &self,
        tenant: &str,
        setup: &str,
    ) -> Result<Option<Generation<AccessRecord>>, StoreError> {
        self.latest(&row(tenant, setup)).await
    }

    /// As [`access`](Self::access), with the error in place of a damaged record, so that it can be rewritten.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn access_or_damage(
        &self,
        tenant: &str,
        setup: &str,
    ) -> Result<Option<Generation<Result<AccessRecord, StoreError>>>, StoreError> {
        self.latest_or_damage(&row(tenant, setup)).await
    }

    /// Writes the next generation of a tenant's access to a set-up; `false` if it exists already.
    ///
    /// # Errors
    /// If it cannot be written.
    pub async fn put_access(
        &self,
        tenant: &str,
        setup: &str,
        number: u64,
        record: &AccessRecord,
    ) -> Result<bool, StoreError> {
        // Grants come first: the record decides.
        for grant in grants(tenant, setup, record) {
            self.put_named(&grant, Bytes::from_static(GRANT)).await?;
        }
        let before = match number.checked_sub(1).filter(|&before| before > 0) {
            Some(before) => {
                unless_damaged(self.record::<AccessRecord>(&numbered(&row(tenant, setup), before)).await)?
            }
            None => None,
        };
        if !self.append(&row(tenant, setup), number, record).await? {
            return Ok(false);
        }
        let stale = before.map(|before| grants(tenant, setup, &before)).unwrap_or_default();
        self.settle_setup(tenant, setup, stale).await?;
        Ok(true)
    }

    /// Makes the index and the grants say what the last record says. `stale`: grants that may have to go.
    ///
    /// # Errors
    /// If the store does not answer.
    pub(crate) async fn settle_setup(
        &self,
        tenant: &str,
        setup: &str,
        mut stale: BTreeSet<String>,
    ) -> Result<(), StoreError> {
        let mut settled = None;
        // Whoever wrote last settles last, whatever the others do in between.
        loop {
            let known = self.access_or_damage(tenant, setup).await?;
            let number = known.as_ref().map_or(0, |known| known.number);
            if settled == Some(number) {
                return Ok(());
            }
            match known.map(|known| known.record) {
                Some(Ok(record)) => {
                    let (held, other) = match record.owned {
                        true => (Kind::Setup, Kind::Deleted),
                        false => (Kind::Deleted, Kind::Setup),
                    };
                    self.enter(tenant, held, setup, record.bytes).await?;
                    self.forget(tenant, other, setup).await?;
                    let wanted = grants(tenant, setup, &record);
                    for grant in &wanted {
                        self.put_named(grant, Bytes::from_static(GRANT)).await?;
                    }
                    for grant in stale.difference(&wanted) {
                        self.backend.delete(grant).await?;
                    }
                    stale.extend(wanted);
                }
                // What it holds is known when it is mended.
                Some(Err(_)) => {}
                None => {
                    self.forget(tenant, Kind::Setup, setup).await?;
                    self.forget(tenant, Kind::Deleted, setup).await?;
                }
            }
            settled = Some(number);
        }
    }

    /// The access to a set-up that another tenant has granted to a tenant, if any.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn granted(&self, tenant: &str, setup: &str) -> Result<Option<AccessRecord>, StoreError> {
        for grantee in [tenant, EVERYBODY] {
            for owner in self.backend.children(&format!("grant/{grantee}/{setup}")).await? {
                // A damaged record grants nothing.
                let found = unless_damaged(self.access(&owner, setup).await)?;
                let record = found.map(|generation| generation.record);
                if let Some(record) = record.filter(|record| record.owned)
                    && match &record.shared {
                        Shared::Private => false,
                        Shared::Tenants(tenants) => tenants.iter().any(|other| other == tenant),
                        Shared::Public => true,
                    }
                {
                    return Ok(Some(record));
                }
            }
        }
        Ok(None)
    }

    /// Ids of all set-ups to which a tenant may have access, sorted.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn setups_of(&self, tenant: &str) -> Result<BTreeSet<String>, StoreError> {
        let mut names: BTreeSet<String> = self.entries(tenant, Kind::Setup).await?.into_keys().collect();
        for below in [format!("grant/{tenant}"), format!("grant/{EVERYBODY}")] {
            names.extend(self.backend.children(&below).await?);
        }
        Ok(names)
    }
}
