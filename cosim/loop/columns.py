"""Columns of what a run records: names, and the rows that compiled code writes."""

from __future__ import annotations

from typing import Any

from cosim.circuits.decks import Drive
from cosim.types import Record
from mech.compiled import inner
from mech.shaft import windup_energy


def columns(drive: Drive, recorded: tuple[str, ...], *, shafts: bool = False) -> list[str]:
    """Names of the columns of `rows`, as `accepted` writes them (tau_*: torques in N m; pot in rad).

    With `shafts` the motors have angles and speeds of their own, qm and vm, at the joint.
    """
    joint = range(1, drive.joints + 1)
    names = ["time", "rule", "x", "y", "fx", "fy"]
    for kind in ("q", "v", "a", "imot", "tau_visc", "tau_coul", "tau_stop", "pot"):
        names += [f"{kind}{j}" for j in joint]
    if shafts:
        names += [f"{kind}{j}" for kind in ("qm", "vm", "tau_shaft") for j in joint] + ["p_shaft", "e_shaft"]
    return names + list(drive.channels) + list(recorded)


def sample_columns(joints: int) -> list[str]:
    """Names of the columns of `samples`, as `_write_sample` writes them."""
    joint = range(1, joints + 1)
    pairs = [f"{a}{b}" for a in joint for b in joint]
    names = ["tick", "time", "contact", "pen", "saturated", "unsolved", "x", "y"]
    for kind in ("q_enc", "v_enc", "u_rad", "cmd_nm"):
        names += [f"{kind}{j}" for j in joint]
    return names + [f"ksp{ab}" for ab in pairs] + [f"ksd{ab}" for ab in pairs]


@inner
def write_row(s: Record, t: float, row: Any) -> int:
    """Write the accepted point into `row`, in the order of `columns`; return where the nodes begin."""
    n = s.n
    row[0] = t
    row[1] = s.used
    row[2], row[3], row[4], row[5] = s.w.r[0], s.w.r[1], s.w.f_op[0], s.w.f_op[1]
    at = 6
    for j in range(n):
        row[at] = s.q[j]
        row[at + n] = s.v[j]
        row[at + 2 * n] = s.a[j]
        row[at + 3 * n] = s.tau[j] / s.torque_per_amp[j]
        row[at + 4 * n] = s.w.tau_visc[j]
        row[at + 5 * n] = s.w.tau_coul[j]
        row[at + 6 * n] = s.w.tau_stop[j]
        row[at + 7 * n] = s.out[j]
        at += 1
    at += 7 * n
    if s.p.shaft_on:
        row[at + 3 * n], row[at + 3 * n + 1] = 0.0, windup_energy(s.p, s.q, s.w)
        for j in range(n):
            rate = s.v[n + j] - s.v[j]
            row[at + j], row[at + n + j], row[at + 2 * n + j] = s.q[n + j], s.v[n + j], s.w.tau_shaft[j]
            row[at + 3 * n] -= s.w.tau_loss[j] * rate
        at += 3 * n + 2
    for i in range(s.dac.count):
        row[at] = s.out[s.dac.first + i]
        at += 1
    return int(at)
