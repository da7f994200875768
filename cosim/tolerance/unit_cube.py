"""Samples of the unit cube: plain, Latin hypercubes, scrambled Sobol points; each by its number alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from cosim.types import Array

__all__ = ["REPLICATES", "Method", "Sampling", "sampling"]

Method = Literal["plain", "lhs", "sobol"]

#: Independent randomisations of a Latin hypercube or a Sobol sequence, whose scatter gives its error.
REPLICATES = 16
#: Half the spacing of the generator's numbers: keeps them away from 0.
_HALF = 2.0**-54
#: Numbers that Philox makes at once; a sample begins with a whole block.
_BLOCK = 4


@dataclass(frozen=True)
class Sampling:
    """Which points are taken: sample i depends on this and on i alone, whatever is computed together.

    Attributes
    ----------
    method
        'plain', 'lhs' or 'sobol'.
    n
        Samples in all.
    variables
        Dimension.
    seed
        Of the study.
    replicates
        Independent randomisations, one after the other, of ``n / replicates`` samples each; 1: plain.
    among
        Points that each randomisation has in all, where only its first are taken; 0: these are all.
    """

    method: Method
    n: int
    variables: int
    seed: int
    replicates: int = 1
    among: int = 0

    @property
    def each(self) -> int:
        """Samples of one randomisation."""
        return self.n // self.replicates

    def uniforms(self, first: int, count: int) -> Array:
        """Return samples ``first`` to ``first + count - 1``, (count, variables), within (0, 1)."""
        if self.method == "plain":
            return self._plain(first, count)
        out = np.empty((count, self.variables))
        at = 0
        while at < count:
            replicate, start = divmod(first + at, self.each)
            whole = self.among or self.each
            rows = _replicate(self.method, whole, self.variables, self.seed, replicate)[start : self.each]
            take = min(len(rows), count - at)
            out[at : at + take] = rows[:take]
            at += take
        return out

    def _plain(self, first: int, count: int) -> Array:
        blocks = -(-self.variables // _BLOCK)
        generator = np.random.Philox(key=_key(self.seed))
        generator.advance(first * blocks)
        drawn = np.random.Generator(generator).random((count, blocks * _BLOCK))
        return drawn[:, : self.variables] + _HALF

    def as_dict(self) -> dict[str, Any]:
        """Return it JSON-ready."""
        stored = asdict(self)
        if not self.among:
            del stored["among"]
        return stored

    def thinned(self, most: int) -> Sampling:
        """Return the first points of each randomisation, at most so many in all."""
        each = max(most // self.replicates, 1)
        if self.each <= each:
            return self
        return replace(self, n=each * self.replicates, among=self.among or self.each)

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> Sampling:
        """Return what `as_dict` gave."""
        return cls(**stored)


def sampling(method: Method, n: int, variables: int, seed: int) -> Sampling:
    """Return a sampling of at least `n` samples.

    Latin hypercubes take the next multiple of `REPLICATES`, Sobol sequences a power of two for each of them.
    """
    if method == "plain":
        return Sampling(method, n, variables, seed)
    each = -(-n // REPLICATES)
    if method == "sobol":
        each = 1 << max(each - 1, 0).bit_length()
    return Sampling(method, each * REPLICATES, variables, seed, REPLICATES)


def _key(seed: int) -> NDArray[np.uint64]:
    return np.asarray(np.random.SeedSequence(seed).generate_state(2, np.uint64), dtype=np.uint64)


@lru_cache(maxsize=2)
def _replicate(method: str, each: int, variables: int, seed: int, replicate: int) -> Array:
    if variables == 0:
        return np.empty((each, 0))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(replicate + 1,)))
    if method == "lhs":
        points = scipy.stats.qmc.LatinHypercube(variables, seed=rng).random(each)
    else:
        points = scipy.stats.qmc.Sobol(variables, scramble=True, seed=rng).random(each)
    clipped: Array = np.clip(np.asarray(points, dtype=float), _HALF, 1.0 - _HALF)
    clipped.setflags(write=False)
    return clipped
