//! One port for gRPC, gRPC-Web and HTTP, with or without TLS, and its graceful shutdown.

use std::{io, net::SocketAddr, time::Duration};

use axum::{Router, body::Body, http::Request};
use hyper::body::Incoming;
use hyper_util::{
    rt::{TokioExecutor, TokioIo, TokioTimer},
    server::{
        conn::auto::Builder,
        graceful::{GracefulShutdown, Watcher},
    },
    service::TowerToHyperService,
};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::{TcpListener, TcpStream},
    time::{sleep, timeout},
};
use tokio_rustls::TlsAcceptor;
use tower::ServiceExt;

use crate::{access::Certified, tls};

/// Time limit of a TLS handshake.
const HANDSHAKE: Duration = Duration::from_secs(10);
/// HTTP/1: idle connections, and those whose request does not arrive, are closed after this time.
const IDLE: Duration = Duration::from_secs(75);
/// HTTP/2: the interval of pings, which detect clients that vanished; their requests are cancelled.
const KEEP_ALIVE: Duration = Duration::from_secs(30);

/// A listening port.
pub struct Port {
    listener: TcpListener,
    tls: Option<TlsAcceptor>,
}

impl Port {
    /// Listens on `address`; port 0 takes a free one.
    ///
    /// # Errors
    /// If the address is not available.
    pub async fn bind(address: SocketAddr, tls: Option<TlsAcceptor>) -> io::Result<Self> {
        Ok(Self { listener: TcpListener::bind(address).await?, tls })
    }

    /// The bound address.
    ///
    /// # Errors
    /// If the system does not report it.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Serves `app` until `close`, then accepts no more connections, finishes running requests, and returns.
    pub async fn serve(self, app: Router, close: impl Future<Output = ()>) {
        let Self { listener, tls } = self;
        let graceful = GracefulShutdown::new();
        let accepting = async {
            loop {
                match listener.accept().await {
                    Ok((stream, _)) => {
                        tokio::spawn(connection(stream, tls.clone(), app.clone(), graceful.watcher()));
                    }
                    Err(error) => {
                        // Most often out of file descriptors: accepting again at once would spin.
                        tracing::warn!(%error, "cannot accept a connection");
                        sleep(Duration::from_millis(50)).await;
                    }
                }
            }
        };
        tokio::select! {
            () = accepting => {}
            () = close => {}
        }
        drop(listener);
        graceful.shutdown().await;
    }
}

async fn connection(stream: TcpStream, tls: Option<TlsAcceptor>, app: Router, watcher: Watcher) {
    // Without it, small messages wait for the acknowledgement of the one before.
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(%error, "cannot set TCP_NODELAY");
    }
    let Some(tls) = tls else { return talk(stream, None, app, watcher).await };
    match timeout(HANDSHAKE, tls.accept(stream)).await {
        Ok(Ok(stream)) => {
            let certificate = stream.get_ref().1.peer_certificates().and_then(<[_]>::first);
            let certified = certificate.and_then(|certificate| {
                let principal = tls::principal(certificate);
                if principal.is_none() {
                    tracing::warn!("a client certificate names no tenant");
                }
                principal.map(Certified)
            });
            talk(stream, certified, app, watcher).await;
        }
        Ok(Err(error)) => tracing::debug!(%error, "TLS handshake failed"),
        Err(_) => tracing::debug!("TLS handshake took too long"),
    }
}

async fn talk(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    certified: Option<Certified>,
    app: Router,
    watcher: Watcher,
) {
    let service = app.map_request(move |request: Request<Incoming>| {
        let mut request = request.map(Body::new);
        if let Some(certified) = &certified {
            request.extensions_mut().insert(certified.clone());
        }
        request
    });
    let mut builder = Builder::new(TokioExecutor::new());
    builder.http1().timer(TokioTimer::new()).header_read_timeout(IDLE);
    builder
        .http2()
        .timer(TokioTimer::new())
        // Large enough to upload a mesh without waiting for acknowledgements.
        .initial_stream_window_size(4 << 20)
        .initial_connection_window_size(16 << 20)
        .max_send_buf_size(1 << 20)
        .keep_alive_interval(KEEP_ALIVE);
    let connection = builder.serve_connection(TokioIo::new(stream), TowerToHyperService::new(service));
    if let Err(error) = watcher.watch(connection.into_owned()).await {
        tracing::debug!(error = &*error, "connection ended");
    }
}
