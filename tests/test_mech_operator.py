"""Operators: formulas, tables, and a user's own class with everything that can be wrong with it."""

import ctypes
import math
import pickle

import numpy as np
import pytest

from mech import Chain, Hand, NoOperator, ParameterError, PointMass, UserOperator, kernels, load_user
from mech.records import KNOTS, OPERATOR, OperatorKind

LINK = Chain(lengths_m=(0.1, 0.1), masses_kg=0.1)


def force(operator, t, r=(0.0, 0.0), v=(0.0, 0.0)):
    out = np.empty(2)
    record = operator.pack()
    kernels.operator_force(record[0], float(t), np.array(r, float), np.array(v, float), out)
    return out


def test_default_hand_is_the_published_arm():
    hand = Hand(waypoints_s_m=[(0.0, 0.0, 0.0)])
    assert (hand.mass_kg, hand.damping_n_s_per_m, hand.stiffness_n_per_m) == (0.554, 6.45, 135.0)


def test_hand_pulls_to_its_waypoint_and_adds_its_force():
    hand = Hand(
        damping_n_s_per_m=6.0,
        stiffness_n_per_m=100.0,
        waypoints_s_m=[(0.0, 0.1, 0.2)],
        force_s_n=[(0.0, 1.0, -1.0)],
    )
    expected = (100.0 * 0.02 - 6.0 * 0.5 + 1.0, 100.0 * -0.01 - 6.0 * -0.25 - 1.0)
    np.testing.assert_allclose(force(hand, 3.0, (0.08, 0.21), (0.5, -0.25)), expected, atol=1e-13)


def test_intended_path_has_minimum_jerk():
    # Flash and Hogan 1985: s = 10 x^3 - 15 x^4 + 6 x^5, peak speed 15/8 of the mean, at the middle.
    path = [(1.0, 0.0, 0.3), (3.0, 0.1, 0.3), (3.5, 0.1, 0.2)]
    place = Hand(mass_kg=0.0, damping_n_s_per_m=0.0, stiffness_n_per_m=1.0, waypoints_s_m=path)
    speed = Hand(mass_kg=0.0, damping_n_s_per_m=1.0, stiffness_n_per_m=0.0, waypoints_s_m=path)
    for x in np.linspace(0.0, 1.0, 11):
        s = 10 * x**3 - 15 * x**4 + 6 * x**5
        np.testing.assert_allclose(force(place, 1.0 + 2.0 * x), (0.1 * s, 0.3), atol=1e-15)
    np.testing.assert_allclose(force(speed, 2.0), (0.05 * 15 / 8, 0.0), atol=1e-15)
    np.testing.assert_allclose(force(speed, 3.25), (0.0, -0.2 * 15 / 8), atol=1e-15)
    for t, at in ((0.0, (0.0, 0.3)), (3.0, (0.1, 0.3)), (9.0, (0.1, 0.2))):
        np.testing.assert_allclose(force(place, t), at, atol=1e-15)
        assert np.all(force(speed, t) == 0.0)


def test_intended_force_is_linear_between_rows_and_constant_beyond():
    table = [(1.0, 0.0, 0.0), (2.0, 1.0, 2.0), (2.5, 1.0, -2.0)]
    hand = Hand(damping_n_s_per_m=0.0, stiffness_n_per_m=0.0, force_s_n=table)
    for t, at in (
        (0.0, (0, 0)),
        (1.5, (0.5, 1)),
        (2.0, (1, 2)),
        (2.25, (1, 0)),
        (2.5, (1, -2)),
        (9.0, (1, -2)),
    ):
        np.testing.assert_allclose(force(hand, t), at, atol=1e-15)
    assert hand.knots_s == (1.0, 2.0, 2.5)


def test_full_tables_are_searched_right():
    rows = [(0.1 * i, math.sin(i), float(i)) for i in range(KNOTS)]
    hand = Hand(damping_n_s_per_m=0.0, stiffness_n_per_m=0.0, force_s_n=rows)
    times = np.random.default_rng(0).uniform(-1.0, 0.1 * KNOTS + 1.0, 300)
    seen = np.array([force(hand, t) for t in times])
    table = np.array(rows)
    expected = np.stack([np.interp(times, table[:, 0], table[:, k]) for k in (1, 2)], axis=1)
    np.testing.assert_allclose(seen, expected, atol=1e-11)
    with pytest.raises(ParameterError, match=f"{KNOTS + 1} rows.*at most {KNOTS}"):
        Hand(force_s_n=[*rows, (1e3, 0.0, 0.0)])


def test_nobody_and_a_point_mass_push_nothing_of_their_own():
    assert np.all(force(NoOperator(), 1.0, (1, 1), (1, 1)) == 0.0)
    assert np.all(force(PointMass(mass_kg=1.0), 1.0, (1, 1), (1, 1)) == 0.0)
    assert PointMass(mass_kg=1.0).pack()["kind"][0] == OperatorKind.MASS


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (lambda: PointMass(mass_kg=-0.1), ["mass_kg"]),
        (lambda: PointMass(mass_kg=math.nan), ["mass_kg"]),
        (
            lambda: Hand(mass_kg=-1, damping_n_s_per_m=math.inf, waypoints_s_m=[(0, 0, 0)]),
            ["mass_kg", "damping_n_s_per_m"],
        ),
        (lambda: Hand(), ["waypoints_s_m"]),
        (lambda: Hand(waypoints_s_m=[(0.0, 0.0)]), ["waypoints_s_m[0]"]),
        (lambda: Hand(waypoints_s_m=[(0, 0, 0), (0, 1, 1)]), ["waypoints_s_m[1]"]),
        (lambda: Hand(waypoints_s_m=[(0, 0, 0)], force_s_n=[(0, math.nan, 0)]), ["force_s_n[0]"]),
        (lambda: Hand(waypoints_s_m=3), ["waypoints_s_m"]),
        (lambda: Hand(waypoints_s_m=["abc"]), ["waypoints_s_m[0]"]),
    ],
)
def test_bad_operators_are_refused_all_at_once(make, names):
    with pytest.raises(ParameterError) as caught:
        make()
    assert [problem.name for problem in caught.value.problems] == names
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)


GOOD = """
class Wall:
    mass_kg = 0.2

    def force(self, t, r, v):
        return -100.0 * r[0] - 2.0 * v[0], t

class Counts:
    calls = 0

    def force(self, t, r, v):
        self.calls += 1
        return [1.0, 2.0]
"""


def write(folder, text):
    (folder / "mine.py").write_text(text, encoding="utf-8")


def test_users_class_is_called_back_by_the_kernel(tmp_path):
    write(tmp_path, GOOD)
    user = load_user("mine.py:Wall", tmp_path)
    assert not user.compiled
    assert Hand(waypoints_s_m=[(0, 0, 0)]).compiled
    assert user.mass_kg == 0.2
    np.testing.assert_allclose(force(user, 0.5, (0.1, 0.0), (3.0, 0.0)), (-16.0, 0.5), rtol=1e-15)
    q = np.array((0.6, 1.1))
    same = Hand(
        mass_kg=0.2,
        damping_n_s_per_m=0.0,
        stiffness_n_per_m=0.0,
        force_s_n=[(0, -100 * LINK.forward(q)[0], 0)],
    )
    expected = LINK.acceleration(q, (0, 0), (0, 0), same)
    np.testing.assert_allclose(LINK.acceleration(q, (0, 0), (0, 0), user), expected, rtol=1e-12)
    one, two = (load_user("mine.py:Counts", tmp_path) for _ in range(2))
    force(one, 0.0)
    assert one._target.calls == 1
    assert two._target.calls == 0


def test_users_class_may_be_called_while_the_interpreter_is_released(tmp_path):
    # As inside ngspice: the call into C has let go of the interpreter's lock.
    write(tmp_path, GOOD)
    user = load_user("mine.py:Counts", tmp_path)
    record = user.pack()

    number, real = ctypes.c_int64, ctypes.c_double
    callback = kernels.operator_force._function
    released = ctypes.CFUNCTYPE(ctypes.c_int32, number, real, *[number] * 7)(
        ctypes.cast(callback, ctypes.c_void_p).value
    )
    r, v, out = (np.zeros(2) for _ in range(3))
    for _ in range(5):
        released(record.ctypes.data, 0.0, r.ctypes.data, 2, v.ctypes.data, 2, out.ctypes.data, 2, 0)
    assert user._target.calls == 5
    assert tuple(out) == (1.0, 2.0)


@pytest.mark.parametrize(
    ("text", "spec", "says"),
    [
        (GOOD, "mine.py", "of the form 'file.py:Class'"),
        (GOOD, "mine.py:", "of the form 'file.py:Class'"),
        (GOOD, "other.py:Wall", r"an existing file; there is no .*other\.py"),
        (GOOD, "mine.py:Wal", "name of a class in that file; it has Wall, Counts"),
        ("x = 1", "mine.py:x", "it has none"),
        (
            "import nothing_of_the_kind",
            "mine.py:A",
            "ModuleNotFoundError: No module named 'nothing_of_the_kind'",
        ),
        ("class A(:", "mine.py:A", "SyntaxError"),
        ("class A:\n    pass", "mine.py:A", r"a method force\(self, t, r, v\)"),
        ("class A:\n    def force(self, t):\n        return 0, 0", "mine.py:A", "too many positional"),
        (
            "class A:\n    def __init__(self, k): pass\n    def force(self, t, r, v): return 0, 0",
            "mine.py:A",
            "starts without",
        ),
        (
            "class A:\n    mass_kg = -1.0\n    def force(self, t, r, v): return 0, 0",
            "mine.py:A",
            "mass_kg = -1.0",
        ),
    ],
)
def test_bad_users_files_are_refused_with_a_reason(tmp_path, text, spec, says):
    write(tmp_path, text)
    with pytest.raises(ParameterError, match=says):
        load_user(spec, tmp_path)


@pytest.mark.parametrize(
    ("body", "kind", "says"),
    [
        ("return float('nan'), 0.0", ParameterError, "two finite numbers"),
        ("return 1.0", ParameterError, "two finite numbers"),
        ("return 1.0, 2.0, 3.0", ParameterError, "two finite numbers"),
        ("return None", ParameterError, "two finite numbers"),
        ("return 1.0 / 0.0, 0.0", RuntimeError, "raised ZeroDivisionError"),
    ],
)
def test_errors_of_the_users_code_are_kept_and_raised(tmp_path, body, kind, says):
    write(tmp_path, f"class A:\n    def force(self, t, r, v):\n        {body}\n")
    user = load_user("mine.py:A", tmp_path)
    assert np.all(np.isnan(force(user, 0.25)))
    with pytest.raises(kind, match=rf"mine\.py:A\.force\(t=0\.25, .*{says}"):
        user.raise_pending()
    user.raise_pending()  # told once
    with pytest.raises(kind, match=says):
        LINK.acceleration((0.1, 0.2), (0, 0), (0, 0), user)


def test_interrupt_inside_the_users_code_is_not_lost():
    class Stop:
        def force(self, t, r, v):
            raise KeyboardInterrupt

    user = UserOperator(Stop(), "Stop")
    force(user, 0.0)
    with pytest.raises(KeyboardInterrupt):
        user.raise_pending()


def test_record_layout_is_what_compiled_callbacks_expect():
    assert OPERATOR.isalignedstruct
    assert OPERATOR.fields["path"][0].shape == (KNOTS, 3)
