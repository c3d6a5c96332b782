"""Retries, deadlines and credentials of clients of all languages, against a server that misbehaves."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
import trustme

from clients import LANGUAGES, Client, Refused
from fake_server import JACOBIAN, DyingServer, FakeServer, contradiction, refusal


@pytest.fixture(scope="module", params=LANGUAGES)
def client(request: pytest.FixtureRequest) -> Iterator[Client]:
    client = Client(request.param)
    yield client
    client.close()


@pytest.fixture
def server(client: Client) -> Iterator[FakeServer]:
    with FakeServer() as server:
        client("connect", address=server.address, first_pause=0.01)
        yield server


def test_a_full_server_is_asked_again_when_it_says(client: Client, server: FakeServer) -> None:
    server.refusals = 2 * [refusal("RESOURCE_EXHAUSTED", retry_after=0.3)]
    assert client("status")["version"] == "fake"
    assert len(server.calls) == 3
    assert all(after - before >= 0.3 for before, after in pairwise(server.times))


def test_a_server_that_is_away_is_asked_again(client: Client, server: FakeServer) -> None:
    server.refusals = 4 * [refusal("UNAVAILABLE")]
    assert client("status")["version"] == "fake"
    assert len(server.calls) == 5


@pytest.mark.parametrize(
    "refused",
    [
        # Without a delay after which to retry, a retry is pointless.
        refusal("RESOURCE_EXHAUSTED"),
        refusal("INVALID_ARGUMENT"),
        refusal("ABORTED"),
        refusal("INTERNAL", retry_after=0.01),
        refusal("DEADLINE_EXCEEDED"),
        refusal("UNAUTHENTICATED"),
        refusal("PERMISSION_DENIED"),
    ],
    ids=lambda refused: refused.code.name,
)
def test_other_failures_are_final(client: Client, server: FakeServer, refused: Any) -> None:
    server.refusals = [refused]
    with pytest.raises(Refused) as error:
        client("status")
    assert error.value.code == refused.code.name
    assert error.value.message == f"{refused.code.name} on demand"
    assert len(server.calls) == 1


def test_an_error_with_two_texts_is_that_error(client: Client, server: FakeServer) -> None:
    server.refusals = [contradiction("DEADLINE_EXCEEDED")]
    with pytest.raises(Refused) as error:
        client("status")
    assert error.value.code == "DEADLINE_EXCEEDED"


def test_attempts_are_counted(client: Client, server: FakeServer) -> None:
    client("connect", address=server.address, first_pause=0.01, attempts=3)
    server.refusals = 9 * [refusal("UNAVAILABLE", retry_after=0.05)]
    with pytest.raises(Refused) as error:
        client("status")
    assert error.value.code == "UNAVAILABLE"
    assert error.value.message == f"UNAVAILABLE on demand ({server.address}: called 3 times)"
    assert error.value.retry_after == 0.05
    assert len(server.calls) == 3


def test_nobody_waits_beyond_the_timeout(client: Client, server: FakeServer) -> None:
    """The deadline covers all attempts, and the server is told the remaining time."""
    client("connect", address=server.address, first_pause=0.01, timeout=1.0)
    server.refusals = [refusal("UNAVAILABLE", retry_after=0.4), refusal("RESOURCE_EXHAUSTED", retry_after=60.0)]
    start = time.monotonic()
    with pytest.raises(Refused) as error:
        client("status")
    assert time.monotonic() - start < 5
    assert error.value.code == "RESOURCE_EXHAUSTED" and error.value.retry_after == 60.0
    first, second = (call[3] for call in server.calls)
    assert first is not None and second is not None
    # From a second on, gRPC rounds the remaining time up to hundredths.
    assert 0.5 < first <= 1.01 and 0.0 < second <= 0.6


def test_an_address_where_nobody_is_is_unavailable(client: Client) -> None:
    with FakeServer() as server:
        address = server.address
    client("connect", address=address, first_pause=0.01, attempts=2)
    with pytest.raises(Refused) as error:
        client("status")
    assert error.value.code == "UNAVAILABLE"


@pytest.mark.parametrize(("losses", "calls"), [(None, 2), (0, 1), (3, 4)])
def test_a_call_that_kills_its_server_is_repeated_once(client: Client, losses: int | None, calls: int) -> None:
    """Otherwise one call kills a supervised server as often as it comes back."""
    options = {} if losses is None else {"losses": losses}
    with DyingServer() as server:
        client("connect", address=server.address, first_pause=0.02, timeout=30.0, **options)
        with pytest.raises(Refused) as error:
            client("status")
        assert error.value.code == "UNAVAILABLE"
        assert len(server.times) == calls
        assert all(after - before >= 0.2 for before, after in pairwise(server.times)), "there is a pause"
        assert server.address in error.value.message and "the server may have died of" in error.value.message
        assert ("called once" if calls == 1 else f"called {calls} times") in error.value.message


def test_a_stream_that_kills_its_server_is_repeated_once(client: Client, server: FakeServer) -> None:
    session = client("resume", session="one")["session"]
    with DyingServer() as dying:
        client("connect", address=dying.address, first_pause=0.01, timeout=30.0)
        for call, arguments in (("resume", {"session": "one"}), ("get_configuration", {"configuration": "one"})):
            before = len(dying.times)
            with pytest.raises(Refused) as error:
                client(call, **arguments)
            assert error.value.code == "UNAVAILABLE" and len(dying.times) == before + 2
    assert session


def test_refused_connections_cost_no_attempts(client: Client) -> None:
    """A server that is started again, or later, is waited for as long as the timeout allows."""
    with FakeServer() as server:
        address = server.address
    client("connect", address=address, first_pause=0.01, timeout=30.0)
    later = FakeServer(address=address)

    def start() -> None:
        time.sleep(1.5)
        later.__enter__()

    starting = threading.Thread(target=start)
    starting.start()
    try:
        assert client("status")["version"] == "fake"
        assert len(later.calls) == 1
    finally:
        starting.join()
        later.__exit__(None, None, None)
    client("connect", address=address, first_pause=0.01, timeout=0.5)
    with pytest.raises(Refused) as error:
        client("status")
    assert error.value.code in ("UNAVAILABLE", "DEADLINE_EXCEEDED")
    if error.value.code == "UNAVAILABLE":
        assert address in error.value.message and " times)" in error.value.message


def test_a_stream_that_breaks_begins_anew(client: Client, server: FakeServer) -> None:
    session = client("resume", session="one")["session"]
    server.refusals = 2 * [refusal("UNAVAILABLE")]
    result = client("jacobian", session=session)
    assert len(server.calls) == 3
    assert result["vertices"].tobytes() == JACOBIAN.tobytes()
    assert result["fraction"] == 1.0


def test_a_retry_is_the_same_request(client: Client, server: FakeServer) -> None:
    session = client("resume", session="one")["session"]
    server.refusals = [refusal("UNAVAILABLE")]
    assert client("update", session=session, design=np.array([1.0, 2.0]))["generation"] == 8
    first, second = (call[2] for call in server.calls)
    assert first.request_id and first == second
    assert client("update", session=session, label="next")["generation"] == 9
    assert server.calls[2][2].request_id != first.request_id


def test_status_is_told_as_it_is(client: Client, server: FakeServer) -> None:
    status = client("status")
    assert (status["queued"], status["linearisation_budget"], status["work"]) == (3, 1 << 40, ["build", "vjp"])


def test_lists_are_read_page_by_page(client: Client, server: FakeServer) -> None:
    setups = client("list_setups")["setups"]
    assert [each["setup"] for each in setups] == ["set-up 0", "set-up 1", "set-up 2"]


def test_the_token_goes_with_every_call(client: Client, server: FakeServer) -> None:
    client("status")
    assert "authorization" not in server.calls[0][1]
    client("connect", address=server.address, token="mold_secret")
    server.refusals = [refusal("UNAVAILABLE")]
    client("status")
    assert [call[1].get("authorization") for call in server.calls[1:]] == 2 * ["Bearer mold_secret"]


def test_the_panel_client_retries_and_sends_its_token(client: Client, server: FakeServer) -> None:
    client("connect", address=server.address, token="mold_secret", first_pause=0.01)
    server.refusals = [refusal("RESOURCE_EXHAUSTED", retry_after=0.2), refusal("UNAVAILABLE")]
    assert client("get_configuration", configuration="one")["configuration"] == "one"
    assert [call[1].get("authorization") for call in server.calls] == 3 * ["Bearer mold_secret"]
    assert server.times[1] - server.times[0] >= 0.2
    server.refusals = [refusal("PERMISSION_DENIED")]
    with pytest.raises(Refused) as error:
        client("get_configuration", configuration="one")
    assert error.value.code == "PERMISSION_DENIED"


def test_the_panel_clients_deadline_covers_all_attempts(client: Client, server: FakeServer) -> None:
    client("connect", address=server.address, first_pause=0.01, timeout=1.0)
    server.refusals = [refusal("UNAVAILABLE", retry_after=0.4), refusal("RESOURCE_EXHAUSTED", retry_after=60.0)]
    with pytest.raises(Refused) as error:
        client("get_configuration", configuration="one")
    assert error.value.code == "RESOURCE_EXHAUSTED" and error.value.retry_after == 60.0
    first, second = (call[3] for call in server.calls)
    assert first is not None and second is not None
    assert 0.5 < first <= 1.01 and 0.0 < second <= 0.6


@pytest.fixture(scope="module")
def authority() -> trustme.CA:
    return trustme.CA()


@pytest.fixture(scope="module")
def files(authority: trustme.CA, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Credentials of a client: the authority that it trusts, its certificate and key."""
    folder: Path = tmp_path_factory.mktemp("tls")
    own = authority.issue_cert("optimizer.example.org")
    authority.cert_pem.write_to_path(folder / "authorities.pem")
    own.cert_chain_pems[0].write_to_path(folder / "certificate.pem")
    own.private_key_pem.write_to_path(folder / "key.pem")
    return {name: str(folder / f"{name}.pem") for name in ("authorities", "certificate", "key")}


def test_tls_is_spoken_with_whom_one_trusts(client: Client, authority: trustme.CA, files: dict[str, str]) -> None:
    own = authority.issue_cert("meshes.example.org")
    key, chain = own.private_key_pem.bytes(), own.cert_chain_pems[0].bytes()
    trusted = {"authorities": files["authorities"], "server_name": "meshes.example.org"}
    with FakeServer(grpc.ssl_server_credentials([(key, chain)])) as server:
        client("connect", address=server.address, tls=trusted, token="mold_secret")
        assert client("status")["version"] == "fake"
        assert server.calls[0][1]["authorization"] == "Bearer mold_secret"
        for not_trusted in ({"server_name": "meshes.example.org"}, {"authorities": files["authorities"]}):
            # Not an authority that the system knows; and not the name that was dialled.
            client("connect", address=server.address, tls=not_trusted, attempts=1)
            with pytest.raises(Refused) as error:
                client("status")
            assert error.value.code == "UNAVAILABLE"
        assert len(server.calls) == 1


def test_mutual_tls_proves_who_the_client_is(client: Client, authority: trustme.CA, files: dict[str, str]) -> None:
    own = authority.issue_cert("meshes.example.org")
    key, chain = own.private_key_pem.bytes(), own.cert_chain_pems[0].bytes()
    credentials = grpc.ssl_server_credentials([(key, chain)], authority.cert_pem.bytes(), require_client_auth=True)
    with FakeServer(credentials) as server:
        client("connect", address=server.address, tls={**files, "server_name": "meshes.example.org"})
        assert client("status")["version"] == "fake"
        assert server.calls[0][4] == [b"optimizer.example.org"]
        anonymous = {"authorities": files["authorities"], "server_name": "meshes.example.org"}
        client("connect", address=server.address, tls=anonymous, attempts=1)
        with pytest.raises(Refused) as error:
            client("status")
        assert error.value.code == "UNAVAILABLE"
