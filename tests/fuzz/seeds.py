"""Writes the seed corpus, a folder for each target: small files of every kind that it reads, from the repository.

python tests/fuzz/seeds.py FOLDER
"""

from __future__ import annotations

import io
import json
import sys
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tomllib

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests" / "e2e"))

import sphere_and_boom  # noqa: E402


def setup(scratch: Path) -> Iterator[bytes]:
    """0: TOML, 1: JSON."""
    for path in sorted([*ROOT.glob("examples/e175/*.toml"), *ROOT.glob("tests/configurations/*/setup.toml")]):
        yield b"\0" + path.read_bytes()
    # All in one file, patches and mesh too: the operations of the E175 on something small.
    document = tomllib.loads((ROOT / "examples/e175/setup.toml").read_text())
    wing = json.loads((ROOT / "tests/configurations/half/geometry/wing.json").read_text())
    document["components"] = [
        {"name": "fuselage", "primitive": {"type": "capsule", "start": [0, 0, 0], "end": [9, 0, 0], "radius": 1}},
        {"name": "wing", "patches": wing["patches"], "open": True},
        {"name": "htail", "primitive": {"type": "box", "low": [8, -1, 0], "high": [9, 1, 0.1]}},
    ]
    vertices, cells = sphere_and_boom.mesh(rings=2)
    document["mesh"] = {"vertices": vertices.round(3).tolist(), "cells": cells, "vertex_groups": {"nose": [0, 1]}}
    yield b"\1" + json.dumps(document).encode()


def mesh(scratch: Path) -> Iterator[bytes]:
    """0: MSH, 1: VTU, 2: STL."""
    for kind, ending in enumerate(["msh", "vtu", "stl"]):
        for path in sorted((ROOT / "server/engine/mesh/tests/fixtures").glob(f"*.{ending}")):
            yield bytes([kind]) + path.read_bytes()


def archive(scratch: Path) -> Iterator[bytes]:
    """0: tar, 1: tar.gz, 2: zip."""
    half, whole = ROOT / "tests/configurations/half", sphere_and_boom.write(scratch / "archived", rings=2)
    for folder in (half, whole):
        paths = sorted(path for path in folder.rglob("*") if path.suffix in (".toml", ".json"))
        files = {path.relative_to(folder).as_posix(): path for path in paths}
        files["mesh.msh"] = ROOT / "server/engine/mesh/tests/fixtures/box_v41_ascii.msh"
        for kind, mode in enumerate(["w", "w:gz"]):
            buffer = io.BytesIO()
            with tarfile.open(fileobj=buffer, mode=mode) as tar:
                for name, path in files.items():
                    tar.add(path, f"top/{name}" if kind else name)
            yield bytes([kind]) + buffer.getvalue()
        for compression in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            buffer = io.BytesIO()
            with zipfile.ZipFile(buffer, "w", compression) as packed:
                for name, path in files.items():
                    packed.write(path, name)
            yield b"\2" + buffer.getvalue()


def body(scratch: Path) -> Iterator[bytes]:
    """0: JSON, 1: .npy, 2: .npz, 3: bytes, whose first half is the shape."""
    vector, matrix = np.arange(3.0), np.arange(6.0).reshape(2, 3)
    for array in (vector, matrix, np.zeros((0, 3)), np.float64(1.5)):
        yield b"\0" + json.dumps(array.tolist()).encode()
        buffer = io.BytesIO()
        np.save(buffer, array)
        yield b"\1" + buffer.getvalue()
    for save in (np.savez, np.savez_compressed):
        buffer = io.BytesIO()
        save(buffer, design=vector, vertices=matrix)
        yield b"\2" + buffer.getvalue()
    yield b"\3" + b"3".ljust(24) + vector.tobytes()
    yield b"\3" + b"2,3".ljust(48) + matrix.tobytes()


def step(scratch: Path) -> Iterator[bytes]:
    """What follows `DATA;`: a box of loose surfaces, and a unit."""
    corner = np.array([[[[x, y, z] for z in (0.0, 1.0)] for y in (0.0, 1.0)] for x in (0.0, 1.0)])
    lines = [
        "#1=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNIT_ASSIGNED_CONTEXT((#2)));",
        "#2=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));",
    ]
    surfaces = []
    for axis in range(3):
        for points in np.moveaxis(corner, axis, 0):
            names = [f"#{len(lines) + k + 1}" for k in range(5)]
            for name, point in zip(names, points.reshape(4, 3), strict=False):
                lines.append(f"{name}=CARTESIAN_POINT('',({','.join(f'{x:.1f}' for x in point)}));")
            a, b, c, d, surface = names
            net = f"(({a},{b}),({c},{d})),.UNSPECIFIED.,.F.,.F.,.F."
            knots = "(2,2),(2,2),(0.,1.),(0.,1.),.UNSPECIFIED."
            lines.append(f"{surface}=B_SPLINE_SURFACE_WITH_KNOTS('Surf_ABCDEFGHIJ, Box, 0',1,1,{net},{knots});")
            surfaces.append(surface)
    yield "\n".join(lines).encode()
    grouped = [*lines, f"#{len(lines) + 1}=GEOMETRIC_SET('ABCDEFGHIJ, Box, 0',({','.join(surfaces)}));"]
    yield "\n".join(grouped).encode()


def iges(scratch: Path) -> Iterator[bytes]:
    """What follows the start section: one bilinear surface."""
    parameters = (
        "128,1,1,1,1,0,0,1,0,0,0.,0.,1.,1.,0.,0.,1.,1.,1.,1.,1.,1.,0.,0.,0.,1.,0.,0.,0.,1.,0.,1.,1.,0.,0.,1.,0.,1.;"
    )
    pieces = [parameters[k : k + 64] for k in range(0, len(parameters), 64)]
    lines = [f"{',,,,,,,,,,,,,6,1HM;':72}G      1"]
    lines += ["".join(f"{f:>8}" for f in (128, 1, 0, 0, 0, 0, 0, 0, 0)) + "D      1"]
    lines += ["".join(f"{f:>8}" for f in (128, 0, 0, len(pieces), 0, "", "", "", 0)) + "D      2"]
    lines += [f"{piece:64}{1:>8}P{k + 1:>7}" for k, piece in enumerate(pieces)]
    yield "\n".join(lines).encode()


def main() -> None:
    folder = Path(sys.argv[1])
    for target in (setup, mesh, archive, body, step, iges):
        seeds = folder / target.__name__
        seeds.mkdir(parents=True, exist_ok=True)
        for index, seed in enumerate(target(folder / "scratch")):
            (seeds / f"{index:02}").write_bytes(seed)


if __name__ == "__main__":
    main()
