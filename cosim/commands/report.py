"""``cosim report``: one self-contained page about a result, or about a scene that it runs first."""

import argparse
from pathlib import Path
from typing import Any

from cosim.commands.command import Command


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "results", nargs="+", help="result folder(s) of `cosim run`; the first is the reference"
    )
    parser.add_argument(
        "-o", "--out", metavar="FOLDER", help="folder for the page (default: report/ in the first result)"
    )


def _run(args: argparse.Namespace) -> tuple[dict[str, Any], str]:
    from cosim.results import Run
    from reports.page import write_report
    from reports.tables import Trial

    folders = [folder for given in args.results for folder in result_folders(Path(given))]
    runs = [Run.load(folder) for folder in folders]
    trials = [Trial(folder.name, run.measures, run) for folder, run in zip(folders, runs, strict=True)]
    out = Path(args.out) if args.out else Path(args.results[0]) / "report"
    page = write_report(runs[0], out, trials if len(trials) > 1 else ())
    return {"page": str(page), "runs": [str(folder) for folder in folders]}, f"wrote {page}"


def result_folders(folder: Path) -> list[Path]:
    """Return the folder itself if it is a result, else the results in it (a ``--set`` run), in order."""
    if (folder / "run.json").is_file():
        return [folder]
    inside = sorted(
        (path.parent for path in folder.glob("*/run.json")), key=lambda path: path.stat().st_mtime
    )
    return inside or [folder]


COMMAND = Command("report", "write one self-contained HTML page about results", _arguments, _run)
