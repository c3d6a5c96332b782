//! `moldline token`: who may use a server.

use std::time::Duration;

use moldline_service::Principal;
use moldline_transport::tokens::{self, TokenFileError};

use crate::{
    config::{Token, TokenCommand},
    table,
};

/// Makes, lists or revokes tokens.
pub fn run(Token { tokens: path, command }: &Token) -> Result<(), TokenFileError> {
    match command {
        TokenCommand::Create { tenant, role, expires } => {
            let principal = Principal { tenant: tenant.clone(), role: *role };
            println!("{}", tokens::create(path, &principal, *expires)?);
            eprintln!("This is the only time that it is seen. Send it as `authorization: Bearer TOKEN`.");
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
