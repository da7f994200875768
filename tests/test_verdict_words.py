"""What the page says of a study: in plain words, from its numbers, with what its cases hold."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support import SCENES

import cosim.studies
from benchmarks.same_results import PERIODS, first, small
from cosim.scene.parameters import Variation
from cosim.studies.case_effects import holds_table
from cosim.studies.claims import load_claims
from cosim.studies.footnote1_map import FootnoteParameters, verdicts
from cosim.studies.study import load_study
from reports.study_page import write_study_page

#: Symbols of our code and of formulas that plain words replace.
_CODE = re.compile(r"K_\w|k_\w|F_\w|c_\w|\w\^T|\w\^-T|sum\(|tau|q''|>>|<=|[JM] [qK]|2c/T|/T\b|\|\w|v T")
#: Footnote and equations of the paper stand in its claims with the paper's own symbols.
_OF_THE_PAPER = re.compile(r"^\((1|2|7|12|16|20|21)\)")


def spoken() -> Iterator[tuple[str, str]]:
    """Module and every literal text of a verdict, also of names that its function puts together."""
    for path in sorted(Path(cosim.studies.__path__[0]).glob("*.py")):
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(function, ast.FunctionDef):
                continue
            calls = [
                node for node in ast.walk(function)
                if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Verdict"
            ]  # fmt: skip
            rows = [argument for call in calls for argument in call.args[1:4]]
            named = {
                node.id for argument in rows for node in ast.walk(argument) if isinstance(node, ast.Name)
            }
            for node in ast.walk(function):
                target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
                texts = isinstance(node, ast.Assign | ast.AugAssign) and isinstance(
                    node.value, ast.JoinedStr | ast.Constant
                )
                if texts and isinstance(target, ast.Name) and target.id in named:
                    rows.append(node.value)  # type: ignore[union-attr]
            for argument in rows:
                yield from ((path.name, text) for text in literals(argument))


def literals(node: ast.expr) -> Iterator[str]:
    """The literal parts of a text; what stands in braces is code."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.JoinedStr):
        for part in node.values:
            if isinstance(part, ast.Constant):
                yield str(part.value)
    elif isinstance(node, ast.BinOp | ast.IfExp):
        for part in ast.iter_child_nodes(node):
            if isinstance(part, ast.expr):
                yield from literals(part)


def test_verdicts_are_plain_words() -> None:
    texts = list(spoken())
    assert len(texts) > 100
    assert [each for each in texts if _CODE.search(each[1])] == []
    assert _CODE.search("adding K_g(F) to the joints' gains")


def test_claims_without_an_equation_of_the_paper_are_plain_words() -> None:
    plain = [
        c
        for c in load_claims(SCENES / "paper").claims
        if not _OF_THE_PAPER.match(c.says) and "Fig" not in c.says
    ]
    assert len(plain) >= 5
    assert [c.id for c in plain if _CODE.search(c.says + c.counts)] == []


def verdict_text(errors: list[float], eta: list[float], dampings: tuple[float, ...] = (0.11, 2.0)) -> str:
    """What is said of op-amps, two dampings each, with thresholds of 5 %."""
    names = [f"op-amp {number // len(dampings)}" for number in range(len(errors))]
    at: dict[str, list[Any]] = {"op-amp": names, "stiffness error [%]": errors, "eta [%]": eta}
    for kind in ("position", "peak_to_peak", "white"):
        at[f"force noise, {kind} [N rms]"] = [0.01] * len(errors)
        at[f"holds, {kind}"] = [True] * len(errors)
    return verdicts(FootnoteParameters(dampings_n_s_per_m=dampings), at, "")[-1].outcome


def test_whether_the_op_amp_decides_is_judged_from_the_numbers() -> None:
    assert verdict_text([1.0, 2.0, 1.5, 2.5], [4.0, 4.0, 4.1, 4.1]).startswith(
        "no: error and eta move by at most 0.5 "
    )
    assert verdict_text([1.0, 2.0, 1.0, 6.0], [4.0] * 4).startswith(
        "yes, at 2 N s/m: error and eta move by at most 4 "
    )
    assert verdict_text([1.0, 2.0] * 2, [4.9, 4.9, 5.1, 4.9]).startswith(
        "yes, at 0.11 N s/m:"
    )  # across eta's limit
    assert verdict_text([6.0, 9.0, 8.0, 7.0], [4.0] * 4).startswith("no:")  # none holds with any op-amp
    assert verdict_text([1.0, 2.0], [4.0, 4.0]).startswith("one op-amp cannot tell:")


#: The cases of every study are few here; the rest of the scene's cases is told below.
STUDIES = [
    ("5_3_footnote", {"points": 3, "opamps": first(1), "corners_hz": first(1), "drivers_hz": first(1)}, ()),
    ("5_4_shift", {"periods_s": PERIODS[:1], "gains": first(1), "cases": first(2)}, ()),
    ("5_5_corner", {"corners_hz": (20.0, 100.0)}, pytest.mark.slow),
    ("5_6_budget", {}, pytest.mark.slow),
]


@pytest.mark.parametrize(
    ("name", "changes"), [pytest.param(*each[:2], id=each[0], marks=each[2]) for each in STUDIES]
)
def test_the_page_says_what_the_cases_hold(name: str, changes: dict[str, Any], tmp_path: Path) -> None:
    result = small(name, **changes)
    table = result.table("holds")
    assert table.columns["of the circuit"][0].startswith("opamp gbw, vca gbw, ")  # as both scenes state
    never = table.note.rpartition("In no case: ")[2]
    assert all(effect in never for effect in ("coulomb", "opamp_slew", "pot_noise"))
    quantised = "encoder" in table.columns["in the scene, but no part of a small motion"][0]
    assert quantised == (name in ("5_3_footnote", "5_6_budget"))  # the others switch them off
    if name == "5_3_footnote":
        return  # its maps cannot be drawn of so few points; the page takes every study's tables alike
    html = write_study_page([(name, result)], tmp_path, "t").read_text(encoding="utf-8")
    answer = html.replace("\u00a0", " ")
    assert "What the cases hold" in answer
    assert "opamp gbw, vca gbw" in answer


def test_every_case_is_reported_with_its_own_levels() -> None:
    """The shift study's cases take away what their names say; one more adds what the scene has not."""
    spec = load_study(SCENES / "paper" / "5_4_shift.toml")
    full = Variation(name="full", set=("solver.model=spice", "effects.opamp=full", "effects.coulomb=true"))
    table = holds_table(spec, (*spec.parameters.cases, full), "")
    circuit = dict(zip(table.columns["case"], table.columns["of the circuit"], strict=True))
    gone = {
        "as built": (), "without op-amp bandwidth": ("opamp",), "without multiplier bandwidth": ("vca",),
        "without driver bandwidth": ("driver_level",), "without motor inductance": ("motor full",),
        "without corners of the differentiator": ("differentiator",),
        "circuit ideal": ("opamp", "vca", "driver_level", "motor full", "differentiator"),
        "full": ("opamp gbw",),
    }  # fmt: skip
    assert list(circuit) == list(gone)
    for case, names in gone.items():
        for words in ("opamp gbw", "vca gbw", "driver_level gbw", "motor full", "differentiator corner"):
            taken = any(words.startswith(name) for name in names)
            assert (words in circuit[case]) is not taken, (case, words)
    assert "opamp full" in circuit["full"]
    assert "coulomb" in table.columns["in the scene, but no part of a small motion"][-1]
    assert "coulomb" not in table.note
