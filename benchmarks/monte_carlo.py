"""Monte Carlo: what two models save of plain samples, what the engine costs, and what a second core gives."""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.figure import Figure, figure
from benchmarks.rig import ROOT
from cosim.tolerance.engine import Job, Processes, run
from cosim.tolerance.intervals import clopper_pearson
from cosim.tolerance.model_levels import Levels
from cosim.tolerance.preparation import Asked, Prepared, prepare
from cosim.tolerance.scene_study import monte_carlo
from cosim.tolerance.spec import Spec
from cosim.tolerance.unit_cube import sampling
from cosim.tolerance.worker_pool import prepare_pool
from cosim.types import Array

#: Scene -> what is set so that a run is short, and its measure.
_SCENES = {
    "press": (("duration_s=1.0",), "rendered_stiffness"),
    "drop": (("duration_s=0.3",), "max_penetration"),
    "slope": (("duration_s=0.3",), "peak_force"),
}
#: Dear samples of a study of two models, and of one of its yield: the bound of no failure among devices that
#: nobody expects to fail, 1.7/n, is most of half of the interval that is wanted.
_DEAR, _DEAR_OF_A_YIELD = 48, 5600
#: Half the interval of a yield that plain samples are held against, and the failure rate.
_HALF, _RATE = 0.0004, 0.01
#: A study as people run it: what the pool's start costs is told by what 1,000 samples take.
_CHUNKS, _SAMPLES_OF_ENGINE = 5, 1000


def _prepared(scene: str, n: int, specs: Sequence[Spec] = ()) -> Prepared:
    overrides, measure = _SCENES[scene]
    return prepare(
        Asked(
            ROOT / "scenes" / f"{scene}.toml",
            ("solver.model=spice", *overrides),
            (measure,),
            tuple(specs),
            n,
            seed=1,
            two_level=True,
        )
    )


def _levels(prepared: Prepared) -> Levels:
    """Return what two models say."""
    levels = monte_carlo(prepared).levels
    assert levels is not None
    return levels


def two_levels(scene: str) -> Callable[[int], list[Figure]]:
    """Return the benchmark of a scene: seconds to an interval, over those of plain samples to the same one.

    What plain samples need for the same intervals follows from the standard deviation, of a Gaussian; the
    worse of mean and standard deviation counts. Seconds are those of a sample of each model, timed within the
    study, times all samples that it took.
    """

    def measured(repetitions: int) -> list[Figure]:
        prepared = _prepared(scene, _DEAR)
        levels = _levels(prepared)
        measure = _SCENES[scene][1]
        each = levels.moments[measure]
        dear, cheap = levels.seconds
        # the study's own devices are on both models
        spent = _DEAR * (dear + cheap) + each.cheap * cheap
        half = 0.5 * (each.mean_high - each.mean_low), 0.5 * (each.spread_high - each.spread_low)
        plain = [(1.96 * each.spread / half[0]) ** 2, 0.5 * (1.96 * each.spread / half[1]) ** 2]
        ratios = [spent / (max(n, 1.0) * dear) for n in plain]
        details = {
            "measure": measure,
            "one_less_correlation": 1.0 - each.pilot.correlation,
            "one_less_of_squares": 1.0 - each.pilot.of_squares,
            "cost_ratio": each.pilot.cost_ratio,
            "of_the_mean": ratios[0],
            "of_the_standard_deviation": ratios[1],
            "samples": (each.dear, each.cheap),
            "beside_the_plane": each.beside_plane,
            "of_the_formula": (each.pilot.gain(), each.pilot.gain(squares=True)),
            "target_holds_for": "rho >= 0.995, of the squares too, and a cost ratio <= 1/100",
        }
        return [figure(f"two_level_vs_plain_{scene}", [max(ratios)], details=details)]

    return measured


def yields(repetitions: int) -> list[Figure]:
    """Return `yield_of` with as many dear samples as the target's interval takes: some minutes."""
    return yield_of(_DEAR_OF_A_YIELD)


def _shown(at: int, of: int, what: str) -> None:
    if at == of or at % 500 == 0:
        print(f"  {what}: {at} of {of}", flush=True)


def yield_of(n: int) -> list[Figure]:
    """Seconds of a yield by strata at a failure rate of 1 %, over those of plain samples as close.

    The limit is where 1 % of the devices fail on the cheap model, by 2,048 of them. The interval is the one
    that a study of this size reaches; the target is for +-0.04 %, and nothing is scaled to it.
    """
    scene, measure = "drop", _SCENES["drop"][1]
    first = _prepared(scene, 8)
    draws = sampling("sobol", 2048, len(first.tolerances.variables), 7)
    with first.batch((measure,), "linear") as batch:  # its process keeps what it has measured
        table = batch.measures(first.tolerances.values(draws.uniforms(0, draws.n)))
    limit = float(np.nanquantile(table[:, 0], 1.0 - _RATE))
    prepared = _prepared(scene, n, (Spec(measure, high=limit),))
    begun = time.process_time()  # of this process: planes, the strata's weights, files; workers measure
    with tempfile.TemporaryDirectory(prefix="cosim-bench-") as name:
        levels = monte_carlo(prepared, _shown, Processes(Path(name) / "mc")).levels
    beside = time.process_time() - begun
    assert levels is not None
    (share,) = levels.yields.values()
    dear, cheap = levels.seconds
    dears = n + levels.extra
    # those on both models, the pilot's twice, and the cheap model's own
    cheaps = max(each.cheap + min(each.dear + 64, n) for each in levels.moments.values())
    cheaps += 0 if share.by.startswith("a plane") else _looked_through(levels, n)
    spent = dears * dear + cheaps * cheap + beside
    half = share.failing.half
    plain = _plain_devices(half)
    details = {
        "half_width": half,
        "failing": share.failing.value,
        "samples": (dears, cheaps),
        "by": share.by,
        "weights": share.weights,
        "counted": share.counted,
        "failed": share.failed,
        "cost_ratio": cheap / dear,
        "beside_samples_s": beside,
        "plain_samples": plain,
        "target_holds_for": f"a half width of {_HALF:g}",
    }
    return [figure("yield_vs_plain", [spent / (plain * dear)], details=details)]


def _looked_through(levels: Levels, n: int) -> int:
    """Return how many devices the cheap model was asked for the border, at most."""
    dear, cheap = levels.seconds
    return n + levels.extra + min(1 << 18, int(n * dear / cheap))


def _plain_devices(half: float) -> int:
    """Return how many plain samples, 1 % of which fail, have an exact interval of this half width, to 1 %."""
    n = 2
    while True:
        low, high = clopper_pearson(round(_RATE * n), n)
        if high - low <= 2.0 * half:
            return n
        n += max(1, n // 100)


def _bare(prepared: Prepared, points: Array) -> float:
    begun = time.perf_counter()
    batch = prepared.batch(prepared.names, prepared.plan.model)
    table = batch.measures(prepared.tolerances.values(points))
    if not np.isfinite(table).all():
        raise RuntimeError(f"samples failed: {batch.failures}")
    return time.perf_counter() - begun


def _job(prepared: Prepared, n: int) -> tuple[Job, Array]:
    how = sampling("plain", n, len(prepared.tolerances.variables), prepared.seed)
    return prepared.job(how, n), how.uniforms(0, n)


def engine_overhead(repetitions: int) -> list[Figure]:
    """Share that the engine adds to `spice` samples: chunks, files and the pool, one worker."""
    prepared = _prepared("drop", _SAMPLES_OF_ENGINE)
    job, points = _job(prepared, _SAMPLES_OF_ENGINE)
    _bare(prepared, points[:2])  # warms up
    shares = []
    for _ in range(max(min(repetitions, 3), 1)):
        bare = _bare(prepared, points)
        with tempfile.TemporaryDirectory(prefix="cosim-bench-") as name:
            begun = time.perf_counter()
            run(job, Path(name) / "mc", workers=1, chunk=_CHUNKS)
            shares.append((time.perf_counter() - begun) / bare - 1.0)
    return [figure("engine_overhead", [max(share, 0.0) for share in shares],
                   details={"samples": _SAMPLES_OF_ENGINE, "chunk": _CHUNKS})]  # fmt: skip


#: A loop of some seconds that uses one processor and no memory; it prints how long it took [s].
_LOOP = """
import time
begun, total = time.perf_counter(), 0
for k in range(30_000_000):
    total += k * k
print(time.perf_counter() - begun)
"""


def _two_loops() -> float:
    """Return how many times as much two plain loops of Python do side by side as one alone.

    Two processors that are threads of one core give less than two: no two workers can do better.
    """

    def seconds(count: int) -> float:
        loops = [
            subprocess.Popen([sys.executable, "-c", _LOOP], stdout=subprocess.PIPE, text=True)
            for _ in range(count)
        ]
        return max(float(loop.communicate()[0]) for loop in loops)

    return 2.0 * seconds(1) / seconds(2)


def two_cores(repetitions: int) -> list[Figure]:
    """Wall time of two workers' samples over one worker's; its inverse is the speed-up.

    Chunks are as large as the engine makes them, and the pool's template loads while the scene is made ready,
    as in `cosim mc`. Beside it stands what the processors themselves give, see `_two_loops`.
    """
    prepare_pool()
    prepared = _prepared("drop", _SAMPLES_OF_ENGINE)
    job, points = _job(prepared, _SAMPLES_OF_ENGINE)
    _bare(prepared, points[:2])  # warms up
    walls: list[list[float]] = [[], []]
    ceilings = []
    for _ in range(max(min(repetitions, 5), 1)):
        for workers, kept in zip((1, 2), walls, strict=True):
            with tempfile.TemporaryDirectory(prefix="cosim-bench-") as name:
                begun = time.perf_counter()
                run(job, Path(name) / "mc", workers=workers)
                kept.append(time.perf_counter() - begun)
        ceilings.append(_two_loops())
    ratios = [b / a for a, b in zip(*walls, strict=True)]
    details = {
        "samples": _SAMPLES_OF_ENGINE,
        "speed_up": 1.0 / statistics.median(ratios),
        "speed_up_of_plain_loops": statistics.median(ceilings),
        "one_s": walls[0],
        "two_s": walls[1],
    }
    return [figure("two_cores", ratios, details=details)]
