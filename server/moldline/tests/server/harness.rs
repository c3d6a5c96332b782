//! A real server on a real port, and plain clients.

use std::{collections::HashMap, net::SocketAddr, sync::Arc, time::Duration};

use moldline::{panel, serve, shell::Parts, telemetry};
use moldline_host::{ComputePool, PoolLimits};
use moldline_mesh_service::{Limits, Service};
use moldline_panel_service::PanelService;
use moldline_transport::{Access, ConnectionLimits, Health, Port, Surroundings, Tls, router, start_metrics};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};
use tonic::transport::Channel;

pub use moldline_testing::ball;

const POOL: PoolLimits = PoolLimits { threads: 2, running: 2, queued: 8, work: PoolLimits::WORK };

pub struct Server {
    pub address: SocketAddr,
    pub health: Health,
}

impl Server {
    pub async fn start() -> Self {
        Self::with(Access::default(), Limits::default()).await
    }

    pub async fn with(access: Access, limits: Limits) -> Self {
        Self::over(access, limits, None).await
    }

    pub async fn over(access: Access, limits: Limits, tls: Option<tokio_rustls::TlsAcceptor>) -> Self {
        let service = Arc::new(Service::new(POOL, limits).unwrap());
        Self::serving(serve::parts(service, 64 << 20).await.unwrap(), access, tls).await
    }

    /// The panel method's service, with `solution_bytes` for its analyses.
    pub async fn panels(solution_bytes: u64) -> Self {
        let limits = moldline_panel_service::Limits { solution_bytes, ..Default::default() };
        let pool = Arc::new(ComputePool::new(POOL, usize::MAX).unwrap());
        let service = Arc::new(PanelService::new(pool, limits));
        Self::serving(panel::serve::parts(service, 64 << 20).await.unwrap(), Access::default(), None).await
    }

    async fn serving(parts: Parts, access: Access, tls: Option<tokio_rustls::TlsAcceptor>) -> Self {
        let Parts { served, health, gauges, .. } = parts;
        let surroundings = Surroundings {
            access: Arc::new(access),
            health: health.clone(),
            metrics: start_metrics().unwrap(),
            gauges,
            trace: telemetry::follow,
            origins: vec!["https://example.org".parse().unwrap()],
            local: true,
        };
        let app = router(served, surroundings);
        let limits = ConnectionLimits { total: 1000, of_peer: 1000 };
        let port =
            Port::bind(SocketAddr::from(([127, 0, 0, 1], 0)), tls.map(Tls::new), limits).await.unwrap();
        let address = port.address().unwrap();
        tokio::spawn(port.serve(app, std::future::pending()));
        Self { address, health }
    }

    /// Asks until the answer is as expected, and returns it.
    ///
    /// # Panics
    /// After ten seconds.
    pub async fn eventually(&self, path: &str, expected: impl Fn(&Answer) -> bool) -> Answer {
        let poll = async {
            loop {
                let answer = self.ask("GET", path, &[], b"").await;
                if expected(&answer) {
                    return answer;
                }
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(10), poll)
            .await
            .expect("the expected answer within ten seconds")
    }

    pub async fn channel(&self) -> Channel {
        Channel::from_shared(format!("http://{}", self.address)).unwrap().connect().await.unwrap()
    }

    /// One request on a connection of its own.
    pub async fn ask(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Answer {
        let mut head = format!("{method} {path} HTTP/1.1\r\nhost: {}\r\nconnection: close\r\n", self.address);
        for (name, value) in headers {
            head += &format!("{name}: {value}\r\n");
        }
        let framed = |&(name, _): &(&str, &str)| matches!(name, "content-length" | "transfer-encoding");
        if !body.is_empty() && !headers.iter().any(framed) {
            head += &format!("content-length: {}\r\n", body.len());
        }
        let mut stream = TcpStream::connect(self.address).await.unwrap();
        stream.write_all(format!("{head}\r\n").as_bytes()).await.unwrap();
        // A server that refuses early need not read the whole body.
        let _ = stream.write_all(body).await;
        let mut bytes = Vec::new();
        let _ = stream.read_to_end(&mut bytes).await;
        Answer::parse(&bytes)
    }

    /// One request with a JSON document.
    pub async fn json(&self, method: &str, path: &str, body: serde_json::Value) -> Answer {
        let body = body.to_string();
        self.ask(method, path, &[("content-type", "application/json")], body.as_bytes()).await
    }
}

#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub headers: HashMap<String, String>,
    pub body: Vec<u8>,
}

impl Answer {
    fn parse(bytes: &[u8]) -> Self {
        let end = bytes.windows(4).position(|window| window == b"\r\n\r\n").expect("an answer with a head");
        let head = std::str::from_utf8(&bytes[..end]).unwrap();
        let mut lines = head.lines();
        let status = lines.next().unwrap().split(' ').nth(1).unwrap().parse().unwrap();
        let headers: HashMap<String, String> = lines
            .map(|line| line.split_once(": ").unwrap())
            .map(|(name, value)| (name.to_owned(), value.to_owned()))
            .collect();
        let mut rest = &bytes[end + 4..];
        if headers.get("transfer-encoding").is_none_or(|encoding| encoding != "chunked") {
            return Self { status, headers, body: rest.to_vec() };
        }
        let mut body = Vec::new();
        loop {
            let line = rest.windows(2).position(|window| window == b"\r\n").expect("a chunk");
            let length = usize::from_str_radix(std::str::from_utf8(&rest[..line]).unwrap(), 16).unwrap();
            body.extend_from_slice(&rest[line + 2..line + 2 + length]);
            if length == 0 {
                return Self { status, headers, body };
            }
            rest = &rest[line + 4 + length..];
        }
    }

    pub fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| {
            panic!("{error}: {} {}", self.status, String::from_utf8_lossy(&self.body))
        })
    }

    /// Status, code and first faulty field of a problem document.
    pub fn problem(&self) -> (u16, String, String) {
        assert_eq!(self.headers["content-type"], "application/problem+json");
        let problem = self.json();
        assert_eq!(problem["status"], self.status);
        let text = |value: &serde_json::Value| value.as_str().unwrap_or_default().to_owned();
        (self.status, text(&problem["code"]), text(&problem["violations"][0]["field"]))
    }
}
