"""What the fuzzers feed: shipped files with slips in them, and values that nobody wrote a check for."""

import json
import re
import struct
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

#: Numbers as text: signs, zeros, what overflows, underflows, is none, or means something else in SPICE.
NUMBERS = (
    *(
        "0",
        "-0.0",
        "-1",
        "1",
        "1e-320",
        "1e-300",
        "5e-324",
        "1e300",
        "1e308",
        "1e400",
        "-1e400",
        "nan",
        "inf",
    ),
    *("-inf", "1" + "0" * 400, "10M", "1meg", "24k3", "2,2k", "1e", "0x10", "1_0", "\u0661", "\u00bd", ""),
    *("{0}", "{1/0}", "true"),
)
#: Text that means something to a shell, to ngspice's command language, to a reader or to a terminal.
TOKENS = (
    *(
        "$ tol=1%",
        "$ tol=-1%",
        "$ lot=5% dev=1%",
        "$ match=net1",
        "agauss(1k, 10, 3)",
        "limit(1, 2)",
        "$ tol=nan sigmas=0",
    ),
    *("`touch MARK`", "$(touch MARK)", "$HOME", ";touch MARK", "> MARK", "| touch MARK", "*ng_script"),
    "\n.control\nshell touch MARK\n.endc\n",
    *(
        ".include /etc/passwd",
        '.include "../../outside.cir"',
        ".lib",
        ".lib x.lib",
        ".csparam x",
        ".param x=",
    ),
    *('.param tp="filesource"', '.model fs filesource (file "/etc/passwd")', ".if (!!!!!!!!", ".ends"),
    *(".subckt a b", "+", "+ +", "'", '"', "{", "}", "(", ")", "[", "]", "{{{{", "((((((((", "=", "==", ","),
    *(";", "$", "#", "*", "%", "@x[y]", "v(", "a.b.c", "\x00", "\x07", "\x1a", "\x1b[31m", "\r", "\v", "\f"),
    *(
        "\x85",
        "\u2028",
        "\u2029",
        "\ufeff",
        "\ud800",
        "\u03bc",
        "\u00b5",
        "\u03a9",
        "\u00e9" * 50,
        " " * 3000,
    ),
    *("x" * 3000, "(" * 300, "\t", "/", "..", "/dev/zero", "none", "params:", "temper", "agauss(1,1,3)"),
    "poly(2)",
)
#: Values of other kinds than a key wants.
OTHER_KINDS = (
    *("[]", "[[]]", "{}", "[1]", "[nan]", "[1, [2]]", '["a"]', "{type = 'none'}", "1979-05-27", "[[0,0]]"),
)

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?:meg|[kKmMuUnNpP])?(?![\w.])")
_WORD = re.compile(r"[A-Za-z_][\w.]*")

Draw = Callable[[Any], Any]


def numbers() -> st.SearchStrategy[str]:
    """Text of a number, or nearly."""
    return st.one_of(
        st.sampled_from(NUMBERS),
        st.floats(allow_nan=False, allow_infinity=False).map(repr),
        st.floats(1e-3, 1e5).map(lambda value: f"{value:.4g}"),
        st.integers(-(10**12), 10**12).map(str),
    )


def values() -> st.SearchStrategy[str]:
    """Text behind an equals sign: numbers, words, lists, tables, quoted and broken text."""
    return st.one_of(
        numbers(),
        st.sampled_from(TOKENS),
        st.sampled_from(OTHER_KINDS),
        st.lists(numbers(), max_size=4).map(lambda parts: f"[{', '.join(parts)}]"),
        st.text(max_size=12),
        st.text(max_size=12).map(json.dumps),
    )  # fmt: skip


@st.composite
def mutated(draw: Any, texts: Sequence[str]) -> str:
    """One of the texts with one to four slips."""
    text: str = draw(st.sampled_from(texts))
    for _ in range(draw(st.integers(1, 4))):
        text = draw(st.sampled_from(_SLIPS))(draw, text)
    return text


def _span(draw: Draw, text: str, longest: int = 200) -> tuple[int, int]:
    start = draw(st.integers(0, max(len(text) - 1, 0)))
    return start, min(start + draw(st.integers(1, longest)), len(text))


def _cut(draw: Draw, text: str) -> str:
    start, end = _span(draw, text)
    return text[:start] + text[end:]


def _double(draw: Draw, text: str) -> str:
    start, end = _span(draw, text)
    return text[:end] + text[start:]


def _truncate(draw: Draw, text: str) -> str:
    return text[: draw(st.integers(0, len(text)))]


def _insert(draw: Draw, text: str) -> str:
    at = draw(st.integers(0, len(text)))
    return text[:at] + draw(st.one_of(st.sampled_from(TOKENS), st.text(max_size=4))) + text[at:]


def _other_number(draw: Draw, text: str) -> str:
    return _replaced(draw, text, _NUMBER, numbers())


def _other_word(draw: Draw, text: str) -> str:
    every = sorted({match[0] for match in _WORD.finditer(text)})
    return _replaced(draw, text, _WORD, st.sampled_from([*every[:400], *TOKENS]))


def _replaced(draw: Draw, text: str, form: re.Pattern[str], other: st.SearchStrategy[str]) -> str:
    every = list(form.finditer(text))
    if not every:
        return text
    match = draw(st.sampled_from(every[:2000]))
    return text[: match.start()] + draw(other) + text[match.end() :]


def _lines(draw: Draw, text: str) -> str:
    """Drop, double, swap or join whole lines."""
    rows = text.split("\n")
    i, j = draw(st.integers(0, len(rows) - 1)), draw(st.integers(0, len(rows) - 1))
    match draw(st.integers(0, 3)):
        case 0:
            del rows[i]
        case 1:
            rows.insert(j, rows[i])
        case 2:
            rows[i], rows[j] = rows[j], rows[i]
        case _ if i + 1 < len(rows):
            rows[i : i + 2] = [rows[i] + rows[i + 1]]
    return "\n".join(rows)


_SLIPS = (_cut, _double, _truncate, _insert, _insert, _other_number, _other_number, _other_word, _lines)


@st.composite
def damaged(draw: Any, contents: Sequence[bytes]) -> bytes:
    """One of the contents with flipped, lost, added or foreign bytes."""
    content: bytes = draw(st.sampled_from(contents))
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(content)))
        count = draw(st.integers(0, 64))
        match draw(st.integers(0, 3)):
            case 0:
                content = content[:at] + content[at + count :]
            case 1:
                content = content[:at] + draw(st.binary(max_size=64)) + content[at:]
            case 2:
                content = content[:at]
            case _:
                odd = struct.pack("<d", draw(st.sampled_from((float("nan"), float("inf"), 1e308, -0.0))))
                content = content[:at] + odd + content[at + 8 :]
    return content


def scene_keys(scenes: Sequence[Path]) -> list[str]:
    """Dotted keys that scenes state, tables included."""
    by_name: dict[str, None] = {}

    def walk(table: dict[str, Any], before: str) -> None:
        for key, value in table.items():
            by_name[before + key] = None
            if isinstance(value, dict):
                walk(value, f"{before}{key}.")

    for scene in scenes:
        walk(tomllib.loads(scene.read_text(encoding="utf-8")), "")
    return list(by_name)
