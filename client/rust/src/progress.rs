//! Progress of long calls, and their results.

use moldline_proto::v1;
use tonic::Streaming;

use crate::{Error, Progress};

/// Callback for the progress of a long call.
pub type Tell = Box<dyn Fn(Progress) + Send + Sync>;

/// A message of a stream that reports progress and ends with a result.
pub enum Event<R> {
    Progress(v1::Progress),
    Result(R),
}

/// Reads a stream to its end, passes progress on, and returns the result.
pub async fn result<M, R>(
    mut stream: Streaming<M>,
    progress: Option<&(dyn Fn(Progress) + Send + Sync)>,
    event: impl Fn(M) -> Option<Event<R>>,
) -> Result<R, Error> {
    let mut result = None;
    while let Some(message) = stream.message().await? {
        match (event(message), progress) {
            (Some(Event::Result(found)), _) => result = Some(found),
            (Some(Event::Progress(v1::Progress { stage, fraction, message })), Some(tell)) => {
                tell(Progress { stage, fraction, message });
            }
            _ => {}
        }
    }
    result.ok_or_else(|| Error::internal("the server ended without a result"))
}
