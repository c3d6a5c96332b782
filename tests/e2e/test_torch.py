"""Both services as functions of PyTorch. Its wheel is large: where it is missing, this is left out."""

from __future__ import annotations

from pathlib import Path

import moldline
import numpy as np
import pytest

torch = pytest.importorskip("torch")

import moldline.torch  # noqa: E402

DESIGN = np.array([0.1, 0.05, 0.2])


def test_gradients_are_the_sessions(setup: moldline.Setup) -> None:
    deform = moldline.torch.deform(setup)
    design = torch.tensor(DESIGN, requires_grad=True)
    mesh = deform(design)
    direct = setup.deform(DESIGN)
    assert np.array_equal(mesh.vertices.detach().numpy(), direct.vertices)
    weights = np.random.default_rng(1).normal(size=direct.vertices.shape)
    (
        torch.vdot(torch.tensor(weights).ravel(), mesh.vertices.ravel()) + 3 * mesh.functions["enclosed_volume"]
    ).backward()
    expected = setup.vjp(vertices=weights, functions={"enclosed_volume": 3.0}, at=direct).design
    assert np.array_equal(design.grad.numpy(), expected)


def test_torchs_own_check_of_gradients(setup: moldline.Setup) -> None:
    deform = moldline.torch.deform(setup)

    def outputs(design):
        mesh = deform(design)
        return mesh.vertices[::50], torch.stack(list(mesh.functions.values()))

    design = torch.tensor(DESIGN, requires_grad=True)
    assert torch.autograd.gradcheck(outputs, (design,), eps=1e-5, atol=1e-6, check_forward_ad=True)


def test_the_chain_of_both_services_is_the_direct_chain(binary: Path, setup: moldline.Setup) -> None:
    reference = moldline.panel.Reference(area=4.0, chord=1.0, span=2.0)
    with moldline.panel.serve(binary=binary) as panels:
        mesh = setup.mesh
        configuration = panels.create_configuration(mesh.vertices, mesh.cells, trailing_edges="none", symmetry="none")
        analyze = moldline.torch.analyze(configuration, reference)
        design, alpha = (torch.tensor(x, dtype=torch.float64, requires_grad=True) for x in (DESIGN, 0.03))
        flow = analyze(moldline.torch.deform(setup)(design).vertices, alpha=alpha, mach=0.3)
        (flow.coefficients["pressure_drag"] + 0.1 * (flow.cp**2).sum()).backward()
        moved = setup.deform(DESIGN)
        direct = configuration.analyze(moved.vertices, reference=reference, alpha=0.03, mach=0.3)
        adjoint = configuration.vjp({"pressure_drag": 1.0}, cp=0.2 * direct.cp, at=direct)
        expected = setup.vjp(vertices=adjoint.vertices, at=moved).design
        assert np.abs(design.grad.numpy() - expected).max() <= 1e-14 * np.abs(expected).max()
        assert alpha.grad.item() == pytest.approx(float(adjoint.alpha), rel=1e-13)


def test_wrong_shapes_are_refused(setup: moldline.Setup) -> None:
    with pytest.raises(ValueError, match=r"design has shape \(2,\), expected \(3,\)"):
        moldline.torch.deform(setup)(DESIGN[:2])
