"""Draws the fillet of the smooth outer mold line against rho (Fig. 5 of the paper), on a mesh of about 100,000 cells.

cargo xtask figures
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import moldline
import numpy as np
from PIL import Image

from demo import BARS, ROOT, Server, setup_folder
from render import View, beside, render, text

#: How far the fillet stands off a right-angled seam, metres.
FILLETS = (0.005, 0.03, 0.08)
SIZE = (640, 460)
VIEWS = {
    "wing": View((12.6, 1.5, 0.35), (-0.62, 0.62, 0.50), 2.6),
    "tail": View((28.5, 0.9, 1.6), (-0.55, 0.60, 0.62), 2.6),
}
COLOUR = np.array([0.76, 0.81, 0.87])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="the moldline program")
    parser.add_argument("--mesh", type=Path, required=True, help="folder with mesh.msh and geometry/")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="folder to write to")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)

    rows: dict[str, list[Image.Image]] = {name: [] for name in VIEWS}
    with tempfile.TemporaryDirectory() as work, Server(arguments.binary, Path(work) / "server.log") as server:
        with moldline.Client(server.address) as client:
            for fillet in FILLETS:
                # A wide fillet near the thin trailing edge takes more steps than the usual limit allows.
                options = {"fillet": fillet, "projection_steps": 200}
                folder = setup_folder("setup-motions.toml", "smooth", Path(work), arguments.mesh, **options)
                setup = client.create_setup(folder, progress=BARS)
                with setup.session() as session:
                    result = session.deform()
                print(
                    f"fillet {fillet:g} m: rho {setup.report['rho']:.1f} 1/m, {setup.cell_count} cells\n{result.quality}"
                )
                # One owner, so that shading runs on over the seam as the surface does.
                colours = np.broadcast_to(COLOUR, (setup.cell_count, 3))
                cells = np.asarray(setup.mesh.cells)
                for name, view in VIEWS.items():
                    owner = np.zeros(setup.cell_count, dtype=np.uint32)
                    image = render(np.asarray(result.vertices), cells, owner, colours, view, SIZE, line=0.7)
                    label = f"fillet {1e3 * fillet:g} mm, rho {setup.report['rho']:.0f}/m"
                    text(image, (16, 12), f"{label}, {name}", 20)
                    rows[name].append(image)
    sheet = beside([image for images in rows.values() for image in images], len(FILLETS))
    # Few colours do for shaded grey, and keep the file small.
    sheet.quantize(80).save(arguments.out / "fillet.png", optimize=True)
    print(f"written to {arguments.out / 'fillet.png'}")


if __name__ == "__main__":
    main()
