"""Clients of all languages authenticate and see their own data."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from clients import LANGUAGES, Client, Refused
from server import Server


@pytest.fixture(scope="module")
def tokens(binary: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("access") / "tokens.json"


@pytest.fixture(scope="module")
def server(binary: Path, tokens: Path) -> Iterator[Server]:
    # It has to exist when the server starts.
    token(binary, tokens, "nobody", "reader")
    with Server(binary, "--tokens", str(tokens)) as server:
        yield server
        assert server.stop() == 0


def token(binary: Path, tokens: Path, tenant: str, role: str) -> str:
    command = [str(binary), "token", "--tokens", str(tokens), "create", "--tenant", tenant, "--role", role]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout.strip()


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_token_decides_what_one_sees_and_may_do(
    language: str, binary: Path, tokens: Path, server: Server, setup_folder: Path
) -> None:
    owner, other, reader = (
        token(binary, tokens, f"{who}-{language}", role)
        for who, role in [("owner", "user"), ("other", "user"), ("other", "reader")]
    )
    client = Client(language)
    client("connect", address=server.address)
    with pytest.raises(Refused) as refused:
        client("status")
    assert refused.value.code == "UNAUTHENTICATED"

    client("connect", address=server.address, token=owner)
    setup = client("create_setup", path=str(setup_folder))["setup"]
    session = client("open", setup=setup)["session"]
    before = client("deform", session=session)["vertices"]

    client("connect", address=server.address, token=other)
    assert client("list_setups")["setups"] == client("list_sessions")["sessions"] == []
    for what, field in [("get_setup", "setup_id"), ("resume", "session_id")]:
        with pytest.raises(Refused) as refused:
            client(what, setup=setup, session=session)
        assert refused.value.code == "NOT_FOUND" and refused.value.fields == [field]

    client("connect", address=server.address, token=owner)
    client("get_setup", setup=setup)
    shared = client("share", setup=setup, visibility="tenants", shared_with=[f"other-{language}"])
    assert shared["access"]["shared_with"] == [f"other-{language}"]

    client("connect", address=server.address, token=other)
    seen = client("get_setup", setup=setup)
    assert seen["access"] == {"owned": False, "visibility": "tenants", "shared_with": []}
    own = client("open", setup=setup)["session"]
    assert client("deform", session=own)["vertices"].tobytes() == before.tobytes()

    client("connect", address=server.address, token=reader)
    assert [each["session"] for each in client("list_sessions")["sessions"]] == [own]
    client("resume", session=own)
    with pytest.raises(Refused) as refused:
        client("close", session=own)
    assert refused.value.code == "PERMISSION_DENIED"
    client.close()
