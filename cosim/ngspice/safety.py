"""What a netlist may hold.

A netlist is a program: ngspice runs the ``.control`` block of whatever it loads, ``shell`` inside it runs any
command, and some elements read and write files. Only statements, elements, models and options known to be
harmless pass; anything else is refused before ngspice sees it, in nested files too. Since the lists are of
what is allowed, a spelling that ngspice happens to accept as an abbreviation does not slip through.
`cosim.ngspice.gate` judges the finished deck once more, name by name.
"""

import re

from cosim.errors import Problem, nearest
from cosim.ngspice.lines import Line, tokens

__all__ = ["DROPPED", "ELEMENTS", "KEPT", "MODELS", "OPTIONS", "allowed_model", "refusal"]

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

ELEMENTS = frozenset("abcdefghijklmoqrstuvwxz")
"""Letters of the elements that describe a circuit; N is a compiled (OSDI) device, P and Y are lines of cables
that no board has."""

MODELS = frozenset(
    # SPICE
    "r res c cap l ind d npn pnp lpnp njf pjf nmf pmf nhfet phfet nmos pmos vdmos vdmosn vdmosp nsoi psoi "
    "sw csw vswitch iswitch ltra urc "
    # XSPICE, analog: what reads no file
    "gain summer mult divide limit climit ilimit pwl multi_input_pwl hyst slew int d_dt s_xfer aswitch "
    "pswitch delay zener oneshot cmeter lmeter core lcouple potentiometer sine triangle square sidiode "
    # XSPICE, digital: gates and bridges
    "adc_bridge dac_bridge bidi_bridge d_and d_nand d_or d_nor d_xor d_xnor d_inverter d_buffer d_tristate "
    "d_open_c d_open_e d_pulldown d_pullup d_dff d_jkff d_tff d_srff d_dlatch d_srlatch d_osc d_fdiv "
    "d_to_real real_delay real_gain real_to_v".split()
)
"""Types of models that read and write no file and start no process."""

OPTIONS = frozenset(
    "abstol reltol vntol gmin chgtol pivtol pivrel trtol cshunt rshunt itl1 itl2 itl3 itl4 itl5 itl6 method "
    "maxord xmu lvltim mu gminsteps srcsteps gshunt temp tnom scale defl defw defad defas defm noopac "
    "noopiter nomod noacct acct list node opts nopage limpts numdgt ingold cptime limtim bypass badmos3 "
    "trytocompact oldlimit minbreak rampshunt keepopinfo autostop convlimit convstep convabsstep "
    "savecurrents width sparse klu".split()
)
"""Options that set numbers of the simulation; of others ngspice makes variables of its command language."""

_FILES = re.compile(
    r"(?<![\w.])(?:file|filename|input_?file|state_?file|process_?file|table_?file|wave_?file|pwl_?file"
    r"|lib_?file|simulation|sim_args|lib_args)\s*=|\bpwl\s+file\b|\bwavefile\b",
    re.IGNORECASE,
)
_COMMANDS = re.compile(
    r"^\.?(shell|system|codemodel|pre_osdi|osdi|pre_codemodel|load|write|wrdata|source)\b", re.I
)
_TRUST = " (--trust allows it)"


def refusal(line: Line) -> Problem | None:
    """Return why `line` is refused, or ``None``.

    Parameters
    ----------
    line
        A logical line of a netlist, comments removed and continuations joined.
    """
    word = line.keyword
    if word.startswith("*@") or word in DROPPED or word in INLINED:
        return None  # never reaches ngspice as it is
    if word.startswith((".control", ".endc", ".exec")):
        reason: str | None = "commands in a netlist are not run" + _TRUST
    elif _COMMANDS.match(line.text):
        reason = "a command that touches the system is not allowed in a netlist" + _TRUST
    elif word.startswith("."):
        reason = _statement(line) if word in KEPT else "unknown statement"
    elif word[:1] not in ELEMENTS:
        reason = "not an element" if word[:1] != "n" else "a compiled (OSDI) device is not allowed" + _TRUST
    else:
        reason = None
    if reason is None and '"' in line.text:
        reason = "a string is not allowed: a model could take it for the name of a file" + _TRUST
    elif reason is None and _FILES.search(line.text):
        reason = "reads or writes a file" + _TRUST
    return Problem(reason, file=line.file, line=line.lineno, value=line.text) if reason else None


def _statement(line: Line) -> str | None:
    """Return why a statement of a known kind is refused."""
    if line.keyword == ".model":
        return allowed_model(line.text)
    if line.keyword in (".option", ".options", ".opt"):
        for word in tokens(line.text)[1:]:
            name = word.partition("=")[0].lower().strip(",")
            if name and name not in OPTIONS:
                near = nearest(name, OPTIONS)
                return f"option {name} is not allowed" + (f", nearest is {near}" if near else "") + _TRUST
    return None


def allowed_model(text: str) -> str | None:
    """Return why a ``.model`` statement is refused: its type must be a plain word that is allowed."""
    words = [word.lower() for word in tokens(text)]
    if len(words) > 2 and words[2].startswith("ako:"):  # like another model, which stands between
        words = words[1:] if words[2] != "ako:" else words[2:]
    if len(words) < 3:
        return "must be .model name type(parameters)"
    kind = words[2].partition("(")[0]
    if kind in MODELS:
        return None
    if not re.fullmatch(r"\w+", kind):
        return "must be .model name type(parameters), the type a plain word" + _TRUST
    return f"a model of type {kind} is not allowed: it could read a file or start a process" + _TRUST
