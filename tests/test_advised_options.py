"""An option that a message advises is one of every command that may print the message."""

import argparse
import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from support import ROOT

from cosim.cli import NAMES, build_parser

OPTION = re.compile(r"(?<![\w-])(--[a-z][a-z-]*[a-z]|-[on])(?![\w-])")
DEVICES = ("mc", "compare", "sweep")
#: `cosim nodes` lists the measures that other commands take.
OF_ANOTHER = {("nodes", "--measure")}
#: Module of the library -> the commands that may print its advice; None: the text names its command.
PRINTED_BY: dict[str, tuple[str, ...] | None] = {
    "accuracy/estimate.py": ("run", "sweep", "effects", "accuracy"),
    "api/verification.py": None,
    "circuits/boardgen.py": None,
    "comparisons/compare_boards.py": ("compare",),
    "loop/spice/convergence.py": None,
    "newproject.py": None,
    "storage/field_types.py": ("verify", "compare"),
    "storage/owned_files.py": ("report", "effects", "accuracy", "hard-cases", "stability", *DEVICES),
    "tolerance/level_samples.py": ("mc",),
    "tolerance/model_levels.py": ("mc",),
    "tolerance/scene_study.py": ("mc",),
    "variants.py": ("check", "run", "compare", "sweep", "stability", "device"),
}
#: ... of what netlists may not do. `effects` and `report` read them, too, and grant nothing.
REFUSED = ("check", "plan", "run", "accuracy", "stability", "noise", "device", "export", "nodes", *DEVICES)
PRINTED_BY |= dict.fromkeys(("ngspice/flatten.py", "ngspice/safety.py", "ngspice/syntax.py"), REFUSED)
#: ... of what varies: `verify` reads that, too, and has samples that it does not write.
PRINTED_BY |= {"tolerance/grammar.py": ("check", "verify", *DEVICES), "tolerance/sample_store.py": DEVICES}


def options() -> dict[str, set[str]]:
    parser = build_parser(NAMES)
    (commands,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    known = {name: set(of._option_string_actions) for name, of in commands.choices.items()}
    return known | {"cosim": set(parser._option_string_actions)}


def advised(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the options within texts of a module: not keys alone, definitions and docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    left_out: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            left_out.add(node.value)
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "add_argument":
            left_out |= set(ast.walk(node))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in left_out:
            if not OPTION.fullmatch(node.value.strip()):
                yield from ((node.lineno, option) for option in OPTION.findall(node.value))


def test_every_advised_option_is_there() -> None:
    known, wrong, used = options(), [], set()
    for path in sorted((ROOT / "cosim").rglob("*.py")):
        name = path.relative_to(ROOT / "cosim").as_posix()
        if path.stem.replace("_", "-") in known and path.parent.name == "commands":
            printed_by: tuple[str, ...] | None = (path.stem.replace("_", "-"),)
        elif path.parent.name == "commands" or name == "cli.py":
            printed_by = None
        else:
            found = list(advised(path))
            if not found:
                continue
            assert name in PRINTED_BY, f"{name}: {found}: which commands print this?"
            used.add(name)
            printed_by = PRINTED_BY[name]
        for line, option in advised(path):
            for command in printed_by or ():
                if option not in known[command] and (command, option) not in OF_ANOTHER:
                    wrong.append(f"{name}:{line}: cosim {command} has no {option}")
            if printed_by is None and not any(option in of for of in known.values()):
                wrong.append(f"{name}:{line}: no command has {option}")
    assert wrong == []
    assert used == set(PRINTED_BY)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('fail("choose another with -o, or --out")', ["-o", "--out"]),
        ('fail("no", key="--out")', []),
        ('"""Words on --out."""', []),
        ('parser.add_argument("--out", help="as --set")', []),
        ('warn(f"{x}: give --model linear")', ["--model"]),
    ],
)
def test_the_reader_of_texts_sees_what_is_advised(text: str, found: list[str], tmp_path: Path) -> None:
    (tmp_path / "module.py").write_text(text)
    assert [option for _, option in advised(tmp_path / "module.py")] == found
