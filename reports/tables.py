"""The tables of a page: measures, statistics, effects, events, provenance, and what a tried value changed."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cosim.units import of_measure, quantity
from reports.formatting import cell, plain_name
from reports.view import RunLike, View, plain

__all__ = ["Table", "Trial", "all_tables", "compare_table", "inputs_table", "with_bound"]


@dataclass(frozen=True)
class Table:
    """A table of texts. `numbers` are the columns set flush right; `note` says what to see."""

    name: str
    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    numbers: frozenset[int] = field(default_factory=frozenset)


@dataclass(frozen=True)
class Trial:
    """One tried value of ``--set``: label (``R12=8.2k``), measures, and the run if it is to be drawn."""

    label: str
    measures: Mapping[str, Mapping[str, Any]]
    run: RunLike | None = None


def all_tables(view: View) -> list[Table]:
    """Return the tables that the run fills, in the order of the page."""
    tables = (
        _measures(view),
        _effects(view),
        _statistics(view),
        _ledger(view),
        _events(view),
        _provenance(view),
    )
    return [table for table in tables if table.rows]


def _measures(view: View) -> Table:
    """Return the measures; for ngspice's runs with the error that its own tolerance suggests."""
    estimated = any(row.get("error") is not None for row in view.run.measures.values())
    note = "Errors are 95 % bounds on what the solver makes, not on what the scene leaves out."
    reltol = view.scene_at("solver", "rtol", default=None)
    fooled = estimated and view.plan.get("model") == "spice" and isinstance(reltol, float)
    rows = []
    for name, row in view.run.measures.items():
        believed = (_believed(row, reltol),) if fooled else ()
        rows.append((plain_name(name), with_bound(row), *believed, str(row.get("text") or "")))
    head = ("measure", "value", *(("reltol alone",) if fooled else ()), "what it is")
    if fooled:
        note += (
            f" Reltol alone: the share of {reltol:g} that ngspice asks of Newton's iterations and of each "
            "step; it is no error of a result, and may be far smaller or larger than one."
        )
    numbers = frozenset({1, 2} if fooled else {1})
    notes = [note, *_why_not(view, "no_error", "bound")] if estimated else []
    return Table("measures", "Measures", head, tuple(rows), " ".join([*notes, *_of_noise(view)]), numbers)


def _of_noise(view: View) -> list[str]:
    """Return what the intervals of the noise are, and which measures have none."""
    rows = view.run.measures
    notes = []
    if any(row.get("noise") for row in rows.values()):
        notes.append("Noise: 95 % of all paths lie so close to their mean, by the linear model.")
    return [*notes, *_why_not(view, "no_noise", "interval of the noise")]


def _why_not(view: View, key: str, what: str) -> list[str]:
    """Return which measures lack something, a sentence for each reason that their rows give by a key."""
    rows = view.run.measures
    notes = []
    for why in dict.fromkeys(str(row[key]) for row in rows.values() if key in row):
        names = [plain_name(name) for name, row in rows.items() if row.get(key) == why]
        notes.append(f"No {what} for {', '.join(names)}: {why}.")
    return notes


def _believed(row: Mapping[str, Any], reltol: float) -> str:
    """Return the error that a relative tolerance suggests, of a measure with a bound; else nothing."""
    if row.get("error") is None or not row.get("value"):
        return ""
    return f"± {quantity(reltol * abs(float(row['value'])), str(row.get('unit') or ''), 1)}"


def with_bound(row: Mapping[str, Any]) -> str:
    """Return a measure as text: value and unit, with the bound of its error where one is known."""
    value = row.get("value")
    if isinstance(value, float | int) and not isinstance(value, bool):
        return of_measure(row)
    return cell(value)


def _effects(view: View) -> Table:
    """Effects in force and left out, as the plan lists them; without a plan, the words of the scene."""
    stated = [
        (state, plain(row))
        for state, key in (("in force", "effects"), ("left out", "left_out"))
        for row in view.plan.get(key) or ()
    ]
    if stated:
        rows: tuple[tuple[str, ...], ...] = tuple(
            (plain_name(str(row.get("name", ""))), cell(row.get("value")), state, *_expected(row))
            for state, row in stated
        )
        head: tuple[str, ...] = ("effect", "setting", "state", "size expected", "cost")
    else:
        asked = plain(view.scene_at("effects", default={}))
        rows = tuple((plain_name(name), cell(value)) for name, value in asked.items())
        head = ("effect", "setting")
    note = "What is left out costs nothing: no node, no state, no random number."
    return Table("effects", "Effects in force and left out", head, rows, note)


def _expected(row: Mapping[str, Any]) -> tuple[str, str]:
    """Return an effect's a-priori size, or why it cannot apply, and its cost, in words."""
    size, cost = row.get("size") or {}, row.get("cost") or {}
    missing = row.get("not_applicable")
    return (f"not applicable: {missing}" if missing else str(size.get("words", ""))), str(
        cost.get("text", "")
    )


def _flat(table: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    rows = []
    for name, value in table.items():
        label = f"{prefix}{plain_name(str(name))}"
        if isinstance(value, Mapping):
            inner = label.removesuffix(" j")
            unit = "_j" if inner != label else ""  # work_j: {motors, operator} are joules each
            rows += _flat({f"{key}{unit}": part for key, part in value.items()}, f"{inner}: ")
        elif not (isinstance(value, list | tuple) and value and isinstance(value[0], Mapping)):
            rows.append(_split_unit(label, value))
    return rows


_UNITS = (
    (" n m per rad", "N m/rad"), (" n per m", "N/m"), (" rad", "rad"), (" hz", "Hz"),
    (" s", "s"), (" j", "J"), (" v", "V"), (" m", "m"), (" a", "A"), (" n", "N"), (" w", "W"),
)  # fmt: skip


def _split_unit(label: str, value: Any) -> tuple[str, str]:
    """Turn the unit at the end of a key (``wall_s``) into the unit of its value."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        for ending, unit in _UNITS:
            if label.endswith(ending):
                return label.removesuffix(ending), quantity(float(value), unit, 4)
    return label, cell(value)


def _statistics(view: View) -> Table:
    rows = tuple(_flat(view.run.stats))
    return Table("statistics", "Statistics of the run", ("quantity", "value"), rows, numbers=frozenset({1}))


def _ledger(view: View) -> Table:
    rows = tuple(_flat(view.run.ledger))
    return Table("ledger", "Energy ledger at the end", ("entry", "value"), rows, numbers=frozenset({1}))


def _events(view: View, most: int = 20) -> Table:
    events = list(view.run.events)
    rows: list[tuple[str, ...]] = []
    for event in events[:most]:
        time = event.get("time", event.get("time_s"))
        rest = {k: v for k, v in event.items() if k not in ("time", "time_s", "kind", "text")}
        facts = [" ".join(_split_unit(plain_name(str(k)), v)) for k, v in rest.items()]
        words = ", ".join([str(event.get("text") or ""), *facts]).removeprefix(", ")
        rows.append(
            (quantity(float(time), "s", 5) if time is not None else "", cell(event.get("kind", "")), words)
        )
    note = f"The first {most} of {len(events)} events." if len(events) > most else ""
    return Table("events", "Events", ("time", "kind", "what happened"), tuple(rows), note, frozenset({0}))


def _provenance(view: View) -> Table:
    facts = dict(view.run.provenance)
    facts["command"] = command_line(facts.get("command"))
    rows = [row for row in _flat(facts) if row[1] not in ("", "not known")]
    return Table("provenance", "Provenance", ("item", "value"), tuple(rows))


def command_line(command: Any) -> str:
    """Return the command as it would be typed; ``python -m cosim`` is the command ``cosim``."""
    if isinstance(command, list | tuple) and command:
        program = Path(str(command[0]))
        name = "cosim" if program.parts[-2:] == ("cosim", "__main__.py") else program.name
        return shlex.join([name, *(str(part) for part in command[1:])])
    return str(command or "")


def inputs_table(labels: Sequence[str], rows: Sequence[tuple[str, Sequence[str | None]]]) -> Table:
    """Return the inputs that are not the same in all runs, one row an input, one column a run."""
    shown = tuple((name, *("-" if value is None else value for value in values)) for name, values in rows)
    note = (
        "Scene, board and versions; a dash where a run does not have it."
        if shown
        else "All inputs are equal."
    )
    return Table("inputs", "Inputs that differ", ("input", *labels), shown, note)


def compare_table(trials: Sequence[Trial]) -> Table:
    """Return what changed in every measure for each tried value, against the first trial.

    Parameters
    ----------
    trials
        The first is the reference; a measure that a trial lacks is shown as a dash.

    Returns
    -------
    Table
        One row a measure; a column for the reference, then one a trial: value and relative change.
    """
    if not trials:
        return Table("compare", "What changed", (), ())
    reference, *others = trials
    names = list(dict.fromkeys(name for trial in trials for name in trial.measures))
    rows = []
    for name in names:
        first = reference.measures.get(name)
        row = [plain_name(name), with_bound(first) if first is not None else "-"]
        row += [_changed(first, trial.measures.get(name)) for trial in others]
        rows.append(tuple(row))
    head = ("measure", *(trial.label for trial in trials))
    note = f"In brackets: change against {reference.label}."
    return Table("compare", "What changed", head, tuple(rows), note, frozenset(range(1, len(head))))


def _changed(first: Mapping[str, Any] | None, row: Mapping[str, Any] | None) -> str:
    if row is None:
        return "-"
    text, value = with_bound(row), row.get("value")
    before = first.get("value") if first is not None else None
    if not isinstance(value, int | float) or not isinstance(before, int | float) or before == 0:
        return text
    change = float(value) / float(before) - 1.0
    if change == 0.0:
        return f"{text} (same)"
    return f"{text} ({100 * change:+.3g} %)" if abs(change) < 10.0 else f"{text} (x {change + 1.0:.3g})"
