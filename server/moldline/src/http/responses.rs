//! The responses that all routes share in the OpenAPI description.

use std::collections::BTreeMap;

use moldline_transport::Problem;
use utoipa::{
    IntoResponses, ToSchema,
    openapi::{ContentBuilder, Ref, RefOr, Response, ResponseBuilder},
};

/// Any other status: an error with its problem document. The components of the description must contain [`Problem`].
pub struct Errors;

impl IntoResponses for Errors {
    fn responses() -> BTreeMap<String, RefOr<Response>> {
        let schema = Ref::from_schema_name(Problem::name());
        let content = ContentBuilder::new().schema(Some(schema)).build();
        let response = ResponseBuilder::new().description("An error.");
        let response = response.content("application/problem+json", content).build();
        BTreeMap::from([("default".to_owned(), response.into())])
    }
}
