"""Names of a strict alphabet in place of a netlist's own.

ngspice hands names to a command language in which back-ticks run programs, ``$`` expands, ``>`` opens files
and ``;`` separates. So no part of a user's name reaches it: nodes are called ``n17``, elements keep their
letter (``r12``), subcircuits and models are ``sub3`` and ``mod4``, in decks and in commands, and all that
ngspice prints is translated back into the user's names. A name that already has that form stays as it is.
"""

from __future__ import annotations

import re
from collections.abc import Callable

__all__ = ["GROUND", "Aliases"]

GROUND = frozenset({"0", "gnd"})
"""Names of the reference node; `gnd` is one to ngspice."""

_ALIAS = re.compile(r"(?<![a-z0-9])(?:sub|mod|[a-z])\d+(?![a-z0-9])", re.IGNORECASE)
_WORD = re.compile(r"[a-z]+\d+")
_PLOT = re.compile(r"(?:const|(?:op|ac|dc|tran|noise|unknown)\d+)\.")
_NOISE = re.compile(r"[io]noise_(?:total_)?")
_SCALES = frozenset(
    "time frequency v-sweep i-sweep temp-sweep res-sweep "
    "onoise_spectrum inoise_spectrum onoise_total inoise_total".split()
)
"""Vectors that are named by ngspice itself."""
_BINNED = re.compile(r"(.+)(\.\d+)")
#: A node that ngspice itself puts into a source with a formula: ``e1_int1``.
_INTERNAL = re.compile(r"_int\d+$")
_PLAIN = re.compile(r"[a-z_][a-z0-9_]*")


class Aliases:
    """The names of one deck, both ways. Letter case does not count.

    Parameters
    ----------
    text
        The deck: no alias is a word of it, so that aliases are unambiguous.
    plain
        Whether names stay as they are: for a deck that its user trusts with commands of its own.
    readable
        Whether names of letters, digits and underscores stay as they are: for a deck that people read.
    """

    def __init__(self, text: str = "", *, plain: bool = False, readable: bool = False) -> None:
        self._plain, self._readable = plain, readable
        self._taken = set() if plain else set(_WORD.findall(text.lower()))
        self._nodes: dict[str, str] = dict.fromkeys(GROUND, "0")
        self._elements: dict[str, str] = {}
        self._blocks: dict[str, str] = {}
        self._models: dict[str, str] = {}
        self._back: dict[str, str] = {}
        self._counts: dict[str, int] = {}
        self._paths: dict[str, str | None] = {}

    def node(self, name: str) -> str:
        """Return the alias of a node; the reference node is ``0``."""
        return self._of(self._nodes, "n", name.lower())

    def element(self, name: str) -> str:
        """Return the alias of an element, which begins with the same letter.

        Raises
        ------
        ValueError
            When a name does not begin with a letter.
        """
        low = name.lower()
        if not ("a" <= low[:1] <= "z"):
            raise ValueError(f"{name!r} is not the name of an element")
        return self._of(self._elements, low[0], low)

    def block(self, name: str) -> str:
        """Return the alias of a subcircuit."""
        return self._of(self._blocks, "sub", name.lower())

    def model(self, name: str) -> str:
        """Return the alias of a model; ``name.3`` stays the third bin of ``name``."""
        low = name.lower()
        binned = _BINNED.fullmatch(low)
        return self._of(self._models, "mod", binned[1]) + binned[2] if binned else self._of(
            self._models, "mod", low
        )  # fmt: skip

    def is_model(self, name: str) -> bool:
        """Return whether a model of this name, or a bin of it, has an alias."""
        return name.lower() in self._models

    def node_path(self, name: str) -> str | None:
        """Return what ngspice calls a node anywhere in the circuit (``xboard.xsum1.out``), if it is one."""
        low = name.lower()
        if self._plain:
            return low
        return self._path(low, "n", self._nodes.get)

    def element_path(self, name: str) -> str | None:
        """Return what ngspice calls an element anywhere (``r.xboard.xsum1.r31``), if it is one."""
        low = name.lower()
        if self._plain:
            return low
        path = self._path(low, "e", self._elements.get)
        if path is None and low[1:2] == ".":
            inner = self._path(low[2:], "e", self._elements.get)
            path = None if inner is None else f"{low[0]}.{inner}"
        return path

    def vector(self, name: str) -> str | None:
        """Return what ngspice calls a vector: a node, a current, a spectrum, a constant; ``None`` if none."""
        low = name.lower()
        if self._plain:
            return low
        path = self.node_path(low)
        plot = _PLOT.match(low)
        if path is None and plot is not None:
            inner = self.vector(low[plot.end() :])
            path = None if inner is None else plot[0] + inner
        if low in _SCALES:
            return low
        if path is None and low.startswith("v(") and low.endswith(")"):
            path = self.node_path(low[2:-1])
        noise = _NOISE.match(low)
        if path is None and noise is not None:
            inner = self._with_tail(low[noise.end() :])
            path = None if inner is None else noise[0] + inner
        if path is None and low.endswith("#branch"):
            inner = self.element_path(low.removesuffix("#branch"))
            path = None if inner is None else inner + "#branch"
        if path is None and _INTERNAL.search(low):
            path = self._with_tail(low)
        return low if path is None and _PLAIN.fullmatch(low) else path

    def restore(self, text: str) -> str:
        """Put the user's names back into what ngspice prints."""
        return _ALIAS.sub(self._user, text) if self._back else text

    def _user(self, match: re.Match[str]) -> str:
        return self._back.get(match[0].lower(), match[0])

    def _of(self, known: dict[str, str], letters: str, name: str) -> str:
        if self._plain:
            return name
        alias = known.get(name)
        if alias is None:
            stays = (self._readable and _PLAIN.fullmatch(name)) or re.fullmatch(rf"{letters}[0-9]+", name)
            alias = name if stays else self._fresh(letters)
            known[name] = alias
            if alias != name:  # keeps a node apart from a vector of ngspice's of the same name
                self._back[alias] = f"v({name})" if letters == "n" and name in _SCALES else name
            self._paths.clear()
        return alias

    def _fresh(self, letters: str) -> str:
        while True:
            count = self._counts[letters] = self._counts.get(letters, 0) + 1
            alias = f"{letters}{count}"
            if alias not in self._taken:
                return alias

    def _with_tail(self, name: str) -> str | None:
        """Resolve an element behind whose name ngspice puts more: ``r1_thermal`` in noise, ``e1_int1``."""
        ends = [len(name), *(k for k, c in enumerate(name) if c == "_")]
        for end in sorted(ends, reverse=True):
            path = self.element_path(name[:end]) if end else None
            if path is not None:
                return path + name[end:]
        return None

    def _path(self, name: str, kind: str, leaf: Callable[[str], str | None]) -> str | None:
        """Resolve instances and a last name; names may hold dots themselves, the longest last name counts."""
        key = kind + name
        if key not in self._paths:
            self._paths[key] = self._resolved(name, leaf)
        return self._paths[key]

    def _resolved(self, name: str, leaf: Callable[[str], str | None]) -> str | None:
        cuts = [0, *(k + 1 for k, c in enumerate(name) if c == ".")]
        best: dict[int, str | None] = {}
        for place in reversed(range(len(cuts))):
            start = cuts[place]
            path = leaf(name[start:])
            for other in cuts[place + 1 :] if path is None else ():
                head, rest = self._elements.get(name[start : other - 1]), best[other]
                if head is not None and head[0] == "x" and rest is not None:
                    path = f"{head}.{rest}"
                    break
            best[start] = path
        return best[0]
