//! Callers: a tenant and its role. Transports derive them from a credential, never from a field of a request.

use std::fmt;

use crate::error::{Code, ServiceError};

/// The owner of set-ups, sessions and configurations, such as a person or a team: 1 to 64 characters of `a`-`z`, `0`-`9`, `_` and `-`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Tenant(String);

/// An invalid name of a tenant.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a tenant's name has 1 to 64 characters of a-z, 0-9, `_` and `-`; this is `{}`", crate::error::shorten(.0))]
pub struct TenantError(String);

impl Tenant {
    /// The tenant of that name.
    ///
    /// # Errors
    /// If the name is invalid.
    pub fn new(name: &str) -> Result<Self, TenantError> {
        const LONGEST: usize = 64;
        let fits =
            |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || matches!(byte, b'_' | b'-');
        if (1..=LONGEST).contains(&name.len()) && name.bytes().all(fits) {
            Ok(Self(name.to_owned()))
        } else {
            Err(TenantError(name.to_owned()))
        }
    }

    /// Its name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Tenant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Permissions of a caller. Each role includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Role {
    /// Reads what its tenant owns, and the tenant's status.
    Reader,
    /// Computes, and changes what its tenant owns.
    User,
    /// Also reads the status of all tenants.
    Admin,
}

impl Role {
    /// The role of a name.
    pub fn named(name: &str) -> Option<Self> {
        [Self::Reader, Self::User, Self::Admin].into_iter().find(|role| role.name() == name)
    }

    /// Its name in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Reader => "reader",
            Self::User => "user",
            Self::Admin => "admin",
        }
    }
}

/// An authenticated caller.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Principal {
    /// The owner of what it uses.
    pub tenant: Tenant,
    /// Its permissions.
    pub role: Role,
}

impl Principal {
    /// The principal used when authentication is off: an administrator of the tenant `local`.
    pub fn local() -> Self {
        Self { tenant: Tenant("local".to_owned()), role: Role::Admin }
    }

    /// Requires a role.
    ///
    /// # Errors
    /// `PermissionDenied` if the caller's role is below `role`.
    pub fn need(&self, role: Role) -> Result<(), ServiceError> {
        if self.role >= role {
            return Ok(());
        }
        Err(ServiceError::new(
            Code::PermissionDenied,
            format!("this needs the role `{}`, and the credential's is `{}`", role.name(), self.role.name()),
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_tenants_are_short_and_plain() {
        let longest = "a".repeat(64);
        for name in ["a", "team-1", "x_9", longest.as_str()] {
            assert_eq!(Tenant::new(name).unwrap().as_str(), name);
        }
        for name in ["", "Team", "a/b", "..", "a b", "ä", "@public", &"a".repeat(65)] {
            assert!(Tenant::new(name).is_err(), "{name}");
        }
    }

    #[test]
    fn a_role_includes_those_before_it() {
        let of = |role| Principal { role, ..Principal::local() };
        assert!(of(Role::Admin).need(Role::User).is_ok() && of(Role::User).need(Role::User).is_ok());
        assert_eq!(of(Role::Reader).need(Role::User).unwrap_err().code, Code::PermissionDenied);
    }
}
