//! `moldline token`: the credentials that a server accepts.

use std::{path::PathBuf, time::Duration};

use clap::{Args, Subcommand};
use moldline_host::{Principal, Role, Tenant};
use moldline_transport::tokens::{self, TokenFileError};

use crate::{table, values};

/// Options of `moldline token`.
#[derive(Debug, Args)]
pub struct TokenOptions {
    /// The token file
    #[arg(long, global = true, env = "MOLDLINE_TOKENS", value_name = "FILE", default_value = "tokens.json")]
    pub tokens: PathBuf,
    /// The command.
    #[command(subcommand)]
    pub command: TokenCommand,
}

/// Commands on tokens.
#[derive(Debug, Subcommand)]
pub enum TokenCommand {
    /// Create a token and print it, this once: the file keeps its hash only
    Create {
        /// Tenant whose set-ups and sessions it opens: up to 64 of a-z, 0-9, _ and -
        #[arg(long, value_parser = |text: &str| Tenant::new(text).map_err(|error| error.to_string()))]
        tenant: Tenant,
        /// Permissions: `reader` may look, `user` may do everything with the tenant's own, `admin` also sees all tenants' load
        #[arg(long, value_parser = role)]
        role: Role,
        /// Lifetime, as in `90d`, `12h`, `30m` or `45s`; unlimited if absent
        #[arg(long, value_parser = values::duration, value_name = "TIME")]
        expires: Option<Duration>,
    },
    /// List the tokens, without their secrets
    List,
    /// Remove a token from the file: a running server refuses it from then on
    Revoke {
        /// Id of the token, from the list
        id: String,
    },
}

fn role(text: &str) -> Result<Role, String> {
    Role::named(text).ok_or_else(|| "expected reader, user or admin".to_owned())
}

/// Creates, lists or revokes tokens.
pub fn run(TokenOptions { tokens: path, command }: &TokenOptions) -> Result<(), TokenFileError> {
    match command {
        TokenCommand::Create { tenant, role, expires } => {
            let principal = Principal { tenant: tenant.clone(), role: *role };
            println!("{}", tokens::create(path, &principal, *expires)?);
            eprintln!("The token is shown only this once. Send it as `authorization: Bearer TOKEN`.");
        }
        TokenCommand::List => print!("{}", list(&tokens::list(path)?, tokens::now())),
        TokenCommand::Revoke { id } => tokens::revoke(path, id)?,
    }
    Ok(())
}

fn list(tokens: &[tokens::Token], now: u64) -> String {
    let mut rows = vec![["id", "tenant", "role", "made", "expires"].map(str::to_owned)];
    for token in tokens {
        let duration = |seconds| table::duration(Duration::from_secs(seconds));
        let expires = match token.expires {
            None => "never".to_owned(),
            Some(end) if end <= now => "expired".to_owned(),
            Some(end) => format!("in {}", duration(end - now)),
        };
        let made = format!("{} ago", duration(now.saturating_sub(token.created)));
        rows.push([token.id.clone(), token.tenant.clone(), token.role.clone(), made, expires]);
    }
    table::render(&rows)
}
