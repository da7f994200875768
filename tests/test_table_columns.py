"""Columns that pictures look up: a heading stands in one place, and means one thing."""

import ast
import pickle
from pathlib import Path

from cosim.studies import table_columns
from cosim.studies.table_columns import Column

ROOT = Path(__file__).resolve().parents[1]
COLUMNS = {name: each for name, each in vars(table_columns).items() if isinstance(each, Column)}


def test_keys_and_headings_are_unique() -> None:
    assert len({each.key for each in COLUMNS.values()}) == len(COLUMNS) == len(set(COLUMNS.values()))
    assert [name for name, each in COLUMNS.items() if each.key != name.lower()] == []


def test_a_column_is_its_heading_and_keeps_its_parts() -> None:
    period = Column("period", "period", "ms")
    assert period == "period [ms]"
    assert {period: 1}["period [ms]"] == 1
    copy = pickle.loads(pickle.dumps(period))
    assert (copy, copy.key, copy.label, copy.unit) == (period, "period", "period", "ms")
    assert Column("share", "share at rest") == "share at rest"


def test_no_picture_types_a_heading_with_a_unit() -> None:
    """Axes have labels of their own: what is looked up is a subscript."""
    typed = [
        (path.name, node.slice.value)
        for path in sorted((ROOT / "reports" / "studies").glob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant)
        if isinstance(node.slice.value, str) and " [" in node.slice.value
    ]
    assert typed == []
