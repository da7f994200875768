"""Hard case 42: NaN and infinity are refused at every number of a scene, by its key."""

import tomllib

import pytest
from support import SCENES

from cosim.errors import InputError
from cosim.scene import load_scene


def numbers(value, key=""):
    """Dotted keys of all numbers in TOML data, those in lists by the list's key."""
    if isinstance(value, dict):
        for name, item in value.items():
            yield from numbers(item, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        if value and all(isinstance(item, int | float) and not isinstance(item, bool) for item in value):
            yield key, value
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield key, value


def every_number():
    for name in ("press", "drop", "slope"):
        data = tomllib.loads((SCENES / f"{name}.toml").read_text(encoding="utf-8"))
        for key, value in numbers(data):
            yield pytest.param(name, key, value, id=f"{name}-{key}")


@pytest.mark.parametrize(("scene", "key", "value"), list(every_number()))
def test_every_number_of_a_scene_refuses_what_is_none(scene: str, key: str, value: object) -> None:
    for text in ("nan", "inf", "-inf"):
        bad = f"[{', '.join([text] * len(value))}]" if isinstance(value, list) else text
        with pytest.raises(InputError) as caught:
            load_scene(SCENES / f"{scene}.toml", [f"{key}={bad}"])
        assert key in str(caught.value)


@pytest.mark.parametrize("text", ["nan", "inf", "1e999", "-nan"])
def test_a_netlist_value_that_is_no_number_is_refused(text: str) -> None:
    from cosim.plan import resolve

    with pytest.raises(InputError, match="r_sum_spring"):
        resolve(load_scene(SCENES / "press.toml", [f'device.values.r_sum_spring="{text}"']))


def test_the_numbers_are_found() -> None:
    """The sweep is worth something: dozens of keys, among them those of every table."""
    keys = {str(param.values[1]) for param in every_number()}
    assert len(keys) > 30
    assert {"duration_s", "device.chain.masses_kg", "computer.period_s", "wall.normal"} <= keys
