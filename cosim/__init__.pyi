from cosim import errors as errors
from cosim.api.batches import monte_carlo as monte_carlo
from cosim.api.batches import study as study
from cosim.api.queries import check as check
from cosim.api.queries import device as device
from cosim.api.queries import noise as noise
from cosim.api.queries import stability as stability
from cosim.api.simulation import compare as compare
from cosim.api.simulation import run as run
from cosim.api.simulation import sweep as sweep
from cosim.errors import CosimError as CosimError
from cosim.errors import InputError as InputError
from cosim.errors import SimulationError as SimulationError
from cosim.errors import StorageError as StorageError
from cosim.loop.userlaw import Command as Command
from cosim.loop.userlaw import Sample as Sample
from cosim.plan import Plan as Plan
from cosim.plan import resolve as resolve
from cosim.results import Run as Run
from cosim.scene import Scene as Scene
from cosim.scene import load_scene as load_scene

__version__: str
__all__: list[str]
