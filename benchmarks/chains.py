"""Scenes for the growth figure: chains of n equal links with all n^2 springs and dampers in use."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from benchmarks.rig import ROOT
from cosim.circuits.boardgen import write_board
from cosim.plan import Plan, resolve
from cosim.scene import load_scene
from mech import Chain

_LENGTH_M = 0.2
_SCENE = """\
title = "{n} joints"
duration_s = {duration}
[device]
board = "board{n}.cir"
linkage = "chain"
[device.chain]
lengths_m = {lengths}
masses_kg = {masses}
coms_m = {coms}
inertias_kg_m2 = {inertias}
rotor_inertia_kg_m2 = {rotors}
[device.start]
q_rad = {q}
[computer]
period_s = 0.005
method = "continuous"
analog_stiffness_n_per_m = 30.0
analog_damping_n_s_per_m = 0.5
[wall]
point_m = {tip}
normal = [-0.6, 0.8]
[operator]
type = "hand"
waypoints_s_m = [[0.0, {x}, {y}], [{duration}, {x1}, {y1}]]
[effects]
opamp = "gbw"
vca = "gbw"
driver_level = "gbw"
motor = "full"
coriolis = true
rotor_inertia = true
operator_dynamics = true
[solver]
max_step_s = 5e-4
"""


def chain_plan(n: int, folder: Path, duration_s: float) -> Plan:
    """Write board and scene for n joints into a folder and return the plan.

    The hand drags the fingertip 5 mm into the wall and 5 mm along it, so that at every sample all springs
    and dampers take new gains.
    """
    shutil.copytree(ROOT / "netlists", folder, dirs_exist_ok=True)
    write_board(n, folder / f"board{n}.cir")
    length = _LENGTH_M / n
    mass = _LENGTH_M / n
    q = [0.9, *([0.8 / max(n - 1, 1)] * (n - 1))]
    chain = Chain(
        lengths_m=(length,) * n,
        masses_kg=(mass,) * n,
        coms_m=(length / 2,) * n,
        inertias_kg_m2=(mass * length**2 / 12,) * n,
    )
    tip = np.asarray(chain.forward(np.array(q))).tolist()
    text = _SCENE.format(
        n=n,
        duration=duration_s,
        lengths=[length] * n,
        masses=[mass] * n,
        coms=[length / 2] * n,
        inertias=[mass * length**2 / 12] * n,
        rotors=[2e-6] * n,
        q=q,
        tip=tip,
        x=tip[0],
        y=tip[1],
        x1=tip[0] + 0.6 * 0.005 + 0.8 * 0.005,
        y1=tip[1] - 0.8 * 0.005 + 0.6 * 0.005,
    )
    scene = folder / f"chain{n}.toml"
    scene.write_text(text, encoding="utf-8")
    return resolve(load_scene(scene))
