"""Deforms a mesh as a new user does: with nothing installed but the wheel, and its program from the environment.

python first_mesh.py SETUP_FOLDER
"""

import subprocess
import sys
from pathlib import Path

import moldline
import numpy as np
from moldline.private_server import program


def main(folder: Path) -> None:
    path = program()
    assert path.parent == Path(sys.executable).parent, f"{path} is not the wheel's"
    version = subprocess.run([path, "--version"], check=True, capture_output=True, text=True).stdout.split()[1]
    assert version == moldline.__version__, f"the program is {version}, the client {moldline.__version__}"
    with moldline.serve() as client:
        setup = client.create_setup(folder)
        variable = setup.variables[0]
        result = setup.deform({variable.name: variable.upper})
        travel = np.linalg.norm(result.vertices - setup.mesh.vertices, axis=1).max()
    assert travel > 0, "no vertex moved"
    print(f"{variable.name} = {variable.upper:g} {variable.unit}: vertices moved up to {travel:.2f} m")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
