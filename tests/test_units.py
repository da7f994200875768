"""Every command writes values with units in one way: a prefix by the size, none before a compound unit."""

import re

import pytest
from support import SCENES

from cosim.cli import main
from cosim.commands.effects import table
from cosim.commands.run import measure_table
from cosim.comparisons.effects_ledger import EffectsLedger, Row
from cosim.units import quantity, signed

_PREFIX = {"p": 1e-12, "n": 1e-9, "µ": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6}
_COMPOUND = r"N m s/rad|N m/rad|N s/m|N/m|V/rad|V/\(N m\)|rad/s|N m"
_WRITTEN = re.compile(
    rf"(?<![\w.])(?P<number>[-+]?\d[\d.]*(?:e[-+]?\d+)?) (?:(?P<unit>{_COMPOUND})|(?P<prefix>[pnµmkM]?)"
    r"(?P<simple>s|m|N|A|V|J|W|rad|Hz))(?![\w/^])"
)


def otherwise_written(text: str) -> list[str]:
    """Every value with a unit that `quantity` writes in no number of digits as the text has it."""
    rows = []
    for each in _WRITTEN.finditer(text):
        unit = each["unit"] or each["simple"]
        value = float(each["number"]) * _PREFIX[each["prefix"] or ""]
        wanted = {write(value, unit, digits) for write in (quantity, signed) for digits in range(1, 7)}
        if each[0] not in wanted:
            rows.append(each[0])
    return rows


def test_the_finder_sees_what_is_written_in_another_way() -> None:
    """0.04 N are 40 mN, 1500 Hz are 1.50 kHz; a stiffness takes no prefix."""
    assert otherwise_written("0.04 N, 1500 Hz, 4000 mm and 0.0042 m") == [
        "0.04 N", "1500 Hz", "4000 mm", "0.0042 m",
    ]  # fmt: skip
    assert otherwise_written("40 mN, 1.50 kHz, 4 m, 612.31 N/m, 0.1 Hz, +4.20 mm, 1.13e-06 N m") == []
    assert not _WRITTEN.search("1.2 kN/m")  # no such unit


@pytest.mark.parametrize(
    ("command", "least"),
    [
        (["stability"], 5),
        (["check"], 60),
        (["plan"], 40),
        (["device"], 12),
        (["noise", "--set", "effects.pot_noise=white", "--set", "effects.component_noise=true"], 9),
    ],
    ids=["stability", "check", "plan", "device", "noise"],
)
def test_a_command_writes_values_as_all_do(
    command: list[str], least: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command[0], str(SCENES / "press.toml"), *command[1:]]) == 0
    text = capsys.readouterr().out
    assert len(_WRITTEN.findall(text)) >= least
    assert otherwise_written(text) == []
    assert not re.search(r"\d [pnµmkM]N(?:/m| s/m| m\b)", text)  # no prefix before N/m, N s/m, N m


@pytest.mark.parametrize(
    ("unit", "none", "change"),
    [
        ("m", 4.29e-3, 1e-5),
        ("N", 0.876, -2e-4),
        ("N/m", 104.5, -0.02),
        ("s", 0.0213, 1e-3),
        ("Hz", 1520.0, 3.0),
    ],
)
def test_effects_writes_measures_as_run_does(unit: str, none: float, change: float) -> None:
    measures = [{"x": {"value": value, "unit": unit, "text": ""}} for value in (none, none + change)]
    ledger = EffectsLedger(*measures, 0.0123, 1.62, (Row("dac", "True", {"x": change}, {}, 2e-3, 0.0),), 3)
    text = table(ledger, "x")
    assert otherwise_written(text) == []
    assert quantity(none, unit, 5) in text
    assert signed(change, unit) in text
    assert "12.3 ms" in text
    assert "+2 ms" in text
    result = measure_table([("one", measures[0])]).splitlines()[1].split()
    assert result[-1 if len(result) == 3 else 2] in text.splitlines()[0]  # the same unit and prefix
