"""What ngspice prints, and what it means.

ngspice writes errors, warnings and chatter to both streams, in words that differ from place to place. The
patterns here were collected by running broken decks through the shared libraries of versions 39, 44 and 47.
"""

import re
from collections.abc import Callable, Sequence

from cosim.errors import InputError, NoOperatingPoint, Problem
from cosim.ngspice.lines import Line

__all__ = [
    "is_error", "load_problems", "operating_point_problem", "step_problem", "without_number", "worth_quoting",
]  # fmt: skip

_ERROR = re.compile(
    r"^(stdout|stderr)\s+("
    r"(fatal\s+)?error\b"
    r"|.*simulation\(s\) aborted"
    r"|.*simulation interrupted"
    r"|.*timestep too small"
    r"|doanalyses:"
    r"|undefined parameter"
    r"|undefined number"
    r"|expression err"
    r"|.*cannot recover and awaits"
    r"|.*no such command available"
    r"|.*no such vector"
    r"|.*checkvalid: vector"
    r"|.*no such function"
    r"|.*can't find model"
    r"|.*too few parameters for subcircuit"
    r"|.*\bmeas(ure)?\b.*failed"
    r")",
    re.IGNORECASE,
)
_CHATTER = re.compile(
    r"Trying gmin|Supplies reduced|gmin (step|increment)|source step|\(?Note:|No\. of Data Rows"
    r"|Doing analysis|^(stdout|stderr)\s+\S+#branch\s+\S+(\s+\S+)?\s*$"
    r"|^(stdout|stderr)\s*[-*]*\s*$|cannot recover and awaits|Circuit: |Creation Date"
    r"|shared library",
    re.IGNORECASE,
)
_NUMBERED = re.compile(r"(?:Error on line|Netlist line no\.|parsing stopped at line)\s*(\d+)", re.IGNORECASE)
_PARAMETER = re.compile(r"Undefined parameter \[(\w+)\]", re.IGNORECASE)
_EXPRESSION = re.compile(r"Expression err: (\S.*\})")
_INSTANCE = re.compile(r"\(instance: x(\S+)\)", re.IGNORECASE)
_SINGULAR = re.compile(r"singular matrix:\s*check nodes?\s+(\S+(?:\s+and\s+\S+)?)", re.IGNORECASE)
_STEP = re.compile(r"timestep too small; time = (\S+), timestep = \S+: (.*)", re.IGNORECASE)
_PRODUCT = re.compile(r"\.model\s+(\S+)\s+mult\b", re.IGNORECASE)
_DC_FAILED = re.compile(
    r"(DC|Transient) solution failed|Transient op failed|operating point could not"
    r"|doAnalyses: .*(too many iterations without convergence|iteration limit reached|matrix is singular)",
    re.IGNORECASE,
)


def is_error(line: str) -> bool:
    """Return whether `line`, with the name of its stream in front, reports an error."""
    return _ERROR.match(line) is not None


def worth_quoting(line: str) -> bool:
    """Return whether `line` is of use to the user (gmin stepping, greetings and rules are not)."""
    return _CHATTER.search(line) is None


def operating_point_problem(
    output: Sequence[str],
    tied: Callable[[str], bool],
    looped: Callable[[str], bool],
    *,
    file: str | None = None,
) -> InputError | None:
    """Return what is wrong with the DC operating point, or ``None``.

    ngspice warns of a singular matrix, and tries gmin and source stepping. Where they fail, the matrix was
    singular for a node without a DC path (`tied` is false of it), a loop of voltage sources (`looped` is
    true of an element in it), or because Newton's method got lost within a model.
    """
    if not any(_DC_FAILED.search(line) for line in output):
        return None
    named = list(dict.fromkeys(match[1] for line in output if (match := _SINGULAR.search(line))))
    nodes = [node for both in named for node in both.split(" and ")]
    loops = [node.removesuffix("#branch") for node in nodes if node.endswith("#branch")]
    loops = [element for element in loops if looped(element)]
    if loops:
        words = f"no DC operating point: loop of voltage sources or inductors through {', '.join(loops)}"
        return InputError(Problem(words, file=file))
    floating = [node for node in nodes if not node.endswith("#branch") and not tied(node)]
    if floating:
        words = f"floating node: {', '.join(floating)} has no DC path to ground"
        return InputError(Problem(words, file=file))
    reason = next((line.strip() for line in output if line.lstrip().lower().startswith("error:")), None)
    lost = f"the matrix became singular at {', '.join(named[:3])}" if named else None
    parts = [part for part in (reason, lost, _last_nodes(output)) if part]
    return NoOperatingPoint(Problem("no DC operating point: " + "; ".join(parts), file=file))


def _last_nodes(output: Sequence[str]) -> str:
    """Return the nodes that ngspice marks with a star as not converged."""
    marked = [line.split()[0] for line in output if re.match(r"^\S+\s+\S+\s+\S+\s+\*\s*$", line)]
    return (
        "these did not converge: " + ", ".join(marked[:6])
        if marked
        else "Newton's method, gmin stepping and source stepping all failed"
    )


def step_problem(output: Sequence[str]) -> tuple[str, float] | None:
    """Return what made ngspice's step vanish in a transient analysis, and the simulated time [s]."""
    match = next((match for line in output if (match := _STEP.search(line))), None)
    if match is None:
        return None
    return f"the time step became too small, {match[2].strip()}", float(match[1])


def without_number(rows: Sequence[str]) -> str:
    """Return what in the deck `rows` can make ngspice answer with something that is no number, or ``""``.

    XSPICE's multiplier finds its slope to an input as its output over that input, 0/0 where that is zero.
    """
    model = next((match[1] for row in rows if (match := _PRODUCT.match(row))), None)
    if model is None:
        return ""
    return (
        f"; to ngspice the XSPICE multiplier {model} has no slope where an input of it is zero: "
        "write a B source with the product, V=v(a)*v(b)"
    )


def load_problems(output: Sequence[str], rows: Sequence[str], lines: Sequence[Line]) -> list[Problem]:
    """Turn ngspice's complaints about a deck into problems that name the user's file and line.

    Parameters
    ----------
    output
        What ngspice printed, streams' names removed.
    rows
        The deck as it was handed over.
    lines
        Origin of the first of these rows.
    """
    words = [line.strip() for line in output if worth_quoting("stderr " + line) and line.strip()]
    words = list(dict.fromkeys(words))
    number = next((int(match[1]) for line in output if (match := _NUMBERED.search(line))), None)
    named = any(
        _PARAMETER.search(word) for word in words
    )  # surer than the line number of 47, which counts its own lines
    index = number - 1 if number is not None and 0 < number <= len(rows) and not named else _find(words, rows)
    quoted = _rows_of_expression(words, rows)
    if len(quoted) == 1:
        index = quoted[0]
    message = (
        "ngspice does not accept the netlist: " + "; ".join(words[:6])
        if words
        else ("ngspice does not accept the netlist and does not say why")
    )
    if index is None or index >= len(lines):
        shown = rows[index] if index is not None and index < len(rows) else None
        return [Problem(message + (f" [{shown}]" if shown and shown not in message else ""))]
    origin = lines[index]
    return [Problem(f"{message} [{origin.text}]", file=origin.file, line=origin.lineno)]


def _rows_of_expression(words: Sequence[str], rows: Sequence[str]) -> list[int]:
    """Return the rows that hold the expression which ngspice could not read, whatever line it names."""
    names = (match[1].lower() for word in words if (match := _EXPRESSION.search(word)))
    wrong = next(names, None)
    return [] if wrong is None else [i for i, row in enumerate(rows) if "{" + wrong in row.lower()]


def _find(words: Sequence[str], rows: Sequence[str]) -> int | None:
    """Return the row that ngspice quotes in `words` without a number.

    Inside a subcircuit it quotes an expanded line, where only the element's type letter, the last part of
    its name and its tail are as the user wrote them.
    """
    for word in words:
        named = _INSTANCE.search(word)
        if named:
            last = "x" + named[1].split(".")[-1].removeprefix("x")
            places = [i for i, row in enumerate(rows) if i and row.lower().split()[:1] == [last]]
            return places[0] if len(places) == 1 else None
    for word in words:
        missing = _PARAMETER.search(word)
        if missing:
            used = re.compile(rf"[={{'*/+(,\s-]{re.escape(missing[1])}\b(?!\s*=)", re.IGNORECASE)
            return next((i for i, row in enumerate(rows) if i and used.search(row)), None)
    normal = [" ".join(row.lower().split()) for row in rows]
    for word in words:
        _, quotes, expression = word.lower().partition("expression err:")
        if quotes:
            return next((i for i, row in enumerate(normal) if i and f"{{{expression.strip()}" in row), None)
    for word in words:
        quoted = " ".join(word.partition("error: unknown subckt:")[2].split() or word.lower().split()).lower()
        for index, row in enumerate(normal[1:], 1):
            if row and row == quoted:
                return index
    for word in words:
        tokens = word.lower().split(":")[-1].split()
        if len(tokens) < 3:
            continue
        name, tail = tokens[0].split(".")[-1], tokens[-1]
        for index, row in enumerate(normal[1:], 1):
            parts = row.split()
            if len(parts) >= 3 and parts[0] == name and parts[-1] == tail:
                return index
    for word in words:
        name = word.lower().split()[0].split(".")[-1]
        places = [i for i, row in enumerate(normal) if i and row.split()[:1] == [name]]
        if "." in word.split()[0] and len(places) == 1:
            return places[0]
    return None
