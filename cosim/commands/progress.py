"""Progress bars on a terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from cosim.commands.verbosity import bars, remark, verbose
from cosim.terminal import printable

COMPILING = "compiling, once, about a minute"
"""What is said where the first run of an installation would look like a hang; seconds of CPU on 2 GHz."""


def announce_compilation() -> None:
    """Say on standard error that code is compiled first, unless a bar will say so."""
    from mech.library_files import is_built

    if not is_built() and not bars():
        remark(f"{COMPILING}; `cosim warm` does it ahead")


@contextmanager
def progress(title: str) -> Iterator[Callable[[int, int, str], None] | None]:
    """Show a bar; yields a function of (done, total, name), or None where nothing is shown."""
    announce_compilation()
    if not bars():
        yield _tell(title) if verbose() else None
        return
    from rich.console import Console
    from rich.progress import Progress, TimeElapsedColumn

    from mech.library_files import is_built

    cold = not is_built()
    columns = (*Progress.get_default_columns(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(shown(f"{title}: {COMPILING}" if cold else title), total=None)

        def show(done: int, total: int, name: str) -> None:
            more = f": {COMPILING}" if cold and done == 0 else ""  # the first step is where code is compiled
            bar.update(task, completed=done, total=total, description=shown(f"{title}: {name}{more}"))

        yield show


def shown(text: str) -> str:
    """Return a scene's text escaped for rich, which would take some of it for markup."""
    from rich.markup import escape

    return escape(printable(text))


def _tell(title: str) -> Callable[[int, int, str], None]:
    """Return a function that prints each step on a line, where no bar is shown."""
    return lambda done, total, name: remark(f"{title}: {name} ({done} of {total})")
