"""What a command says beside its result: --quiet, --verbose, NO_COLOR, completion."""

import argparse
import io
import os
import re
import subprocess
import sys

import pytest

from cosim import cli
from cosim.caution import MOST_ALIKE, Caution
from cosim.commands import verbosity
from cosim.commands.command import caution_lines
from cosim.commands.progress import COMPILING, progress

MANY = [Caution("odd", f"value {number} looks odd", "look again") for number in range(MOST_ALIKE + 2)]


@pytest.fixture(autouse=True)
def usual():
    yield
    verbosity.choose(quiet=False, verbose=False)


def test_quiet_says_nothing_beside_the_result(capsys):
    verbosity.choose(quiet=True, verbose=False)
    verbosity.remark("a remark")
    with progress("work") as show:
        assert show is None
    assert capsys.readouterr().err == ""


def test_verbose_says_each_step_and_every_warning(capsys):
    verbosity.choose(quiet=False, verbose=True)
    with progress("work") as show:
        show(1, 3, "a point")
    assert "work: a point (1 of 3)" in capsys.readouterr().err
    assert len(caution_lines(MANY)) == len(MANY)


class Terminal(io.StringIO):
    """A terminal of 120 columns."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("warm", [True, False])
def test_a_first_run_says_that_it_compiles_until_its_first_step_is_done(monkeypatch, warm):
    """A first sweep stood at 0 % for four minutes; broken once: without `more` in `show` it fails."""
    monkeypatch.setattr("mech.library_files.is_built", lambda: warm)
    monkeypatch.setattr(sys, "stderr", Terminal())
    said: list[str] = []
    for name in ("add_task", "update"):
        monkeypatch.setattr(
            f"rich.progress.Progress.{name}",
            lambda *words, description="", **_: said.append(description or str(words[1])),
        )
    with progress("sweep") as show:
        for done in range(2):
            show(done, 2, f"r = {done}")
    assert [COMPILING in text for text in said] == [not warm, not warm, False]
    assert ["r = 0" in said[1], "r = 1" in said[2]] == [True, True]


def test_usual_says_the_first_of_many():
    assert len(caution_lines(MANY)) == MOST_ALIKE + 1


def test_quiet_and_verbose_exclude_each_other(capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["keys", "--quiet", "--verbose"])
    assert ended.value.code == 2
    assert "not allowed with" in capsys.readouterr().err


def test_no_color_is_obeyed():
    """https://no-color.org: with the variable set, nothing is coloured even on a terminal."""
    code = "from rich.console import Console; print(Console(force_terminal=True).no_color)"
    output = [
        subprocess.run(
            [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
        ).stdout
        for env in ({**os.environ, "NO_COLOR": "1"}, {k: v for k, v in os.environ.items() if k != "NO_COLOR"})
    ]
    assert [text.strip() for text in output] == ["True", "False"]


def test_an_option_is_spelled_alike_in_every_command():
    (commands,) = [a for a in cli.build_parser()._actions if isinstance(a, argparse._SubParsersAction)]
    options = [(name, a) for name, parser in commands.choices.items() for a in parser._actions
               if a.option_strings]  # fmt: skip
    spellings = {}
    for _, action in options:
        for option in action.option_strings:
            spellings.setdefault(option, set()).add(tuple(action.option_strings))
    assert {option: ways for option, ways in spellings.items() if len(ways) > 1} == {}
    assert [option for option in spellings if not re.fullmatch(r"-[a-z]|--[a-z]+(-[a-z]+)*", option)] == []
    assert [(name, action.dest) for name, action in options if not action.help] == []


@pytest.mark.parametrize("shell", cli.SHELLS)
def test_completion_knows_every_command(shell, capsys):
    assert cli.main(["--completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(name in script for name in cli.NAMES)
    assert "--quiet" in script or shell == "tcsh"
