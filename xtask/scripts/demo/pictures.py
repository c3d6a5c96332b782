"""Pictures of the demo: the whole aircraft of a case and close-ups of its wing junction."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import moldline
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from render import View, beside, colour_bar, ramp, render, text

#: Colours of components, in order.
PALETTE = np.array([[0.74, 0.80, 0.88], [0.95, 0.72, 0.38], [0.44, 0.74, 0.67], [0.80, 0.62, 0.78], [0.72, 0.78, 0.45]])
#: Aspect ratios of the ends of the colour scale.
ASPECT = (1.0, 3.0)
#: Middle of the wing's root in the reference geometry, on the junction's starboard side, metres.
ROOT = np.array([13.9, 1.1, 0.25])


@dataclass(frozen=True)
class Drawing:
    """A case to draw."""

    name: str
    mold_line: str
    folder: Path
    vertices: NDArray[np.float64]
    mesh: moldline.Mesh
    cell_quality: dict[str, NDArray[np.float64]]
    design: dict[str, float]


def caption(design: dict[str, float], mold_line: str) -> str:
    """A design in words."""
    parts = []
    if translation := design.get("wing.translation"):
        parts.append(f"wing {translation:+g} m")
    if rotation := design.get("wing.rotation"):
        parts.append(f"wing and tail {rotation:+g}\N{DEGREE SIGN}")
    if "fuselage.diameter_ratio" in design:
        parts.append(f"fuselage diameter {100 * design['fuselage.diameter_ratio']:g} %")
    return f"{', '.join(parts) or 'baseline'} ({mold_line})"


def draw(drawing: Drawing) -> None:
    """Writes `<case>-junction.png`, and `<case>.png` too unless it would look like that of the sharp outer mold line."""
    title = caption(drawing.design, drawing.mold_line)
    if drawing.mold_line == "sharp":
        image = aircraft(drawing.mesh, drawing.vertices)
        text(image, (32, image.height - 60), title, 30)
        image.save(drawing.folder / f"{drawing.name}.png")

    aspect = drawing.cell_quality["aspect_ratio"]
    colours = ramp(aspect, *ASPECT)
    at = ROOT + [drawing.design.get("wing.translation", 0.0), 0, 0]
    images = []
    for towards, where in (((-0.50, 0.70, 0.55), "from above"), ((-0.30, 0.60, -0.72), "from below")):
        centre = at if towards[2] > 0 else at - [0, 0.7, 0.3]
        image = mesh_image(drawing.mesh, drawing.vertices, colours, View(tuple(centre), towards, 5.0), (960, 740))
        text(image, (28, 20), f"{title}, {where}")
        images.append(image)
    colour_bar(images[-1], *ASPECT, "aspect ratio")
    beside(images, 2).save(drawing.folder / f"{drawing.name}-junction.png")


def aircraft(mesh: moldline.Mesh, vertices: NDArray[np.float64], size: tuple[int, int] = (1440, 900)) -> Image.Image:
    """The whole aircraft, coloured by component."""
    view = View((15.6, 0.0, 1.9), (-0.55, 0.58, 0.60), 20.5)
    return mesh_image(mesh, vertices, PALETTE[mesh.cell_owner % len(PALETTE)], view, size)


def mesh_image(
    mesh: moldline.Mesh, vertices: NDArray, colours: NDArray, view: View, size: tuple[int, int], **lines: Any
) -> Image.Image:
    return render(
        np.asarray(vertices), np.asarray(mesh.cells), np.asarray(mesh.cell_owner), colours, view, size, **lines
    )


def overview(folder: Path, names: list[str]) -> None:
    """All cases on one sheet, `overview.png`."""
    images = [Image.open(folder / f"{name}.png") for name in names if (folder / f"{name}.png").exists()]
    if images:
        small = [image.resize((image.width // 2, image.height // 2), Image.Resampling.LANCZOS) for image in images]
        beside(small, 3).save(folder / "overview.png")
