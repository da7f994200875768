"""A page of sliders over the fitted surfaces of a Monte Carlo study: move a component, see measure and yield.

It is a single file, works without a server or a network, and evaluates the surfaces only; their R^2 on
held-out samples and their error are shown beside the results.
"""

import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from cosim.catalogue import UNITS
from cosim.tolerance.intervals import clopper_pearson
from cosim.tolerance.sensitivity import deviations
from cosim.units import pretty
from reports.page import render

if TYPE_CHECKING:
    from cosim.tolerance.study_results import Findings

__all__ = ["SLIDERS", "sliders_page"]

SLIDERS = "sliders.html"

#: Components that get a slider, and samples that are moved with them.
_SLIDERS, _SAMPLES = 10, 500
#: A slider goes to so many times the component's tolerance.
_REACH = 2.0


def sliders_page(findings: "Findings") -> str:
    """Return the page; at most 500 kB, whatever the study's size."""
    data = json.dumps(_data(findings), allow_nan=False, separators=(",", ":"))
    return render("sliders.html.j2", data=data.replace("<", "\\u003c"))


def _data(findings: "Findings") -> dict[str, Any]:
    # of each randomisation as many: their intervals are those of the study
    study, surfaces = findings.study.thinned(_SAMPLES), findings.surfaces
    columns = np.array([study.column(name) for name in surfaces])
    known = np.flatnonzero(np.isfinite(columns).all(axis=0))[:_SAMPLES]
    weight = np.zeros(len(study.tolerances.variables))
    for surface in surfaces.values():
        weight += (surface.linear / surface.total) ** 2
    leading = [int(j) for j in np.argsort(-weight, kind="stable")[:_SLIDERS]]
    place = {j: k for k, j in enumerate(leading)}
    z = deviations(study.tolerances, study.uniforms()[known])[:, leading]
    sliders, components = [], {each.key: each for each in study.tolerances.components}
    for j in leading:
        shape = study.tolerances.shape(j)
        size = max(shape.high, -shape.low)
        # a lot moves many components, an offset has no design to be moved: neither has a value of its own
        own = components.get(study.tolerances.variables[j])
        own = own if own is not None and own.recipe.centre is None else None
        sliders.append(
            {
                "name": study.tolerances.variables[j], "tolerance": shape.text(), "relative": shape.relative,
                "nominal": own.nominal if own is not None else None,
                "unit": pretty(own.unit) if own is not None else "",
                "reach": _REACH * size, "deviation": shape.moments()[1],
            }
        )  # fmt: skip
    shown = [
        {
            "name": name, "title": f"{name.replace('_', ' ')} [{UNITS.get(name) or '1'}]",
            "linear": [float(f"{s.linear[j]:.7g}") for j in leading],
            "second": [
                [place[a], place[b], float(f"{c:.7g}")]
                for (a, b), c in zip(s.terms, s.second, strict=True)
                if a in place and b in place
            ],
            "samples": [float(f"{v:.9g}") for v in study.column(name)[known]],
            "r2": s.held_out, "error": s.total * math.sqrt(max(1.0 - s.held_out, 0.0)),
        }
        for name, s in surfaces.items()
    ]  # fmt: skip
    specs = [
        {
            "measure": spec.measure, "text": spec.text,
            "low": max(spec.low, -1e300), "high": min(spec.high, 1e300),
        }
        for spec in findings.specs if spec.measure in surfaces
    ]  # fmt: skip
    how = study.sampling
    interval = "Clopper and Pearson, for so many independent devices"
    # one without a device that has all measures tells nothing
    groups = known // how.each if how.replicates > 1 else known[:0]
    randomisations = len(np.unique(groups))
    if how.replicates > 1:
        interval = f"Student t over {randomisations} randomisations"
    left_out = int(np.sum(~np.isfinite(columns).all(axis=0)))
    others = f"; {left_out} more lack a measure and are left out here, of a yield too" if left_out else ""
    note = (
        f"{len(known)} devices, model {study.model}{others}. The error is the standard deviation of what a "
        "surface leaves unexplained; far from the design, where no device was, it says nothing. Intervals of "
        f"a yield: 95 %, {interval}."
    )
    return {
        "sliders": sliders, "surfaces": shown, "specs": specs, "note": note,
        "groups": groups.tolist(),
        "replicates": how.replicates, "t": float(stats.t.ppf(0.975, max(randomisations - 1, 1))),
        "bounds": [
            [float(f"{v:.5g}") for v in clopper_pearson(k, len(known))] for k in range(len(known) + 1)
        ],
        "z": [[float(f"{v:.5g}") for v in row] for row in z],
    }  # fmt: skip
