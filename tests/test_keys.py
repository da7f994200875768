"""What is kept or drawn belongs to its question alone: keys of the models' cache, seeds of the noise."""

from dataclasses import fields, replace

import numpy as np
import pytest

from cosim.circuits.cache import Asked
from cosim.effects.period_jitter import lateness
from cosim.loop.noise import stream

ASKED = Asked("* a deck\n.end\n", "linear", 1e3, 1e-6)
OTHERS = {"text": "* a deck \n.end\n", "model": "ideal", "band_hz": 1001.0, "tolerance": 1e-5}


def test_every_field_of_the_question_is_in_the_key():
    assert {field.name for field in fields(Asked)} == set(OTHERS)
    keys = {replace(ASKED, **{name: value}).digest for name, value in OTHERS.items()}
    assert len(keys | {ASKED.digest}) == len(OTHERS) + 1
    assert replace(ASKED).digest == ASKED.digest


@pytest.mark.parametrize("bit", range(63))
def test_every_bit_of_the_seed_draws_something_else(bit):
    """A seed is any number below 2^63: none of its bits may be lost."""
    base = 0x2545F4914F6CDD1D
    drawn = [stream(seed, "potentiometer/white", 0).standard_normal(4) for seed in (base, base ^ (1 << bit))]
    assert not np.any(drawn[0] == drawn[1])


def test_sources_joints_and_kinds_draw_apart():
    named = [("a", 0), ("b", 0), ("a", 1), ("ab", 0)]
    drawn = [stream(1, *name).standard_normal(4) for name in named]
    assert len({tuple(values) for values in drawn}) == len(named)
    assert np.array_equal(stream(1, "a", 0).standard_normal(4), drawn[0])
    high, low = (lateness("uniform", seed, 8, 0.1) for seed in (1 + 2**40, 1))
    assert not np.array_equal(high, low)
