"""Why devices lack measures: by sample and measure, and as the text that is kept with a sample."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from cosim.circuits.fitting.rational_fit import FitError

__all__ = ["Lack", "Missing", "Reasons", "lacks", "of_measures", "reasons_of", "text_of", "words"]

#: Measure -> why a device has none.
Reasons = Mapping[str, str]
#: Sample -> measure -> why it has none; a sample that has all of them is not in it.
Missing = Mapping[int, Reasons]

#: Characters of a reason that are kept.
_MOST_WORDS = 300


@dataclass(frozen=True)
class Lack:
    """Measures that the same samples lack.

    Attributes
    ----------
    names, samples
        Which measures, and how many samples lack them.
    first, why
        The first of these samples, and its reason.
    """

    names: tuple[str, ...]
    samples: int
    first: int
    why: str

    @property
    def text(self) -> str:
        """The measures, as a sentence lists them."""
        return ", ".join(self.names)


def words(reason: Exception, without: str = "") -> str:
    """Return a refusal in one line, `without` a text that is another one each time."""
    text = f"no `linear` model: {reason}" if isinstance(reason, FitError) else str(reason)
    text = text.replace(without, "") if without else text
    return " ".join(text.split())[:_MOST_WORDS] or type(reason).__name__


def text_of(reasons: Reasons) -> str:
    """Return reasons as one text, a line for each: the measures without a value, and why.

    Examples
    --------
    >>> print(text_of({'k_max': 'no wall', 'curl': 'one joint', 'eta': 'no wall'}))
    k_max, eta: no wall
    curl: one joint
    """
    together: dict[str, list[str]] = {}
    for name, why in reasons.items():
        together.setdefault(why, []).append(name)
    return "\n".join(f"{', '.join(names)}: {why}" for why, names in together.items())


def reasons_of(text: str) -> dict[str, str]:
    """Return the reasons that `text_of` wrote.

    Examples
    --------
    >>> reasons_of(text_of({'k_max': 'no wall: none', 'curl': 'one joint'}))
    {'k_max': 'no wall: none', 'curl': 'one joint'}
    """
    reasons: dict[str, str] = {}
    for line in text.split("\n") if text else ():
        names, _colon, why = line.partition(": ")
        reasons |= dict.fromkeys(names.split(", "), why)
    return reasons


def of_measures(missing: Missing, names: Sequence[str]) -> dict[int, Reasons]:
    """Return what is missing of these measures."""
    some = {k: {name: why for name, why in each.items() if name in names} for k, each in missing.items()}
    return {k: each for k, each in some.items() if each}


def lacks(missing: Missing, names: Iterable[str]) -> list[Lack]:
    """Return which measures are missing in how many samples; those that the same samples lack together."""
    together: dict[tuple[int, ...], list[str]] = {}
    for name in names:
        samples = tuple(sorted(k for k, each in missing.items() if name in each))
        if samples:
            together.setdefault(samples, []).append(name)
    return [
        Lack(tuple(of), len(samples), samples[0], missing[samples[0]][of[0]])
        for samples, of in together.items()
    ]
