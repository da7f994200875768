"""``--set NAME=V1,V2,V3``: values to try without copying files.

NAME is a key of the scene (``computer.period_s``, ``seed``) or a name of the netlist: a parameter or an
element (``r_diff_in``, ``R12``), or one instance's (``xdiff1.r1``, which begins with an x as all
instances of subcircuits do).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from cosim.errors import InputError, Problem
from cosim.toml import inline_toml

_TOP_LEVEL = ("title", "duration_s", "seed", "effects")
#: Tables of a scene, which ``--set 'operator={type="none"}'`` sets as a whole.
TABLES = (
    "device", "computer", "wall", "operator", "effects", "solver", "record", "measures", "tolerance",
)  # fmt: skip


@dataclass(frozen=True)
class Setting:
    """One name and the values to try for it, as written."""

    name: str
    values: tuple[str, ...]

    @classmethod
    def of(cls, name: str, values: Iterable[Any]) -> "Setting":
        """Return the setting of Python values: text as it would be typed, all else as TOML has it.

        Examples
        --------
        >>> Setting.of("computer.period_s", [0.005, 0.01]).values
        ('0.005', '0.01')
        >>> Setting.of("R12", ["8.2k"]).override("8.2k")
        'device.values.R12=8.2k'
        """
        return cls(name, tuple(each if isinstance(each, str) else inline_toml(each) for each in values))

    @property
    def is_netlist(self) -> bool:
        """Whether the name is the netlist's and not the scene's."""
        if "." in self.name:
            return self.name[0] in "xX"
        if self.name in TABLES and all(value.startswith("{") and "=" in value for value in self.values):
            return False
        return self.name not in _TOP_LEVEL

    def override(self, value: str) -> str:
        """Return the override for `cosim.scene.load_scene` that sets this value."""
        prefix = "device.values." if self.is_netlist else ""
        return f"{prefix}{self.name}={value}"


@dataclass(frozen=True)
class Variant:
    """One combination of values: what to show, and the overrides that make it.

    Attributes
    ----------
    values
        Every name with its value.
    overrides
        For `cosim.scene.load_scene`.
    label
        Text such as ``R12=8.2k seed=3`` of the names that take several values (of all, when none does);
        empty for the scene as it stands.
    """

    values: tuple[tuple[str, str], ...]
    overrides: tuple[str, ...]
    label: str


def parse_settings(texts: Iterable[str], *, several: bool = True) -> tuple[Setting, ...]:
    """Parse the texts of ``--set``; `several` says whether a name may have several values there.

    Raises
    ------
    InputError
        For a text without a name or a value, and for a name given twice.

    Examples
    --------
    >>> [(s.name, s.values) for s in parse_settings(['R12=8.2k,10k', 'seed=3'])]
    [('R12', ('8.2k', '10k')), ('seed', ('3',))]
    """
    settings: list[Setting] = []
    problems: list[Problem] = []
    for text in texts:
        name, _, values = text.partition("=")
        setting = Setting(name.strip(), tuple(split_values(values)))
        if not setting.name or not all(setting.values):
            problems.append(Problem("must look like R12=8.2k or R12=8.2k,10k,12k", key="--set", value=text))
        elif len(set(setting.values)) < len(setting.values):
            problems.append(Problem("has the same value twice", key="--set", value=text))
        elif any(setting.name == other.name for other in settings):
            hint = "; write all values in one --set" if several else ""
            problems.append(Problem("is set twice" + hint, key="--set", value=text))
        settings.append(setting)
    if problems:
        raise InputError(problems)
    return tuple(settings)


def split_values(text: str) -> list[str]:
    """Split at commas outside of brackets, braces and quotes: a point ``[0.1, 0.2]`` is one value.

    Examples
    --------
    >>> split_values('[0.1, 0.2],[0.3, 0.4]')
    ['[0.1, 0.2]', '[0.3, 0.4]']
    """
    values, depth, quote = [""], 0, ""
    for char in text:
        if quote:
            quote = "" if char == quote else quote
        elif char in "\"'":
            quote = char
        elif char in "[{(":
            depth += 1
        elif char in "]})":
            depth -= 1
        if char == "," and depth == 0 and not quote:
            values.append("")
        else:
            values[-1] += char
    return [value.strip() for value in values]


def variants(settings: Sequence[Setting]) -> list[Variant]:
    """Return every combination of the values, the last setting changing fastest.

    Examples
    --------
    >>> [variant.label for variant in variants(parse_settings(['R12=1k,2k', 'seed=3,4']))]
    ['R12=1k seed=3', 'R12=1k seed=4', 'R12=2k seed=3', 'R12=2k seed=4']
    """
    several = {s.name for s in settings if len(s.values) > 1} or {s.name for s in settings}
    every = []
    for chosen in product(*(s.values for s in settings)):
        pairs = list(zip(settings, chosen, strict=True))
        every.append(
            Variant(
                values=tuple((s.name, value) for s, value in pairs),
                overrides=tuple(s.override(value) for s, value in pairs),
                label=" ".join(f"{s.name}={value}" for s, value in pairs if s.name in several),
            )
        )
    return every


def overrides(texts: Iterable[str]) -> tuple[str, ...]:
    """Return ``--set`` texts of one value each as overrides for `cosim.scene.load_scene`.

    Raises
    ------
    InputError
        As `parse_settings`, and where a name has several values.
    """
    settings = parse_settings(texts, several=False)
    problems = [
        Problem("takes one value here", key="--set", value=f"{setting.name}={','.join(setting.values)}")
        for setting in settings
        if len(setting.values) > 1
    ]
    if problems:
        raise InputError(problems)
    return tuple(setting.override(setting.values[0]) for setting in settings)
