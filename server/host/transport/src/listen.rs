//! One port for gRPC, gRPC-Web and HTTP, with or without TLS, and its graceful shutdown.

use std::{
    convert::Infallible,
    io,
    net::SocketAddr,
    pin::{Pin, pin},
    sync::{Arc, Mutex, PoisonError},
    task::{Context, Poll, ready},
    time::Duration,
};

use axum::{Router, body::Body, http::Request};
use hyper::body::Incoming;
use hyper_util::{
    rt::{TokioExecutor, TokioIo, TokioTimer},
    server::conn::auto::Builder,
    service::TowerToHyperService,
};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpListener, TcpStream},
    time::{sleep, timeout},
};
use tokio_rustls::TlsAcceptor;
use tower::{ServiceExt, service_fn};

use crate::{
    access::Certified,
    answer::Answer,
    connections::{Close, Connection, ConnectionLimits, Connections, IDLE_HTTP1, Place},
    tls,
};

/// Time limit of a TLS handshake.
const HANDSHAKE: Duration = Duration::from_secs(10);
/// HTTP/2: the interval of pings, which detect clients that vanished; their requests are cancelled.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// HTTP/2: the time for the answer to a ping.
const PONG: Duration = Duration::from_secs(10);

/// A listening port.
pub struct Port {
    listener: TcpListener,
    tls: Option<Tls>,
    connections: Arc<Connections>,
}

/// TLS of a port, whose certificates can be exchanged while it serves.
#[derive(Clone)]
pub struct Tls(Arc<Mutex<TlsAcceptor>>);

impl Tls {
    /// TLS with these certificates.
    pub fn new(acceptor: TlsAcceptor) -> Self {
        Self(Arc::new(Mutex::new(acceptor)))
    }

    /// Uses other certificates for new connections.
    pub fn replace(&self, acceptor: TlsAcceptor) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = acceptor;
    }

    fn acceptor(&self) -> TlsAcceptor {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Port {
    /// Listens on `address`; port 0 takes a free one.
    ///
    /// # Errors
    /// If the address is not available.
    pub async fn bind(address: SocketAddr, tls: Option<Tls>, limits: ConnectionLimits) -> io::Result<Self> {
        let listener = TcpListener::bind(address).await?;
        Ok(Self { listener, tls, connections: Connections::new(limits) })
    }

    /// The bound address.
    ///
    /// # Errors
    /// If the system does not report it.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Its connections.
    pub fn connections(&self) -> Arc<Connections> {
        Arc::clone(&self.connections)
    }

    /// Serves `app` until `close`, then accepts no more connections, finishes running requests, and returns.
    pub async fn serve(self, app: Router, close: impl Future<Output = ()>) {
        let Self { listener, tls, connections } = self;
        let accepting = async {
            for number in 0.. {
                connections.room().await;
                match listener.accept().await {
                    Ok((stream, peer)) => {
                        // Closed at once where every connection is busy.
                        let Some(place) = connections.admit(peer.ip(), number) else { continue };
                        tokio::spawn(connection(stream, tls.clone(), app.clone(), place));
                    }
                    Err(error) => {
                        // Most often out of file descriptors: accepting again at once would spin.
                        tracing::warn!(%error, "cannot accept a connection");
                        sleep(Duration::from_millis(50)).await;
                    }
                }
            }
        };
        let sweep = Arc::clone(&connections).sweep();
        let mut sweep = pin!(sweep);
        tokio::select! {
            () = accepting => {}
            () = &mut sweep => {}
            () = close => {}
        }
        drop(listener);
        tokio::select! {
            () = connections.drain() => {}
            () = sweep => {}
        }
    }
}

async fn connection(stream: TcpStream, tls: Option<Tls>, app: Router, place: Place) {
    // Without it, small messages wait for the acknowledgement of the one before.
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(%error, "cannot set TCP_NODELAY");
    }
    let connection = &place.connection;
    let Some(tls) = tls else { return talk(stream, None, app, connection).await };
    let handshake = async {
        tokio::select! {
            stream = timeout(HANDSHAKE, tls.acceptor().accept(stream)) => Some(stream),
            _ = connection.closing(Close::Gracefully) => None,
        }
    };
    match handshake.await {
        Some(Ok(Ok(stream))) => {
            let certificate = stream.get_ref().1.peer_certificates().and_then(<[_]>::first);
            let certified = certificate.and_then(|certificate| {
                let principal = tls::principal(certificate);
                if principal.is_none() {
                    tracing::warn!("a client certificate names no tenant");
                }
                principal.map(Certified)
            });
            talk(stream, certified, app, connection).await;
        }
        Some(Ok(Err(error))) => tracing::debug!(%error, "TLS handshake failed"),
        Some(Err(_)) => tracing::debug!("TLS handshake took too long"),
        None => {}
    }
}

async fn talk(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    certified: Option<Certified>,
    app: Router,
    connection: &Arc<Connection>,
) {
    let of = Arc::clone(connection);
    let service = service_fn(move |request: Request<Incoming>| {
        let under_way = of.begin(lasting(request.uri().path()));
        let mut request = request.map(Body::new);
        if let Some(certified) = &certified {
            request.extensions_mut().insert(certified.clone());
        }
        let answer = app.clone().oneshot(request);
        async move {
            let answer = answer.await?;
            Ok::<_, Infallible>(answer.map(|body| Body::new(Answer::new(body, under_way))))
        }
    });
    let mut builder = Builder::new(TokioExecutor::new());
    builder.http1().timer(TokioTimer::new()).header_read_timeout(IDLE_HTTP1);
    builder
        .http2()
        .timer(TokioTimer::new())
        // Large enough to upload a mesh without waiting for acknowledgements; what comes before its memory is taken is no more.
        .initial_stream_window_size(2 << 20)
        .initial_connection_window_size(4 << 20)
        .max_send_buf_size(256 << 10)
        .keep_alive_interval(KEEP_ALIVE)
        .keep_alive_timeout(PONG);
    let stream = TokioIo::new(Watched { stream, connection: Arc::clone(connection), preface: 0 });
    let mut talk = pin!(builder.serve_connection(stream, TowerToHyperService::new(service)));
    let mut asked = Close::Open;
    loop {
        tokio::select! {
            ended = &mut talk => {
                if let Err(error) = ended {
                    tracing::debug!(error = &*error, "connection ended");
                }
                return;
            }
            close = connection.closing(asked) => match close {
                Close::AtOnce => return,
                Close::Open | Close::Gracefully => talk.as_mut().graceful_shutdown(),
            },
        }
        asked = Close::Gracefully;
    }
}

/// Whether the answer of a path is a stream that lasts as long as the client likes.
fn lasting(path: &str) -> bool {
    path.starts_with("/grpc.health.") || path.starts_with("/grpc.reflection.")
}

/// A stream whose first bytes and silence are known to its connection.
struct Watched<S> {
    stream: S,
    connection: Arc<Connection>,
    /// Bytes of the HTTP/2 preface that have come.
    preface: usize,
}

/// What every HTTP/2 connection begins with.
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

impl<S> Watched<S> {
    fn received(&mut self, bytes: &[u8]) {
        if bytes.is_empty() {
            return;
        }
        if !self.connection.known() {
            let expected = &PREFACE[self.preface..];
            let common = expected.iter().zip(bytes).take_while(|(a, b)| a == b).count();
            self.preface += common;
            if self.preface == PREFACE.len() {
                self.connection.speaks(true);
            } else if common < bytes.len() {
                self.connection.speaks(false);
            }
        }
        self.connection.received();
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Watched<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        ready!(Pin::new(&mut self.stream).poll_read(context, buffer))?;
        self.received(&buffer.filled()[before..]);
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Watched<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, bytes)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}
