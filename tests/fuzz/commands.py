"""Whole commands on damaged projects: exit codes, words, time, JSON, and what is left behind."""

import json
import os
import random
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from cosim.errors import CosimError
from cosim.results import Run

from .inputs import TOKENS, mutated, numbers, values
from .targets import Project, check_words

#: A command may take so much longer than the scene's time limit [s].
BEYOND_S = 10.0
#: The scene's time limit in these cases [s].
LIMIT_S = 20.0
#: What is run; {scene} is the fuzzed scene, {out} a place of its own.
COMMANDS = (
    "run {scene} --out {out}/run",
    "run {scene} --out {out}/run --set {set} --format csv",
    "check {scene}",
    "check {board}",
    "plan {scene}",
    "plan {scene} --set {set}",
    "stability {scene}",
    "noise {scene} --set effects.pot_noise=white",
    "device {scene}",
    "export {scene} --out {out}/deck.cir",
    "compare {board} {scene} --set {set} --out {out}/compare",
    "sweep {scene} {set} --measure peak_force --out {out}/sweep",
    "mc {scene} --list",
    "mc {scene} --list --set {set}",
    "mc {scene} -n 2 --workers 1 --measure k_max --out {out}/mc",
    "nodes {scene}",
    "report {scene}",
    "report {result} --out {out}/report",
)


class Defect(AssertionError):
    """What no input may bring about."""


@dataclass(frozen=True)
class Case:
    """A command line with the file that was damaged for it."""

    words: tuple[str, ...]
    file: Path | None
    text: str


def cases(project: Project, result: Path) -> st.SearchStrategy[Case]:
    """Commands on a scene or a netlist with slips, with odd values, or with both."""
    texts = {path: path.read_text(encoding="utf-8") for path in (*project.scenes, *project.netlists)}
    keys = (
        *("r_sum_spring", "opa548_gbw", "tl072_gbw", "xdiff1.r11", "seed", "duration_s", "computer.period_s"),
        *("device.board", "effects.opamp", "solver.rtol", "record.nodes", "wall.normal"),
    )

    @st.composite
    def case(draw: Any) -> Case:
        path = draw(st.one_of(st.none(), st.sampled_from(list(texts))))
        text = draw(mutated([texts[path]])) if path is not None else ""
        scene = path if path in project.scenes else draw(st.sampled_from(project.scenes))
        odd = draw(st.one_of(numbers(), values(), st.sampled_from(TOKENS)))
        places = {
            "scene": str(scene),
            "board": str(project.netlists[1]),
            "set": f"{draw(st.sampled_from(keys))}={odd}".replace("\x00", ""),  # no command line can hold it
            "result": str(result),
            "out": "{out}",
        }
        form = draw(st.sampled_from(COMMANDS))
        words = [word.format(**places) for word in form.split()]
        return Case((*words, *draw(st.sampled_from(((), ("--json",))))), path, text)

    return case()


def exercise(project: Project, result: Path, folder: Path, number: int, count: int) -> dict[str, int]:
    """Run `count` commands; return how many ended with which exit code.

    Raises
    ------
    Defect
        For the first command that broke a promise; its words and its file are in the message.
    """
    codes: dict[str, int] = {}

    @seed(number)
    @settings(max_examples=count, database=None, deadline=None, phases=(Phase.generate,),
              suppress_health_check=list(HealthCheck), print_blob=False)  # fmt: skip
    @given(cases(project, result))
    def once(case: Case) -> None:
        code = _attempt(project, case, Path(tempfile.mkdtemp(prefix="case-", dir=folder)))
        codes[str(code)] = codes.get(str(code), 0) + 1

    once()
    return codes


def _attempt(project: Project, case: Case, out: Path) -> int:
    before = _listing(project.folder)
    words = [word.replace("{out}", str(out)) for word in case.words]
    if words[0] in ("run", "check", "plan", "stability", "noise", "export", "mc") and ".toml" in words[1]:
        words += ["--set", f"solver.time_limit_s={LIMIT_S:g}"]
    if case.file is None:
        code = _run(words, out)
    else:
        with project.holding(case.file, case.text):
            code = _run(words, out)
    if _listing(project.folder) != before:
        raise Defect(f"{case}: files appeared in the project: {_listing(project.folder) - before}")
    marks = [path for path in (*out.rglob("MARK*"), *Path.cwd().glob("MARK*"))]
    if marks:
        raise Defect(f"{case}: a command of the netlist was run: {marks}")
    # the seal of a file stands beside it
    left = {path.name for path in out.iterdir() if path.name.startswith(".")}
    left -= {f".{path.name}.cosim.json" for path in out.iterdir()}
    if left:
        raise Defect(f"{case}: left {left}")
    for record in out.rglob("run.json"):
        try:
            Run.load(record.parent)
        except CosimError as error:
            raise Defect(f"{case}: a result that does not load: {error}") from error
    return code


def _run(words: list[str], out: Path) -> int:
    begun = time.monotonic()
    try:
        done = subprocess.run(
            [sys.executable, "-m", "cosim", *words],
            capture_output=True,
            cwd=out,
            env={**os.environ, "TMPDIR": str(out.parent)},
            stdin=subprocess.DEVNULL,
            timeout=6 * (LIMIT_S + BEYOND_S),  # commands that run a scene several times have a limit for each
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise Defect(f"{words}: still runs after {time.monotonic() - begun:.0f} s") from None
    output = done.stderr.decode("utf-8", "replace")
    answer = done.stdout.decode("utf-8", "replace")
    if done.returncode not in (0, 1, 2):
        raise Defect(f"{words}: exit code {done.returncode}\n{output[-3000:]}")
    if done.returncode != 0 and not (output.strip() or answer.strip()):
        raise Defect(f"{words}: exit code {done.returncode} without a word")
    try:
        check_words(output[:20_000])
    except AssertionError as error:
        raise Defect(f"{words}: {error}\n{output[-3000:]}") from error
    if "--json" in words and done.returncode == 0:
        json.loads(answer, parse_constant=_refuse)
    return done.returncode


def _refuse(text: str) -> NoReturn:
    raise Defect(f"JSON with {text}")


def _listing(folder: Path) -> set[Path]:
    return set(folder.rglob("*"))


def kill_and_resume(project: Project, folder: Path, number: int, count: int) -> int:
    """Kill sweeps and runs at random instants, go on, and compare with what was never disturbed.

    Returns
    -------
    int
        How many of them were killed before their end.

    Raises
    ------
    Defect
        For a half result, something left behind, or other bytes than those of an undisturbed run.
    """
    chance = random.Random(number)
    scene = str(project.scenes[-1])
    quick = ["--set", "duration_s=0.1", "--set", "solver.model=linear"]
    sweep = ["sweep", scene, "seed=1:4:4", "--measure", "peak_force", *quick, "--out"]
    single = ["run", scene, *quick, "--out"]
    undisturbed = folder / "undisturbed"
    lengths = {}
    for name, words in (("sweep", sweep), ("run", single)):
        begun = time.monotonic()
        _must(words, undisturbed / name, folder)
        lengths[name] = time.monotonic() - begun
    killed = 0
    for turn in range(count):
        name, words = ("sweep", sweep) if turn % 2 else ("run", single)
        out = folder / f"killed{turn}" / name
        out.parent.mkdir()
        process = subprocess.Popen([sys.executable, "-m", "cosim", *words, str(out)], cwd=folder,
                                   env={**os.environ, "TMPDIR": str(folder)}, stdin=subprocess.DEVNULL,
                                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip
        try:
            process.wait(chance.uniform(0.0, lengths[name]))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            killed += 1
        if (out / "run.json").exists():
            Run.load(out)
        elif name == "run" and out.exists():
            raise Defect(f"kill {turn}: half a result in {out}")
        _must(words, out, folder)
        kept = "sweep.csv" if name == "sweep" else "signals.raw"
        if (out / kept).read_bytes() != (undisturbed / name / kept).read_bytes():
            raise Defect(f"kill {turn}: {out / kept} differs from an undisturbed one")
        left = [path for path in out.parent.iterdir() if path.name.startswith(".")]
        if left:
            raise Defect(f"kill {turn}: left {left}")
    scratch = [path for path in folder.iterdir() if path.name.startswith("cosim-")]
    if len(scratch) > 1:  # what the last command itself may just be removing
        raise Defect(f"left {scratch}")
    return killed


def _must(words: list[str], out: Path, folder: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "cosim", *words, str(out)],
        cwd=folder,
        env={**os.environ, "TMPDIR": str(folder)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise Defect(f"{words}: exit code {done.returncode}\n{done.stderr[-3000:]}")
