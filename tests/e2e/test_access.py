"""Authentication by tokens that the command line creates."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import grpc
import moldline
import pytest
import requests
from moldline.v1 import mesh_service_pb2, mesh_service_pb2_grpc

from server import Server


def token(binary: Path, file: Path, *arguments: str) -> str:
    command = [str(binary), "token", "--tokens", str(file), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout.strip()


def status(server: Server, secret: str | None) -> Any:
    headers = {"Authorization": f"Bearer {secret}"} if secret else {}
    return requests.get(f"http://{server.address}/v1/status", headers=headers, timeout=10)


def test_tokens_are_made_listed_and_revoked_while_the_server_runs(binary: Path, tmp_path: Path) -> None:
    file = tmp_path / "tokens.json"
    anna = token(binary, file, "create", "--tenant", "anna", "--role", "user", "--expires", "90d")
    assert anna not in file.read_text()
    with Server(binary, "--tokens", str(file)) as server:
        assert status(server, None).status_code == 401
        assert status(server, anna).status_code == 200
        bert = token(binary, file, "create", "--tenant", "bert", "--role", "reader")
        assert status(server, bert).status_code == 200
        listed = token(binary, file, "list").splitlines()
        assert [line.split()[1:3] for line in listed] == [["tenant", "role"], ["anna", "user"], ["bert", "reader"]]
        token(binary, file, "revoke", listed[1].split()[0])
        assert status(server, anna).status_code == 401
        assert status(server, bert).status_code == 200

        with grpc.insecure_channel(server.address) as channel:
            stub = mesh_service_pb2_grpc.MeshServiceStub(channel)
            request = mesh_service_pb2.GetStatusRequest()
            assert not stub.GetStatus(request, metadata=[("authorization", f"Bearer {bert}")], timeout=10).all_tenants
            with pytest.raises(grpc.RpcError) as refused:
                stub.GetStatus(request, timeout=10)
            assert refused.value.code() == grpc.StatusCode.UNAUTHENTICATED
        assert server.stop() == 0
        assert not any("no authentication" in line for line in server.log)


def test_with_tokens_a_public_address_is_allowed(binary: Path, tmp_path: Path) -> None:
    file = tmp_path / "tokens.json"
    secret = token(binary, file, "create", "--tenant", "anna", "--role", "admin")
    with Server(binary, "--tokens", str(file), "--listen", "0.0.0.0:0") as server:
        server.address = server.address.replace("0.0.0.0", "127.0.0.1")
        assert status(server, secret).json()["all_tenants"]
        command = [str(binary), "status", "--json", "--server", server.address, "--token", secret]
        shown = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
        assert json.loads(shown.stdout)["sessions"] == 0
        refused = subprocess.run(command[:-2], capture_output=True, text=True, timeout=60)
        assert refused.returncode == 1 and "credential" in refused.stderr
        assert server.stop() == 0
        assert any("in the clear" in line for line in server.log)


def test_status_shows_what_is_there(binary: Path, server: Server, setup: moldline.Setup) -> None:
    with setup.session():
        command = [str(binary), "status", "--server", server.address]
        shown = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
    for words in ["all tenants", "running", "linearisations", "sessions", "nothing runs"]:
        assert words in shown, shown


def test_a_server_that_is_not_there_is_said(binary: Path) -> None:
    command = [str(binary), "status", "--server", "127.0.0.1:1"]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert shown.returncode == 1 and "127.0.0.1:1" in shown.stderr
