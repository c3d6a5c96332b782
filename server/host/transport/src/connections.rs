//! The connections of a port: how many there are, in total and from one address, what they do, and which of them are closed
//! because nothing comes from them or nobody reads at their other end.
//!
//! A connection is *busy* while a request is under way on it, else *silent*. Beyond a limit the connection that has been silent
//! longest makes room for a new one, those first that never sent a request; where all are busy, the new one is closed. So silent
//! connections keep nobody out, however many there are.

use std::{
    collections::HashMap,
    net::IpAddr,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError, Weak,
        atomic::{AtomicBool, AtomicU8, AtomicU64, AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

use tokio::sync::{Notify, watch};

/// The first request has to begin within this time, an HTTP/2 preface included.
const FIRST: Duration = Duration::from_secs(15);
/// HTTP/1: the head of a request has to end within this time from its first byte.
const HEAD: Duration = Duration::from_secs(10);
/// Silent connections are closed after this time. Clients of HTTP/1 ask anew on another connection.
pub(crate) const IDLE_HTTP1: Duration = Duration::from_secs(75);
/// The same for HTTP/2, whose clients open channels long before they use them; pings find those that are gone.
const IDLE_HTTP2: Duration = Duration::from_secs(600);
/// A connection that has been asked to close has this time for it.
const FAREWELL: Duration = Duration::from_secs(10);
/// A client that does not take the next piece of an answer for this time has gone.
const UNREAD: Duration = Duration::from_secs(120);

/// Most connections at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConnectionLimits {
    /// In total.
    pub total: usize,
    /// From one address.
    pub of_peer: usize,
}

/// The connections of a port.
#[derive(Debug)]
pub struct Connections {
    limits: ConnectionLimits,
    start: Instant,
    all: Mutex<HashMap<u64, Arc<Connection>>>,
    /// Told when a connection has ended.
    ended: Notify,
}

/// How a connection is to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Close {
    /// Not yet.
    Open,
    /// Once its requests are over, told to the client.
    Gracefully,
    /// At once.
    AtOnce,
}

/// What is known of the protocol.
const UNKNOWN: u8 = 0;
const HTTP1: u8 = 1;
const HTTP2: u8 = 2;

/// A connection. Times are milliseconds since the port was opened, and 0 for never.
#[derive(Debug)]
pub(crate) struct Connection {
    peer: IpAddr,
    start: Instant,
    protocol: AtomicU8,
    /// Requests under way that someone waits for.
    requests: AtomicUsize,
    /// Streams that are open for as long as the client likes: health watches, reflection.
    streams: AtomicUsize,
    /// Requests so far.
    served: AtomicU64,
    /// Since when it has been silent.
    silent: AtomicU64,
    /// When the head of the next request began to come.
    head: AtomicU64,
    /// When it was asked to close.
    asked: AtomicU64,
    /// Whether requests were under way when the drain began.
    owed: AtomicBool,
    /// Times at which the answers under way were given a piece that the client has not taken.
    unread: Mutex<Vec<Weak<AtomicU64>>>,
    close: watch::Sender<Close>,
}

impl Connection {
    fn now(&self) -> u64 {
        milliseconds(self.start)
    }

    /// Records the protocol, once it is known.
    pub(crate) fn speaks(&self, http2: bool) {
        self.protocol.store(if http2 { HTTP2 } else { HTTP1 }, Ordering::Relaxed);
    }

    /// Whether the protocol is known.
    pub(crate) fn known(&self) -> bool {
        self.protocol.load(Ordering::Relaxed) != UNKNOWN
    }

    /// Records that bytes have come.
    pub(crate) fn received(&self) {
        if self.protocol.load(Ordering::Relaxed) != HTTP2 && !self.busy() {
            let _ = self.head.compare_exchange(0, self.now(), Ordering::Relaxed, Ordering::Relaxed);
        }
    }

    /// A request begins; it is over when what this returns is dropped. `lasting`: a stream without an end of its own.
    pub(crate) fn begin(self: &Arc<Self>, lasting: bool) -> UnderWay {
        let kind = if lasting { &self.streams } else { &self.requests };
        kind.fetch_add(1, Ordering::Relaxed);
        self.served.fetch_add(1, Ordering::Relaxed);
        self.head.store(0, Ordering::Relaxed);
        let given = Arc::new(AtomicU64::new(0));
        let mut unread = lock(&self.unread);
        unread.retain(|given| given.strong_count() > 0);
        unread.push(Arc::downgrade(&given));
        drop(unread);
        UnderWay { connection: Arc::clone(self), lasting, given }
    }

    fn busy(&self) -> bool {
        self.requests.load(Ordering::Relaxed) + self.streams.load(Ordering::Relaxed) > 0
    }

    /// Waits until the connection has to end in a way other than `but`.
    pub(crate) async fn closing(&self, but: Close) -> Close {
        let mut close = self.close.subscribe();
        let found = close.wait_for(|&close| close != Close::Open && close != but).await.map(|close| *close);
        match found {
            Ok(close) => close,
            // The sender is part of this connection.
            Err(_) => Close::AtOnce,
        }
    }

    fn ask(&self, close: Close, why: &str) {
        tracing::debug!(peer = %self.peer, "{why}");
        self.asked.store(self.now(), Ordering::Relaxed);
        self.close.send_replace(close);
    }

    /// Closes the connection if something has lasted too long.
    fn check(&self) {
        let now = self.now();
        let over = |since: u64, limit: Duration| since > 0 && now.saturating_sub(since) > as_u64(limit);
        let stuck = lock(&self.unread)
            .iter()
            .filter_map(Weak::upgrade)
            .any(|given| over(given.load(Ordering::Relaxed), UNREAD));
        if stuck {
            return self.ask(Close::AtOnce, "a client does not read its answer: connection closed");
        }
        if self.busy() {
            return;
        }
        let silent = self.silent.load(Ordering::Relaxed);
        if *self.close.borrow() == Close::Gracefully
            && over(self.asked.load(Ordering::Relaxed).max(silent), FAREWELL)
        {
            return self.ask(Close::AtOnce, "a connection did not end: closed");
        }
        match self.protocol.load(Ordering::Relaxed) {
            UNKNOWN if over(silent, FIRST) => {
                self.ask(Close::AtOnce, "a connection sent no request: closed");
            }
            HTTP1 if over(self.head.load(Ordering::Relaxed), HEAD) => {
                self.ask(Close::AtOnce, "the head of a request does not end: connection closed");
            }
            HTTP2 if *self.close.borrow() == Close::Open && over(silent, IDLE_HTTP2) => {
                self.ask(Close::Gracefully, "a connection was silent: closed");
            }
            _ => {}
        }
    }
}

/// A request under way on a connection, from its head to the last piece of its answer.
#[derive(Debug)]
pub(crate) struct UnderWay {
    connection: Arc<Connection>,
    lasting: bool,
    given: Arc<AtomicU64>,
}

impl UnderWay {
    /// A piece of the answer has been handed out.
    pub(crate) fn gave(&self) {
        self.given.store(self.connection.now(), Ordering::Relaxed);
    }

    /// The client is ready for the next piece.
    pub(crate) fn asked(&self) {
        self.given.store(0, Ordering::Relaxed);
    }
}

impl Drop for UnderWay {
    fn drop(&mut self) {
        let connection = &self.connection;
        connection.silent.store(connection.now(), Ordering::Relaxed);
        let kind = if self.lasting { &connection.streams } else { &connection.requests };
        kind.fetch_sub(1, Ordering::Relaxed);
    }
}

/// The place of a connection; free when this is dropped.
#[derive(Debug)]
pub(crate) struct Place {
    connections: Arc<Connections>,
    number: u64,
    /// The connection.
    pub(crate) connection: Arc<Connection>,
}

impl Drop for Place {
    fn drop(&mut self) {
        lock(&self.connections.all).remove(&self.number);
        self.connections.ended.notify_one();
    }
}

impl Connections {
    pub(crate) fn new(limits: ConnectionLimits) -> Arc<Self> {
        Arc::new(Self { limits, start: Instant::now(), all: Mutex::default(), ended: Notify::new() })
    }

    /// The limits in force.
    pub fn limits(&self) -> ConnectionLimits {
        self.limits
    }

    /// Number of open connections.
    pub fn open(&self) -> usize {
        lock(&self.all).len()
    }

    /// Number of requests under way, apart from streams without an end of their own.
    pub fn requests(&self) -> usize {
        lock(&self.all).values().map(|connection| connection.requests.load(Ordering::Relaxed)).sum()
    }

    /// Waits for room in the table: silent connections that have been told to make room take a moment to close their file.
    pub(crate) async fn room(&self) {
        /// Connections beyond the limit, for those that are closing.
        const CLOSING: usize = 16;
        while self.open() >= self.limits.total.saturating_add(CLOSING) {
            let _ = tokio::time::timeout(Duration::from_millis(10), self.ended.notified()).await;
        }
    }

    /// A place for a new connection from `peer`; `None` if all are taken by busy ones.
    pub(crate) fn admit(self: &Arc<Self>, peer: IpAddr, number: u64) -> Option<Place> {
        let mut all = lock(&self.all);
        let staying = |connection: &&Arc<Connection>| *connection.close.borrow() == Close::Open;
        let total = all.values().filter(staying).count();
        let of_peer = all.values().filter(staying).filter(|connection| connection.peer == peer).count();
        let crowded = of_peer >= self.limits.of_peer;
        if crowded || total >= self.limits.total {
            let silent = all.iter().filter(|(_, connection)| {
                staying(connection) && !connection.busy() && (!crowded || connection.peer == peer)
            });
            let longest = silent.min_by_key(|(number, connection)| {
                let served = connection.served.load(Ordering::Relaxed) > 0;
                (served, connection.silent.load(Ordering::Relaxed), **number)
            });
            longest?.1.ask(Close::AtOnce, "a silent connection makes room for a new one");
        }
        let (close, _) = watch::channel(Close::Open);
        let connection = Arc::new(Connection {
            peer,
            start: self.start,
            protocol: AtomicU8::new(UNKNOWN),
            requests: AtomicUsize::new(0),
            streams: AtomicUsize::new(0),
            served: AtomicU64::new(0),
            silent: AtomicU64::new(milliseconds(self.start)),
            head: AtomicU64::new(0),
            asked: AtomicU64::new(0),
            owed: AtomicBool::new(false),
            unread: Mutex::default(),
            close,
        });
        all.insert(number, Arc::clone(&connection));
        drop(all);
        Some(Place { connections: Arc::clone(self), number, connection })
    }

    /// Closes what has lasted too long, once a second, for ever.
    pub(crate) async fn sweep(self: Arc<Self>) {
        let mut interval = tokio::time::interval(Duration::from_secs(1));
        interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            interval.tick().await;
            let all: Vec<_> = lock(&self.all).values().cloned().collect();
            all.iter().for_each(|connection| connection.check());
        }
    }

    /// Asks all connections to end once their requests are over: their clients' certificates are checked anew on others.
    pub fn renew(&self) {
        for connection in lock(&self.all).values() {
            if *connection.close.borrow() == Close::Open {
                connection.ask(Close::Gracefully, "certificates have changed");
            }
        }
    }

    /// Asks all connections to end once their requests are over, and waits until they have.
    pub(crate) async fn drain(&self) {
        for connection in lock(&self.all).values() {
            connection.owed.store(connection.requests.load(Ordering::Relaxed) > 0, Ordering::Relaxed);
            connection.ask(Close::Gracefully, "the port closes");
        }
        while self.open() > 0 {
            let _ = tokio::time::timeout(Duration::from_millis(100), self.ended.notified()).await;
        }
    }

    /// During a drain, the number of connections that wait for clients to leave by themselves, such as those of health watches.
    pub fn watched(&self) -> usize {
        let watched = |connection: &&Arc<Connection>| {
            connection.requests.load(Ordering::Relaxed) == 0 && connection.streams.load(Ordering::Relaxed) > 0
        };
        lock(&self.all).values().filter(watched).count()
    }

    /// During a drain, the number of connections that owe an answer, or the end of one, to their client.
    pub fn owing(&self) -> usize {
        let owes = |connection: &&Arc<Connection>| {
            connection.requests.load(Ordering::Relaxed) > 0
                || connection.owed.load(Ordering::Relaxed) && !connection.busy()
        };
        lock(&self.all).values().filter(owes).count()
    }
}

/// Milliseconds since `start`, at least 1.
fn milliseconds(start: Instant) -> u64 {
    as_u64(start.elapsed()).max(1)
}

fn as_u64(duration: Duration) -> u64 {
    u64::try_from(duration.as_millis()).unwrap_or(u64::MAX)
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peer(last: u8) -> IpAddr {
        IpAddr::from([127, 0, 0, last])
    }

    fn told(place: &Place) -> Close {
        *place.connection.close.borrow()
    }

    #[test]
    fn the_connection_silent_longest_makes_room_and_busy_ones_stay() {
        let connections = Connections::new(ConnectionLimits { total: 3, of_peer: 3 });
        let admit = |number| connections.admit(peer(1), number);
        let busy = admit(0).unwrap();
        let request = busy.connection.begin(false);
        let served = admit(1).unwrap();
        drop(served.connection.begin(false));
        let fresh = admit(2).unwrap();
        // The third never sent a request.
        let next = admit(3).unwrap();
        assert_eq!([told(&busy), told(&served), told(&fresh)], [Close::Open, Close::Open, Close::AtOnce]);
        let under_way = next.connection.begin(false);
        let last = admit(4).unwrap();
        assert_eq!([told(&busy), told(&served), told(&next)], [Close::Open, Close::AtOnce, Close::Open]);
        // All are busy.
        let third = last.connection.begin(false);
        assert!(admit(5).is_none());
        assert_eq!(connections.requests(), 3);
        drop((request, under_way, third));
        assert!(admit(5).is_some());
    }

    #[test]
    fn a_peer_at_its_limit_displaces_its_own_connections_only() {
        let connections = Connections::new(ConnectionLimits { total: 10, of_peer: 2 });
        let other = connections.admit(peer(2), 0).unwrap();
        let first = connections.admit(peer(1), 1).unwrap();
        let second = connections.admit(peer(1), 2).unwrap();
        let _third = connections.admit(peer(1), 3).unwrap();
        assert_eq!([told(&other), told(&first), told(&second)], [Close::Open, Close::AtOnce, Close::Open]);
        let (_a, _b) = (second.connection.begin(false), _third.connection.begin(false));
        assert!(connections.admit(peer(1), 4).is_none());
        assert!(connections.admit(peer(2), 5).is_some());
    }

    #[tokio::test]
    async fn a_drain_waits_for_answers_and_not_for_watches() {
        let connections = Connections::new(ConnectionLimits { total: 10, of_peer: 10 });
        let places: Vec<_> = (0..3).map(|number| connections.admit(peer(1), number).unwrap()).collect();
        let answer = places[0].connection.begin(false);
        let _watch = places[1].connection.begin(true);
        let mut drain = std::pin::pin!(connections.drain());
        assert!(tokio::time::timeout(Duration::from_millis(1), &mut drain).await.is_err());
        assert_eq!((connections.owing(), connections.watched(), told(&places[2])), (1, 1, Close::Gracefully));
        // The answer has been handed out, its last bytes are still to be sent.
        drop(answer);
        assert_eq!((connections.requests(), connections.owing()), (0, 1));
        drop(places);
        drain.await;
        assert_eq!((connections.open(), connections.owing()), (0, 0));
    }
}
