"""What an edit did: boards, values of ``--set`` or an earlier run under one scene, side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cosim.catalogue import MEASURES
from cosim.caution import Caution, collected, warn
from cosim.checking.check import Check, check
from cosim.checking.check_target import Subject, load_subject
from cosim.circuits.instability.stability_verdict import Question
from cosim.circuits.linear_circuit import LinearCircuit
from cosim.comparisons.board_figures import (
    Figure,
    first_to_clip,
    of_check,
    of_circuit,
    of_dissipation,
    of_measures,
    of_reduced,
)
from cosim.comparisons.board_measures import board_measures, contact_measures
from cosim.comparisons.dissipation import dissipation
from cosim.comparisons.measure_values import Measured, check_blocks, measure
from cosim.errors import InputError, fail
from cosim.measures import Tolerance, tolerances
from cosim.ngspice import deck_file
from cosim.ngspice.child import Child, call
from cosim.plan import Plan, resolve
from cosim.results import Run, written_files
from cosim.runner import run
from cosim.scene import load_scene
from cosim.scene.load import SceneLike
from cosim.storage.field_types import refuse_code
from cosim.storage.staging import require_ours
from cosim.units import quantity
from cosim.variants import Variant

#: Differences below this share are rounding of the measurement, not the edit.
_ROUNDING = 1e-6
#: Least noticeable change of a force at the hand, with its source, as a share of the scene's largest force: a
#: change of a tiny force is not felt, however large a share of that force it is.
_FORCE = (0.07, "Pang, Tan and Durlach 1991")
#: The same of a stiffness and a damping, as a share of itself.
_IMPEDANCE = {
    ("measures", "rendered stiffness"): (0.08, "Jones and Hunter 1990"),
    ("gains", "spring at full-scale gain"): (0.08, "Jones and Hunter 1990"),
    ("gains", "damper at full-scale gain"): (0.14, "Jones and Hunter 1993"),
}
#: Sections whose forces are those at the hand.
_AT_THE_HAND = ("measures", "out of contact", "noise")
#: Magnitudes below which a figure counts as zero, by unit.
_NOTHING = {"N": 1e-9, "A": 1e-9, "V": 1e-9, "s": 1e-12, "W": 1e-9, "%": 1e-6, "N/m": 1e-9, "N s/m": 1e-9}

#: Code of the doubt that run and check may both tell.
_MISSED = "constant-missed"


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
    findings : results in words: (quantity, text)
    """

    label: str
    plan: Plan
    run: Run
    check: Check
    circuit: LinearCircuit | None
    figures: tuple[Figure, ...]
    findings: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Row:
    """One figure on all sides.

    Attributes
    ----------
    section, quantity, unit : of the figure
    places : where on the board, with the parts that sit there
    values : one a side, None where a side has none
    change : largest change against the first, as a share of the larger of the two
    felt : that change over what matters of this figure, None where nobody feels it
    by : what matters, in words
    """

    section: str
    quantity: str
    places: tuple[str, ...]
    unit: str
    values: tuple[float | None, ...]
    change: float
    felt: float | None = None
    by: str = ""

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
    asked: list[tuple[str, tuple[str, ...], Path | None]] = []
    if last is not None:
        asked.append((f"run {last.name}", (), last))
    if len(boards) == 2 or not tried or last is None:
        asked += [(name, overrides, None) for name, overrides in of_board]
    asked += [(_label(variant), (*of_board[0][1], *variant.overrides), None) for variant in tried]
    return [
        Asked(f"{chr(ord('A') + number)} {name}", overrides, folder)
        for number, (name, overrides, folder) in enumerate(asked)
    ]


def _board(board: str) -> tuple[str, ...]:
    return (f"device.board={Path(board).resolve().as_posix()!r}",)


def _label(variant: Variant) -> str:
    return variant.label or " ".join(f"{name}={value}" for name, value in variant.values)


def compare(
    scene_file: SceneLike,
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
    places = [folder / _file_name(each.label) for each in asked]
    for each, place in zip(asked, places, strict=True):
        if each.stored is None:
            require_ours(place, written_files)  # refuse before anything is computed
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
                result = run(plan, places[number], formats=(), child=child)
            warn(*result.warnings)
            with collected(forward=False) as checked:
                sides.append(_side(each.label, plan, subject, result, child))
            warn(*_untold(checked, result.warnings))
    return sides


def _untold(checked: Sequence[Caution], told: Sequence[Caution]) -> list[Caution]:
    """Return what the check doubts, without the constants whose miss the run has told.

    Run and check measure a constant in two ways and differ in its last digits: one doubt in other words.
    """

    def missed(caution: Caution) -> str:  # the constant and its stated value, with which the text begins
        return caution.text.partition(",")[0] if caution.code == _MISSED else ""

    known = {missed(each) for each in told} - {""}
    return [each for each in checked if missed(each) not in known]


def _file_name(label: str) -> str:
    return "".join(c if c.isalnum() or c in "._=-+" else "_" for c in label)


def _prepared(scene_file: SceneLike, asked: Asked, trust: bool) -> tuple[Plan, Subject, Run | None]:
    if asked.stored is not None:
        result = Run.load(asked.stored)
        every = range(1, result.scene.joints + 1)
        lacking = [name for j in every for name in (f"imot{j}", f"v{j}") if name not in result.signals]
        if lacking:
            fail(
                "is not a run of its scene: signals are missing",
                file=str(result.signals.path),
                key=lacking[0],
            )
        named = result.scene.code() - load_scene(scene_file).code()  # the user's own scene is read
        refuse_code(named, str(asked.stored), trust=trust)
        board = deck_file.load(asked.stored, trust=trust)
        plan = resolve(result.scene, trust=trust, board=board)
        # its netlists are gone, and with them the parts at other levels: the share of ideal parts is unknown
        kind = result.scene.effects.driver.value
        return plan, Subject(board, board, kind, result.scene, Question((board,))), result
    plan = resolve(load_scene(scene_file, asked.overrides), trust=trust)
    variant = Variant((), asked.overrides, asked.label)
    return plan, load_subject(scene_file, variant, None, None, trust=trust), None


def _side(label: str, plan: Plan, subject: Subject, result: Run, child: Child | None) -> Side:
    measured = check(subject, child=child)
    stated = plan.stated(child)
    rows, lacking = contact_measures(plan, child)  # of the board's own measures the check tells more
    figures = [
        *of_measures({**result.measures, **rows}), *of_check(measured),
        *of_dissipation(dissipation(result, stated)),
    ]  # fmt: skip
    notes = first_to_clip(measured, result)
    notes += [(MEASURES[name].text, why) for name, why in lacking.items()]
    circuit = None
    try:
        circuit = _circuit(plan, 0.0, child)
        reduced = _circuit(plan, plan.scene.solver.reduction_tolerance, child)
    except InputError as error:  # a board too nonlinear for one is still a board
        notes.append(("small-signal model", error.in_brief))
    else:
        figures += [*of_circuit(circuit), *of_reduced(reduced)]
        notes.append(("small-signal model", str(circuit.certificate["footnote_1"]["sentence"])))
    return Side(label, plan, result, measured, circuit, tuple(figures), tuple(notes))


def compare_measures(
    scene_file: SceneLike,
    asked: list[Asked],
    names: Sequence[str],
    *,
    child: Child | None = None,
    trust: bool = False,
    on_progress: Callable[[int, int, str], None] | None = None,
) -> list[tuple[str, Measured]]:
    """Return the named measures of every side, and nothing else; nothing runs where none of them needs it.

    Raises
    ------
    InputError
        For a board that does not fit the scene, and a measure that has nothing to be taken from.
    """
    prepared = [_prepared(scene_file, each, trust) for each in asked]
    check_blocks(names, [plan.board for plan, _, _ in prepared])
    compared = []
    for number, (each, (plan, _, result)) in enumerate(zip(asked, prepared, strict=True)):
        if on_progress is not None:
            on_progress(number, len(asked), each.label)
        if result is None:
            compared.append((each.label, measure(plan, names, child=child)))
        else:
            rows, lacking = board_measures(plan, names, child=child)
            compared.append((each.label, Measured({**result.measures, **rows}, lacking, 0.0)))
    return compared


def _circuit(plan: Plan, tolerance: float, child: Child | None) -> LinearCircuit:
    payload = {
        "board": plan.board,
        "model": "linear",
        "band_hz": plan.scene.solver.band_hz,
        "tolerance": tolerance,
    }
    circuit: LinearCircuit = call(
        "cosim.circuits.extraction.extract:extract",
        payload,
        time_limit_s=plan.scene.solver.time_limit_s,
        deck=str(plan.board.path),
        child=child,
    )
    return circuit


def changes(sides: list[Side]) -> list[Row]:
    """Return the figures that differ between the sides, what is felt most first.

    First come changes beyond the scene's tolerance or what a hand notices, by how far they are beyond; then
    all others by relative change; last the error bounds of the tool's own models, not of the board.
    Places with the same values share a row.
    """
    known = [{figure.key: figure for figure in side.figures} for side in sides]
    stated = tolerances(sides[0].plan.scene)
    peak = known[0].get(("measures", "peak force", ""))
    force_n = peak.value if peak is not None and peak.value is not None else 0.0
    rows: dict[tuple[object, ...], Row] = {}
    for key in dict.fromkeys(key for figures in known for key in figures):
        both = [figures.get(key) for figures in known]
        unit = next(figure.unit for figure in both if figure is not None)
        values = tuple(figure.value if figure is not None else None for figure in both)
        size = _change(values, _NOTHING.get(unit, 1e-12))
        if size <= _ROUNDING:
            continue
        parts = dict.fromkeys(figure.part for figure in both if figure is not None and figure.part)
        place = key[2] + (f" ({' / '.join(parts)})" if parts else "")
        same = (key[0], key[1], tuple(None if v is None else f"{v:.6g}" for v in values))
        if same in rows:
            rows[same] = replace(rows[same], places=(*rows[same].places, place))
        else:
            felt, by = _felt(key[0], key[1], unit, values, stated, force_n)
            rows[same] = Row(key[0], key[1], (place,) if place else (), unit, values, size, felt, by)
    return sorted(rows.values(), key=_rank)


def _rank(row: Row) -> tuple[int, float]:
    if row.section == "bounds":
        return 2, -row.change
    beyond = row.felt is not None and row.felt >= 1.0
    return (0, -(row.felt or 0.0)) if beyond else (1, -row.change)


def _felt(
    section: str, name: str, unit: str, values: tuple[float | None, ...],
    stated: Mapping[str, Tolerance], force_n: float,
) -> tuple[float | None, str]:  # fmt: skip
    """Return a figure's change over what matters of it, and what that is; (None, '') if it is not felt."""
    tolerance = stated.get(name.replace(" ", "_")) if section == "measures" else None
    known = [abs(value) for value in values if value is not None]
    share, source = _IMPEDANCE.get((section, name), (0.0, ""))
    if tolerance is not None:
        allowed, by = tolerance.allowed(max(known)), f"tolerance of {tolerance.text(unit)}"
    elif share:
        allowed, by = share * max(known), f"{100 * share:.0f} % is noticed ({source})"
    elif section in _AT_THE_HAND and unit == "N":
        share, source = _FORCE
        allowed = share * max(*known, force_n)
        by = f"{100 * share:.0f} % of {quantity(allowed / share, 'N')} is noticed ({source})"
    else:
        return None, ""
    first = values[0]
    if first is None or len(known) < len(values) or not allowed > 0.0:
        return math.inf, by
    return max(abs(value - first) for value in values if value is not None) / allowed, by


def _change(values: tuple[float | None, ...], nothing: float) -> float:
    first = values[0]
    if first is None:
        return 0.0 if all(value is None for value in values) else 1.0
    change = 0.0
    for value in values[1:]:
        if value is None:
            change = max(change, 1.0)
        elif max(abs(value), abs(first)) > nothing:
            change = max(change, abs(value - first) / max(abs(first), abs(value)))
    return change
