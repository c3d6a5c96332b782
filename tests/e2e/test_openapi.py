"""Requests that schemathesis generates from the OpenAPI document: none breaks the server, and answers match it."""

from __future__ import annotations

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, settings
from schemathesis import Case
from schemathesis.specs.openapi.checks import positive_data_acceptance

from server import Server

BINARY = ["x-npy", "x-npz", "x-tar", "gzip", "zip", "toml"]


@schemathesis.serializer(*(f"application/{name}" for name in BINARY))
def as_bytes(context: object, value: object) -> bytes:
    """Bodies of types that schemathesis does not know."""
    return value if isinstance(value, bytes) else str(value).encode()


@pytest.fixture
def api(server: Server, setup: object) -> schemathesis.BaseSchema:
    return schemathesis.openapi.from_url(f"http://{server.address}/openapi.json")


schema = schemathesis.pytest.from_fixture("api")


@schema.parametrize()
@settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)
def test_answers_are_as_described(case: Case) -> None:
    # No schema can say which sessions there are, how long a design is, or that an upload is a whole set-up.
    case.call_and_validate(timeout=30, excluded_checks=[positive_data_acceptance])
