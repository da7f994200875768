"""Linkage and operator as circuit elements.

One node a link, in *absolute* link angles phi_i = q_1 + ... + q_i: the voltage of node `alpha_i` is the
angular acceleration of link i, a current into it is a torque on the link, a conductance is an inertia.
Kirchhoff's law at the node is then the equation of motion

    sum_j A_ij (cos(phi_i - phi_j) alpha_j + sin(phi_i - phi_j) omega_j^2) + gravity = torques on link i

(A: `couple` of `mech.records`). A joint lies between its two links, so a motor, a rotor (a conductance) and a
friction connect node i-1 to node i. All that is linear is a linear element; only the links' mutual terms and
the fingertip's lever arms are B-sources. Speeds `w_i` and angles `phi_i` are the voltages of 1 F capacitors.

A rotor behind a shaft is a capacitor of its inertia, its speed `wm_i` the voltage, torques the currents.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mech.records import OperatorKind

Vector = NDArray[np.float64]


def number(value: float) -> str:
    """Return a number with all its digits."""
    return repr(float(value))


@dataclass
class Netlist:
    """Elements under construction; each gets a running number, so that names never clash."""

    lines: list[str]

    def note(self, text: str) -> None:
        """Add a comment."""
        self.lines.append(f"* {text}")

    def add(self, kind: str, rest: str) -> None:
        """Add an element of a kind (its letter) with nodes and value."""
        self.lines.append(f"{kind}m{len(self.lines)} {rest}")

    def gain(self, source: str, sink: str, plus: str, minus: str, value: float) -> None:
        """Let a current of value * (v(plus) - v(minus)) flow from node `source` into node `sink`."""
        if value != 0.0:
            self.add("G", f"{source} {sink} {plus} {minus} {number(value)}")

    def sum_node(self, node: str) -> None:
        """Make a node whose voltage is the sum of the currents into it."""
        self.add("R", f"{node} 0 1")

    def sine(self, node: str, function: str, angle: str) -> None:
        """Make a node that is cos or sin of another's voltage."""
        self.add("B", f"0 {node} i={function}(v({angle}))")
        self.sum_node(node)


def mechanics(p: Any, op: Any, q: Vector, v: Vector, gear: float, kt: float, speeds: bool) -> list[str]:
    """Return the elements of linkage and operator, from currents `imot` to pins `pot` and `vel`.

    Parameters
    ----------
    p, op
        Records `LINKAGE` and `OPERATOR`.
    q, v
        Start, joint angles and speeds [rad, rad/s].
    gear, kt
        Of the motors [motor turns per joint turn, N m/A].
    speeds
        Whether the board's pins `vel` are driven.
    """
    net = Netlist([])
    n = int(p["n"])
    phi, rate = np.cumsum(q[:n]), np.cumsum(v[:n])
    for i in range(1, n + 1):
        net.note(f"link {i}: angle, speed, acceleration")
        net.add("C", f"phi{i} 0 1")
        net.gain("0", f"phi{i}", f"w{i}", "0", 1.0)
        net.add("C", f"w{i} 0 1")
        net.gain("0", f"w{i}", f"alpha{i}", "0", 1.0)
        net.lines.append(f".ic v(phi{i})={number(phi[i - 1])} v(w{i})={number(rate[i - 1])}")
        _joint(net, p, i, gear, kt, speeds)
        if p["shaft_on"]:  # starts with its joint
            net.lines.append(f".ic v(qm{i})={number(q[i - 1])} v(wm{i})={number(v[i - 1])}")
    if p["slider"]:
        _slider(net, p, op)
    else:
        _chain(net, p, op)
    _operator(net, p, op)
    return net.lines


def _joint(net: Netlist, p: Any, i: int, gear: float, kt: float, speeds: bool) -> None:
    """Motor, rotor and friction of joint i, and what its potentiometer and its motor's speed are."""

    def below(name: str) -> str:
        return f"{name}{i - 1}" if i > 1 else "0"

    here, base = f"alpha{i}", below("alpha")
    if p["shaft_on"]:
        _shaft(net, p, i, gear * kt, below)
    else:
        net.gain(base, here, f"imot{i}", "0", kt * gear)
    if p["armature"][i - 1] > 0.0:
        net.add("R", f"{here} {base} {number(1.0 / p['armature'][i - 1])}")
    if p["viscous_on"]:
        net.gain(here, base, f"w{i}", below("w"), p["viscous"][i - 1])
    if p["coulomb_on"] and p["coulomb"][i - 1] > 0.0:
        speed = f"v(w{i})" if i == 1 else f"v(w{i},w{i - 1})"
        step = number(p["coulomb_speed"])
        net.add("B", f"{here} {base} i={number(p['coulomb'][i - 1])}*tanh({speed}/{step})")
    net.add("E", f"pot{i} 0 phi{i} {below('phi')} 1")
    if speeds:
        turning = f"wm{i} 0" if p["shaft_on"] else f"w{i} {below('w')}"
        net.add("E", f"vel{i} 0 {turning} {number(gear)}")


def _shaft(net: Netlist, p: Any, i: int, torque_per_amp: float, below: Callable[[str], str]) -> None:
    """Rotor i, a capacitor of its inertia, and the spring and damper between it and joint i."""
    net.note(f"motor {i}: angle, speed, torque of its shaft")
    net.add("C", f"qm{i} 0 1")
    net.gain("0", f"qm{i}", f"wm{i}", "0", 1.0)
    net.add("C", f"wm{i} 0 {number(p['rotor'][i - 1])}")
    net.gain("0", f"wm{i}", f"imot{i}", "0", torque_per_amp)
    torque, damping = f"shaft{i}", p["shaft_damping"][i - 1]
    net.sum_node(torque)
    net.gain("0", torque, f"qm{i}", f"pot{i}", p["shaft_stiffness"][i - 1])
    net.gain("0", torque, f"wm{i}", f"w{i}", damping)
    if i > 1:
        net.gain("0", torque, below("w"), "0", damping)
    net.gain(f"wm{i}", "0", torque, "0", 1.0)
    net.gain(below("alpha"), f"alpha{i}", torque, "0", 1.0)


def _slider(net: Netlist, p: Any, op: Any) -> None:
    net.note("slider: inertia, weight, force at the fingertip")
    arm = p["length"][0] * p["direction"]
    inertia = p["couple"][0, 0] + op["mass"] * p["length"][0] ** 2
    net.add("R", f"alpha1 0 {number(1.0 / inertia)}")
    weight = p["moment"][0] * float(p["gravity"] @ p["direction"])
    if p["heavy"] and weight != 0.0:
        net.add("I", f"0 alpha1 dc {number(weight)}")
    for k, axis in enumerate("xy"):
        net.sum_node(axis)
        net.gain("0", axis, "phi1", "0", arm[k])
        _constant(net, axis, p["origin"][k])
        if op["kind"] == OperatorKind.NONE:
            continue
        net.gain("0", "alpha1", f"h{axis}", "0", arm[k])
        if op["damping"] != 0.0:
            net.sum_node(f"d{axis}")
            net.gain("0", f"d{axis}", "w1", "0", arm[k])


def _chain(net: Netlist, p: Any, op: Any) -> None:
    n = int(p["n"])
    links = range(1, n + 1)
    length = p["length"]
    held = op["kind"] != OperatorKind.NONE
    net.note("chain: directions of the links, inertias, fingertip")
    for i in links:
        net.sine(f"c{i}", "cos", f"phi{i}")
        net.sine(f"s{i}", "sin", f"phi{i}")
    couple = p["couple"] + op["mass"] * np.outer(length, length)
    for i in links:
        net.add("R", f"alpha{i} 0 {number(1.0 / couple[i - 1, i - 1])}")
        if p["heavy"]:
            net.gain(f"alpha{i}", "0", f"s{i}", "0", p["moment"][i - 1] * p["gravity"][0])
            net.gain(f"alpha{i}", "0", f"c{i}", "0", -p["moment"][i - 1] * p["gravity"][1])
        terms = [_mutual(i, j, couple[i - 1, j - 1], bool(p["coriolis"])) for j in links if j != i]
        if held:
            terms.append(f"{number(length[i - 1])}*(v(s{i})*v(hx)-v(c{i})*v(hy))")
        if terms:
            net.add("B", f"alpha{i} 0 i={'+'.join(terms)}")
    for axis, direction in (("x", "c"), ("y", "s")):
        net.sum_node(axis)
        for i in links:
            net.gain("0", axis, f"{direction}{i}", "0", length[i - 1])
        _constant(net, axis, p["origin"]["xy".index(axis)])
    if held and op["damping"] != 0.0:
        for axis, sign, direction in (("x", "-", "s"), ("y", "", "c")):
            moved = "+".join(f"{number(length[i - 1])}*v({direction}{i})*v(w{i})" for i in links)
            net.add("B", f"0 d{axis} i={sign}({moved})")
            net.sum_node(f"d{axis}")


def _mutual(i: int, j: int, couple: float, coriolis: bool) -> str:
    """Torque that link j takes from link i."""
    text = f"(v(c{i})*v(c{j})+v(s{i})*v(s{j}))*v(alpha{j})"
    if coriolis:
        text += f"+(v(s{i})*v(c{j})-v(c{i})*v(s{j}))*v(w{j})*v(w{j})"
    return f"{number(couple)}*({text})"


def _operator(net: Netlist, p: Any, op: Any) -> None:
    """Force of the operator on the device at nodes `hx` and `hy`, without the inertia of its mass."""
    kind = OperatorKind(int(op["kind"]))
    if kind is OperatorKind.NONE:
        return
    net.note(f"operator: {kind.name.lower()}")
    for k, axis in enumerate("xy"):
        node = f"h{axis}"
        net.sum_node(node)
        _constant(net, node, op["falls"] * op["mass"] * p["gravity"][k])
        if kind is OperatorKind.HAND:
            if op["paths"] > 0:
                net.gain(node, "0", axis, "0", op["stiffness"])
            if op["damping"] != 0.0:
                net.gain(node, "0", f"d{axis}", "0", op["damping"])
    if kind is OperatorKind.HAND:
        _intention(net, op)
    _felt(net, p, op)


def _felt(net: Netlist, p: Any, op: Any) -> None:
    """Force `fx`, `fy` that the device feels: with the inertia of the operator's mass."""
    mass = float(op["mass"])
    links = range(1, int(p["n"]) + 1)
    for k, axis in enumerate("xy"):
        node = f"f{axis}"
        net.sum_node(node)
        net.gain("0", node, f"h{axis}", "0", 1.0)
        if mass == 0.0:
            continue
        if p["slider"]:
            net.gain(node, "0", "alpha1", "0", mass * p["length"][0] * p["direction"][k])
            continue
        along, across, sign = ("c", "s", "-") if axis == "x" else ("s", "c", "")
        terms = []
        for i in links:
            pull = f"-v({along}{i})*v(w{i})*v(w{i})" if p["coriolis"] else ""
            terms.append(f"{number(mass * p['length'][i - 1])}*({sign}v({across}{i})*v(alpha{i}){pull})")
        net.add("B", f"{node} 0 i={'+'.join(terms)}")


def _constant(net: Netlist, node: str, value: float) -> None:
    if value != 0.0:
        net.add("I", f"0 {node} dc {number(value)}")


def _intention(net: Netlist, op: Any) -> None:
    """Intended path (minimum jerk from waypoint to waypoint) and intended force, as functions of time."""
    path = op["path"][: int(op["paths"])]
    for k, axis in enumerate("xy"):
        if len(path):
            _constant(net, f"h{axis}", op["stiffness"] * path[0, k + 1])
    for k in range(1, len(path)):
        t0, t1 = path[k - 1, 0], path[k, 0]
        step = path[k, 1:] - path[k - 1, 1:]
        if not step.any():
            continue
        net.note(f"move {k}: share of the time, of the way, and speed")
        net.add("V", f"part{k} 0 {_ramp(t0, t1)}")
        x = f"v(part{k})"
        net.add("B", f"0 way{k} i={x}*{x}*{x}*(10+{x}*(6*{x}-15))")
        net.sum_node(f"way{k}")
        if op["damping"] != 0.0:
            net.add("B", f"0 pace{k} i=({x}*(1-{x}))*({x}*(1-{x}))")
            net.sum_node(f"pace{k}")
        for axis, length in zip("xy", step, strict=True):
            net.gain("0", f"h{axis}", f"way{k}", "0", op["stiffness"] * length)
            if op["damping"] != 0.0:
                net.gain("0", f"h{axis}", f"pace{k}", "0", op["damping"] * 30.0 / (t1 - t0) * length)
    force = op["force"][: int(op["forces"])]
    for k, axis in enumerate("xy"):
        if len(force) == 1:
            _constant(net, f"h{axis}", force[0, k + 1])
        elif force[:, k + 1].any():
            corners = " ".join(f"{number(row[0])} {number(row[k + 1])}" for row in force)
            net.add("I", f"0 h{axis} pwl({corners})")


def _ramp(t0: float, t1: float) -> str:
    return f"pwl({number(t0)} 0 {number(t1)} 1)"
