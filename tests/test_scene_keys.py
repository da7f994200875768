"""`cosim keys` and `cosim nodes`: every key is documented, every listed node can be recorded."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from support import SCENES, merge, quick, scene_of, simulate, slider, toml

from cosim import cli
from cosim.effects import EFFECTS
from cosim.errors import InputError
from cosim.results import Run
from cosim.scene import load_scene
from cosim.scene.keys import keys, section
from cosim.scene.meanings import MEANINGS
from cosim.units import sample_unit, signal_unit

ALL = {key.path: key for key in keys()}


def test_every_key_has_a_meaning_and_no_other_has() -> None:
    assert set(ALL) == set(MEANINGS)
    assert all(len(text) > 9 for text in MEANINGS.values())


def test_every_effect_is_a_key_and_is_named_by_none_that_is_none() -> None:
    known = {effect.name for effect in EFFECTS} | {"auto"}
    assert {path.partition(".")[2] for path in ALL if path.startswith("effects.")} == known
    assert {key for effect in EFFECTS for key in effect.keys} <= set(ALL)


def _dotted(table: dict[str, object], path: str = "") -> list[str]:
    rows = []
    for name, value in table.items():
        here = f"{path}.{name}".lstrip(".")
        names = {"device.parts": "<part>", "device.values": "<name>",
                 "tolerance.components": "<name>", "tolerance.trim": "<name>"}  # fmt: skip
        if here in names:
            for inner in value.values():  # type: ignore[attr-defined]
                each = f"{here}.{names[here]}"
                rows += [each] if not isinstance(inner, dict) else _dotted(inner, each)
        else:
            rows += _dotted(value, here) if isinstance(value, dict) else [here]
    return rows


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.toml")), ids=lambda path: path.stem)
def test_all_that_a_resolved_scene_writes_is_listed(path: Path) -> None:
    assert set(_dotted(load_scene(path).as_dict())) <= set(ALL)


def test_default_unit_and_range_are_those_of_the_schema(tmp_path: Path) -> None:
    """A scene that states every default by hand is the scene that leaves them out."""
    result = scene_of(tmp_path, slider())
    stated: dict[str, object] = {}
    for key in ALL.values():
        if key.default in ("required", "none", "0 for each joint") or "<" in key.path:
            continue
        if key.path.startswith(("device.chain", "operator", "device.start", "solver.model")):
            continue
        value = (
            json.loads(key.default)
            if re.fullmatch(r"true|false|-?[\d.e+-]+|\[.*\]", key.default)
            else key.default
        )
        for part in reversed(key.path.split(".")):
            value = {part: value}
        stated = merge(stated, value)
    text = merge(merge({"solver": {"model": "spice"}}, stated), slider())
    (tmp_path / "stated.toml").write_text(toml(text))
    assert load_scene(tmp_path / "stated.toml").as_dict() == result.as_dict()
    period = ALL["computer.period_s"]
    assert (period.unit, period.allowed, period.default) == ("s", ">= 1e-06 and <= 10", "required")


def test_sections(capsys: pytest.CaptureFixture[str]) -> None:
    assert {key.path for key in section("computer.dac")} == {p for p in ALL if p.startswith("computer.dac.")}
    assert [key.path for key in section("duration_s")] == ["duration_s"]
    assert cli.main(["keys", "computer"]) == 0
    out = capsys.readouterr().out
    assert "computer.delay_periods: a whole number (>= 0 and <= 1000), default 0\n" in out
    assert "used with effects.delay" in out
    assert cli.main(["keys", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["keys"]) == len(ALL)
    assert cli.main(["keys", "compuetr"]) == 2
    assert "nearest is computer" in capsys.readouterr().err


def test_nodes_that_are_listed_can_be_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = scene_of(tmp_path, slider(duration_s=0.05))
    assert scene.file is not None
    assert cli.main(["nodes", str(scene.file), "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert "xboard.xdiff1.inn" in out["nodes"]
    run = simulate(
        load_scene(scene.file, [f"record.nodes={json.dumps(out['nodes'][:40])}"]), tmp_path / "run"
    )
    assert set(run.signals) == set(out["signals"]) | set(out["nodes"][:40])
    assert set(run.samples) == set(out["samples"])
    assert set(run.measures) <= set(out["measures"])


def test_units_of_signals_and_samples() -> None:
    names = ("time", "q1", "imot2", "ksp12", "e_kin", "p_mot", "xboard.a", "rule")
    assert [signal_unit(name) for name in names] == ["s", "rad", "A", "V", "J", "W", "V", ""]
    assert [sample_unit(n) for n in ("ksp12", "ksd11", "pen", "cmd_nm1", "tick", "contact")] == [
        "N m/rad", "N m s/rad", "m", "N m", "", "",
    ]  # fmt: skip


def test_own_joint_dampers_are_used(tmp_path: Path) -> None:
    """Of joint_pd: the sampled damper gain is what the scene states, in contact."""
    tables = slider(
        computer={"method": "joint_pd", "joint_damping_n_m_s_per_rad": [0.02]},
        device={"start": {"q_rad": [-0.01]}},
        duration_s=0.1,
        solver={"model": "linear"},
    )
    run: Run = quick(tmp_path, tables)
    held = np.asarray(run.samples["contact"]) > 0
    assert held.any()
    assert np.all(np.asarray(run.samples["ksd11"])[held] == 0.02)
    assert np.abs(run.signals["ksd11"]).max() > 0.0


def test_a_word_finds_keys_by_name_and_by_meaning() -> None:
    def paths(word: str) -> set[str]:
        return {key.path for key in section(word)}

    assert paths("Gravity") == {
        "effects.gravity",
        "device.chain.gravity_m_per_s2",
        "device.slider.gravity_m_per_s2",
    }
    assert "computer.period_s" in paths("period")
    assert "operator.mass_kg" in paths("hand mass")  # both words, in name and meaning together
    assert paths("computer.dac") == {path for path in ALL if path.startswith("computer.dac.")}  # no search
    with pytest.raises(InputError, match=r"nearest is computer\.period_s"):
        section("perod")
