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


def named_by_python(tree: ast.AST, known: set[str]) -> set[str]:
    """Names that a module's uncompiled code uses, of what is `known` there or an attribute of it."""
    every: set[str] = set()
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, ast.FunctionDef) and compiled(child):
            continue
        if isinstance(child, ast.Name) and child.id in known:
            every.add(child.id)
        elif (
            isinstance(child, ast.Attribute) and isinstance(child.value, ast.Name) and child.value.id in known
        ):
            every.add(child.attr)
        every |= named_by_python(child, known)
    return every


def inner_in(tree: ast.Module) -> set[str]:
    """Functions of a module that have no wrapper."""
    return {
        node.name
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
        and any(isinstance(each, ast.Name) and each.id in INNER for each in node.decorator_list)
    }


def known_in(tree: ast.Module) -> set[str]:
    """Names that a module imports, and its own functions without wrappers."""
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom))
    imported = {alias.asname or alias.name.partition(".")[0] for node in imports for alias in node.names}
    return imported | inner_in(tree)


def test_python_calls_no_inner_function() -> None:
    inner, named = set[str](), set[str]()
    for folder in ("mech", "cosim", "tests", "benchmarks", "reports"):
        for path in (ROOT / folder).rglob("*.py"):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            named |= named_by_python(tree, known_in(tree))
            inner |= inner_in(tree)
    assert len(inner) > 50
    assert not inner & named


def test_a_call_from_python_is_seen() -> None:
    tree = ast.parse("from a import b\n@inner\ndef f(): g()\n@njit\ndef h(): f()\ndef k(s): s.f(); b.c()\n")
    assert named_by_python(tree, known_in(tree)) == {"b", "c"}
    assert "f" in named_by_python(tree := ast.parse("@inner\ndef f(): pass\nf()\n"), known_in(tree))
