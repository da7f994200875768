"""The exported decks: `replay` and `monolithic`."""

from __future__ import annotations

import os
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np

from cosim.circuits.decks import testbench
from cosim.effects import EFFECTS
from cosim.errors import InputError, Problem, fail
from cosim.export.mechanics import mechanics
from cosim.export.waveform import channels, source, stopping_source
from cosim.ngspice.gate import admit
from cosim.ngspice.lines import Line
from cosim.plan import Plan
from cosim.results import Run
from cosim.scene import PotNoise, PythonOperator, Scene
from cosim.scene.mechanism import mechanism, operator, start
from cosim.storage.owned_files import own_file, write_file

KINDS = ("monolithic", "replay")


def export(plan: Plan, run: Run, path: str | os.PathLike[str], kind: str = "monolithic") -> Path:
    """Write a scene as one deck for ``ngspice -b``, with nominal values.

    Parameters
    ----------
    plan
        Of the scene; gives board, driven pins and tolerances.
    run
        A run of the same scene: its DAC outputs (`replay`: all its sources) become piecewise linear sources.
    path
        File to write.
    kind
        `replay`: the circuit with all its sources recorded. `monolithic`: circuit, linkage and operator, with
        recorded DAC outputs.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        For a run of another board or another time, a scene that a monolithic deck cannot carry (end stops,
        potentiometer noise, an operator in Python), or a file that cannot be written.
    """
    own_file(path)
    lines = deck_lines(plan, run, kind)
    write_file(path, ("\n".join(lines) + "\n").encode())
    return Path(path)


def deck_lines(plan: Plan, run: Run, kind: str = "monolithic") -> list[str]:
    """Return the deck that `export` writes, line by line; raises what it raises."""
    if kind not in KINDS:
        fail("there is no such kind of export", key="kind", value=kind, allowed=", ".join(KINDS))
    _check_run(plan, run)
    _check_exported(plan.scene)
    return _monolithic(plan, run) if kind == "monolithic" else _replay(plan, run)


def _check_run(plan: Plan, run: Run) -> None:
    file = str(run.signals.path)
    if plan.scene.effects.component_noise:
        fail("a deck has no component noise: leave the effect out", key="effects.component_noise",
             file=plan.scene.file_name, value=True, allowed="false")  # fmt: skip
    missing = [name for name in plan.circuit.channels if name not in run.signals]
    if missing:
        fail(f"this is the run of another scene: it has not recorded {', '.join(missing)}", file=file)
    end = float(run.signals["time"][-1])
    if end < plan.scene.duration_s * (1 - 1e-9):
        fail("the run is shorter than the scene", file=file, value=end, unit="s")


def _replay(plan: Plan, run: Run) -> list[str]:
    circuit, signals = plan.circuit, run.signals
    # angles and speeds have one value where the DACs jump
    time, apart = np.unique(np.asarray(signals["time"]), return_index=True)
    gear = _constant(run, "gear")
    # angles are smooth between samples, unless noise bends them at any point
    angle = source if plan.scene.effects.pot_noise is PotNoise.NONE else stopping_source
    speed = "vm" if plan.scene.effects.shaft else "v"  # a motor behind a shaft has a speed of its own
    sources = channels(plan.scene, signals, circuit.channels)
    for j in range(1, circuit.joints + 1):
        sources.append(angle(f"pot{j}", time, np.asarray(signals[f"pot{j}"])[apart]))
        if circuit.speeds:
            sources.append(source(f"vel{j}", time, gear * np.asarray(signals[f"{speed}{j}"])[apart]))
    return _deck(plan, "replay of recorded sources", sources, [])


def _monolithic(plan: Plan, run: Run) -> list[str]:
    scene, circuit = plan.scene, plan.circuit
    _check_carried(scene)
    gear = _constant(run, "gear")
    linkage = mechanism(scene, gear)
    q, v = start(scene, linkage)
    p, op = linkage.pack()[0], operator(scene).pack()[0]
    moving = mechanics(p, op, q, v, gear, _constant(run, "motor_k") or _constant(run, "kt"), circuit.speeds)
    commands = channels(scene, run.signals, circuit.channels)
    shown = ["x", "y"]
    if scene.operator.type != "none":
        shown += ["fx", "fy"]
    for j in range(1, circuit.joints + 1):
        shown += [f"pot{j}", f"w{j}"] + ([f"qm{j}", f"wm{j}"] if scene.effects.shaft else [])
    return _deck(plan, "circuit, linkage and operator", [*commands, *moving], shown)


def _check_carried(scene: Scene) -> None:
    """Refuse what a monolithic deck cannot carry; all of it at once."""
    file = scene.file_name
    problems = [
        Problem(
            f"a monolithic deck has no {each.not_monolithic}: switch it off, or export a replay",
            file=file,
            key=f"effects.{each.name}",
            value=each.value(scene),
            allowed=str(each.null).lower(),
        )
        for each in EFFECTS
        if each.not_monolithic and each.is_in_force(scene)
    ]
    if isinstance(scene.operator, PythonOperator):
        message, known = "a monolithic deck cannot call Python", "none, mass, hand"
        problems.append(Problem(message, file=file, key="operator.type", value="python", allowed=known))
    if problems:
        raise InputError(problems)


def _check_exported(scene: Scene) -> None:
    """Refuse what no deck can carry."""
    for each in EFFECTS:
        if each.not_exported and each.is_in_force(scene):
            fail(
                each.not_exported,
                file=scene.file_name,
                key=f"effects.{each.name}",
                value=each.value(scene),
                allowed=str(each.null).lower(),
            )


def _deck(plan: Plan, what: str, elements: list[str], shown: list[str]) -> list[str]:
    scene, circuit = plan.scene, plan.circuit
    title = " ".join("".join(c if c.isprintable() else " " for c in scene.title).split())
    currents = [f"imot{j}" for j in range(1, circuit.joints + 1)]
    saved = [*currents, *shown, *plan.recorded]
    # ngspice takes a file whose first line begins with "*ng_script" for a script
    head = [Line(f"cosim export, {title}: {what}"), Line(f"* board, sha256 {plan.board.digest}")]
    lines = [*head, *plan.board.lines[1:]]
    rows = [
        *(line.text for line in lines),
        *testbench(plan.board, circuit, {}),
        *elements,
        plan.tolerances.line(),
        f".tran {scene.solver.max_step_s!r} {scene.duration_s!r} 0 {scene.solver.max_step_s!r}",
        ".save " + " ".join(f"v({name})" for name in saved),
        *_measures(currents, shown, scene.duration_s),
        ".end",
    ]
    admitted = admit(rows, lines, readable=True)
    with_mode = f" -D ngbehavior={admitted.behaviour}" if admitted.behaviour else ""
    return [head[0].text, f"* Run with: ngspice -b{with_mode}", *admitted.rows[1:]]


def command(deck: Path) -> str:
    """Return the command line that runs an exported deck, quoted for a shell."""
    with open(deck, encoding="utf-8") as file:
        words = next(row for row in file if row.startswith("* Run with: ")).partition(": ")[2].split()
    return shlex.join([*words, str(deck)])


_LINK_SPEED = re.compile(r"^w([0-9]+)$")


def _measures(currents: list[str], shown: list[str], end: float) -> list[str]:
    lines = []
    for name in currents:
        lines += [f".meas tran {name}_{kind} {kind} v({name})" for kind in ("max", "min")]
        lines.append(f".meas tran {name}_rms rms v({name})")
    # a shade before the end: rounding must not put it behind the last point
    at = f"at={end * (1 - 1e-9)!r}"
    for name in shown:
        match = _LINK_SPEED.match(name)
        if match is None:
            lines.append(f".meas tran {name}_end find v({name}) {at}")
        else:  # nodes w are links' speeds in space; a joint's, as beside it its angle, is a difference
            j = int(match[1])
            speed = f"v(w{j})" if j == 1 else f"par('v(w{j})-v(w{j - 1})')"
            lines.append(f".meas tran v{j}_end find {speed} {at}")
    return lines


def _constant(run: Run, name: str) -> float:
    constants: dict[str, Any] = run.plan.get("constants", {})
    if name not in constants:
        fail(
            "this is not a run of a board: its record lacks a constant", file=str(run.signals.path), key=name
        )
    return float(constants[name])
