"""Circuits of Shichman-Hodges transistors as equations C(v) v' = f(v, t), without any netlist.

Written from the description of the test set for IVP solvers (NAND gate, two-bit adding unit), a second time
and apart from the decks: a flat table of transistors in arrays, branches by the case in which a
transistor is, and not by `max`. What a node is charged with is the sum of what its branches take.
"""

from dataclasses import dataclass

import numpy as np

PHI_B, DELTA, THERMAL = 0.87, 0.02, 25.85


@dataclass(frozen=True)
class Circuit:
    """Transistors by the numbers of their nodes [V]; node 0 is ground, the last ones are sources.

    Attributes
    ----------
    d, g, s : [transistors] outer nodes; the inner ones are si, di, bs, bd
    load : [transistors] whether it is a depletion load
    gain, back : [transistors] A/V^2, forwards and backwards
    to_ground : node -> F
    product : whether a junction's charge is its capacitance times its voltage
    """

    names: list[str]
    d: np.ndarray
    g: np.ndarray
    s: np.ndarray
    inner: np.ndarray
    load: np.ndarray
    gain: np.ndarray
    back: np.ndarray
    ohms: tuple[float, float]
    farads: tuple[float, float]
    leakage: float
    to_ground: dict[int, float]
    product: bool
    sources: list

    @property
    def unknowns(self):
        return len(self.names) - 1 - len(self.sources)

    def volts(self, t, segment, y):
        """All voltages and their rates' places; `segment` is an instant inside the linear piece."""
        driven = [source(t, segment) for source in self.sources]
        return np.concatenate([[0.0], y, [v for v, _ in driven]]), [r for _, r in driven]

    def currents(self, v):
        """Currents into each node."""
        si, di, bs, bd = self.inner.T
        into = np.zeros(len(v))

        def flow(a, b, amps):
            np.subtract.at(into, a, amps)
            np.add.at(into, b, amps)

        flow(si, self.s, (v[si] - v[self.s]) / self.ohms[0])
        flow(di, self.d, (v[di] - v[self.d]) / self.ohms[0])
        for bulk, end in ((bs, self.s), (bd, self.d)):
            np.add.at(into, bulk, (-2.5 - v[bulk]) / self.ohms[1])
            across = v[bulk] - v[end]
            leak = np.where(across <= 0.0, -self.leakage * np.expm1(np.minimum(across, 0.0) / THERMAL), 0.0)
            flow(end, bulk, leak)
        vds = v[di] - v[si]
        ahead = vds > 0.0
        rest, rise, phi = np.where(self.load[:, None], (-2.43, 0.2, 1.28), (0.2, 0.035, 1.01)).T
        over = np.where(ahead, v[self.g] - v[si], v[self.g] - v[di])
        body = np.where(ahead, v[bs] - v[self.s], v[bd] - v[self.d])
        over = over - rest - rise * (np.sqrt(phi - body) - np.sqrt(phi))
        span = np.abs(vds)
        saturated, linear = over**2, span * (2.0 * over - span)
        amps = np.where(over <= 0.0, 0.0, np.where(over <= span, saturated, linear))
        amps = amps * (1.0 + DELTA * span) * np.where(ahead, self.gain, -self.back)
        flow(di, si, amps)
        return into

    def charging(self, v, rate):
        """What the branches take from each node at rates of the voltages [A]."""
        si, di, bs, bd = self.inner.T
        out = np.zeros(len(v))

        def take(a, b, amps):
            np.add.at(out, a, amps)
            np.subtract.at(out, b, amps)

        for end in (si, di):
            take(self.g, end, self.farads[0] * (rate[self.g] - rate[end]))
        for bulk, end in ((bs, self.s), (bd, self.d)):
            across = v[bulk] - v[end]
            below = np.minimum(across, 0.0)
            c = np.where(across <= 0.0, 1.0 / np.sqrt(1.0 - below / PHI_B), 1.0 + across / (2.0 * PHI_B))
            if self.product:  # of C(v) v
                slope = np.where(
                    across <= 0.0, 0.5 / PHI_B * (1.0 - below / PHI_B) ** -1.5, 1.0 / (2.0 * PHI_B)
                )
                c = c + across * slope
            take(bulk, end, self.farads[1] * c * (rate[bulk] - rate[end]))
        for node, farad in self.to_ground.items():
            out[node] += farad * rate[node]
        return out

    def residual(self, t, segment, y, rate):
        """C(v) v' - f of the unknown nodes."""
        v, driven = self.volts(t, segment, y)
        rates = np.concatenate([[0.0], rate, driven])
        return (self.charging(v, rates) - self.currents(v))[1 : 1 + self.unknowns]


def build(transistors, sources, ohms, farads, leakage, to_ground, *, product=False, back=1.0):
    """Number the nodes of (name, is load, gain, d, g, s); sources: name -> function of time and segment."""
    names = ["0"]
    for name, _, _, d, g, s in transistors:
        inner = [f"{name}.{end}" for end in ("si", "di", "bs", "bd")]
        names += [n for n in dict.fromkeys((*inner, d, g, s)) if n not in names and n not in sources]
    names += list(sources)
    at = {n: k for k, n in enumerate(names)}
    columns = list(zip(*transistors, strict=True))
    inner = np.array([[at[f"{n}.{end}"] for end in ("si", "di", "bs", "bd")] for n in columns[0]])
    gain, load = np.array(columns[2]), np.array(columns[1])
    return Circuit(
        names, *(np.array([at[n] for n in columns[k]]) for k in (3, 4, 5)), inner, load, gain,
        np.where(load, gain, back * gain), ohms, farads, leakage,
        {at[n]: c for n, c in to_ground.items()}, product, list(sources.values()),
    )  # fmt: skip


def pulse(delay, high, period, ramp=5.0):
    """Voltage and rate of a pulse of five volts, in the piece that `segment` lies in."""

    def at(t, segment):
        phase = segment % period
        now = t - (segment - phase) - delay
        phase -= delay
        if 0.0 < phase < ramp:
            return 5.0 * now / ramp, 5.0 / ramp
        if ramp < phase < ramp + high:
            return 5.0, 0.0
        if ramp + high < phase < 2 * ramp + high:
            return 5.0 * (2 * ramp + high - now) / ramp, -5.0 / ramp
        return 0.0, 0.0

    return at


def constant(volts):
    return lambda t, segment: (volts, 0.0)


def nand(back=0.1):
    """The NAND gate; `back`: gain of the switches backwards over forwards, a tenth in the set's program."""
    rows = [("l", True, 5.35e-4, "vdd", "out", "out"), ("a", False, 1.748e-3, "out", "in1", "mid"),
            ("b", False, 1.748e-3, "mid", "in2", "0")]  # fmt: skip
    sources = {"vdd": constant(5.0), "in1": pulse(5, 5, 20), "in2": pulse(15, 15, 40)}
    return build(rows, sources, (4.0, 10.0), (6e-5, 2.4e-5), 1e-14, {"out": 5e-5, "mid": 5e-5}, back=back)


def adder():
    """The two-bit adding unit: (output, kind, inputs), then three switches below the carry's inverse."""
    rows = []

    def switch(name, size, d, g, s):
        rows.append((name, False, 8.74 * size, d, g, s))

    for out, kind, inputs in (
        ("5", "nor", "v1 v2"), ("18", "andoi", "5 v2 v1"), ("36", "nor", "18 cin"),
        ("49", "andoi", "36 cin 18"),
        ("67", "andoi", "5 cin 18"), ("85", "nor", "v3 v4"), ("98", "andoi", "85 v4 v3"),
        ("116", "nand", "67 98"), ("130", "orani", "116 67 98"), ("148", "andoi", "85 5 98"),
    ):  # fmt: skip
        a, b, c = (*inputs.split(), "")[:3]
        mid = f"m{out}"
        rows.append((f"l{out}", True, 2.675, "vdd", out, out))
        if kind in ("nor", "andoi"):
            switch(f"a{out}", 1, out, a, "0")
        else:
            switch(f"a{out}", 2, out, a, mid)
        if kind == "nor":
            switch(f"b{out}", 1, out, b, "0")
        elif kind == "andoi":
            switch(f"b{out}", 2, out, b, mid)
            switch(f"c{out}", 2, mid, c, "0")
        else:
            switch(f"b{out}", 2, mid, b, "0")
        if kind == "orani":
            switch(f"c{out}", 2, mid, c, "0")
    switch("t162", 3, "148", "98", "166")
    switch("t167", 3, "166", "18", "171")
    switch("t172", 3, "171", "cin", "0")
    sources = {"vdd": constant(5.0), "v1": pulse(0, 5, 20), "v2": pulse(10, 15, 40), "v3": pulse(30, 35, 80),
               "v4": pulse(70, 75, 160), "cin": pulse(150, 155, 320)}  # fmt: skip
    loads = {"49": 2.0, "130": 2.0, "148": 2.0}
    return build(rows, sources, (8e-4, 2e-3), (0.6, 0.24), 5e-11, loads, product=True)


def settled(circuit, y, step=1e-3, steps=40):
    """The state some time constants later, inputs at rest, by implicit Euler: a consistent start."""
    at = -2.5  # in front of the first pulses
    for _ in range(steps):
        old = y
        for _ in range(30):

            def off(new, old=old):
                return circuit.residual(at, at, new, (new - old) / step)

            here = off(y)
            slopes = np.array([(off(y + 1e-7 * row) - here) / 1e-7 for row in np.eye(len(y))]).T
            move = np.linalg.solve(slopes, -here)
            y = y + move
            if np.abs(move).max() < 1e-10:
                break
    return y


def by_ida(circuit, y, end, rtol, atol):
    """Voltages at the end by SUNDIALS' IDA, restarted where a pulse has a kink (every 5)."""
    from sksundae.ida import IDA

    for k in range(round(end / 5.0)):
        start = 5.0 * k

        def residual(t, y, rate, out, inside):
            out[:] = circuit.residual(t, inside, y, rate)

        # the rates are linear in the equations; what no capacitor ties to ground has the smallest
        still = circuit.residual(start, start + 2.5, y, np.zeros_like(y))
        unit = np.eye(len(y))
        farads = np.array([circuit.residual(start, start + 2.5, y, row) - still for row in unit]).T
        rate = np.linalg.lstsq(farads, -still, rcond=1e-12)[0]
        solver = IDA(residual, userdata=start + 2.5, rtol=rtol, atol=atol, max_num_steps=10**6)
        y = solver.solve(np.array([start, start + 2.5, start + 5.0]), y, rate).y[-1].copy()
    return y
