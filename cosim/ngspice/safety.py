"""What a netlist may not do.

A netlist is a program: ngspice runs the ``.control`` block of whatever it loads, ``shell`` inside it runs any
command, and some elements read and write files. Only statements known to be harmless pass; anything else is
refused before ngspice sees it, in nested files too. Since the list is one of what is allowed, a spelling
that ngspice happens to accept as an abbreviation does not slip through.
"""

import re

from cosim.errors import Problem
from cosim.ngspice.lines import Line, assignments, tokens

__all__ = ["DROPPED", "KEPT", "refusal"]

KEPT = frozenset(
    ".param .params .csparam .func .model .options .option .opt .temp .global .nodeset .subckt .ends "
    ".eom .if .elseif .else .endif".split()
)
"""Statements that describe a circuit."""

INLINED = frozenset({".include", ".inc", ".lib", ".endl"})
"""Statements that the loader carries out itself."""

DROPPED = frozenset(
    ".title .end .save .probe .tran .ac .dc .op .noise .tf .sens .pz .disto .sp .four .fourier .plot .print "
    ".ic .measure .meas .width .backanno .step .aliases .endaliases".split()
)
"""Statements of a test bench: harmless, ignored with a word. A run starts from the operating point, so that
initial conditions can only contradict it."""

_ELEMENTS = frozenset("abcdefghijklmopqrstuvwxyz")
_FILE_MODELS = re.compile(
    r"\b(filesource|file_source|d_source|d_state|d_ram_file|table2d|table3d|d_process|d_cosim|osdi)\b",
    re.IGNORECASE,
)
_FILE_KEYS = re.compile(
    r"\b(file|filename|input_file|state_file|process_file|simulation|wavefile|wave_file|table_file)\s*=",
    re.IGNORECASE,
)
_COMMANDS = re.compile(
    r"^\.?(shell|system|codemodel|pre_osdi|osdi|pre_codemodel|load|write|wrdata|source)\b", re.I
)


def refusal(line: Line) -> Problem | None:
    """Return why `line` is refused, or ``None``.

    Parameters
    ----------
    line
        A logical line of a netlist, comments removed and continuations joined.
    """
    word = line.keyword
    reason = None
    if word.startswith("*@"):
        return None
    if word.startswith((".control", ".endc", ".exec")):
        reason = "commands in a netlist are not run"
    elif _COMMANDS.match(line.text):
        reason = "a command that touches the system is not allowed in a netlist"
    elif word.startswith("."):
        if word in DROPPED:
            return None  # never reaches ngspice
        if word not in KEPT and word not in INLINED:
            reason = "unknown statement"
        elif _touches_file(line) and word not in INLINED:
            reason = "reads or writes a file"
    elif word[0] not in _ELEMENTS:
        reason = "not an element" if word[0] != "n" else "a compiled (OSDI) device is not allowed"
    elif _touches_file(line):
        reason = "reads or writes a file"
    if reason is None:
        return None
    hint = "" if reason in ("unknown statement", "not an element") else " (--trust allows it)"
    return Problem(f"{reason}{hint}", file=line.file, line=line.lineno, value=line.text)


def _touches_file(line: Line) -> bool:
    """Return whether an element or a model names a file."""
    words = tokens(line.text)
    if line.keyword in (".model", ".option", ".options", ".opt") or line.keyword.startswith("a"):
        return _FILE_MODELS.search(line.text) is not None or _FILE_KEYS.search(line.text) is not None
    if line.keyword[0] in "vibeg":
        return _FILE_KEYS.search(line.text) is not None
    return "file" in assignments(words)
