"""Functions that tests run in a child process, well- and ill-behaved."""

import ctypes
import os
import time
from typing import Any

from cosim.caution import Caution, warn
from cosim.errors import InputError
from cosim.ngspice.child import OUTBOX


def echo(payload: Any, report: Any) -> Any:
    return payload


def where(payload: Any, report: Any) -> dict[str, Any]:
    return {"cwd": os.getcwd(), "home": os.environ["HOME"], "files": os.listdir("."), "pid": os.getpid()}


def in_a_copy(payload: str, report: Any) -> dict[str, Any]:
    """Tell what this process is, and what it can do with the folder `payload` and with processes."""
    from cosim.ngspice.forked import is_copy
    from cosim.ngspice.sandbox import applied

    def can(act: Any) -> bool:
        try:
            act()
        except OSError:
            return False
        return True

    def process() -> None:
        if os.fork() == 0:
            os._exit(0)

    return {
        **where(None, report),
        "is_copy": is_copy(),
        "secret": os.environ.get("SECRET"),
        "descriptors": len(os.listdir("/proc/self/fd")),
        "landlock": applied().landlock,
        "made a process": can(process),
        "wrote": can(lambda: os.close(os.open(f"{payload}/file", os.O_WRONLY | os.O_CREAT))),
        "read": can(lambda: os.listdir(payload)),
    }


def segfault(payload: Any, report: Any) -> None:
    report({"time_s": 0.125})
    ctypes.string_at(0)


def leave(payload: Any, report: Any) -> None:
    os._exit(3)


def spin(payload: Any, report: Any) -> None:
    report({"time_s": 0.25})
    while True:
        pass


def standstill(payload: Any, report: Any) -> None:
    while True:
        time.sleep(0.06)
        report({"time_s": 0.5})


def await_file(payload: str, report: Any) -> bool:
    while not os.path.exists(payload):
        time.sleep(0.005)
    return True


def steady(payload: Any, report: Any) -> int:
    for i in range(10):
        time.sleep(0.06)
        report({"time_s": 0.1 * i})
    return 7


def fail_plainly(payload: Any, report: Any) -> None:
    raise ZeroDivisionError("the very words")


def fail_on_input(payload: Any, report: Any) -> None:
    raise InputError("the user's fault")


def sleep(payload: Any, report: Any) -> None:
    with open(OUTBOX / "marker", "w") as file:
        file.write(f"{os.getpid()} {os.getcwd()}")
    time.sleep(60)


def simulate(payload: str, report: Any) -> dict[str, Any]:
    from cosim.ngspice.simulator import Simulator

    simulator = Simulator(on_time=lambda t: report({"time_s": t}))
    simulator.load(payload)
    simulator.command("op")
    return {name: simulator.vector(name) for name in simulator.vector_names()}


def unpicklable(payload: Any, report: Any) -> Any:
    return lambda: None


def modules(payload: Any, report: Any) -> list[str]:
    import sys

    return list(sys.modules)


def load(payload: tuple[str, Any], report: Any) -> None:
    from cosim.ngspice.simulator import Simulator

    text, lines = payload
    Simulator().load(text, lines)


def doubts(payload: Any, report: Any) -> Any:
    """Doubt, and answer all the same."""
    warn(Caution("doubt", f"number {payload['number']}", "count again"))
    return payload["number"]


def respond(payload: dict[str, Any], report: Any) -> Any:
    """Run `.ac` of a deck in text: what a source makes of a node at some frequencies [Hz]."""
    import numpy as np

    from cosim.ngspice.simulator import Simulator

    simulator = Simulator()
    simulator.load("\n".join([payload["text"], ".end"]) + "\n")
    simulator.command(f"alter @{payload['source']}[acmag] = 1")
    rows = []
    for hz in payload["hz"]:
        simulator.command(f"ac lin 1 {hz!r} {hz!r}")
        rows.append(complex(simulator.vector(payload["node"])[0]))
        simulator.command("destroy all")
    return np.array(rows)


def forgiving(payload: str, report: Any) -> str:
    """Say what cannot be had, as a verdict does, and go on."""
    from cosim.errors import CosimError

    try:
        return f"{float(simulate(payload, report)['a'][0]):g} V"
    except CosimError:
        return "not to be had"
