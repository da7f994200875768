"""What no designer can have meant: figures of a scene, a board or a run that are possible but absurd.

Each function looks for one kind of slip and yields a `Caution` for it; thresholds stand beside them with
their reasons. `of_plan` needs no run, `of_run` looks at a finished one; `of_circuit` and
`of_response` compare a board's stated constants with its circuit.
"""

from cosim.plausibility.constants import DEVIATION, constant_missed, of_circuit, of_response
from cosim.plausibility.input_checks import of_plan
from cosim.plausibility.result_checks import of_run

__all__ = ["DEVIATION", "constant_missed", "of_circuit", "of_plan", "of_response", "of_run"]
