"""A room imports only from floors below it, and only one module touches PySpice or matplotlib."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest
from floors import FLOORS, TOGETHER, WORDS, with_picture

ROOT = Path(__file__).resolve().parents[1]


def modules():
    for top in ("mech", "cosim", "reports"):
        for path in sorted((ROOT / top).rglob("*.py")):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            yield name.removesuffix(".__init__"), path


@cache
def imports(name, path):
    """Absolute names of the modules that a file imports, function bodies included."""
    return tuple(_imports(name, path))


def _imports(name, path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: relative import"
            for alias in node.names:
                # `from package import module` depends on the module, not on what else the package shows
                full = f"{node.module}.{alias.name}"
                yield full if full in NAMES else node.module


def floor(name):
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        prefix = ".".join(parts[:length])
        if prefix in FLOORS:
            return FLOORS[prefix], prefix
    return None, None


MODULES = list(modules())
NAMES = {name for name, _ in MODULES}


@pytest.mark.parametrize(("name", "path"), MODULES, ids=[name for name, _ in MODULES])
def test_imports_point_down(name, path):
    here, room = floor(name)
    assert room is not None, f"{name} has no floor"
    for target in imports(name, path):
        there, other = floor(target)
        if other is None or other == room or (other == "cosim" and target not in NAMES):
            continue
        same_floor_is_fine = there == here and here in TOGETHER and room.split(".")[0] != "mech"
        assert there < here or same_floor_is_fine, f"{name} (floor {here}) imports {target} (floor {there})"


def targets(path):
    """Functions that a file names in words, for another process to call: module and function."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            match = re.fullmatch(r"((?:cosim|mech|reports)(?:\.\w+)+):(\w+)", node.value)
            if match:
                yield match.groups()


def test_functions_named_in_words_exist_and_lie_no_higher():
    """A child process imports them: to the floors it is an import like any other."""
    homes = dict(MODULES)
    named = [(name, *target) for name, path in MODULES for target in targets(path)]
    assert len(named) > 20
    for name, module, function in named:
        assert module in homes, f"{name} names {module}, which is no module"
        tree = ast.parse(homes[module].read_text(encoding="utf-8"))
        assert function in {each.name for each in tree.body if isinstance(each, ast.FunctionDef)}, (
            f"{name} names {module}:{function}, which is no function"
        )
        assert floor(module)[0] <= floor(name)[0], f"{name} names {module} of a higher floor"


def test_one_module_reaches_up_to_the_pictures():
    """Results draw themselves: by one module, whose calls name functions that there are."""
    above = [name for name, path in MODULES if name.startswith("cosim.") and floor(name)[0] < 6
             and re.search(r"[\"']reports\.", path.read_text(encoding="utf-8"))]  # fmt: skip
    assert above == ["cosim.notebook_view"]
    called = {match for name, path in MODULES if name.startswith("cosim.")
              for match in re.findall(r"\bview\(\"(\w+)\"", path.read_text(encoding="utf-8"))}  # fmt: skip
    tree = ast.parse((ROOT / "reports" / "notebook.py").read_text(encoding="utf-8"))
    views = {each.name for each in tree.body if isinstance(each, ast.FunctionDef) and each.name[0] != "_"}
    assert called == views


def test_mechanics_knows_no_circuit():
    for name, path in MODULES:
        if name.split(".")[0] == "mech":
            assert not [t for t in imports(name, path) if t.split(".")[0] in ("cosim", "reports")], name


def test_circuits_know_no_mechanics():
    for name, path in MODULES:
        if name.startswith(("cosim.circuits", "cosim.ngspice")):
            assert not [t for t in imports(name, path) if t.split(".")[0] == "mech"], name


@pytest.mark.parametrize(
    ("library", "home"),
    [("PySpice", "cosim.ngspice"), ("matplotlib", "reports"), ("pydantic", "cosim.scene")],
)
def test_a_library_has_one_home(library, home):
    for name, path in MODULES:
        if name == "cosim.storage.field_types":  # pydantic's second one: forms of what comes from disk
            continue
        if any(target.split(".")[0] == library for target in imports(name, path)):
            assert name == home or name.startswith(home + "."), f"{name} imports {library}"


def test_the_picture_of_the_floors_is_current():
    """`python tests/floors.py` writes it; every room of the table that is a package has its words."""
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    assert with_picture(text) == text
    packages = {name for name in FLOORS if (ROOT / name.replace(".", "/")).is_dir()} - {"cosim"}
    assert packages <= set(WORDS)
    assert set(WORDS) <= set(FLOORS)


def test_no_module_name_occurs_twice():
    """A name says what is inside: twice the same says less. Commands have the name of their function."""
    places = {}
    for name, _ in MODULES:
        if name.startswith("cosim.") and not name.startswith("cosim.commands."):
            places.setdefault(name.rpartition(".")[2], []).append(name)
    assert not {name: where for name, where in places.items() if len(where) > 1}


@pytest.mark.parametrize(("one", "other"), [("spice", "linear"), ("linear", "spice")])
def test_the_two_loops_do_not_know_each_other(one, other):
    for name, path in MODULES:
        if name.startswith(f"cosim.loop.{one}."):
            assert not [t for t in imports(name, path) if t.startswith(f"cosim.loop.{other}")], name


def test_files_and_functions_are_short():
    """A file has at most 400 lines, a function 80 without its docstring."""
    long = []
    for name, path in MODULES:
        text = path.read_text(encoding="utf-8")
        if text.count("\n") > 400:
            long.append(name)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                documented = ast.get_docstring(node) is not None
                first = node.body[0].end_lineno if documented else node.lineno
                if node.end_lineno - first > 80:
                    long.append(f"{name}.{node.name}")
    assert not long


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "ARCHITECTURE.md"])
def test_files_that_a_page_names_are_there(page):
    """By their path, or by the end of it; `NAME` is for the reader's own, `dac_gain` was a trial."""
    text = (ROOT / page).read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w./-]+\.(?:py|md|lib|toml))`", text)) - {"cosim/effects/dac_gain.py"}
    tops = ("cosim", "mech", "reports", "tests", "netlists", "scenes", "benchmarks")
    there = [f"/{path.relative_to(ROOT).as_posix()}" for top in tops for path in (ROOT / top).rglob("*.*")]
    missing = [name for name in named if "NAME" not in name and not (ROOT / name).is_file()
               and not any(path.endswith(f"/{name}") for path in there)]  # fmt: skip
    assert len(named) > 10
    assert missing == []


def test_no_import_cycles():
    graph = {
        name: {target for target in imports(name, path) if target in NAMES and target != name}
        for name, path in MODULES
    }
    done, active = set(), []

    def visit(name):
        assert name not in active, " -> ".join([*active[active.index(name) :], name])
        if name not in done:
            active.append(name)
            for target in sorted(graph[name]):
                visit(target)
            active.pop()
            done.add(name)

    for name in graph:
        visit(name)


@pytest.mark.parametrize("path", sorted((ROOT / "tests").glob("*.py")), ids=lambda path: path.stem)
def test_no_test_module_is_imported(path):
    """What tests share lies in modules without tests: each can be run alone, and in any order."""
    taken = {name for name in imports(path.stem, path) if name.rpartition(".")[2].startswith("test_")}
    assert not {name for name in taken if (ROOT / "tests" / f"{name.split('.')[0]}.py").exists()}
