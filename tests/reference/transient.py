"""Transients of a circuit of `mna.py` by two integrators that share nothing: extrapolation, SUNDIALS' IDA.

f(x, t) + C x' = 0, an index-1 system where nodes have no capacitor. Both start at rest, all sources at zero.
"""

from itertools import pairwise

import numpy as np


class Transient:
    """A circuit whose independent sources `drive` (name -> function of time) follow in time."""

    def __init__(self, circuit, drive):
        self.circuit, self.drive = circuit, drive
        self.capacitors = circuit.matrices(np.zeros(circuit.size))[1]

    def currents(self, t, x):
        """Return f(x, t) and its slopes."""
        g, _, b = self.circuit.matrices(x)
        for name, volts in self.drive.items():
            b[len(self.circuit.index) + self.circuit.branches[f"{name}#"]] += volts(t)
        return g @ x - b, g

    def euler(self, t, x, h):
        """One step of the implicit Euler method, by Newton's."""
        new = x.copy()
        for _ in range(60):
            f, slopes = self.currents(t + h, new)
            move = np.linalg.solve(slopes + self.capacitors / h, -f - self.capacitors @ (new - x) / h)
            # an exponential is not to be followed further than it is straight
            move *= min(1.0, 0.2 / max(np.abs(move).max(), 1e-300))
            new = new + move
            if np.abs(move).max() <= 1e-14 * max(1.0, np.abs(new).max()):
                break
        return new

    def by_extrapolation(self, times, columns=7):
        """States at the times, one macro step each: Euler with 1, 2, 3 ... steps, extrapolated to none."""
        x = np.zeros(self.circuit.size)
        states = [x]
        for start, end in pairwise(times):
            table = []
            for count in range(1, columns + 1):
                h, y = (end - start) / count, x
                for k in range(count):
                    y = self.euler(start + k * h, y, h)
                row = [y]
                for j, before in enumerate(table[-1] if table else ()):
                    row.append(row[j] + (row[j] - before) / (count / (count - j - 1) - 1.0))
                table.append(row)
            x = table[-1][-1]
            states.append(x)
        return np.array(states)

    def by_ida(self, times, rtol, atol):
        """States at the times by variable-order BDF; needs scikit-sundae."""
        from sksundae.ida import IDA

        def residual(t, y, rate, out):
            out[:] = self.currents(t, y)[0] + self.capacitors @ rate

        solver = IDA(residual, rtol=rtol, atol=atol, max_num_steps=10**6)
        start = np.zeros(self.circuit.size)
        return solver.solve(np.asarray(times), start, start).y
