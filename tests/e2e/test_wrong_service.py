"""Clients that reach another service than theirs."""

from __future__ import annotations

import moldline
import moldline.panel
import pytest

from server import Server
from wing import wing


def test_a_panel_client_is_told_that_it_met_the_mesh_service(server: Server) -> None:
    vertices, cells, _ = wing()
    with (
        moldline.panel.Client(server.address) as panels,
        pytest.raises(moldline.MoldlineError, match="mesh service, not its panel service"),
    ):
        panels.create_configuration(vertices, cells)
