//! Bodies of requests: documents or arrays.

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
    /// A JSON document.
    Document(T),
    /// Arrays of any other type.
    Arrays(Arrays),
}

/// Reads bodies.
#[derive(Clone, Copy, Debug)]
pub struct Bodies {
    /// Largest length of a body, bytes.
    pub most: usize,
}

impl Bodies {
    /// Largest length of a body of this type. JSON has a smaller one, since its numbers take several times their text in memory.
    fn limit(self, media: Media) -> usize {
        if media == Media::Json { self.most / 4 } else { self.most }
    }

    /// Reads a body that must be JSON.
    pub async fn document<T: DeserializeOwned + Send + 'static>(
        self,
        headers: &HeaderMap,
        body: Body,
    ) -> Answer<T> {
        match Media::sent(headers)? {
            Media::Json => {
                let body = media::read(headers, body, self.limit(Media::Json)).await?;
                media::beside(body.len(), move || media::json(&body)).await
            }
            _ => Err(media::unsupported("this takes application/json")),
        }
    }

    /// Reads a document or arrays; `main` names an array that is sent alone, and `shape` has its extents.
    pub async fn numbers<T: DeserializeOwned + Send + 'static>(
        self,
        headers: &HeaderMap,
        body: Body,
        main: &str,
        shape: Option<&str>,
    ) -> Answer<Sent<T>> {
        let media = Media::sent(headers)?;
        let body: Bytes = media::read(headers, body, self.limit(media)).await?;
        let length = body.len();
        let (main, shape) = (main.to_owned(), shape.map(str::to_owned));
        let read = move || {
            Ok(match media {
                Media::Json => Sent::Document(media::json(&body)?),
                _ if body.is_empty() => Sent::Arrays(Arrays::new(Vec::new())),
                _ => {
                    let arrays = media::arrays(media, body, &main, shape.as_deref(), self.most)?;
                    Sent::Arrays(Arrays::new(arrays))
                }
            })
        };
        media::beside(length, read).await
    }
}
