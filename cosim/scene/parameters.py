"""Tables of other files than scenes, checked and explained in the same way."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field, ValidationError

from cosim.errors import Problem
from cosim.scene.explain import explain, is_real
from cosim.scene.quantities import Unit
from cosim.scene.table import Table

__all__ = ["Field", "Parameters", "Unit", "Variation", "read_parameters"]


class Parameters(Table):
    """Base of such a table: frozen and strict; an unknown key, NaN and infinity are refused."""


class Variation(Parameters):
    """One of several scenes of a study: its name, and what it changes in the study's scene."""

    name: str = Field(min_length=1)
    set: tuple[str, ...] = ()


def read_parameters(
    kind: type[Parameters], data: Mapping[str, Any]
) -> tuple[Parameters | None, list[Problem]]:
    """Return the checked table, or None and all that is wrong with it (without a file's name)."""
    try:
        return kind.model_validate(data), []
    except ValidationError as error:
        entries = filter(is_real, error.errors(include_url=False))
        return None, [explain(entry, data, kind) for entry in entries]
