"""``cosim report``: one self-contained page about results, or about studies that it runs first."""

import argparse
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.caution import Caution, collected, warn
from cosim.commands.command import Command, tolerance_argument

if TYPE_CHECKING:
    from cosim.ngspice.deck import Deck
    from cosim.results import Run
    from cosim.studies.study import StudyFile

#: Inputs that the terminal shows.
_MOST_INPUTS = 12


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "results",
        nargs="+",
        help="result folder(s), the first is the reference; or study file(s), or a folder of them",
    )
    parser.add_argument(
        "-o", "--out", metavar="FOLDER", help="folder for the page (default: report/ in the first result)"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="of studies: change a key of their scenes or a name of their netlists; repeatable",
    )
    tolerance_argument(
        parser,
        "of results: say which measures are not known to be so right; of studies: choose the solver for it",
    )


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    studies = study_files([Path(given) for given in args.results])
    return _report_studies(args, studies) if studies else _report_runs(args)


def _report_runs(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.comparisons.input_differences import differing
    from cosim.errors import fail
    from cosim.results import PAGE_FOLDER, Run
    from cosim.storage.staging import writable_folder
    from reports.page import write_report
    from reports.tables import Trial, inputs_table

    out = Path(args.out) if args.out else Path(args.results[0]) / PAGE_FOLDER
    writable_folder(out)
    if args.set:
        fail("a result is what it is: only the scenes of studies can be changed", key="--set", value=args.set)
    folders = [folder for given in args.results for folder in result_folders(Path(given))]
    runs = [_judged(Run.load(folder), args.tol) for folder in folders]
    for folder, run in zip(folders, runs, strict=True):
        with collected(folder.name if len(runs) > 1 else ""):
            warn(*run.warnings)
    trials = [Trial(folder.name, run.measures, run) for folder, run in zip(folders, runs, strict=True)]
    differences = differing(runs, [_board(folder) for folder in folders]) if len(runs) > 1 else []
    inputs = inputs_table([folder.name for folder in folders], differences) if len(runs) > 1 else None
    page = write_report(runs[0], out, trials if len(trials) > 1 else (), inputs)
    lines = [f"{name}: {', '.join('-' if v is None else v for v in values)}" for name, values in differences]
    shown = [f"  {line}" for line in lines[:_MOST_INPUTS]]
    if len(lines) > len(shown):
        shown.append(f"  and {len(lines) - len(shown)} more, on the page")
    head = ["inputs that differ:"] if shown else ["all inputs are equal"] if len(runs) > 1 else []
    data = {
        "page": str(page),
        "runs": [str(folder) for folder in folders],
        "inputs": [{"input": name, "values": list(values)} for name, values in differences],
    }
    return data, "\n".join([*head, *shown, f"wrote {page}"])


def _judged(run: "Run", texts: list[str]) -> "Run":
    """Return the result with a caution about each measure that may be wrong by more."""
    if not texts:
        return run
    from cosim.accuracy.tolerance_control import parse_tolerances, shortfalls

    missed = parse_tolerances(texts).missed(run.measures)
    again = f"simulate it with cosim run SCENE {' '.join(f'--tol {text!r}' for text in texts)}"
    shortfall_cautions = [replace(caution, advice=again) for caution in shortfalls(missed)]
    return replace(run, warnings=(*run.warnings, *shortfall_cautions))


def _board(folder: Path) -> "Deck | None":
    """Return the board that a result keeps; None where it keeps none that can be read."""
    from cosim.errors import InputError
    from cosim.ngspice import deck_file

    try:
        return deck_file.load(folder)
    except InputError as error:
        why = "; ".join(problem.message for problem in error.problems)
        warn(Caution("board-unread", f"the board kept in {folder.name} is not compared: {why}",
                     "run the scene again"))  # fmt: skip
        return None


def study_files(given: list[Path]) -> list[Path]:
    """Return the study files among `given` and in its folders, in the order of their names.

    Raises
    ------
    InputError
        When studies and results are mixed.
    """
    from cosim.errors import fail
    from cosim.studies.study import is_study

    paths: list[Path] = []
    for path in given:
        listed = path.glob("*.toml") if os.path.isdir(path) else ()
        inside = [path] if is_study(path) else sorted(filter(is_study, listed))
        if paths and not inside:
            fail("holds no study file: studies and results need pages of their own", file=str(path))
        paths += inside
    return paths


def _report_studies(args: argparse.Namespace, files: list[Path]) -> tuple[dict[str, Any], str]:
    from cosim.accuracy.tolerance_control import parse_tolerances
    from cosim.commands.progress import progress
    from cosim.storage.owned_files import refuse_foreign
    from cosim.studies.claims import Claims, load_claims
    from cosim.studies.study import load_study, run_study
    from cosim.variants import overrides
    from reports.page import PAGE_NAME
    from reports.study_page import MANIFEST, write_study_page

    parse_tolerances(args.tol)  # refuse a bad tolerance before any file is read
    changes = overrides(args.set)
    specs = [load_study(file, changes) for file in files]  # all are checked before the first runs
    if args.tol:
        specs = _within(specs, args.tol)
    # the claims of a folder are about all of its studies together
    folders = [path for path in map(Path, args.results) if os.path.isdir(path)]
    claims = load_claims(folders[0]) if len(folders) == 1 else Claims()
    out = (
        Path(args.out)
        if args.out
        else Path("out") / (files[0].parent.name if len(files) > 1 else files[0].stem)
    )
    refuse_foreign(out, [PAGE_NAME], MANIFEST)
    results = []
    with collected() as cautions:
        for number, spec in enumerate(specs, start=1):
            with progress(f"{number}/{len(specs)} {spec.title}") as show, collected(spec.title):
                results.append(
                    (spec.file.stem, run_study(spec, out / "studies" / spec.file.stem, on_progress=show))
                )
    title = claims.title or (specs[0].title if len(specs) == 1 else f"Studies of {files[0].parent.name}")
    asked = [f"--set {change}" for change in args.set] + [f"--tol {text!r}" for text in args.tol]
    page = write_study_page(
        results,
        out,
        title,
        " ".join(["cosim report", *args.results, *asked]),
        claims.claims,
        cautions=cautions,
    )
    verdicts = [verdict for _, result in results for verdict in result.verdicts]
    judged = {verdict.id for verdict in verdicts}
    left = [claim.id for claim in claims.claims if claim.id not in judged]
    marks = {True: "ok  ", False: "NOT ", None: "    "}
    lines = [f"{marks[v.holds]} {v.id:6} {v.claim}: {v.outcome}{' (own check)' * v.own}" for v in verdicts]
    lines += [f"     {name:6} not judged" for name in left]
    lines.append(f"wrote {page}")
    data = {"page": str(page), "verdicts": [vars(v) for v in verdicts], "not_judged": left}
    return data, "\n".join(lines)


def _within(specs: "list[StudyFile]", tolerances: list[str]) -> "list[StudyFile]":
    """Return the studies, with tolerances where their runs have measures; warns about the others.

    Raises
    ------
    InputError
        Where there is none.
    """
    from cosim.errors import fail

    reasons = {spec.study.name: spec.study.no_tolerance for spec in specs if spec.study.no_tolerance}
    words = [f'a study "{name}" has no tolerance to choose: {why}' for name, why in reasons.items()]
    if all(spec.study.no_tolerance for spec in specs):
        fail("; ".join(words), file=str(specs[0].file), key="--tol", value=tolerances)
    warn(*(Caution("no-tolerance", text, "its page states what its numbers rest on") for text in words))
    return [
        spec if spec.study.no_tolerance else replace(spec, tolerances=tuple(tolerances)) for spec in specs
    ]


def result_folders(folder: Path) -> list[Path]:
    """Return the folder itself if it is a result, else the results in it (a ``--set`` run), in order."""
    if os.path.isfile(folder / "run.json") or not os.path.isdir(folder):
        return [folder]
    inside = sorted(
        (path.parent for path in folder.glob("*/run.json")), key=lambda path: path.stat().st_mtime
    )
    return inside or [folder]


COMMAND = Command("report", "write one self-contained HTML page about results or studies", _arguments, _run)
