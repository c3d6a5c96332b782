"""A store full of closed sessions: opening another one and the metrics take no longer than without them."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import moldline
import numpy as np

import sphere_and_boom
from server import Server
from sockets import ask
from trial import Row

#: Sessions that are opened, and scrapes, for each figure.
SAMPLES = 50


def opened(setup: moldline.Setup) -> float:
    """Median time to open a session, s; they are closed again."""
    times = []
    for _ in range(SAMPLES):
        start = time.perf_counter()
        session = setup.session()
        times.append(time.perf_counter() - start)
        session.close()
    return float(np.median(times))


def scraped(server: Server) -> float:
    """Median time of a scrape, s."""
    return float(np.median([ask(server, "/metrics")[1] for _ in range(SAMPLES)]))


def sessions(binary: Path, folder: Path, short: bool) -> list[Row]:
    """Sessions opened and closed by one tenant, on a folder."""
    count = 500 if short else 100_000
    setup_folder = sphere_and_boom.write(folder / "setup")
    with Server(binary, store=folder / "store") as server, server.client() as client:
        setup = client.create_setup(setup_folder)
        few = opened(setup)
        few_scraped = scraped(server)
        with ThreadPoolExecutor(8) as pool:
            list(pool.map(lambda _: setup.session().close(), range(count)))
        many, many_scraped = opened(setup), scraped(server)
    return [
        Row("open a session, the store empty", 1e3 * few, "ms", timed=True),
        Row(f"open a session, {count} closed before", 1e3 * many, "ms", "<= 10", timed=True),
        Row("scrape of /metrics, the store empty", 1e3 * few_scraped, "ms", timed=True),
        Row(f"scrape of /metrics, {count} closed before", 1e3 * many_scraped, "ms", "<= 20", timed=True),
    ]
