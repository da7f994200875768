"""What a run leaves while it lasts: rows and samples in files, faults as errors, and what it cost."""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np

from cosim.errors import Crawl, InputError, SimulationError, StepTooSmall
from cosim.loop.setup import Memory
from cosim.loop.state import NO_VOLTAGE, PATIENCE, Fault
from cosim.loop.userclass import in_users_words
from cosim.storage.staging import disk_errors
from cosim.types import Report
from mech.addresses import address_of

_FAULTS = {
    Fault.NOT_FINITE: "a motor current is not a finite number",
    Fault.DIVERGED: "the coupling of circuit and linkage diverged: a joint angle was predicted wrong by more "
    "than half a radian in one step; shorten solver.max_step_s",
    Fault.STEP_COLLAPSED: "the steps became endlessly short: more than a million points in one sampling "
    "period; loosen solver.coupling_tolerance_rad or solver.rtol",
    Fault.SAMPLE_LOST: "a sample of the computer was overtaken before its DACs changed",
    Fault.RAN_AWAY: "the device ran away: a joint turns faster than 1e5 rad/s. The closed loop is "
    "unstable or a force has no bounds: look at resistors and gains that were changed (cosim check tells "
    "gains and loop margins), the operator, and the stiffness that the sampling period allows "
    "(cosim stability)",
    Fault.STOPPED: "stopped",
    Fault.CRAWLS: f"ngspice crawls: Newton's method takes {PATIENCE:g} times the steps that were predicted",
}
#: Faults that another error control may get around.
_KINDS = {Fault.STEP_COLLAPSED: StepTooSmall, Fault.CRAWLS: Crawl}
#: Streamed while the simulation runs, in the result's temporary folder.
ROWS, SAMPLES = "rows.f64", "samples.f64"


class Owner(Protocol):
    """Whoever owns time, as a `Recorder` knows it."""

    def truncate_vectors(self) -> bool:
        """Forget what has been handed over; whether that was possible."""

    def stop(self) -> None:
        """End the run at its next point."""


class Recorder:
    """Streams rows and samples to files, and turns faults of compiled code into exceptions.

    `streams` take rows and samples in place of files in `folder`.
    """

    def __init__(
        self,
        memory: Memory,
        simulator: Owner,
        folder: Path,
        report: Report,
        *,
        deck: str | None = None,
        person: str = "operator",
        nodes: Sequence[str] = (),
        streams: tuple[BinaryIO, BinaryIO] | None = None,
    ) -> None:
        self.memory, self.simulator, self.report = memory, simulator, report
        self.folder, self.deck, self.person, self.nodes = folder, deck, person, tuple(nodes)
        self.failure: BaseException | None = None
        self.running = True  # stop only a running analysis: the next one would stop at its start
        opened = streams or (open(folder / ROWS, "wb"), open(folder / SAMPLES, "wb"))
        self.rows: BinaryIO = opened[0]
        self.samples: BinaryIO = opened[1]
        self.bytes = 0
        this = weakref.proxy(self)  # or a run's memory would stay until garbage is collected
        self.callback = ctypes.CFUNCTYPE(None)(lambda: this.drain())
        state = memory.state[0]
        state["drain_address"] = address_of(self.callback)

    def drain(self) -> None:
        """Write what compiled code has left in the buffers; called by it, so it must not raise."""
        try:
            s = self.memory.state[0]
            with disk_errors(self.folder):
                self._write(self.rows, self.memory.rows, "rows")
                self._write(self.samples, self.memory.samples, "samples")
            self.simulator.truncate_vectors()
            try:
                self.memory.operator.raise_pending()
            except BaseException as error:
                raise in_users_words(self.person, error, float(s["t"])) from error
            if s["fault"]:
                kind = _KINDS.get(int(s["fault"]), SimulationError)
                raise kind(self._words(s), deck=self.deck, time_s=float(s["t"]))
            self.report({"time_s": float(s["t"]), "points": int(s["points"])})
        except BaseException as error:
            self.fail(error)

    def _words(self, state: np.void) -> str:
        """Return what a fault means; voltages that no circuit has are of the node that is worst."""
        if not self.nodes or state["fault"] != Fault.NOT_FINITE:
            return _FAULTS[int(state["fault"])]
        peaks = state["node"]["peak"][: len(self.nodes)]
        if not np.all(peaks < NO_VOLTAGE):
            worst = int(np.argmax(np.where(np.isnan(peaks), math.inf, peaks)))
            return (
                f"{self.nodes[worst]} is at {peaks[worst]:.3g} V, which no circuit is: an expression divides "
                "by zero, or a gain has no bounds"
            )
        return _FAULTS[int(state["fault"])]

    def fail(self, error: BaseException) -> None:
        """Keep what went wrong in a callback and stop ngspice at its next point."""
        self.failure = self.failure or error
        if self.running:
            self.simulator.stop()

    def _write(self, file: BinaryIO, buffer: np.ndarray[Any, Any], kind: str) -> None:
        memory = self.memory.state[0][kind]
        file.write(buffer[: memory["used"]].data)
        memory["used"] = 0

    def close(self) -> None:
        """Write the rest and close; raises what went wrong while compiled code was running."""
        self.drain()
        for file in (self.rows, self.samples):
            try:
                with disk_errors(self.folder):
                    file.close()
            except InputError as error:  # the rest in the buffer met a full disk
                self.fail(error)
        if self.failure is not None:
            raise self.failure


def statistics(memory: Memory, wall_s: float, cpu_s: float) -> dict[str, Any]:
    """Return the cost of the run and the error of its coupling."""
    s = memory.state[0]
    return {
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "points": int(s["points"]),
        "rejected": int(s["rejected"]),
        "source_calls": int(s["calls"]["count"]),
        "discontinuities": int(s["discontinuities"]),
        "random_draws": memory.draws,
        "defect_max_rad": float(s["defect_max"]),
        "defect_sum_rad": float(s["defect_sum"]),
    }
