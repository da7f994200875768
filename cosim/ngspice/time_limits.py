"""The two limits of a call: its whole time, and the time without progress."""

import time
from collections.abc import Mapping
from typing import Any

__all__ = ["Watch"]


class Watch:
    """The two limits of a call, and the simulated time last heard of."""

    def __init__(self, time_limit_s: float | None, stall_limit_s: float | None) -> None:
        self._start = self._beat = time.monotonic()
        self._limit, self._stall = time_limit_s, stall_limit_s
        self.time_s: float | None = None
        self._attempt = 1

    def beat(self, progress: Mapping[str, Any]) -> None:
        """Note a report; the same simulated time again is no sign of life, except in a further attempt."""
        time_s = progress.get("time_s")
        if time_s is not None:
            again, self._attempt = self._attempt, progress.get("attempt", 1)
            if again == self._attempt and self.time_s is not None and time_s <= self.time_s:
                return
            self.time_s = float(time_s)
        self._beat = time.monotonic()

    def patience_s(self) -> float | None:
        """Return how long to wait for the next message [s]."""
        now, left = time.monotonic(), []
        if self._limit is not None:
            left.append(self._start + self._limit - now)
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
        if self._limit is not None and now - self._start >= self._limit:
            raise TimeoutError(f"the time limit of {self._limit:g} s is over; {reached}")
        if self._stall is not None and now - self._beat >= self._stall:
            raise TimeoutError(f"no progress for {self._stall:g} s; {reached}")
