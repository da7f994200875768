"""Measures of devices one at a time, each resolved from its scene: slow, and simple."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cosim.caution import collected
from cosim.comparisons.measuring import measure
from cosim.errors import CosimError, InputError, Problem
from cosim.ngspice.child import Child
from cosim.plan import Plan, resolve

__all__ = ["Batch"]

Array = NDArray[np.float64]


class Batch:
    """Devices that differ in the values of elements of the board."""

    def __init__(
        self, plan: Plan, keys: Sequence[str], measures: Sequence[str], model: str | None = None
    ) -> None:
        wrong = [key for key in keys if ":" in key and not key.endswith((":motor_r", ":motor_l"))]
        if wrong:
            raise InputError(Problem("cannot vary here", key=key) for key in wrong)
        self._plan, self._names = plan, tuple(measures)
        self._model = model or plan.model
        self._keys = [key.replace(":motor_", ".") for key in keys]
        self._child: Child | None = None
        self.failures: dict[int, str] = {}

    def measures(self, values: Array) -> Array:
        """Return the measures (n, measures) of values (n, components)."""
        self.failures = {}
        found = np.full((len(values), len(self._names)), np.nan)
        for k, row in enumerate(values):
            try:
                with collected(forward=False):
                    got = measure(self._of(row), self._names, child=self._child)
            except CosimError as error:
                self.failures[k] = str(error)
                continue
            cells = [got.rows.get(name, {}).get("value", math.nan) for name in self._names]
            found[k] = [float(cell) for cell in cells]
        return found

    def _of(self, row: Array) -> Plan:
        scene = self._plan.scene
        own = dict(zip(self._keys, (repr(float(v)) for v in row), strict=True))
        device = scene.device.model_copy(update={"values": {**scene.device.values, **own}})
        solver = scene.solver.model_copy(update={"model": type(scene.solver.model)(self._model)})
        return resolve(scene.model_copy(update={"device": device, "solver": solver}), trust=self._plan.trust)

    def close(self) -> None:
        """Nothing is held."""
