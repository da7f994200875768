"""``cosim mc``: measures of many devices built from one design, their yield, and which component to blame."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.commands.command import Command, trust_arguments

if TYPE_CHECKING:
    from cosim.tolerance.intervals import Estimate
    from cosim.tolerance.random_variables import Tolerances
    from cosim.tolerance.scene_study import Asked, Prepared, Processes
    from cosim.tolerance.study_results import Findings

_USUAL_SAMPLES = 200
#: Options of a whole study.
_OF_A_STUDY = (
    "two_level", "rare", "until", "wanted", "worst_case", "workers", "chunk", "shard", "merge", "out",
)  # fmt: skip
#: Options, and those that have no meaning beside each.
_ALONE = {
    "--list": (*_OF_A_STUDY, "samples", "sample"),
    "--sample": _OF_A_STUDY,
    "--shard": ("two_level", "rare", "wanted", "worst_case", "merge"),
    "--merge": ("two_level", "rare", "workers", "chunk"),
    "--until": ("samples",),
    "--cluster": ("list", "sample", "shard", "merge", "workers"),
}
#: Options that say something, or are not given.
_TEXTS = ("until", "shard", "cluster", "out", "model")
#: What the last columns of the bill mean.
_COLUMNS = (
    "loosest: the largest tolerance sold with which that component alone still keeps the yield; better: the "
    "next better one sold; adds: what it alone adds to the yield"
)
#: Lines of the bill that are printed; the file has all.
_MOST_LINES = 12


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", help="scene file (TOML)")
    parser.add_argument("-n", "--samples", type=int, metavar="N", help=f"devices (default: {_USUAL_SAMPLES})")
    parser.add_argument(
        "--measure", action="append", default=[], metavar="NAME", help="measure of the devices; repeatable"
    )
    parser.add_argument(
        "--spec", action="append", default=[], metavar="TEXT",
        help='what a device must do to pass: "rendered_stiffness in 95..105", "k_max > 500"; repeatable',
    )  # fmt: skip
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="change a value for all; repeatable"
    )
    parser.add_argument("--model", metavar="NAME", help="circuit model instead of the effects' choice")
    parser.add_argument("--seed", type=int, metavar="S", help="of the draws (default: the scene's)")
    parser.add_argument(
        "--sampling", choices=("plain", "lhs", "sobol"), default="plain",
        help="plain (default), Latin hypercubes or scrambled Sobol points, 16 randomisations of either",
    )  # fmt: skip
    parser.add_argument(
        "--until", metavar="TEXT",
        help='instead of -n: "yield +- 0.5%%" or "k_max +- 5 N/m"; the number follows from a discarded pilot',
    )  # fmt: skip
    parser.add_argument(
        "--yield", dest="wanted", metavar="P", help="yield that the bill's loosest tolerances must keep: 99%%"
    )
    parser.add_argument("--worst-case", action="store_true", help="search the worst device within all limits")
    parser.add_argument(
        "--two-level", action="store_true",
        help="correct the samples by many of a cheaper model: spice by linear, linear by ideal",
    )  # fmt: skip
    parser.add_argument(
        "--rare", action="store_true",
        help="search failures of the specifications that are too rare for samples, and count them",
    )  # fmt: skip
    parser.add_argument("--list", action="store_true", help="print what varies, and draw nothing")
    parser.add_argument("--sample", type=int, metavar="I", help="measure sample I of the study alone")
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: one a processor)")
    parser.add_argument(
        "--cluster", metavar="ADDRESS",
        help="scheduler of `distributed` whose workers measure, tcp://HOST:PORT; they must see the folder",
    )  # fmt: skip
    parser.add_argument("--chunk", type=int, metavar="N", help="samples measured together")
    parser.add_argument("--shard", metavar="I/N", help="measure the I-th of N shards only, for array jobs")
    parser.add_argument("--merge", nargs="+", default=[], metavar="FOLDER", help="put shards together")
    trust_arguments(parser)
    parser.add_argument(
        "-o", "--out", metavar="FOLDER", help="folder for tables, record and page (default: out/mc)"
    )


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.caution import collected
    from cosim.commands.progress import progress
    from cosim.tolerance.replay import record_of
    from cosim.tolerance.scene_study import check_folder, measure_shard, monte_carlo, prepare
    from cosim.tolerance.spec import parse_specs
    from cosim.tolerance.worker_pool import prepare_pool

    _check_together(args)
    if (args.workers or 1) > 1:
        prepare_pool()  # meanwhile the scene is made ready
    prepared = prepare(_asked(args, parse_specs(args.spec)))
    if args.list:
        return _listed(prepared.tolerances)
    if args.sample is not None:
        return _one(prepared, args.sample)
    out = Path(args.out) if args.out else Path("out/mc")
    digest = prepared.digest()
    check_folder(out, digest)
    processes = _processes(args, out)
    if args.shard:
        with progress("mc") as show:
            done = measure_shard(prepared, processes, _shard(args.shard), show)
        return {"folder": str(out), "done": done}, f"wrote {out}: {done}"
    from cosim.storage.owned_files import refuse_foreign
    from reports.monte_carlo import FILES, MANIFEST, write_monte_carlo

    refuse_foreign(out, FILES, MANIFEST)  # refuse before the first sample
    with collected() as cautions, progress("mc") as show:
        findings = monte_carlo(prepared, show, processes)
    page = write_monte_carlo(
        findings,
        out,
        replay(args, findings.study.sampling.n),
        digest,
        cautions,
        record_of(prepared),
        whole(args),
    )
    result = findings.as_dict() | {"page": str(page)}
    return result, "\n".join([*_text(findings), f"wrote {page}"])


def _check_together(args: argparse.Namespace) -> None:
    """Refuse options that are empty or have no meaning beside another: none is ignored in silence."""
    from cosim.errors import InputError, Problem

    def given(name: str) -> bool:
        value = getattr(args, name)
        return value is not None and value is not False and value != "" and value != []

    problems = [
        Problem(f"has no meaning beside {option}", key="--yield" if name == "wanted" else
                "-n" if name == "samples" else f"--{name.replace('_', '-')}")
        for option, others in _ALONE.items() if given(option[2:])
        for name in others if given(name)
    ]  # fmt: skip
    # a variable of an array job that is not set: without its shard each would measure the whole study
    problems += [
        Problem("is empty", key=f"--{name}", value="") for name in _TEXTS if getattr(args, name) == ""
    ]
    if problems:
        raise InputError(problems)


def _processes(args: argparse.Namespace, out: Path) -> "Processes":
    from cosim.errors import fail
    from cosim.tolerance.scene_study import Processes

    for name in ("workers", "chunk"):
        value = getattr(args, name)
        if value is not None and value < 1:
            fail("must be at least one", key=f"--{name}", value=value, allowed=">= 1")
    return Processes(out, args.workers, args.chunk, tuple(map(Path, args.merge)), args.cluster)


def _shard(text: str) -> tuple[int, int]:
    from cosim.errors import fail

    i, slash, of = text.partition("/")
    if not (slash and i.strip().isdecimal() and of.strip().isdecimal()):  # a raised 2 is a digit, too
        fail("is not a shard", key="--shard", value=text, allowed="I/N, such as 1/8 to 8/8")
    return int(i), int(of)


def _asked(args: argparse.Namespace, specs: tuple[Any, ...]) -> "Asked":
    from cosim.errors import fail
    from cosim.ngspice.lines import number
    from cosim.tolerance.scene_study import Asked
    from cosim.variants import overrides

    wanted = None
    if args.wanted is not None:
        share = number(args.wanted.strip().removesuffix("%"))
        if share is None or not args.wanted.strip().endswith("%"):
            fail("is not a yield", key="--yield", value=args.wanted, allowed="per cent, such as 99%")
        if not specs:
            fail("needs a --spec: a yield is the share that passes", key="--yield", value=args.wanted)
        wanted = share / 100.0
    forced = (f"solver.model={args.model}",) if args.model else ()
    return Asked(
        args.scene, (*forced, *overrides(args.set)), tuple(args.measure), specs, _samples(args),
        args.sampling, args.seed, args.until or "", wanted, args.worst_case, args.trust, args.two_level,
        args.rare,
    )  # fmt: skip


def _samples(args: argparse.Namespace) -> int:
    return _USUAL_SAMPLES if args.samples is None else int(args.samples)


def replay(args: argparse.Namespace, n: int) -> str:
    """Return the command that measures one sample of `n` again, without its number."""
    import shlex

    words = _same_devices(args)
    words += ["--sampling", args.sampling, "-n", str(n)] if args.sampling != "plain" else []
    return f"{shlex.join(words)} --sample"


def whole(args: argparse.Namespace) -> str:
    """Return the command of the whole study, but for its folder and who works on it."""
    import shlex

    words = _same_devices(args)
    words += ["--sampling", args.sampling] if args.sampling != "plain" else []
    words += ["--until", args.until] if args.until else ["-n", str(_samples(args))]
    words += ["--yield", args.wanted] if args.wanted is not None else []
    words += [
        f"--{name.replace('_', '-')}" for name in ("worst_case", "two_level", "rare") if getattr(args, name)
    ]
    return shlex.join(words)


def _same_devices(args: argparse.Namespace) -> list[str]:
    """Return the words of a command that all its devices depend on."""
    words = ["cosim", "mc", args.scene]
    words += [word for text in args.set for word in ("--set", text)]
    words += [word for name in args.measure for word in ("--measure", name)]
    words += [word for text in args.spec for word in ("--spec", text)]
    words += ["--model", args.model] if args.model else []
    # what the netlists needed then, they need again
    words += [
        *(["--trust"] if args.trust else []),
        *(w for each in args.include for w in ("--include", each)),
    ]
    return words + (["--seed", str(args.seed)] if args.seed is not None else [])


def _listed(tolerances: "Tolerances") -> tuple[dict[str, Any], str]:
    from cosim.tolerance.listing import CONVENTION, component_rows, table

    result = {"components": component_rows(tolerances), "variables": list(tolerances.variables)}
    return result, "\n".join([*table(tolerances), CONVENTION])


def _one(prepared: "Prepared", number: int) -> tuple[dict[str, Any], str]:
    from cosim.catalogue import UNITS
    from cosim.errors import SimulationError
    from cosim.tolerance.missing import text_of
    from cosim.tolerance.scene_study import one_sample
    from cosim.units import quantity

    study, values = one_sample(prepared, number)
    missing = study.failures.get(number, {})
    if len(missing) == len(study.names):
        raise SimulationError(f"sample {number}: {text_of(missing)}")
    components = prepared.tolerances.components
    rows = [
        [each.key, quantity(value, each.unit, 6), f"nominal {quantity(each.nominal, each.unit, 6)}"]
        for each, value in zip(components, values, strict=True)
    ]
    known = zip(study.names, map(float, study.nominal), strict=True)
    measures = {name: value for name, value in known if name not in missing}
    lines = [f"{name}: {quantity(value, UNITS.get(name, ''), 6)}" for name, value in measures.items()]
    lines += [f"{name}: none: {why}" for name, why in missing.items()]
    keyed = dict(zip(prepared.tolerances.keys, map(float, values), strict=True))
    result = {"sample": number, "values": keyed, "measures": measures, "missing": dict(missing)}
    return result, "\n".join([*_aligned(rows), *lines])


def _text(findings: "Findings") -> list[str]:
    from cosim.catalogue import UNITS
    from cosim.tolerance.bill import grade_text
    from cosim.units import quantity

    study = findings.study
    how = study.sampling
    lines = [f"{how.n} devices, {how.method} sampling, seed {how.seed}, model {study.model}"]
    rows = [["measure", "nominal", "mean", "standard deviation", "1 % below", "1 % above"]]
    for name, each in findings.summaries.items():
        unit = UNITS.get(name, "")
        values = (each.mean, each.spread, each.quantiles[0.01], each.quantiles[0.99])
        rows.append([name, quantity(each.nominal, unit, 5), *(_with_interval(one, unit) for one in values)])
    lines += _aligned(rows)
    lines += [f"yield, {text}: {_percent(share)}" for text, share in findings.yields.items()]
    for name, corner in findings.corners.items():
        unit = UNITS.get(name, "")
        low, high = quantity(corner.low, unit, 5), quantity(corner.high, unit, 5)
        outside = f"; {corner.outside} samples lie outside the limits" if corner.outside else ""
        lines.append(f"worst case, {name}: {low} to {high} ({corner.evaluations} devices looked at{outside})")
    if findings.bill and findings.surfaces:
        names = list(findings.surfaces)
        table = [["component", "tolerance", *(f"share of {n}" for n in names), "loosest", "better", "adds"]]
        for line in findings.bill[:_MOST_LINES]:
            table.append(
                [
                    line.name, line.tolerance, *(_percent(line.share[n]) for n in names),
                    grade_text(line.loosest), grade_text(line.better),
                    "-" if line.gain is None else _percent(line.gain),
                ]
            )  # fmt: skip
        lines += ["", *_aligned(table), *([_COLUMNS] if findings.specs else [])]
        lines += [
            f"R^2 of samples that were not fitted, {n}: {s.explained:.5g}"
            for n, s in findings.surfaces.items()
        ]
    return [*lines, *findings.notes]


def _with_interval(of: "Estimate", unit: str) -> str:
    from reports.tolerance_sections import value

    return value(of, unit)


def _percent(of: "Estimate") -> str:
    return f"{100 * of.value:.4g} % ({100 * of.low:.4g} to {100 * of.high:.4g})"


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]


COMMAND = Command(
    "mc",
    "Monte Carlo over the tolerances: distributions, yield, worst case, and which component to blame",
    _arguments,
    _run,
)
