"""What runs in the simulations' processes: functions of (payload, report), as `cosim.ngspice.child` asks.

A child may send numbers, arrays, containers and types of the package, but none of the benchmarks' own.
"""

from __future__ import annotations

import resource
import statistics
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks import monolithic
from benchmarks.callbacks import CallLog
from benchmarks.figure import interleaved
from benchmarks.replay import replay
from benchmarks.rig import CURRENTS, Outcome, equations, error, instants, lockstep, retold, smooth, tight
from cosim.plan import Plan

Report = Callable[[dict[str, Any]], None]
#: Room for the points of a tight run.
_TIGHT_ROOM = 200_000


def lockstep_wall(payload: dict[str, Any], report: Report) -> float:
    """Run our lockstep once; returns its wall time [s]."""
    return lockstep(payload["plan"]).wall_s


def lockstep_run(payload: dict[str, Any], report: Report) -> dict[str, Any]:
    """Run our lockstep once and keep its signals; returns `Outcome`'s fields."""
    return vars(lockstep(payload["plan"], keep=True))


def replay_pair(payload: dict[str, Any], report: Report) -> dict[str, Any]:
    """Lockstep and replay in turn: walls, points, and the error of each against its own tight run."""
    plan: Plan = payload["plan"]
    ours = lockstep(plan, keep=True)
    assert ours.constants is not None
    gear = ours.constants.gear
    peer = replay(plan, ours, gear)
    once = peer.run()
    times = instants(plan)
    truth = replay(tight(plan), ours, gear, room=_TIGHT_ROOM).run()
    error_peer = error(once.signals, truth.signals, CURRENTS, times)
    even = smooth()
    reference = lockstep(tight(even), keep=True)
    error_ours = error(lockstep(even, keep=True).signals, reference.signals, CURRENTS, times)
    walls = interleaved(payload["repetitions"], lambda: lockstep(plan).wall_s, lambda: peer.run().wall_s)
    return {
        "walls": walls,
        "points": (ours.stats["points"], once.stats["points"]),
        "rejected": (ours.stats["rejected"], once.stats["rejected"]),
        "difference": error(once.signals, ours.signals, CURRENTS, times),
        "error_ours": error_ours,
        "error_peer": error_peer,
    }


def callback_times(payload: dict[str, Any], report: Report) -> dict[str, Any]:
    """All callbacks of a run repeated without ngspice, the empty loop, and the run, in turn [s]."""
    plan: Plan = payload["plan"]
    log = CallLog(plan)
    walls = interleaved(
        payload["repetitions"],
        log.seconds,
        lambda: log.seconds(empty=True),
        lambda: lockstep(plan).wall_s,
    )
    return {"walls": walls, "calls": log.parts()}


def monolithic_choice(payload: dict[str, Any], report: Report) -> dict[str, Any]:
    """Find the peer's fastest setting that is as accurate as we are, then time both in turn.

    Returns
    -------
    dict
        'walls' of ours and the peer, errors, the peer's setting, all settings tried, and its microseconds a
        point with recorded DACs and with none.
    """
    plan, repetitions = smooth(), payload["repetitions"]
    reference = lockstep(tight(plan), keep=True)
    constants = reference.constants
    assert constants is not None
    steps = monolithic.recorded_steps(plan, reference)
    times = instants(plan)
    names = (*CURRENTS, "q1", "q2")
    error_ours = error(lockstep(plan, keep=True).signals, reference.signals, names, times)
    tried = []
    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as name:
        folder = Path(name)

        def peer(method: str, feed: str, rtol: float, longest: float) -> Outcome:
            changed = retold(plan, rtol=rtol, method=method, max_step_s=longest)
            return monolithic.run(changed, constants, steps, feed, folder)

        for method in ("trap", "gear"):
            for rtol in (1e-2, 1e-3, 1e-4, 1e-5):
                for longest in (1e-3, 2e-3, 4e-3):
                    runs = [peer(method, "pwl", rtol, longest) for _ in range(3)]
                    tried.append(
                        {
                            "setting": (method, "pwl", rtol, longest),
                            "error": error(runs[0].signals, reference.signals, names, times),
                            "points": runs[0].stats["points"],
                            "wall_s": min(run.wall_s for run in runs),
                        }
                    )
                    report({"time_s": float(len(tried))})
        good = [row for row in tried if row["error"] <= error_ours]
        if not good:
            raise RuntimeError("no setting of the monolithic deck is as accurate as the lockstep")
        best = min(good, key=lambda row: row["wall_s"])
        method, _, rtol, longest = best["setting"]
        # the same setting with the other feeds: the same points, another cost
        feeds = {feed: peer(method, feed, rtol, longest) for feed in monolithic.FEEDS}
        errors = {feed: error(run.signals, reference.signals, names, times) for feed, run in feeds.items()}

        def timed(feed: str) -> Callable[[], float]:
            return lambda: peer(method, feed, rtol, longest).wall_s

        silent = peer(method, "none", rtol, longest)
        walls = interleaved(
            repetitions,
            lambda: lockstep(plan).wall_s,
            *(timed(feed) for feed in monolithic.FEEDS),
            timed("none"),
        )
    peers = dict(zip(monolithic.FEEDS, walls[1:-1], strict=True))
    fastest = min(peers, key=lambda feed: statistics.median(peers[feed]))
    return {
        "walls": (walls[0], peers[fastest]),
        "error_ours": error_ours,
        "error_peer": errors[fastest],
        "setting": {"feed": fastest, "method": method, "rtol": rtol, "max_step_s": longest},
        "feeds_ms": {feed: 1e3 * statistics.median(times) for feed, times in peers.items()},
        "tried": tried,
        "us_per_point": 1e6 * statistics.median(peers[fastest]) / feeds[fastest].stats["points"],
        "us_per_point_source_free": 1e6 * statistics.median(walls[-1]) / silent.stats["points"],
        "points": feeds[fastest].stats["points"],
    }


def growth_run(payload: dict[str, Any], report: Report) -> dict[str, Any]:
    """Run one board: wall time [s] and points, and the number of equations of its matrix if asked."""
    plan: Plan = payload["plan"]
    done = lockstep(plan)
    count = equations(plan) if payload["count"] else 0
    return {"wall_s": done.wall_s, "points": done.stats["points"], "equations": count}


def memory_run(payload: dict[str, Any], report: Report) -> dict[str, Any]:
    """Run a long scene and return the peak resident memory of this process [MB] and its points."""
    done = lockstep(payload["plan"])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"peak_mb": peak / (1e6 if sys.platform == "darwin" else 1e3), "points": done.stats["points"]}


def same_work(payload: dict[str, Any], report: Report) -> dict[str, Any]:
    """Run the peers of this process once on a short run: what a test can hold them to."""
    plan = smooth(payload["duration_s"])
    ours = lockstep(plan, keep=True)
    assert ours.constants is not None
    times = instants(plan)
    peer = replay(plan, ours, ours.constants.gear).run()
    log = CallLog(plan)
    log.seconds()
    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as folder:
        steps = monolithic.recorded_steps(plan, ours)
        peer_run = monolithic.run(plan, ours.constants, steps, "pwl", Path(folder))
    return {
        "points": ours.stats["points"],
        "replay_points": peer.stats["points"],
        "replay_difference": error(peer.signals, ours.signals, CURRENTS, times),
        "calls": log.parts(),
        "monolithic_difference": error(peer_run.signals, ours.signals, ("q1", "q2"), times),
    }
