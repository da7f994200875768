"""The claims that a folder of studies judges: its file ``claims.toml``.

The file names the page and lists the claims in order, so that a claim without a verdict shows.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from cosim.errors import InputError, Problem
from cosim.scene.layers import read_layer
from cosim.scene.parameters import Field, Parameters, read_parameters

__all__ = ["FILE", "Claim", "Claims", "load_claims"]

FILE = "claims.toml"


class Claim(Parameters):
    """One claim: its id, as in `Verdict.id`, what is claimed, and when it counts."""

    id: str = Field(min_length=1)
    says: str
    counts: str


class _Listed(Parameters):
    title: str
    claims: tuple[Claim, ...] = Field(min_length=1)


@dataclass(frozen=True)
class Claims:
    """Heading of the page and the claims in its order; empty where a folder lists none."""

    title: str = ""
    claims: tuple[Claim, ...] = ()


def load_claims(folder: Path) -> Claims:
    """Return what ``claims.toml`` in a folder lists.

    Raises
    ------
    InputError
        With every problem of the file; an id that stands twice is one.
    """
    file = folder / FILE
    if not os.path.isfile(file):
        return Claims()
    claims, problems = read_parameters(_Listed, read_layer(file).data)
    if claims is None:
        raise InputError(Problem(p.message, str(file), p.key, p.value, p.unit, p.allowed) for p in problems)
    assert isinstance(claims, _Listed)
    ids = [claim.id for claim in claims.claims]
    twice = sorted({name for name in ids if ids.count(name) > 1})
    if twice:
        raise InputError(Problem("stands twice", str(file), "claims.id", name) for name in twice)
    return Claims(claims.title, claims.claims)
