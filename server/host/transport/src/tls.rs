//! TLS, and principals from client certificates.
//!
//! A certificate signed by the clients' authority names its tenant in one of two ways:
//! - a subject alternative name of kind URI, `moldline://TENANT/ROLE`, with the role `reader`, `user` or `admin`;
//! - otherwise, the subject's common name is the tenant, and the role is `user`.

use std::{path::Path, sync::Arc};

use moldline_host::{Principal, Role, Tenant};
use tokio_rustls::{
    TlsAcceptor,
    rustls::{
        RootCertStore, ServerConfig,
        crypto::ring,
        pki_types::{CertificateDer, CertificateRevocationListDer, PrivateKeyDer, pem::PemObject},
        server::WebPkiClientVerifier,
    },
};
use x509_parser::{extensions::GeneralName, prelude::FromDer};

/// An unusable certificate or key file.
#[derive(Debug, thiserror::Error)]
#[error("{}: {reason}", path.display())]
pub struct TlsError {
    path: std::path::PathBuf,
    reason: String,
}

/// PEM files of certificate, key and client authority.
#[derive(Clone, Copy, Debug)]
pub struct TlsFiles<'a> {
    /// The server's certificate chain, its own certificate first.
    pub certificate: &'a Path,
    /// Its private key.
    pub key: &'a Path,
    /// The authorities that sign client certificates.
    pub client_authority: Option<&'a Path>,
    /// Whether clients without a certificate are accepted.
    pub client_optional: bool,
    /// Client certificates that their authorities have revoked (CRL); an authority without a list has revoked none.
    pub revoked: Option<&'a Path>,
}

/// TLS with HTTP/2 and HTTP/1.1.
///
/// # Errors
/// If a file cannot be read or has invalid content.
pub fn acceptor(files: TlsFiles<'_>) -> Result<TlsAcceptor, TlsError> {
    let failed = |path: &Path, error: &dyn std::fmt::Display| TlsError {
        path: path.to_owned(),
        reason: error.to_string(),
    };
    let provider = Arc::new(ring::default_provider());
    let builder = ServerConfig::builder_with_provider(Arc::clone(&provider))
        .with_safe_default_protocol_versions()
        .map_err(|error| failed(files.certificate, &error))?;
    let builder = match files.client_authority {
        None => builder.with_no_client_auth(),
        Some(path) => {
            let mut roots = RootCertStore::empty();
            for certificate in certificates(path)? {
                roots.add(certificate).map_err(|error| failed(path, &error))?;
            }
            let mut verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider);
            if let Some(path) = files.revoked {
                verifier = verifier.with_crls(revocations(path)?).allow_unknown_revocation_status();
            }
            if files.client_optional {
                verifier = verifier.allow_unauthenticated();
            }
            builder.with_client_cert_verifier(verifier.build().map_err(|error| failed(path, &error))?)
        }
    };
    let key = PrivateKeyDer::from_pem_file(files.key).map_err(|error| failed(files.key, &error))?;
    let mut config = builder
        .with_single_cert(certificates(files.certificate)?, key)
        .map_err(|error| failed(files.certificate, &error))?;
    config.alpn_protocols = vec![b"h2".to_vec(), b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    sections(path, "there is no certificate in it")
}

fn revocations(path: &Path) -> Result<Vec<CertificateRevocationListDer<'static>>, TlsError> {
    sections(path, "there is no list of revoked certificates in it")
}

/// All sections of one kind in a PEM file, of which there must be one.
fn sections<T: PemObject>(path: &Path, none: &str) -> Result<Vec<T>, TlsError> {
    let failed = |reason| TlsError { path: path.to_owned(), reason };
    match T::pem_file_iter(path).and_then(Iterator::collect::<Result<Vec<_>, _>>) {
        Ok(found) if found.is_empty() => Err(failed(none.to_owned())),
        Ok(found) => Ok(found),
        Err(error) => Err(failed(error.to_string())),
    }
}

/// The principal that a certificate names; `None` if it names no tenant.
pub fn principal(certificate: &CertificateDer<'_>) -> Option<Principal> {
    let (_, certificate) = x509_parser::certificate::X509Certificate::from_der(certificate).ok()?;
    let names = certificate.subject_alternative_name().ok().flatten();
    let uri = names.iter().flat_map(|names| &names.value.general_names).find_map(|name| match name {
        GeneralName::URI(uri) => uri.strip_prefix("moldline://"),
        _ => None,
    });
    let (tenant, role) = match uri {
        Some(uri) => {
            let (tenant, role) = uri.split_once('/')?;
            (tenant, Role::named(role)?)
        }
        None => (certificate.subject().iter_common_name().next()?.as_str().ok()?, Role::User),
    };
    Some(Principal { tenant: Tenant::new(tenant).ok()?, role })
}

#[cfg(test)]
mod tests {
    use rcgen::{CertificateParams, DnType, KeyPair, SanType};

    use super::*;

    fn named(common_name: &str, uri: Option<&str>) -> Option<(String, Role)> {
        let mut params = CertificateParams::new(Vec::new()).unwrap();
        params.distinguished_name.push(DnType::CommonName, common_name);
        params.subject_alt_names.extend(uri.map(|uri| SanType::URI(uri.try_into().unwrap())));
        let certificate = params.self_signed(&KeyPair::generate().unwrap()).unwrap();
        principal(certificate.der()).map(|principal| (principal.tenant.to_string(), principal.role))
    }

    #[test]
    fn a_certificate_names_its_tenant_and_role() {
        assert_eq!(named("anna", None), Some(("anna".to_owned(), Role::User)));
        assert_eq!(named("x", Some("moldline://bert/reader")), Some(("bert".to_owned(), Role::Reader)));
        assert_eq!(named("anna", Some("https://example.org")), Some(("anna".to_owned(), Role::User)));
        // An invalid URI is not replaced by the common name.
        assert_eq!(named("anna", Some("moldline://bert/king")), None);
        assert_eq!(named("anna", Some("moldline://bert")), None);
        assert_eq!(named("Anna Smith", None), None);
        assert!(principal(&CertificateDer::from(vec![1, 2, 3])).is_none());
    }
}
