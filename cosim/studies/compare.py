"""What an edit did: boards, values of ``--set`` or an earlier run under one scene, side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cosim.caution import collected, warn
from cosim.check.check import Check, check
from cosim.check.subject import Subject, load_subject
from cosim.circuits.linear import LinearCircuit
from cosim.errors import InputError, fail
from cosim.ngspice import stored
from cosim.ngspice.child import Child, call
from cosim.plan import Plan, resolve
from cosim.results import Run
from cosim.run import run
from cosim.scene import load_scene
from cosim.settings import Variant
from cosim.studies.dissipation import dissipation
from cosim.studies.figures import (
    Figure,
    first_to_clip,
    of_check,
    of_circuit,
    of_dissipation,
    of_reduced,
    of_run,
)

#: Differences below this share are rounding of the measurement, not the edit.
_ROUNDING = 1e-6
#: Magnitudes below which a figure is nothing, by unit.
_NOTHING = {"N": 1e-9, "A": 1e-9, "V": 1e-9, "s": 1e-12, "W": 1e-9, "%": 1e-6, "N/m": 1e-9, "N s/m": 1e-9}


@dataclass(frozen=True)
class Side:
    """One board under the scene.

    Attributes
    ----------
    label : in words
    plan : scene and board
    run : its run
    check : what `cosim check` measures
    circuit : its small-signal model with all poles; ``None`` where there is none
    figures : every number
    said : what is told in words: (quantity, text)
    """

    label: str
    plan: Plan
    run: Run
    check: Check
    circuit: LinearCircuit | None
    figures: tuple[Figure, ...]
    said: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Row:
    """One figure on all sides; `change` is the largest relative change against the first."""

    section: str
    quantity: str
    places: tuple[str, ...]
    unit: str
    values: tuple[float | None, ...]
    change: float

    @property
    def where(self) -> str:
        """Return the places in a few words."""
        more = len(self.places) - 2
        return ", ".join(self.places[:2]) + (f" and {more} more" if more > 0 else "")


@dataclass(frozen=True)
class Asked:
    """One side to be made: a board file (the scene's own where it is ``None``), values, or a stored run."""

    label: str
    overrides: tuple[str, ...] = ()
    stored: Path | None = None


def sides_of(boards: list[str], variants: list[Variant], last: Path | None) -> list[Asked]:
    """Return the sides that are asked for, the reference first.

    Parameters
    ----------
    boards
        None (the scene's own), one or two.
    variants
        Combinations of ``--set``; a single one without values for none.
    last
        Result folder to compare with.

    Raises
    ------
    InputError
        When nothing is left to compare.
    """
    tried = [variant for variant in variants if variant.values]
    if len(boards) > 1 and (tried or last):
        fail("compare two boards, or one with values (--set) or with a run (--last)", key="boards")
    if len(boards) < 2 and not tried and last is None:
        fail("give a second board, values to try (--set), or an earlier run (--last)", key="boards")
    names = [Path(board).stem for board in boards]
    if len(set(names)) < len(names):
        names = [f"{Path(board).resolve().parent.name}/{Path(board).stem}" for board in boards]
    of_board = [(name, _board(board)) for name, board in zip(names, boards, strict=True)]
    of_board = of_board or [("as it stands", ())]
    found: list[tuple[str, tuple[str, ...], Path | None]] = []
    if last is not None:
        found.append((f"run {last.name}", (), last))
    if len(boards) == 2 or not tried or last is None:
        found += [(name, overrides, None) for name, overrides in of_board]
    found += [(_label(variant), (*of_board[0][1], *variant.overrides), None) for variant in tried]
    return [
        Asked(f"{chr(ord('A') + number)} {name}", overrides, folder)
        for number, (name, overrides, folder) in enumerate(found)
    ]


def _board(board: str) -> tuple[str, ...]:
    return (f"device.board={Path(board).resolve().as_posix()!r}",)


def _label(variant: Variant) -> str:
    return variant.label or " ".join(f"{name}={value}" for name, value in variant.values)


def compare(
    scene_file: str | Path,
    asked: list[Asked],
    folder: Path,
    *,
    child: Child | None = None,
    trust: bool = False,
    on_progress: Callable[[int, int, str], None] | None = None,
) -> list[Side]:
    """Check and run every side under one scene; a stored run is taken as it is.

    Parameters
    ----------
    scene_file
        The scene.
    asked
        From `sides_of`.
    folder
        Where the runs are kept, one folder a side.

    Raises
    ------
    InputError
        For a board that does not fit the scene, or a result that keeps no board.
    """
    prepared = []
    for each in asked:
        with collected(each.label):
            prepared.append(_prepared(scene_file, each, trust))
    sides = []
    for number, (each, (plan, subject, result)) in enumerate(zip(asked, prepared, strict=True)):
        if on_progress is not None:
            on_progress(number, len(asked), each.label)
        with collected(each.label):
            if result is None:
                name = "".join(c if c.isalnum() or c in "._=-+" else "_" for c in each.label)
                result = run(plan, folder / name, formats=(), child=child)
            warn(*result.warnings)
            sides.append(_side(each.label, plan, subject, result, child))
    return sides


def _prepared(scene_file: str | Path, asked: Asked, trust: bool) -> tuple[Plan, Subject, Run | None]:
    if asked.stored is not None:
        result = Run.load(asked.stored)
        board = stored.load(asked.stored, trust=trust)
        plan = resolve(result.scene, trust=trust, board=board)
        # its parts at other levels are gone with the netlists, so the share of ideal parts is not told
        return plan, Subject(board, board, result.scene.effects.driver.value, result.scene), result
    plan = resolve(load_scene(scene_file, asked.overrides), trust=trust)
    variant = Variant((), asked.overrides, asked.label)
    return plan, load_subject(str(scene_file), variant, None, None, trust=trust), None


def _side(label: str, plan: Plan, subject: Subject, result: Run, child: Child | None) -> Side:
    measured = check(subject, child=child)
    stated = plan.stated(child)
    figures = [*of_run(result), *of_check(measured), *of_dissipation(dissipation(result, stated))]
    said = first_to_clip(measured, result)
    circuit = None
    try:
        circuit = _circuit(plan, 0.0, child)
        reduced = _circuit(plan, plan.scene.solver.reduction_tolerance, child)
    except InputError as error:  # a board too nonlinear for one is still a board
        said.append(("small-signal model", "; ".join(problem.message for problem in error.problems)))
    else:
        figures += [*of_circuit(circuit), *of_reduced(reduced)]
        said.append(("small-signal model", str(circuit.certificate["footnote_1"]["sentence"])))
    return Side(label, plan, result, measured, circuit, tuple(figures), tuple(said))


def _circuit(plan: Plan, tolerance: float, child: Child | None) -> LinearCircuit:
    payload = {
        "board": plan.board,
        "model": "linear",
        "band_hz": plan.scene.solver.band_hz,
        "tolerance": tolerance,
    }
    circuit: LinearCircuit = call(
        "cosim.circuits.extraction:extract",
        payload,
        time_limit_s=plan.scene.solver.time_limit_s,
        deck=str(plan.board.path),
        child=child,
    )
    return circuit


def changes(sides: list[Side]) -> list[Row]:
    """Return the figures that differ between the sides, the largest relative change first.

    Places with the same values are told once.
    """
    known = [{figure.key: figure for figure in side.figures} for side in sides]
    rows: dict[tuple[object, ...], Row] = {}
    for key in dict.fromkeys(key for figures in known for key in figures):
        found = [figures.get(key) for figures in known]
        unit = next(figure.unit for figure in found if figure is not None)
        values = tuple(figure.value if figure is not None else None for figure in found)
        size = _change(values, _NOTHING.get(unit, 1e-12))
        if size <= _ROUNDING:
            continue
        same = (key[0], key[1], tuple(None if v is None else f"{v:.6g}" for v in values))
        if same in rows:
            rows[same] = Row(
                key[0], key[1], (*rows[same].places, key[2]), unit, rows[same].values, rows[same].change
            )
        else:
            rows[same] = Row(key[0], key[1], (key[2],) if key[2] else (), unit, values, size)
    return sorted(rows.values(), key=lambda row: -row.change)


def _change(values: tuple[float | None, ...], nothing: float) -> float:
    first = values[0]
    if first is None:
        return 0.0 if all(value is None for value in values) else 1.0
    found = 0.0
    for value in values[1:]:
        if value is None:
            found = max(found, 1.0)
        elif max(abs(value), abs(first)) > nothing:
            found = max(found, abs(value - first) / max(abs(first), abs(value)))
    return found
