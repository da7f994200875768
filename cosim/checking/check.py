"""`check`: measure a subject in ngspice's process and judge it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from cosim.caution import warn
from cosim.checking.check_target import Subject
from cosim.checking.coupling_step import Coupling, step_bound
from cosim.checking.measured import Measured
from cosim.checking.requirements import Finding, Severity, findings, missed, of_stability
from cosim.circuits.instability.stability_verdict import Verdict
from cosim.ngspice.child import Child, call
from cosim.stability_gate import verdict

TIME_LIMIT_S = 300.0
"""A board of six joints takes a few seconds; a board that does not converge must not hold the designer."""


@dataclass(frozen=True)
class Check:
    """What was found about one subject; `coupling` needs a scene with a back-EMF."""

    subject: Subject
    measured: Measured
    coupling: Coupling | None
    stability: Verdict
    findings: tuple[Finding, ...]

    def count(self, severity: Severity) -> int:
        """Return the number of findings of a severity."""
        return sum(finding.severity is severity for finding in self.findings)

    def as_dict(self) -> dict[str, Any]:
        """Return every number, JSON-ready."""
        board, measured = self.subject.board, asdict(self.measured)
        for row, constant in zip(measured["constants"], self.measured.constants, strict=True):
            row["deviation_percent"] = constant.deviation_percent
            row["ideal_deviation_percent"] = constant.ideal_deviation_percent
        for row, swing in zip(measured["headroom"]["swings"], self.measured.headroom.swings, strict=True):
            row["headroom_percent"] = swing.headroom_percent
        return {
            "set": self.subject.label,
            "board": board.board,
            "file": str(board.path),
            "joints": board.joints,
            "pins": list(board.pins),
            "driver": self.subject.driver,
            "parts": [asdict(part) for part in board.parts],
            "notes": list(board.notes),
            "deck_digest": board.digest,
            **measured,
            "stability": self.stability.as_dict(),
            "coupling": asdict(self.coupling) if self.coupling else None,
            "findings": [asdict(finding) for finding in self.findings],
            "problems": self.count(Severity.PROBLEM),
            "warnings": self.count(Severity.WARNING),
        }


def check(subject: Subject, *, child: Child | None = None) -> Check:
    """Measure and judge a board.

    Raises
    ------
    InputError
        When ngspice does not accept the board: syntax, floating node, no operating point.
    """
    pot = subject.potentiometer
    limit = subject.scene.solver.time_limit_s if subject.scene is not None else TIME_LIMIT_S
    measured: Measured = call(
        "cosim.checking.measured:measure",
        {
            "board": subject.board,
            "ideal": subject.ideal,
            "noise_rad": pot.noise_rad,
            "noise_bandwidth_hz": pot.noise_bandwidth_hz,
        },
        time_limit_s=limit,
        deck=str(subject.board.path),
        child=child,
    )
    coupling = None
    if subject.scene is not None:
        coupling = step_bound(subject.scene, measured.admittance_a_s, measured.stated)
    warn(*missed(measured))
    judged = verdict(subject.stability, subject.board.path, child, limit)
    warn(*judged.cautions())
    judgements = (*of_stability(judged), *findings(measured, coupling))
    return Check(subject, measured, coupling, judged, judgements)
