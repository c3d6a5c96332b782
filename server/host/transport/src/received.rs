//! Bodies of requests as the service reads them: memory is taken for each message before it comes, and a body that comes too
//! slowly is given up. And bodies of answers, which hold the memory of their request to the end.

use std::{
    fmt,
    pin::Pin,
    task::{Context, Poll, ready},
    time::Duration,
};

use axum::{
    body::{Body, Bytes},
    http::{HeaderMap, StatusCode, header},
};
use http_body::{Body as HttpBody, Frame, SizeHint};
use moldline_host::{Code, ServiceError};
use tokio::time::{Instant, Sleep, sleep};

use crate::{
    admit::{Account, Method},
    error_response::{ErrorResponse, is_grpc, status},
};

/// The time over which the pace of a body is measured, while the service waits for it.
const WINDOW: Duration = Duration::from_secs(30);
/// Least number of bytes in that time: 4 KiB/s.
const LEAST: u64 = 120 << 10;

/// The body of a request.
pub(crate) struct Received {
    inner: Body,
    account: Account,
    framing: Framing,
    pace: Pace,
    most: usize,
}

/// How messages lie in a body.
enum Framing {
    /// gRPC: a flag, the length in four bytes, the message.
    Messages { head: [u8; 5], have: usize, left: u64 },
    /// A body as a whole, of which bytes take so many in memory each. `left`: what memory has been taken for.
    Whole { factor: u64, left: u64 },
    /// The service takes the memory.
    Elsewhere,
}

/// A body that is given up.
#[derive(Clone, Debug)]
pub(crate) struct Refused(pub ServiceError);

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl std::error::Error for Refused {}

/// The refusal in an error of a body, as an answer over HTTP.
pub(crate) fn refusal(error: &axum::Error) -> Option<ErrorResponse> {
    let mut source: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(error) = source {
        if let Some(Refused(error)) = error.downcast_ref::<Refused>() {
            let slow = error.code == Code::DeadlineExceeded;
            return Some(match slow {
                true => ErrorResponse::with(StatusCode::REQUEST_TIMEOUT, error.clone()),
                false => error.clone().into(),
            });
        }
        source = error.source();
    }
    None
}

impl Received {
    /// The body of a request to `method`, with messages of `most` bytes.
    ///
    /// # Errors
    /// `ResourceExhausted` if there is no memory for a body of the length that is announced.
    pub(crate) fn new(
        inner: Body,
        headers: &HeaderMap,
        account: Account,
        method: Method,
        most: usize,
    ) -> Result<Self, ServiceError> {
        /// A number in JSON may take two bytes, and 24 in a list of a list.
        const JSON: u64 = 12;
        /// Arrays are decoded to vectors, and those to the engine's.
        const BINARY: u64 = 4;
        let framing = if is_grpc(headers) {
            Framing::Messages { head: [0; 5], have: 0, left: 0 }
        } else if method.streamed {
            Framing::Elsewhere
        } else {
            let kind =
                headers.get(header::CONTENT_TYPE).map(header::HeaderValue::as_bytes).unwrap_or_default();
            let factor = if kind.starts_with(b"application/json") { JSON } else { BINARY };
            // One that is not announced is paid for as it comes; one that is too long is refused by its reader.
            let announced = inner.size_hint().exact().filter(|&length| length <= most as u64).unwrap_or(0);
            account.lock().grow("the body of the request", factor * announced)?;
            Framing::Whole { factor, left: announced }
        };
        Ok(Self { inner, account, framing, pace: Pace::new(), most })
    }

    /// Takes the memory for what begins in `data`.
    fn account(&mut self, data: &[u8]) -> Result<(), ServiceError> {
        match &mut self.framing {
            Framing::Elsewhere => Ok(()),
            Framing::Whole { factor, left } => {
                let more = (data.len() as u64).saturating_sub(*left);
                *left = left.saturating_sub(data.len() as u64);
                self.account.lock().grow("the body of the request", *factor * more)
            }
            Framing::Messages { head, have, left } => {
                let mut rest = data;
                while !rest.is_empty() {
                    if *left > 0 {
                        let skipped = (*left).min(rest.len() as u64);
                        *left -= skipped;
                        rest = &rest[skipped as usize..];
                        continue;
                    }
                    head[*have] = rest[0];
                    *have += 1;
                    rest = &rest[1..];
                    if *have == head.len() {
                        *have = 0;
                        *left = u64::from(u32::from_be_bytes([head[1], head[2], head[3], head[4]]));
                        if *left > self.most as u64 {
                            let message = format!(
                                "the message has {left} bytes, and the limit is {}; send less at a time, or let the server \
                                 take more (--max-message)",
                                self.most
                            );
                            return Err(ServiceError::new(Code::ResourceExhausted, message));
                        }
                        // The message before has been read.
                        let mut share = self.account.lock();
                        share.shrink(0);
                        share.grow("the message", *left + moldline_proto::decoded(*left))?;
                    }
                }
                Ok(())
            }
        }
    }

    fn refuse(&self, error: ServiceError) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Poll::Ready(Some(Err(match self.framing {
            Framing::Messages { .. } => axum::Error::new(status(error)),
            _ => axum::Error::new(Refused(error)),
        })))
    }
}

impl HttpBody for Received {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        match Pin::new(&mut self.inner).poll_frame(context) {
            Poll::Pending => {
                ready!(self.pace.wait(context));
                let seconds = WINDOW.as_secs();
                let message =
                    format!("fewer than {LEAST} bytes of the body came in {seconds} s; it is given up");
                self.refuse(ServiceError::new(Code::DeadlineExceeded, message))
            }
            Poll::Ready(Some(Ok(frame))) => {
                if let Some(data) = frame.data_ref() {
                    self.pace.came(data.len());
                    let data = data.clone();
                    if let Err(error) = self.account(&data) {
                        return self.refuse(error);
                    }
                }
                Poll::Ready(Some(Ok(frame)))
            }
            other => other,
        }
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

/// The pace at which a body comes: time counts while the service waits, whatever it does in between.
struct Pace {
    bytes: u64,
    /// Time waited in this window before the wait under way.
    waited: Duration,
    since: Option<Instant>,
    end: Pin<Box<Sleep>>,
}

impl Pace {
    fn new() -> Self {
        Self { bytes: 0, waited: Duration::ZERO, since: None, end: Box::pin(sleep(WINDOW)) }
    }

    fn came(&mut self, bytes: usize) {
        self.bytes += bytes as u64;
        if let Some(since) = self.since.take() {
            self.waited += since.elapsed();
        }
        if self.bytes >= LEAST {
            (self.bytes, self.waited) = (0, Duration::ZERO);
        }
    }

    /// Ready when too little has come.
    fn wait(&mut self, context: &mut Context<'_>) -> Poll<()> {
        if self.since.is_none() {
            let now = Instant::now();
            self.since = Some(now);
            self.end.as_mut().reset(now + WINDOW.saturating_sub(self.waited));
        }
        self.end.as_mut().poll(context)
    }
}

/// The body of an answer, with the memory of its request.
pub(crate) struct Held {
    inner: Body,
    _account: Account,
}

impl Held {
    pub(crate) fn new(inner: Body, account: Account) -> Self {
        Self { inner, _account: account }
    }
}

impl HttpBody for Held {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.inner).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use axum::body;
    use moldline_host::{Role, Sharing, Supply, Tenant};
    use tokio_stream::{StreamExt, wrappers::ReceiverStream};

    use super::*;

    const METHOD: Method = Method { role: Role::User, streamed: false };

    fn account(limit: u64) -> (std::sync::Arc<Supply>, Account) {
        let supply = Supply::new("bytes", "--memory", limit, Sharing::Alone);
        let share = supply.take(&Tenant::new("anna").unwrap(), "a request", 0).unwrap();
        (supply, Account::of(share))
    }

    fn grpc() -> HeaderMap {
        HeaderMap::from_iter([(header::CONTENT_TYPE, "application/grpc".parse().unwrap())])
    }

    fn message(length: u32) -> Vec<u8> {
        let mut bytes = vec![0];
        bytes.extend_from_slice(&length.to_be_bytes());
        bytes.resize(5 + length as usize, 7);
        bytes
    }

    async fn read(body: Received) -> Result<Bytes, axum::Error> {
        body::to_bytes(Body::new(body), usize::MAX).await
    }

    #[tokio::test]
    async fn memory_is_taken_for_a_message_when_its_length_is_known() {
        let (supply, account) = account(1 << 30);
        let (sender, receiver) = tokio::sync::mpsc::channel::<Bytes>(4);
        let stream = ReceiverStream::new(receiver).map(Ok::<_, Infallible>);
        let received = Received::new(Body::from_stream(stream), &grpc(), account, METHOD, 1 << 20).unwrap();
        let mut body = Body::new(received).into_data_stream();
        // In pieces of one byte.
        let all = message(1000);
        for (i, byte) in all[..5].iter().enumerate() {
            assert_eq!(supply.used(), 0, "{i}");
            sender.send(Bytes::copy_from_slice(&[*byte])).await.unwrap();
            body.next().await.unwrap().unwrap();
        }
        assert_eq!(supply.used(), 1000 + moldline_proto::decoded(1000));
        sender.send(all[5..].to_vec().into()).await.unwrap();
        sender.send(message(10).into()).await.unwrap();
        body.next().await.unwrap().unwrap();
        body.next().await.unwrap().unwrap();
        // The first one has been read by now.
        assert_eq!(supply.used(), 10 + moldline_proto::decoded(10));
        drop(body);
        assert_eq!(supply.used(), 0);
    }

    #[tokio::test]
    async fn messages_beyond_limit_or_memory_are_refused() {
        for (limit, most, length) in [(1 << 30, 999, 1000), (2000, 1 << 20, 1000)] {
            let (_, account) = account(limit);
            let received =
                Received::new(Body::from(message(length)), &grpc(), account, METHOD, most).unwrap();
            let error = tonic::Status::from_error(Box::new(read(received).await.unwrap_err()));
            assert_eq!(error.code(), tonic::Code::ResourceExhausted, "{error}");
        }
    }

    #[tokio::test]
    async fn bodies_are_paid_for_by_length_or_as_they_come() {
        let (supply, account) = account(1000);
        let json = HeaderMap::from_iter([(header::CONTENT_TYPE, "application/json".parse().unwrap())]);
        let received = Received::new(Body::from("x".repeat(50)), &json, account, METHOD, 1 << 20).unwrap();
        assert_eq!(supply.used(), 600);
        read(received).await.unwrap();
        let (_, account) = self::account(1000);
        assert!(Received::new(Body::from("x".repeat(100)), &json, account, METHOD, 1 << 20).is_err());
        let (_, account) = self::account(1000);
        let parts = tokio_stream::iter((0..100).map(|_| Ok::<_, Infallible>(Bytes::from_static(b"x"))));
        let received = Received::new(Body::from_stream(parts), &json, account, METHOD, 1 << 20).unwrap();
        let error = refusal(&read(received).await.unwrap_err()).unwrap();
        assert_eq!(serde_json::to_value(error.problem()).unwrap()["code"], "RESOURCE_EXHAUSTED");
    }

    #[tokio::test(start_paused = true)]
    async fn a_body_that_drips_is_given_up_and_a_slow_one_is_not() {
        // Bytes each second, and whether they arrive.
        for (piece, arrives) in [(1, false), (1 << 10, false), (8 << 10, true)] {
            let (_, account) = account(1 << 30);
            let seconds = tokio_stream::iter(0..100_u32).then(move |_| async move {
                sleep(Duration::from_secs(1)).await;
                Ok::<_, Infallible>(Bytes::from(vec![0; piece]))
            });
            let body = Body::from_stream(seconds);
            let received = Received::new(body, &HeaderMap::new(), account, METHOD, 1 << 20).unwrap();
            let start = Instant::now();
            let outcome = read(received).await;
            assert_eq!(outcome.is_ok(), arrives, "{piece}");
            if !arrives {
                assert!(start.elapsed() < Duration::from_secs(32));
            }
        }
    }
}
