"""The form of ``run.json``: what readers of a stored result rely on, whoever has written it.

Entries that are only shown may be anything that JSON can hold; numbers and texts have passed
`cosim.storage.checksums`.
"""

from __future__ import annotations

from typing import Any, NotRequired

from typing_extensions import TypedDict

from cosim.caution import CautionFields

__all__ = ["Record"]


class _Measure(TypedDict):
    value: float
    unit: str
    text: str
    error: NotRequired[float | None]
    noise: NotRequired[float | None]


class _Amplifier(TypedDict):
    path: str
    part: str
    peak_v: float
    swing_v: float | None
    swing_stated: NotRequired[bool]
    headroom: float


class _Words(TypedDict, total=False):
    words: str


class _Cost(TypedDict, total=False):
    text: str


class _Effect(TypedDict):
    name: str
    value: Any
    size: NotRequired[_Words | None]
    cost: NotRequired[_Cost | None]
    not_applicable: NotRequired[str | None]


class _Plan(TypedDict, total=False):
    model: str
    constants: dict[str, float]
    amplifiers: list[_Amplifier]
    effects: list[_Effect]
    left_out: list[_Effect]
    notes: list[str]
    circuit_states: int | None


class _Work(TypedDict, total=False):
    shafts: float


class _Ledger(TypedDict, total=False):
    work_j: _Work
    residual_j: float
    closure: float


class _Stats(TypedDict, total=False):
    wall_s: float
    cpu_s: float
    total_s: float
    points: int
    rejected: int
    defect_max_rad: float


class _Event(TypedDict, total=False):
    time: float
    time_s: float


class _Provenance(TypedDict, total=False):
    command: list[str] | str
    deck_digest: str


class Record(TypedDict):
    """A run's record; its scene is checked by `cosim.scene.scene_from_dict`."""

    scene: dict[str, Any]
    plan: _Plan
    measures: dict[str, _Measure]
    ledger: _Ledger
    stats: _Stats
    provenance: _Provenance
    events: list[_Event]
    warnings: list[CautionFields]
    printed: list[str]
    files: dict[str, str]
    forms: dict[str, str]
