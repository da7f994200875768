"""Values from random numbers: a number, or an expression of such values, with what it deviates by."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from cosim.ngspice.expression import reduce
from cosim.tolerance.distributions import Shape
from cosim.types import Array

__all__ = ["Recipe", "Term"]

#: Allowed probability that a value that must be positive is not: no batch will ever meet it.
MOST_NEGATIVE = 1e-12


@dataclass(frozen=True)
class Term:
    """A deviation drawn from one random variable, by its place among all of them."""

    variable: int
    shape: Shape


@dataclass(frozen=True)
class Recipe:
    """How a value comes about.

    Attributes
    ----------
    nominal
        Its value without deviations.
    words, names
        Words of the expression that it is of other values, and these; none for a number.
    terms
        Its own deviations; they add.
    centre
        About what it is drawn, where that is not its nominal value: an offset is drawn about 0.
    """

    nominal: float
    words: tuple[str, ...] = ()
    names: Mapping[str, Recipe] = field(default_factory=dict)
    terms: tuple[Term, ...] = ()
    centre: float | None = None

    def values(self, n: int, deviation: Callable[[Term], Array]) -> Array:
        """Return `n` of its values, where `deviation` tells those of a term."""
        base: Array = np.full(n, self.nominal)
        if self.words:
            known = {name: recipe.values(n, deviation) for name, recipe in self.names.items()}
            base = np.asarray(reduce(list(self.words), known), dtype=float) + np.zeros(n)
        if not self.terms:
            return base
        start = base if self.centre is None else np.full(n, self.centre)
        share, amount = np.zeros(n), np.zeros(n)
        for term in self.terms:
            drawn = deviation(term)
            if term.shape.relative:
                share += drawn
            else:
                amount += drawn
        return np.asarray(start + share * base + amount)

    def used(self) -> tuple[Term, ...]:
        """Return all terms that it depends on, its own last."""
        return (*(term for recipe in self.names.values() for term in recipe.used()), *self.terms)

    def not_positive(self) -> float:
        """Return a bound of the probability that one of the values it is made of is not positive."""
        inner = sum(recipe.not_positive() for recipe in self.names.values())
        if self.centre is not None or not self.terms or self.nominal <= 0.0:
            return inner
        sizes = [(1.0 if t.shape.relative else 1.0 / self.nominal, t.shape) for t in self.terms]
        lows = [factor * shape.box[0] for factor, shape in sizes]
        if sum(lows) == 0.0:
            return inner
        # each term alone would have to cover its share of the distance to zero
        return inner + sum(
            shape.below(-low / sum(lows) / factor) if low else 0.0
            for low, (factor, shape) in zip(lows, sizes, strict=True)
        )

    def text(self, unit: str) -> str:
        """Return its deviations in words."""
        about = "" if self.centre is None else f" about {self.centre:g}"
        formula = len(self.words) > 1  # 0.01 of 10k*(1+flat(0.01)) is no resistance
        inner = (term for recipe in self.names.values() for term in recipe.used())
        texts = [
            f"{each.shape.text()} in its formula" if formula and not each.shape.relative
            else each.shape.text(unit) + about
            for each in inner
        ]  # fmt: skip
        texts += [term.shape.text(unit) + about for term in self.terms]
        return " and ".join(dict.fromkeys(texts))
