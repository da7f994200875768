"""Code in pages: what stands between fences, run as a reader would, and how printed numbers are checked.

A page runs from top to bottom in one folder. If it does not lay out a project itself, it starts in one of two
joints. Marks are comments in front of a fence:

    <!-- not run: WHY -->       nothing happens with it
    <!-- output ±1 % -->        what the block before has printed, numbers within the band; … is anything
    <!-- check: NAME 104.5 ±0.2 -->   a number that prose quotes, in a line of that output beginning with NAME
    <!-- slow: WHY -->          (anywhere) the page runs with the slow tests
    <!-- needs: ngspice -->     (anywhere) a program or module without which the page is skipped

A fence with a title is a file: it is written before what follows runs.

`python doc_blocks.py PAGE [PATTERN ...]` prints the page as a shell script, without lines that match PATTERN;
what is "not run" here is in it (`.ci/fresh` runs it elsewhere).
"""

import ast
import contextlib
import importlib.util
import io
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_FENCE = re.compile(
    r"^(?P<indent> *)(?:<!-- (?P<mark>[^\n]*?) -->\n\n?(?P=indent))?"
    r"```(?P<kind>\w*)(?: title=\"(?P<title>[^\"]+)\")?\n(?P<text>.*?)^(?P=indent)```$"
    r"|^<!-- check: (?P<check>.+?) -->$",
    re.MULTILINE | re.DOTALL,
)
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
RUN = ("sh", "python", "text", "toml")


@dataclass(frozen=True)
class Block:
    """A fence: its language, the file that its title names, its text, its mark and its line; or a check."""

    kind: str
    title: str
    text: str
    mark: str
    line: int

    @property
    def why_not(self):
        """Why it is not run; '' if it is."""
        return self.mark.removeprefix("not run: ") if self.mark.startswith("not run: ") else ""


def blocks(text):
    """Return the blocks of a page in order."""
    rows = []
    for match in _FENCE.finditer(text):
        line = text.count("\n", 0, match.start()) + 1
        if match["check"]:
            rows.append(Block("check", "", match["check"], "", line))
            continue
        cut = len(match["indent"])
        body = "".join(each[cut:] for each in match["text"].splitlines(keepends=True))
        rows.append(Block(match["kind"], match["title"] or "", body, match["mark"] or "", line))
    return rows


def commands(text):
    """Return the lines of shell blocks that are run, continued lines as one."""
    return [
        line
        for block in blocks(text)
        if block.kind == "sh" and not block.why_not and not block.title
        for line in shell_lines(block.text)
    ]


def shell_lines(text):
    """Return the commands of a block; what ends in a backslash goes on."""
    return [line for line in text.replace("\\\n", " ").splitlines() if line.strip() and line[0] != "#"]


def words(line):
    """Return the words of a command, and whether it is one plain command: no pipe, redirection or loop."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars="|<>;&()")
    lexer.whitespace_split = True
    every = list(lexer)
    ends = [k for k, word in enumerate(every) if word and set(word) <= set("|<>;&()")]
    return (every[: ends[0]] if ends else every), not ends and "$(" not in line


def lacking(text):
    """Return programs and modules that a page needs and that are not here."""
    needed = [name for each in re.findall(r"<!-- needs: (.+?) -->", text) for name in each.split()]
    return [n for n in needed if shutil.which(n) is None and importlib.util.find_spec(n) is None]


class Reader:
    """Does what a page says, in a folder."""

    def __init__(self, folder):
        self.folder, self.printed, self.names = Path(folder), "", {}

    def follow(self, page):
        """Run the blocks of a page."""
        for block in blocks(page):
            try:
                self._take(block)
            except AssertionError as error:
                raise AssertionError(f"line {block.line}: {error}") from error

    def _take(self, block):
        if block.why_not:
            return
        if block.title:
            path = self.folder / block.title
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, encoding="utf-8")
        elif block.kind == "sh":
            self.printed = "".join(self.type(line) for line in shell_lines(block.text))
        elif block.kind == "python":
            self.printed = self.execute(block.text)
        elif block.kind == "text":
            check_output(block.text, self.printed, band(block.mark))
        elif block.kind == "check":
            check_number(block.text, self.printed)
        elif block.kind == "toml":
            check_scene(block.text)

    def type(self, line):
        """Run a command; return what it prints. Our own runs in this process, which has its code loaded."""
        from cosim.cli import main

        (program, *arguments), plain = words(line)
        if program == "cd":
            self.folder = self.folder / arguments[0]
            return ""
        if program == ".":  # the environment of the tests is in force
            return ""
        if program != "cosim" or not plain:
            return self._shell(line)
        out = io.StringIO()
        with contextlib.chdir(self.folder), contextlib.redirect_stdout(out):
            code = main(arguments)
        assert code == 0, f"{line}: exit code {code}\n{out.getvalue()}"
        return out.getvalue()

    def _shell(self, line):
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        done = subprocess.run(
            ["sh", "-ec", line], cwd=self.folder, env={**os.environ, "PATH": path}, capture_output=True,
            text=True, timeout=300, check=False,
        )  # fmt: skip
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
        return done.stdout

    def execute(self, text):
        """Run Python; return what it prints."""
        out = io.StringIO()
        with contextlib.chdir(self.folder), contextlib.redirect_stdout(out):
            exec(compile(text, "page", "exec"), self.names)
        return out.getvalue()


def band(mark):
    """Return the share by which numbers of an output may differ."""
    match = re.fullmatch(r"output ±([\d.]+) %", mark)
    assert match, "an output states its band, or why it is not checked"
    return float(match[1]) / 100


def check_output(shown, printed, share):
    """Check that each line that is shown was printed, its numbers within the band.

    The bound of an error (behind ±) is one of magnitude: it may differ tenfold.
    """
    lines = [" ".join(line.split()) for line in printed.splitlines()]
    for line in shown.splitlines():
        wanted = " ".join(line.split())
        if wanted in ("", "…"):
            continue
        pattern = re.compile("".join(_pattern(piece) for piece in re.split(f"(…|{_NUMBER.pattern})", wanted)))
        expected = _NUMBER.findall(wanted)
        rows = [match.groups() for each in lines if (match := pattern.fullmatch(each))]
        close = [
            groups for groups in rows
            if all(_near(*pair, share) for pair in zip(expected, groups, _bounds(wanted), strict=True))
        ]  # fmt: skip
        assert close, f"{line!r} was not printed within {100 * share:g} %; alike: {rows}"


def _pattern(piece):
    if piece == "…":
        return ".*"
    return f"({_NUMBER.pattern})" if _NUMBER.fullmatch(piece) else re.escape(piece)


def _bounds(line):
    return [line[: match.start()].endswith("± ") for match in _NUMBER.finditer(line)]


def _near(shown, value, bound, share):
    a, b = float(shown), float(value)
    if bound:
        return (a == b == 0.0) or 0.1 <= b / a <= 10.0
    return abs(a - b) <= share * abs(a) + 1e-12


def check_number(text, printed):
    """Check a number that prose quotes: ``NAME 104.5 ±0.2``, the first in the line that begins with NAME."""
    name, value, tolerance = re.fullmatch(r"(.+?) (\S+) ±(\S+)", text).groups()
    lines = [line.strip() for line in printed.splitlines() if line.strip().startswith(name)]
    numbers = [float(digits[0]) for line in lines if (digits := _NUMBER.findall(line[len(name) :]))]
    assert any(math.isclose(each, float(value), rel_tol=0, abs_tol=float(tolerance)) for each in numbers), (
        f"{text}: printed is {lines}"
    )


def check_scene(text):
    """Check that lines of a scene are TOML and that every key is one of the schema."""
    from cosim.scene.keys import keys

    known = [re.sub(r"<\w+>", "*", key.path).split(".") for key in keys()]

    def walk(table, path):
        for name, value in table.items():
            here = [*path, name]
            inside = [
                key for key in known
                if len(key) >= len(here) and all(k in (h, "*") for k, h in zip(key, here, strict=False))
            ]  # fmt: skip
            assert inside, f"{'.'.join(here)} is no key of a scene"
            if isinstance(value, dict) and any(len(key) > len(here) for key in inside):
                walk(value, here)

    walk(tomllib.loads(text), [])


def check_python(text):
    """Check that code is Python."""
    ast.parse(text)


def script(text, left_out=()):
    """Return what a page tells to type as a shell script, blocks of Python as well."""
    lines = []
    for block in blocks(text):
        if block.kind in ("sh", "") and not block.title:
            lines += [
                line
                for line in shell_lines(block.text)
                if not any(re.search(each, line) for each in left_out)
            ]
        elif block.kind == "python" and not block.why_not and not block.title:
            lines += ["python - <<'END'", *block.text.splitlines(), "END"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(script(Path(sys.argv[1]).read_text(encoding="utf-8"), sys.argv[2:]), end="")
