"""Whole studies: Fig. 13 on `linear` against the monolithic deck; a map of borders against one border.

Of Fig. 13 our side is run whole, in one process, from the extraction to the last drop. The deck is timed at
single points: the beginning of a drop, at its fastest setting within `ACCURACY` of a tight lockstep. What a
simulated second costs there, between the points by the period's logarithm, times the seconds that the sweep
simulated (`Dropped.samples` periods) is what the deck would take; loading it for each run is not counted.
Where ours is more than `ACCURACY` off, the deck may be as much.
"""

from __future__ import annotations

import math
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import monolithic
from benchmarks.figure import Figure, figure
from benchmarks.models import ACCURACY, Report, model, packed, signals, tip_errors
from benchmarks.rig import ROOT, SMOOTH, Outcome, instants, lockstep, retold, tight
from cosim.analysis.held_contact import HeldContact
from cosim.analysis.stability import border, held
from cosim.analysis.stiffness_map import Axis, border_map
from cosim.ngspice.child import Child
from cosim.plan import resolve
from cosim.studies.drop_test import Job, jobs, scan
from cosim.studies.study import StudyFile, load_study

FIG13 = ROOT / "scenes" / "paper" / "1_fig13.toml"
#: The two curves of Fig. 13.
CURVES = ("discrete only", "with 100 N/m analog")
#: Places among the periods at which the deck is timed.
POINTS = (0, 5, 11)
#: Length of the timed drop in periods; beginning of the drop, touch and a few contacts.
PERIODS, LEAST_S, MOST_S = 100, 0.6, 2.0
#: Settings of the deck: integration, relative tolerance, longest step as a share of the period.
SETTINGS = tuple(
    (method, rtol, share)
    for method in ("trap", "gear")
    for rtol in (1e-2, 1e-3, 1e-4, 1e-5)
    for share in (0.01, 0.04, 0.16, 1.0)
)
#: Stiffness of the timed drop over the exact limit: where most drops of a scan are.
_BELOW = 0.8
#: Cells of the map along each side, and stiffnesses scanned.
SIDE, SCANNED = 100, (1.0, 1e5)


def fig13(repetitions: int) -> list[Figure]:
    """Fig. 13 on `linear` against the deck."""
    spec = load_study(FIG13)
    ours: dict[tuple[str, float], tuple[float, int, int]] = {}
    exact: dict[tuple[str, float], float] = {}
    extracting = 0.0
    work: dict[tuple[str, float], Job] = {}
    for family in spec.parameters.families:
        if family.name in CURVES:
            begun = time.perf_counter()
            for period, job in jobs(spec, family).items():
                work[family.name, period] = job
            extracting += time.perf_counter() - begun
    warm = next(iter(work.values()))
    scan(Job(warm.scene, warm.constants, warm.circuit, _few(warm)))  # compiled by then
    for place, job in work.items():
        begun = time.perf_counter()
        dropped = scan(job)
        exact[place] = dropped.exact_n_per_m
        ours[place] = (time.perf_counter() - begun, dropped.runs, dropped.samples)
        print(
            f"  {place[0]}, {1e3 * place[1]:.3g} ms: {ours[place][0]:.2f} s, {dropped.runs} drops", flush=True
        )
    periods = sorted({period for _, period in work})
    rates: dict[str, list[dict[str, Any]]] = {}
    for curve in CURVES:
        rates[curve] = []
        for at in POINTS:
            payload = {
                "spec": spec,
                "curve": curve,
                "period": periods[at],
                "stiffness": _BELOW * exact[curve, periods[at]],
                "repetitions": max(2, repetitions // 5),
            }
            with Child() as child:
                rates[curve].append(child.call("benchmarks.sweeps:deck_rate", payload))
            print(f"  deck, {curve}, {1e3 * periods[at]:.3g} ms: {rates[curve][-1]}", flush=True)
    peer = 0.0
    for (curve, period), (_, _, samples) in ours.items():
        known = rates[curve]
        rate = np.interp(
            math.log(period), [math.log(row["period_s"]) for row in known],
            [math.log(row["per_second"]) for row in known],
        )  # fmt: skip
        peer += math.exp(float(rate)) * samples * period
    wall = extracting + sum(seconds for seconds, _, _ in ours.values())
    every = [row for rows in rates.values() for row in rows]
    return [
        figure(
            "fig13_vs_monolithic", [wall / peer],
            error_ours=max(row["error_ours"] for row in every),
            error_peer=max(row["error_peer"] for row in every),
            error_unit="of the largest position or force, first contacts; both against one tight lockstep",
            details={
                "times_faster": peer / wall, "ours_s": wall, "of_it_extraction_s": extracting, "peer_s": peer,
                "drops": sum(runs for _, runs, _ in ours.values()),
                "simulated_s": sum(samples * period for (_, period), (_, _, samples) in ours.items()),
                "measured": rates,
            },
        )
    ]  # fmt: skip


def _few(job: Job) -> Any:
    from dataclasses import replace

    return replace(job.rest, phases=1, window_s=job.scene.computer.period_s * 20, from_share=0.9)


def deck_rate(payload: dict[str, Any], report: Report) -> dict[str, Any]:
    """Time the deck on the beginning of one drop at its fastest setting that is accurate; runs in a child."""
    spec: StudyFile = payload["spec"]
    family = next(each for each in spec.parameters.families if each.name == payload["curve"])
    period = payload["period"]
    length = min(max(PERIODS * period, LEAST_S), MOST_S)
    changes = (
        *family.set, *SMOOTH, f"computer.period_s={period!r}", f"duration_s={length!r}",
        f"computer.discrete_stiffness_n_per_m={payload['stiffness']!r}",
    )  # fmt: skip
    plan = resolve(spec.scene(*changes, "solver.model=spice"))
    reference = lockstep(tight(plan), keep=True)
    constants = reference.constants
    assert constants is not None
    times = instants(plan)
    steps = monolithic.recorded_steps(plan, reference)
    own = resolve(spec.scene(*changes))
    circuit = model(own, "linear", own.scene.solver.reduction_tolerance)
    run = packed(own, constants, circuit, own.scene.solver.coupling_tolerance_rad)
    error_ours = max(tip_errors(signals(run), reference.signals, times))
    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as name:
        folder = Path(name)

        def peer(setting: tuple[str, float, float]) -> Outcome:
            method, rtol, share = setting
            changed = retold(plan, rtol=rtol, method=method, max_step_s=share * period)
            return monolithic.run(changed, constants, steps, "pwl", folder, monolithic.TIP)

        tried = []
        for setting in SETTINGS:
            outcome = peer(setting)
            tried.append(
                (outcome.wall_s, max(tip_errors(outcome.signals, reference.signals, times)), setting)
            )
            report({"time_s": float(len(tried))})
        good = [row for row in tried if row[1] <= max(ACCURACY, error_ours)]
        _, error, best = min(good) if good else min(tried, key=lambda row: row[1])
        walls = [peer(best).wall_s for _ in range(payload["repetitions"])]
    return {
        "period_s": period, "window_s": length, "per_second": statistics.median(walls) / length,
        "setting": best, "error_ours": error_ours, "error_peer": error,
    }  # fmt: skip


def borders(repetitions: int) -> list[Figure]:
    """Map borders over period and analog stiffness against one border."""
    spec = load_study(FIG13)
    scene = spec.scene("computer.method=combined", "computer.analog_stiffness_n_per_m=100")
    contact = HeldContact.of(resolve(scene))

    def one() -> tuple[float, float]:
        begun = time.perf_counter()
        edge = border(
            lambda k: held(contact.with_computer(discrete_stiffness_n_per_m=k)),
            *SCANNED,
        )
        return time.perf_counter() - begun, edge.value

    one()
    rows = Axis("computer.analog_stiffness_n_per_m", tuple(float(k) for k in np.linspace(1.0, 400.0, SIDE)))
    columns = Axis("computer.period_s", tuple(float(t) for t in np.geomspace(3e-3, 0.1, SIDE)))
    before = [one()[0] for _ in range(5)]
    begun = time.perf_counter()
    limits = border_map(
        scene, contact.constants, contact.circuit, rows, columns, low=SCANNED[0], high=SCANNED[1], workers=1
    )
    wall = time.perf_counter() - begun
    singles = before + [one()[0] for _ in range(5)]
    errors = []
    rng = np.random.default_rng(1)
    for i, j in rng.integers(0, SIDE, (8, 2)):
        there = contact.with_computer(analog_stiffness_n_per_m=rows.values[i], period_s=columns.values[j])
        single = border(
            lambda k, at=there: held(at.with_computer(discrete_stiffness_n_per_m=k)),
            *SCANNED,
        ).value
        errors.append(abs(limits[i, j] / single - 1.0))
    ratios = [wall / single for single in singles]
    return [
        figure(
            "border_map", ratios, error_ours=max(errors), error_peer=0.0,
            error_unit="of the border, at 8 cells; both are exact",
            details={"map_s": wall, "one_border_s": statistics.median(singles), "cells": SIDE * SIDE},
        )
    ]  # fmt: skip
