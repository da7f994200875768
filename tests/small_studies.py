"""Studies of the paper with few and short points, for tests of their tables."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from support import SCENES

from cosim.storage.checkpoint import Points
from cosim.studies.study import StudyResult, load_study

PAPER = SCENES / "paper"
#: Periods [s] whose thousandfold is no short decimal in binary: 20.299999999999997, 52.699999999999996.
PERIODS = (0.0203, 0.0527)
FALL = {"window_s": 0.2, "rest_time_s": 0.05, "phases": 1}


class Serial(Points):
    """Points computed one after the other: a pool of processes takes longer to start than these take."""

    def map(
        self, compute: Callable[[Any], Any], arguments: Mapping[str, Any], workers: int | None = 1
    ) -> list[Any]:
        return super().map(compute, arguments, 1)


def small(name: str, **changes: Any) -> StudyResult:
    spec = load_study(PAPER / f"{name}.toml")
    given = spec.parameters
    changes = {
        key: value(getattr(given, key)) if callable(value) else value for key, value in changes.items()
    }
    with Serial(None) as points:
        return spec.study.analyse(replace(spec, parameters=given.model_copy(update=changes)), points)


def first(count: int) -> Callable[[tuple[Any, ...]], tuple[Any, ...]]:
    return lambda given: given[:count]
