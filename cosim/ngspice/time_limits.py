"""The two limits of a call: its time, imports and compilations apart, and the time without progress."""

import time
from collections.abc import Mapping
from typing import Any

__all__ = ["MOST_PREPARING_S", "Watch"]

#: Imports and compilation never take longer than this [s] on any machine: what does hangs.
MOST_PREPARING_S = 600.0


class Watch:
    """The two limits of a call, and the simulated time last reported.

    Attributes
    ----------
    time_s : simulated time last reported [s]
    preparing_s : time of imports and compilations since the child began, as last reported [s]
    """

    def __init__(
        self, time_limit_s: float | None, stall_limit_s: float | None, prepared_s: float = 0.0
    ) -> None:
        self._start = self._beat = time.monotonic()
        self._limit, self._stall = time_limit_s, stall_limit_s
        self.time_s: float | None = None
        self._attempt = 1
        self._before_s = self.preparing_s = prepared_s

    def beat(self, progress: Mapping[str, Any]) -> None:
        """Note a report; the same simulated time again is no sign of life, except in a further attempt."""
        if "preparing_s" in progress:
            self.preparing_s = float(progress["preparing_s"])
        time_s = progress.get("time_s")
        if time_s is not None:
            again, self._attempt = self._attempt, progress.get("attempt", 1)
            if again == self._attempt and self.time_s is not None and time_s <= self.time_s:
                return
            self.time_s = float(time_s)
        self._beat = time.monotonic()

    def _allowance_s(self) -> float:
        """Return by how much imports and compilations extend the time limit [s]."""
        return min(max(self.preparing_s - self._before_s, 0.0), MOST_PREPARING_S)

    def patience_s(self) -> float | None:
        """Return how long to wait for the next message [s]."""
        now, left = time.monotonic(), []
        if self._limit is not None:
            left.append(self._start + self._limit + self._allowance_s() - now)
        if self._stall is not None:
            left.append(self._beat + self._stall - now)
        return max(min(left), 0.0) if left else None

    def check(self) -> None:
        """Raise `TimeoutError` when a limit is passed."""
        now = time.monotonic()
        reached = (
            "no simulated time was reported"
            if self.time_s is None
            else f"last reported t = {self.time_s:.9g} s"
        )
        if self._limit is not None and now - self._start - self._allowance_s() >= self._limit:
            raise TimeoutError(f"the time limit of {self._limit:g} s is over; {reached}")
        if self._stall is not None and now - self._beat >= self._stall:
            raise TimeoutError(f"no progress for {self._stall:g} s; {reached}")
