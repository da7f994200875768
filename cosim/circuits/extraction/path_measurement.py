"""Ask ngspice for every path of a board apart: before the multipliers, and after them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.circuits.extraction.multipliers import LOW_HZ
from cosim.circuits.extraction.testbench import Testbench
from cosim.ngspice.deck import Deck
from cosim.types import Array, Complex

__all__ = ["LOW_HZ", "Paths", "Session"]


#: Crosstalk between joints above this share of the largest path to one place: nothing is driven together.
_CROSSTALK = 1e-10


@dataclass(frozen=True)
class Paths:
    """What was measured, at the frequencies `hz` [F].

    Attributes
    ----------
    x
        [F, m, 2 n]: pot, u -> behind the X probe of each multiplier. A lumped board: its share of the
        current of motor i at a gain of `v_fs`.
    gain
        [m], 1/V.
    post
        [F, n, m + 2 n]: multiplier's product, cmd, vel -> imot.
    total
        [F, n, T]: imot with every gain pin at `v_fs` and `driven`, measured as a whole.
    driven
        [2 n, T]: amplitudes of pot, u [V].
    lumped
        Whether the multipliers have no probes.
    v_fs
        Full scale of the gain pins [V].
    """

    hz: Array
    x: Complex
    gain: Array
    post: Complex
    total: Complex
    driven: Array
    lumped: bool
    v_fs: float

    @property
    def s(self) -> Complex:
        """The frequencies as s = jw [rad/s]."""
        out: Complex = 2j * np.pi * self.hz.astype(complex)
        return out


class Session(Testbench):
    """A board whose paths are measured.

    Attributes
    ----------
    together
        Whether inputs of different joints are driven together: joint j's reach only the multipliers of joint
        j, and motor i's multipliers only motor i, as far as that was measured.
    """

    def __init__(
        self, board: Deck, extra: Sequence[str] = (), beat: Callable[[], object] = lambda: None
    ) -> None:
        super().__init__(board, extra, beat=beat)
        self.together = self.joints > 1 and bool(self.multipliers)
        before = [self.before(part) for part in self.multipliers]
        #: For each multiplier the first one that is fed by the same node.
        self._first = [before.index(node) for node in before]

    def groups(self) -> list[list[int]]:
        """Return the channels in sets that are driven together: one a motor, or each alone."""
        m, n = len(self.channels), self.joints
        if not self.together:
            return [[c] for c in range(m)]
        return [[kind + i * n + j for i in range(n)] for kind in (0, n * n) for j in range(n)]

    def measure(self, sweep: str, gain: Array | None = None) -> Paths:
        """Measure all paths over a sweep such as ``dec 20 0.1 100meg``.

        Parameters
        ----------
        gain
            Known gains of the multipliers [m], 1/V. Then nothing is measured again that a change of values
            does not affect, cmd and vel are driven together with pot and u, and gain pins stay at `v_fs`.
        """
        if not self.multipliers:
            return self._lumped(sweep)
        paths = self._apart(sweep, gain)
        if self.together and gain is None and self._crosstalk(paths, sweep):
            self.together = False
            paths = self._apart(sweep, gain)
        return paths

    def _sets(self, pins: list[str]) -> list[list[int]]:
        """Return the places in `pins`, n of each of two kinds, that are driven together."""
        n = self.joints
        return [[*range(n)], [*range(n, 2 * n)]] if self.together else [[k] for k in range(len(pins))]

    def _apart(self, sweep: str, known: Array | None) -> Paths:
        n, m = self.joints, len(self.channels)
        channel = np.arange(m)
        joint, motor = channel % n, channel // n % n
        inside = [part.x_node for part in self.multipliers]
        first = self._first
        self.hold(dict.fromkeys(self.channels, self.v_fs))
        sets, groups = self._sets(self.signals), self.groups()
        driving = [[self.signals[k] for k in one] for one in sets]
        if known is not None:
            driving = [
                pins + [self.commands[k] for k in one] for pins, one in zip(driving, sets, strict=True)
            ]
        # multipliers that are fed by one node have one X, as long as no probe is driven
        fed = sorted(set(first))
        nodes = [inside[c] for c in fed] + self._outputs
        place = [fed.index(c) for c in first] + list(range(len(fed), len(nodes)))
        sides = [self.respond(dict.fromkeys(pins, 1.0), sweep, nodes)[:, place] for pins in driving]
        nodes = inside + self._outputs
        hz, size = self.hz, len(self.hz)
        x = np.zeros((size, m, 2 * n), complex)
        driven = np.zeros((2 * n, len(sets)))
        for run, one in enumerate(sets):
            driven[one, run] = 1.0
            if self.together:
                x[:, channel, joint + one[0]] = sides[run][:, :m]
            else:
                x[:, :, one[0]] = sides[run][:, :m]
        # a driven probe also moves what stands before it a little: solve for each multiplier's own share
        probed = np.stack(
            [
                self.respond(dict.fromkeys([self.multipliers[c].x for c in one], 1.0), sweep, nodes)
                for one in groups
            ],
            axis=1,
        )
        share = np.zeros((size, n, m), complex)
        for i in range(n):
            own = np.flatnonzero(motor == i) if self.together else channel
            share[:, i, own] = np.linalg.solve(probed[:, :, own], probed[:, :, m + i, None])[:, :, 0]
        gain = self._gains(share[0], hz[0], groups) if known is None else known
        post = np.zeros((size, n, m + 2 * n), complex)
        post[:, :, :m] = share / (gain * self.v_fs)
        for run, one in enumerate(sets):
            if known is None:
                pins = dict.fromkeys([self.commands[k] for k in one], 1.0)
                direct = self.respond(pins, sweep, self._outputs)
            else:  # what came through the multipliers is known apart
                direct = sides[run][:, m:] - (share @ sides[run][:, :m, None])[:, :, 0]
            if self.together:
                post[:, range(n), [m + k for k in one]] = direct
            else:
                post[:, :, m + one[0]] = direct
        if known is None:
            self.hold(dict.fromkeys(self.channels, 0.0))
        total = np.stack([side[:, m:] for side in sides], axis=2)
        return Paths(hz, x, gain, post, total, driven, False, self.v_fs)

    def _gains(self, share: Complex, hz: float, groups: list[list[int]]) -> Array:
        """Return w per X and volt at the gain pin [m]; `share` [n, m] is X -> imot at full scale and `hz`."""
        out = np.full(len(self.channels), 1.0 / self.v_fs)
        once = f"lin 1 {float(hz)!r} {float(hz)!r}"
        for group in groups:
            ends = {c: (part.z, part.z_node) for c in group if (part := self.multipliers[c]).z is not None}
            nodes = [node for _, node in ends.values() if node is not None]
            if not nodes:
                continue
            drive = {source: 1.0 for source, _ in ends.values() if source is not None}
            response = self.respond(drive, once, [*self._outputs, *nodes])[0]
            for c, at_z in zip(ends, response[self.joints :], strict=True):
                strongest = int(np.argmax(np.abs(share[:, c])))
                if response[strongest] == 0.0:  # nothing comes through to a motor: any gain does
                    continue
                out[c] = np.real(share[strongest, c] * at_z / (response[strongest] * self.v_fs))
        return out

    def _crosstalk(self, paths: Paths, sweep: str) -> bool:
        """Whether joints reach each other: everything driven at once, by different voltages, must add up."""
        n, m = self.joints, len(self.channels)
        kind, points, *ends = sweep.split()
        coarse, every = (" ".join([kind, "1", *ends]), int(points)) if kind == "dec" else (sweep, 1)
        volts = np.random.default_rng(0).uniform(0.5, 1.5, m + 2 * n)  # no two differences alike
        inside = [part.x_node for part in self.multipliers]
        response = self.respond(dict(zip(self.signals, volts.tolist(), strict=False)), coarse, inside)
        expected = paths.x[::every][: len(response)] @ volts[: 2 * n]
        if (np.abs(response - expected).max(axis=0) > _CROSSTALK * np.abs(paths.x).max(axis=(0, 2))).any():
            return True
        self.hold(dict.fromkeys(self.channels, self.v_fs))
        names = [*(part.x for part in self.multipliers), *self.commands]
        response = self.respond(dict(zip(names, volts.tolist(), strict=True)), coarse, inside + self._outputs)
        self.hold(dict.fromkeys(self.channels, 0.0))
        post = paths.post[::every][: len(response)]
        direct = np.broadcast_to(volts[m:], (len(response), 2 * n))
        expected = (
            post @ np.concatenate([response[:, :m] * (paths.gain * self.v_fs), direct], axis=1)[:, :, None]
        )[:, :, 0]
        return bool(
            (np.abs(response[:, m:] - expected).max(axis=0) > _CROSSTALK * np.abs(expected).max(axis=0)).any()
        )

    def _lumped(self, sweep: str) -> Paths:
        n, m = self.joints, len(self.channels)
        none = [self.respond(pin, sweep, self._outputs) for pin in self.signals]
        size = len(self.hz)
        x = np.zeros((size, m, 2 * n), complex)
        post = np.zeros((size, n, m + 2 * n), complex)
        for c, pin in enumerate(self.channels):
            motor = c // n % n
            self.hold({pin: self.v_fs})
            for k, signal in enumerate(self.signals):
                x[:, c, k] = (self.respond(signal, sweep, self._outputs) - none[k])[:, motor]
            self.hold({pin: 0.0})
            post[:, motor, c] = 1.0
        for k, pin in enumerate(self.commands):
            post[:, :, m + k] = self.respond(pin, sweep, self._outputs)
        self.hold(dict.fromkeys(self.channels, self.v_fs))
        total = np.stack([self.respond(pin, sweep, self._outputs) for pin in self.signals], axis=2)
        self.hold(dict.fromkeys(self.channels, 0.0))
        gain = np.full(m, 1.0 / self.v_fs)
        return Paths(self.hz, x, gain, post, total, np.eye(2 * n), True, self.v_fs)
