//! Bodies of answers as the connection takes them: in small pieces, so that what a slow reader has not taken is still here, and
//! counted, and not in the connection's buffers.

use std::{
    pin::Pin,
    task::{Context, Poll, ready},
};

use axum::body::{Body, Bytes};
use http_body::{Body as HttpBody, Frame, SizeHint};

use crate::connections::UnderWay;

/// Largest piece, bytes.
const PIECE: usize = 64 << 10;

/// The body of an answer, and the request that is under way until its end.
pub(crate) struct Answer {
    inner: Body,
    rest: Bytes,
    under_way: UnderWay,
}

impl Answer {
    /// `inner`, with `under_way` until its end.
    pub(crate) fn new(inner: Body, under_way: UnderWay) -> Self {
        Self { inner, rest: Bytes::new(), under_way }
    }
}

impl HttpBody for Answer {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        self.under_way.asked();
        if self.rest.is_empty() {
            match ready!(Pin::new(&mut self.inner).poll_frame(context))
                .map(|frame| frame.map(Frame::into_data))
            {
                None => return Poll::Ready(None),
                Some(Err(error)) => return Poll::Ready(Some(Err(error))),
                Some(Ok(Ok(data))) => self.rest = data,
                Some(Ok(Err(trailers))) => return Poll::Ready(Some(Ok(trailers))),
            }
        }
        self.under_way.gave();
        let length = self.rest.len().min(PIECE);
        Poll::Ready(Some(Ok(Frame::data(self.rest.split_to(length)))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let inner = self.inner.size_hint();
        let rest = self.rest.len() as u64;
        let mut hint = SizeHint::new();
        hint.set_lower(inner.lower() + rest);
        if let Some(upper) = inner.upper() {
            hint.set_upper(upper + rest);
        }
        hint
    }
}
