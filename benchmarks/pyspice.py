"""The same lockstep in PySpice's own style: `get_vsrc_data` per source, `send_data` per point, all in Python.

A plain implementation of the same coupling for scenes without noise and delay. What a user of PySpice would
take from a compiled library - the equations of motion, the control law - is the same compiled code here.
"""

from __future__ import annotations

import logging
import os
import time
from typing import Any

import numpy as np
from PySpice.Spice.NgSpice.Shared import NgSpiceShared, ffi

from benchmarks.rig import Outcome, Signals
from cosim.circuits.decks import lockstep_deck, saved
from cosim.circuits.design_constants import DesignConstants
from cosim.loop.computer import law, read_encoders, to_volts
from cosim.loop.dac_channels import channels
from cosim.loop.setup import pack
from cosim.plan import Plan
from mech.kernels import dynamics


class PythonLockstep(NgSpiceShared):  # type: ignore[misc]  # PySpice carries no types
    """PySpice's simulator with the two methods that it asks to override; only one in a process."""

    def __init__(self) -> None:
        logging.getLogger("PySpice").setLevel(logging.CRITICAL)
        NgSpiceShared.LIBRARY_PATH = os.environ.get("NGSPICE_LIBRARY_PATH", "libngspice.so.0")
        super().__init__(send_data=True)
        self._sync_c = ffi.callback(
            "int (double, double *, double, int, int, int, void *)", self.get_sync_data
        )
        self._ngspice_shared.ngSpice_Init_Sync(
            self._get_vsrc_data_c, self._get_isrc_data_c, self._sync_c, self._ngspice_id, self._self_c
        )

    def begin(self, plan: Plan, constants: DesignConstants, order: int = 2) -> None:
        """Make ready for a run of a plan; `order` 1 forgets the acceleration before the last."""
        self.plan, self.order = plan, order
        nodes = plan.recorded + tuple(n for n in plan.watched if n not in plan.recorded)
        self.deck = lockstep_deck(plan.board, plan.circuit, plan.tolerances, nodes)
        self.names = [name.lower() for name in saved(plan.circuit, nodes)]
        memory = pack(plan.scene, constants, plan.circuit, plan.recorded, nodes)
        self.memory, s = memory, memory.state[0]
        scene, n = plan.scene, plan.scene.joints
        self.n, self.p, self.op, self.w, self.c, self.x = n, s["p"], s["op"], s["w"], s["c"], s["x"]
        self.q, self.v = s["q"].tolist()[:n], s["v"].tolist()[:n]
        self.a, self.a_old = [0.0] * n, [0.0] * n
        self.t, self.h_old, self.history = 0.0, 1.0, 0
        self.trial = (-1.0, self.q, self.v)
        self.torque_per_amp, self.gear = float(s["torque_per_amp"][0]), float(s["gear"])
        self.h_max, self.h_first = float(s["steps"]["longest"]), float(s["steps"]["first"])
        self.h_couple = self.h_max
        self.tolerance, self.tiny = float(s["steps"]["tol"]), float(s["steps"]["least"])
        self.settle, self.period = float(s["dac"]["settle"]), scene.computer.period_s
        self.tick, self.last_tick, self.end = 0, int(s["clock"]["last_tick"]), scene.duration_s
        every = channels(n)
        self.channel = {name: every.index(name) for name in plan.circuit.channels}
        self.kind = {f"v{k:02d}": pin for k, pin in enumerate(plan.circuit.sources())}
        self.before, self.after, self.started = [0.0] * len(every), [0.0] * len(every), 0.0
        self.ramp_end = -1.0
        self.knots = sorted(set(memory.knots.tolist()))
        self.rows: list[list[float]] = []
        self.tau_array, self.a_array = np.zeros(6), np.zeros(6)
        self.q_array, self.v_array = np.zeros(6), np.zeros(6)
        self.failure: BaseException | None = None
        self.sample()
        self.before = self.after

    def sample(self) -> None:
        """One sample of the computer: new DAC voltages from the joint angles now."""
        self.q_array[: self.n] = self.q
        read_encoders(self.c, self.x, self.tick, self.q_array)
        law(self.c, self.p, self.x)
        volts = np.zeros(len(self.after))
        to_volts(self.c, self.x, volts)
        self.before, self.after = self.after, volts.tolist()
        self.tick += 1

    def predict(self, t: float) -> tuple[float, list[float], list[float]]:
        """Angles and speeds at a trial time."""
        if self.trial[0] != t:
            h, q, v = t - self.t, [], []
            for j in range(self.n):
                slope = (self.a[j] - self.a_old[j]) / self.h_old if self.history > 1 else 0.0
                q.append(self.q[j] + h * (self.v[j] + h * (self.a[j] / 2 + h * slope / 6)))
                v.append(self.v[j] + h * (self.a[j] + h * slope / 2))
            self.trial = (t, q, v)
        return self.trial

    def get_vsrc_data(self, voltage: Any, time: float, node: str, ngspice_id: int) -> int:
        """PySpice asks for one source."""
        pin = self.kind[node]
        if pin.startswith("pot"):
            voltage[0] = self.predict(time)[1][int(pin[3:]) - 1]
        elif pin.startswith("vel"):
            voltage[0] = self.gear * self.predict(time)[2][int(pin[3:]) - 1]
        else:
            k = self.channel[pin]
            if time < self.ramp_end:
                part = (time - self.started) / self.settle
                voltage[0] = self.before[k] + part * (self.after[k] - self.before[k])
            else:
                voltage[0] = self.after[k]
        return 0

    def get_sync_data(
        self, t: float, delta: Any, old: float, redo: int, ident: int, where: int, user: Any
    ) -> int:
        """Step control, which PySpice does not offer: handed to the library by ourselves."""
        if where == 1 or self.failure is not None:
            return 0
        try:
            h, now = delta[0], t + self.tiny
            if self.ramp_end > 0.0 and self.ramp_end <= now:
                self.ramp_end = -1.0
                self.history = min(self.history, 1)
            while self.knots and self.knots[0] <= now:
                self.knots.pop(0)
                self.history = min(self.history, 1)
            if self.tick == 1 and t == 0.0:
                self._ngspice_shared.ngSpice_SetBkpt(self.period)
            if self.tick <= self.last_tick and self.tick * self.period <= now:
                self.sample()
                if any(self.before[k] != self.after[k] for k in self.channel.values()):
                    self.started = (self.tick - 1) * self.period
                    self.ramp_end = self.started + self.settle
                    self.history = min(self.history, 1)
                    h = self.h_first
                if self.tick <= self.last_tick:
                    self._ngspice_shared.ngSpice_SetBkpt(self.tick * self.period)
            h = min(h, self.h_max, self.h_couple)
            event = self.tick * self.period if self.tick <= self.last_tick else self.end
            if self.ramp_end > 0.0:
                event = min(event, self.ramp_end)
            if self.knots:
                event = min(event, self.knots[0])
            rest = event - t
            if rest > 0.0:
                if h > 0.999 * rest:
                    h = rest
                elif h > 0.5 * rest:
                    h = 0.5 * rest
            delta[0] = h
        except BaseException as error:  # it would be swallowed
            self.failure = error
        return 0

    def acceleration(self, t: float, q: list[float], v: list[float]) -> list[float]:
        """Accelerations from the compiled equations of motion."""
        self.q_array[: self.n], self.v_array[: self.n] = q, v
        dynamics(self.p, self.op, t, self.q_array, self.v_array, self.tau_array, self.a_array, self.w)
        return list(self.a_array[: self.n].tolist())

    def send_data(self, actual_vector_values: dict[str, complex], count: int, ngspice_id: int) -> int:
        """PySpice hands over an accepted point."""
        t = actual_vector_values["time"].real
        currents = [actual_vector_values[f"imot{j + 1}"].real for j in range(self.n)]
        self.tau_array[: self.n] = [self.torque_per_amp * i for i in currents]
        h = t - self.t
        if h > 0.0:
            _, q_trial, v_trial = self.predict(t)
            new = self.acceleration(t, q_trial, v_trial)
            defect = 0.0
            for j in range(self.n):
                right = (new[j] - self.a[j]) / h
                c = 0.0
                if self.history > 1:
                    c = (right - (self.a[j] - self.a_old[j]) / self.h_old) / (h + self.h_old)
                b = right - c * h
                q = self.q[j] + h * (self.v[j] + h * (self.a[j] / 2 + h * (b / 6 + h * c / 12)))
                v = self.v[j] + h * (self.a[j] + h * (b / 2 + h * c / 3))
                defect = max(defect, abs(q - q_trial[j]) + h * abs(v - v_trial[j]))
                self.q[j], self.v[j] = q, v
            self.a_old, self.a = self.a, self.acceleration(t, self.q, self.v)
            self.t, self.h_old, self.history = t, h, min(self.history + 1, self.order)
            share = defect / (0.8 * self.tolerance)
            self.h_couple = h * (4.0 if share * 64.0 < 1.0 else share ** (-1.0 / 3.0))
            self.trial = (-1.0, self.q, self.v)
        else:
            self.a = self.acceleration(t, self.q, self.v)
            self.history = 1
        tip = (*self.w["r"].tolist(), *self.w["f_op"].tolist())
        self.rows.append([t, *self.q, *tip, *(actual_vector_values[name].real for name in self.names)])
        return 0

    def run(self) -> Outcome:
        """Run once."""
        self.load_circuit(self.deck)
        longest = self.plan.scene.solver.max_step_s
        begun, busy = time.perf_counter(), time.process_time()
        self.exec_command(f"tran {longest!r} {self.end!r} 0 {longest!r}")
        wall, cpu = time.perf_counter() - begun, time.process_time() - busy
        if self.failure is not None:
            raise self.failure
        table = np.array(self.rows)
        columns = ["time", *(f"q{j + 1}" for j in range(self.n)), "x", "y", "fx", "fy", *self.names]
        signals: Signals = {name: table[:, i] for i, name in enumerate(columns)}
        self.exec_command("destroy all")
        self.exec_command("remcirc")
        stats = {"wall_s": wall, "cpu_s": cpu, "points": len(table)}
        return Outcome(stats, signals, np.empty((0, 0)), ())


_simulator: PythonLockstep | None = None


def run(payload: dict[str, Any], report: Any) -> dict[str, Any]:
    """Run a plan ('plan', 'constants', 'order') once, in a process of its own; returns `Outcome`'s fields."""
    global _simulator
    if _simulator is None:
        _simulator = PythonLockstep()
    _simulator.begin(payload["plan"], payload["constants"], payload.get("order", 2))
    return vars(_simulator.run())
