"""Driver of the Python clients for the end-to-end tests: see README.md. `driver.py aio` drives those for asyncio."""

from __future__ import annotations

import asyncio
import base64
import inspect
import json
import math
import re
import sys
from typing import Any

import moldline
import moldline.aio
import moldline.panel.aio
import numpy as np

Fields = dict[str, Any]


class Stop(Exception):
    """Cancels a call."""


def array(values: Any) -> Fields:
    values = np.ascontiguousarray(values)
    data = base64.b64encode(values.tobytes()).decode()
    return {"dtype": values.dtype.str, "shape": list(values.shape), "data": data}


def arrays(values: dict[str, Any]) -> Fields:
    return {name: array(each) for name, each in values.items()}


def from_array(given: Fields) -> np.ndarray:
    return np.frombuffer(base64.b64decode(given["data"]), dtype=given["dtype"]).reshape(given["shape"])


def point(arguments: Fields) -> Fields:
    """`design` and `control_points` as keyword arguments."""
    made: Fields = {}
    if "design" in arguments:
        design = arguments["design"]
        made["design"] = from_array(design) if "data" in design else design
    if "control_points" in arguments:
        made["control_points"] = {name: from_array(each) for name, each in arguments["control_points"].items()}
    return made


def access(given: moldline.SetupAccess) -> Fields:
    return {"owned": given.owned, "visibility": given.visibility, "shared_with": list(given.shared_with)}


def of_functions(values: dict[str, Any]) -> Fields:
    """Values of the functions, in the order of the set-up, along the last axis."""
    return array(np.stack(list(values.values()), axis=-1))


async def settled(value: Any) -> Any:
    """A result, awaited if the client is the one for asyncio."""
    return await value if inspect.isawaitable(value) else value


def kept(arguments: Fields, *names: str) -> Fields:
    """Those of the arguments, arrays decoded."""

    def decoded(value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        return from_array(value) if "data" in value else {name: decoded(each) for name, each in value.items()}

    return {name: decoded(arguments[name]) for name in names if name in arguments}


def loads(given: moldline.panel.Loads) -> Fields:
    return array([*given.force, *given.moment, given.lift, given.drag])


def difference(given: moldline.Difference) -> list[float]:
    return [given.step, math.nan if given.error is None else given.error]


def checked_row(row: moldline.CheckedVariable) -> Fields:
    made = {
        "design": row.design,
        "variable": row.variable,
        "numbers": array([row.size, row.dual, float(row.worst_vertex), row.functions]),
        "stages": list(row.stages),
        "stage_errors": array(list(row.stages.values())),
        "first_discrepancy": row.first_discrepancy or "",
        "differences": array([difference(each) for each in row.differences]),
        "best": array([] if row.best is None else difference(row.best)),
    }
    if row.kink is not None:
        kink = row.kink
        made["crease"] = kink.component
        made["kink"] = array([float(kink.vertices), float(kink.worst_vertex), kink.jump, *kink.position, kink.error])
    return made


def described_check(check: moldline.Check) -> Fields:
    return {
        "maxima": array([check.dot_product_max, check.dual_max, check.central_difference_max]),
        "seed": check.seed,
        "designs": [
            {
                "design": array(list(each.design.values())),
                "dot_products": array([[float(dot.block), dot.error] for dot in each.dot_products]),
                "maxima": array([each.dot_product_max, each.dual_max, each.central_difference_max, each.values_max]),
            }
            for each in check.designs
        ],
        "rows": [checked_row(row) for row in check.rows],
        "definition": check.definition,
        "table": check.table(),
    }


def described_analysis(analysis: moldline.panel.Analysis) -> Fields:
    sections = analysis.sections
    return {
        "id": analysis.id,
        "coefficients": array([getattr(analysis.coefficients, name) for name in moldline.panel.COEFFICIENTS]),
        "numbers": array([analysis.wake_lift, analysis.disagreement, analysis.residual]),
        "residuals": array(np.array(analysis.residuals, dtype=float)),
        "total": loads(analysis.total),
        "components": {name: loads(each) for name, each in analysis.components.items()},
        "sections": arrays(
            {
                "edges": sections.edges,
                "middles": sections.middles,
                "spans": sections.spans,
                "loads": sections.loads,
            }
        ),
        "cp": array(analysis.cp),
        "vertex_cp": array(analysis.vertex_cp),
        "supercritical_cells": analysis.supercritical_cells,
        "rounds": analysis.rounds,
        "reused": analysis.reused,
    }


class Driver:
    def __init__(self, module: Any) -> None:
        self._module = module
        self._client: Any = None
        self._panels: Any = None
        self._setups: dict[str, Any] = {}
        self._sessions: dict[str, Any] = {}
        self._deformations: dict[str, moldline.Deformation] = {}
        self._configurations: dict[str, Any] = {}
        self._analyses: dict[str, moldline.panel.Analysis] = {}

    async def run(self, what: str, a: Fields) -> Fields:
        return await getattr(self, what)(a)

    async def connect(self, a: Fields) -> Fields:
        if self._client is not None:
            await settled(self._client.close())
            await settled(self._panels.close())
        retry = moldline.Retry(**{name: a[name] for name in ("attempts", "first_pause", "losses") if name in a})
        tls = moldline.TLS(**a["tls"]) if "tls" in a else False
        timeout = a.get("timeout", 600.0)
        options: Fields = {"token": a.get("token"), "tls": tls, "timeout": timeout, "retry": retry}
        panel = moldline.panel.aio if self._module is moldline.aio else moldline.panel
        # Connections are made on first use.
        self._client = self._module.Client(a["address"], **options)
        self._panels = panel.Client(a["address"], **options)
        self._setups, self._sessions, self._configurations = {}, {}, {}
        return {}

    async def create_setup(self, a: Fields) -> Fields:
        stages, tell = self._progress(a)
        options = {
            name: a[name] for name in ("setup_file", "request_id", "visibility", "shared_with", "timeout") if name in a
        }
        setup = await settled(self._client.create_setup(a["path"], progress=tell, **options))
        return {**self._remember_setup(setup), "stages": stages}

    def _progress(self, a: Fields) -> tuple[list[str], Any]:
        """The stages so far, and a callback that notes them and cancels the call at one of them."""
        stages: list[str] = []
        task = asyncio.current_task()

        def tell(progress: moldline.Progress) -> None:
            if not stages or stages[-1] != progress.stage:
                stages.append(progress.stage)
            if progress.stage == a.get("cancel_at"):
                if self._module is moldline.aio:
                    task.cancel()
                else:
                    raise Stop

        return stages, tell

    async def check(self, a: Fields) -> Fields:
        stages, tell = self._progress(a)
        options = kept(a, "designs", "design", "variables", "seed", "timeout")
        check = await settled(self._setups[a["setup"]].check(**options, progress=tell))
        return {**described_check(check), "stages": stages}

    async def create_configuration(self, a: Fields) -> Fields:
        edges = a.get("trailing_edges", {})
        options = kept(a, "cell_groups", "vertex_groups", "symmetry", "components", "solver", "tolerance", "timeout")
        if "angle" in edges:
            options["trailing_edges"] = moldline.panel.Angle(edges["angle"])
        elif "groups" in edges:
            options["trailing_edges"] = moldline.panel.Groups(*edges["groups"])
        elif "edges" in edges:
            options["trailing_edges"] = moldline.panel.Edges(from_array(edges["edges"]))
        elif "none" in edges:
            options["trailing_edges"] = "none"
        vertices, cells = from_array(a["vertices"]), from_array(a["cells"])
        return self._remember_configuration(
            await settled(self._panels.create_configuration(vertices, cells, **options))
        )

    async def get_configuration(self, a: Fields) -> Fields:
        return self._remember_configuration(await settled(self._panels.get_configuration(a["configuration"])))

    def _remember_configuration(self, configuration: Any) -> Fields:
        self._configurations[configuration.id] = configuration
        return {
            "configuration": configuration.id,
            "vertex_count": configuration.vertex_count,
            "cell_count": configuration.cell_count,
            "unknowns": configuration.unknowns,
            "symmetric": configuration.symmetric,
            "trailing_edges": array(configuration.trailing_edges),
            "roots": array(configuration.roots),
            "solver": configuration.solver,
            "memory": configuration.memory,
            "components": list(configuration.components),
        }

    async def analyze(self, a: Fields) -> Fields:
        stages, tell = self._progress(a)
        options = kept(a, "vertices", "mach", "sideslip", "pressures", "timeout")
        reference = moldline.panel.Reference(**a["reference"])
        configuration = self._configurations[a["configuration"]]
        analyses = await settled(configuration.sweep(a["alphas"], **options, reference=reference, progress=tell))
        self._analyses.update((each.id, each) for each in analyses)
        return {"analyses": [described_analysis(each) for each in analyses], "stages": stages}

    def _analysed(self, a: Fields) -> Any:
        at = a["at"]
        if "analysis" in at:
            return self._analyses[at["analysis"]]
        vertices = from_array(at["vertices"]) if "vertices" in at else None
        reference = moldline.panel.Reference(**at["reference"])
        return moldline.panel.AnalysisPoint(vertices, at["mach"], at["alpha"], at["sideslip"], reference)

    async def panel_jvp(self, a: Fields) -> Fields:
        directions = kept(a, "vertices", "alpha", "sideslip", "mach", "area", "chord", "point", "timeout")
        configuration = self._configurations[a["configuration"]]
        tangents = await settled(configuration.jvp(**directions, at=self._analysed(a)))
        return {
            "coefficients": of_functions(dict(tangents.coefficients)),
            "section_loads": array(tangents.section_loads),
            "cp": array(tangents.cp),
        }

    async def panel_vjp(self, a: Fields) -> Fields:
        seeds = kept(a, "coefficients", "section_loads", "cp", "timeout")
        configuration = self._configurations[a["configuration"]]
        gradients = await settled(configuration.vjp(**seeds, at=self._analysed(a)))
        names = ("vertices", "alpha", "sideslip", "mach", "area", "chord", "point")
        return arrays({name: getattr(gradients, name) for name in names})

    async def get_setup(self, a: Fields) -> Fields:
        return self._remember_setup(await settled(self._client.get_setup(a["setup"])))

    def _remember_setup(self, setup: Any) -> Fields:
        self._setups[setup.id] = setup
        lower, upper = setup.bounds
        return {
            "setup": setup.id,
            "built": setup.built,
            "name": setup.name,
            "access": access(setup.access),
            "report_text": setup.report_text,
            "variables": [variable.name for variable in setup.variables],
            "units": [variable.unit for variable in setup.variables],
            "baseline": array(setup.baseline),
            "lower": array(lower),
            "upper": array(upper),
            "groups": list(setup.groups),
            "components": list(setup.components),
            "control_point_counts": list(setup.control_point_counts.values()),
            "functions": [function.name for function in setup.functions],
            "function_values": array([function.value for function in setup.functions]),
            "vertex_count": setup.vertex_count,
            "cell_count": setup.cell_count,
        }

    async def mesh(self, a: Fields) -> Fields:
        mesh = self._setups[a["setup"]].mesh
        mesh = await mesh() if callable(mesh) else mesh
        seam = mesh.seam.astype("u1")
        return arrays({"vertices": mesh.vertices, "cells": mesh.cells, "cell_owner": mesh.cell_owner, "seam": seam})

    async def control_points(self, a: Fields) -> Fields:
        points = self._setups[a["setup"]].control_points
        return arrays(await points() if callable(points) else points)

    async def list_setups(self, a: Fields) -> Fields:
        setups = [
            {
                "setup": each.id,
                "name": each.name,
                "vertex_count": each.vertex_count,
                "variable_count": each.variable_count,
                "created": each.created.timestamp(),
                "access": access(each.access),
            }
            for each in await settled(self._client.list_setups())
        ]
        return {"setups": setups}

    async def share(self, a: Fields) -> Fields:
        setup = self._setups[a["setup"]]
        await settled(setup.share(a["visibility"], shared_with=a.get("shared_with", ())))
        return {"access": access(setup.access)}

    async def delete_setup(self, a: Fields) -> Fields:
        await settled(self._setups[a["setup"]].delete())
        return {}

    async def open(self, a: Fields) -> Fields:
        options = {name: a[name] for name in ("label", "request_id") if name in a}
        return self._remember_session(await settled(self._setups[a["setup"]].session(**options)))

    async def resume(self, a: Fields) -> Fields:
        return self._remember_session(await settled(self._module.Session.resume(self._client, a["session"])))

    def _remember_session(self, session: Any) -> Fields:
        self._sessions[session.id] = session
        return self._state(session.state)

    def _state(self, state: moldline.SessionState) -> Fields:
        made = {
            "session": state.id,
            "setup": state.setup_id,
            "generation": state.generation,
            "label": state.label,
            "updated": state.updated.timestamp(),
        }
        if state.design is not None:
            made["design"] = array(state.design.design)
            made["control_points"] = arrays(dict(state.design.control_points or {}))
        return made

    async def list_sessions(self, a: Fields) -> Fields:
        return {"sessions": [self._state(state) for state in await settled(self._client.list_sessions())]}

    async def update(self, a: Fields) -> Fields:
        session = self._sessions[a["session"]]
        await settled(session.update(**point(a), label=a.get("label")))
        return self._state(session.state)

    async def refresh(self, a: Fields) -> Fields:
        session = self._sessions[a["session"]]
        await settled(session.refresh())
        return self._state(session.state)

    async def close(self, a: Fields) -> Fields:
        await settled(self._sessions[a["session"]].close())
        return {}

    async def deform(self, a: Fields) -> Fields:
        options = {name: a[name] for name in ("cell_quality", "timeout") if name in a}
        result = await settled(self._sessions[a["session"]].deform(**point(a), **options))
        self._deformations[result.linearisation_id] = result
        q = result.quality.total
        quality = [q.cells, q.aspect_ratio.p95, q.edge_ratio.max, q.min_scaled_jacobian, q.min_angle, q.skew_p95]
        made = {
            "vertices": array(result.vertices),
            "functions": of_functions(result.functions),
            "id": result.linearisation_id,
            "quality": array(np.array([*quality, q.folded, q.inverted], dtype=float)),
            "seam_residual": result.seam_residual,
            "engine_seconds": result.engine_seconds,
        }
        if result.cell_quality is not None:
            made["cell_quality"] = arrays(result.cell_quality)
        return made

    def _at(self, a: Fields) -> Any:
        at = a.get("at", {})
        if "deformation" in at:
            return self._deformations[at["deformation"]]
        return at["id"] if "id" in at else moldline.DesignPoint(**point(at))

    async def jvp(self, a: Fields) -> Fields:
        options: Fields = {}
        if "directions" in a:
            options["directions"] = from_array(a["directions"])
        if "control_points" in a:
            options["control_points"] = {name: from_array(each) for name, each in a["control_points"].items()}
        tangents = await settled(self._sessions[a["session"]].jvp(**options, at=self._at(a)))
        return {"vertices": array(tangents.vertices), "functions": of_functions(tangents.functions)}

    async def vjp(self, a: Fields) -> Fields:
        options: Fields = {name: from_array(a[name]) for name in ("vertices", "functions") if name in a}
        options.update(design=a.get("by_design", True), control_points=a.get("by_control_points", ()))
        gradients = await settled(self._sessions[a["session"]].vjp(**options, at=self._at(a)))
        made: Fields = {"control_points": arrays(gradients.control_points)}
        if gradients.design is not None:
            made["design"] = array(gradients.design)
        return made

    async def jacobian(self, a: Fields) -> Fields:
        fractions: list[float] = []
        tell = lambda progress: fractions.append(progress.fraction)
        result = await settled(self._sessions[a["session"]].jacobian(at=self._at(a), progress=tell))
        return {
            "vertices": array(result.vertices),
            "functions": of_functions(result.functions),
            "fraction": fractions[-1],
        }

    async def status(self, a: Fields) -> Fields:
        status = await settled(self._client.status())
        return {
            "version": status.version,
            "uptime_seconds": status.uptime_seconds,
            "sessions": status.sessions,
            "setups_stored": status.setups_stored,
            "running": status.running,
            "queued": status.queued,
            "linearisation_budget": status.linearisation_cache.budget_bytes,
            "work": [work.kind for work in status.work],
        }


def failed(error: moldline.MoldlineError) -> Fields:
    name = {"InternalError": "Internal"}.get(type(error).__name__, type(error).__name__)
    made: Fields = {
        "code": re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).upper(),
        "message": error.message,
        "violations": [{"field": each.field, "description": each.description} for each in error.violations],
    }
    if error.retry_after is not None:
        made["retry_after"] = error.retry_after
    return made


async def main() -> None:
    driver = Driver(moldline.aio if sys.argv[1:] == ["aio"] else moldline)
    for line in sys.stdin:
        command = json.loads(line)
        answer: Fields
        try:
            # A task of its own, so that one can be cancelled alone.
            answer = {"ok": await asyncio.create_task(driver.run(command.pop("do"), command))}
        except moldline.MoldlineError as error:
            answer = {"error": failed(error)}
        except (Stop, asyncio.CancelledError):
            answer = {"error": {"code": "CANCELLED", "message": "cancelled by the driver", "violations": []}}
        except Exception as error:  # A fault of the driver or of its arguments: the test reports it.
            answer = {"error": {"code": "CLIENT", "message": repr(error), "violations": []}}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    asyncio.run(main())
