"""Functions without wrappers are called by compiled code alone."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
INNER = {"inner", "inner_inlined"}


def compiled(function: ast.FunctionDef) -> bool:
    """Whether numba compiles it: by ``njit``, ``cfunc``, or as an inner function."""
    words = {
        node.id for each in function.decorator_list for node in ast.walk(each) if isinstance(node, ast.Name)
    }
    return bool(words & (INNER | {"njit", "cfunc"}))


def named_by_python(tree: ast.AST) -> set[str]:
    """Names that a module's uncompiled code uses."""
    found: set[str] = set()
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, ast.FunctionDef) and compiled(child):
            continue
        if isinstance(child, ast.Name):
            found.add(child.id)
        elif isinstance(child, ast.Attribute):
            found.add(child.attr)
        found |= named_by_python(child)
    return found


def test_python_calls_no_inner_function() -> None:
    inner, named = set(), set[str]()
    for folder in ("mech", "cosim", "tests", "benchmarks", "reports"):
        for path in (ROOT / folder).rglob("*.py"):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            named |= named_by_python(tree)
            for node in ast.walk(tree):
                if isinstance(node, ast.FunctionDef) and any(
                    isinstance(each, ast.Name) and each.id in INNER for each in node.decorator_list
                ):
                    inner.add(node.name)
    assert len(inner) > 50
    assert not inner & named
