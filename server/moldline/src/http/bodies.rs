//! Bodies of requests, as documents or as arrays.

use axum::{
    body::{Body, Bytes},
    http::HeaderMap,
};
use moldline_transport::{
    Answer,
    media::{self, Media},
};
use serde::de::DeserializeOwned;

use super::arrays::Arrays;

/// A body with numbers.
pub enum Sent<T> {
    /// JSON.
    Document(T),
    /// Anything else.
    Arrays(Arrays),
}

/// Reads bodies.
#[derive(Clone, Copy, Debug)]
pub struct Bodies {
    /// Most bytes.
    pub most: usize,
}

impl Bodies {
    /// Bytes of a body: numbers take several times as much memory as they have letters in JSON.
    fn limit(self, media: Media) -> usize {
        if media == Media::Json { self.most / 4 } else { self.most }
    }

    /// A body that has to be JSON.
    pub async fn document<T: DeserializeOwned>(self, headers: &HeaderMap, body: Body) -> Answer<T> {
        match Media::sent(headers)? {
            Media::Json => media::json(&media::read(headers, body, self.limit(Media::Json)).await?),
            _ => Err(media::unsupported("this takes application/json")),
        }
    }

    /// A body with numbers; `main` is the name of the array that comes alone.
    pub async fn numbers<T: DeserializeOwned>(
        self,
        headers: &HeaderMap,
        body: Body,
        main: &str,
        shape: Option<&str>,
    ) -> Answer<Sent<T>> {
        let media = Media::sent(headers)?;
        let body: Bytes = media::read(headers, body, self.limit(media)).await?;
        Ok(match media {
            Media::Json => Sent::Document(media::json(&body)?),
            _ if body.is_empty() => Sent::Arrays(Arrays::new(Vec::new())),
            _ => Sent::Arrays(Arrays::new(media::arrays(media, body, main, shape, self.most)?)),
        })
    }
}
