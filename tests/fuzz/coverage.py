"""``python -m tests.fuzz.coverage -runs=20000``: the netlist loader under a fuzzer that follows its branches.

Needs atheris (the extra ``fuzz``). Options are libFuzzer's; without a corpus folder the shipped netlists are
the corpus. A crash is written to the working folder and ends with exit code 77.
"""

import shutil
import sys
import tempfile
import warnings
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["cosim.ngspice", "cosim.errors"]):
    from cosim.assets import netlists_folder
    from cosim.errors import CosimError
    from cosim.ngspice.deck import load_deck

LEVELS = ("ideal", "gbw", "full")


def main() -> None:
    """Fuzz until libFuzzer's limits are reached; it ends the process itself."""
    folder = Path(tempfile.mkdtemp(prefix="cosim-fuzz-"))
    netlists = folder / "netlists"
    shutil.copytree(netlists_folder(), netlists)
    corpus = folder / "corpus"
    corpus.mkdir()
    files = [netlists / "board2.cir", *sorted((netlists / "blocks").glob("*.cir"))]
    for number, path in enumerate(files):
        (corpus / path.name).write_bytes(bytes([number]) + path.read_bytes())
    originals = {path: path.read_bytes() for path in files}
    warnings.simplefilter("error")

    def one(data: bytes) -> None:
        """Take the first byte as the file and the level, the rest as its content."""
        if not data:
            return
        path, level = files[data[0] % len(files)], LEVELS[data[0] % 3]
        path.write_bytes(data[1:])
        try:
            load_deck(netlists / "board2.cir", levels={"opamp": level, "vca": level}, root=folder)
        except CosimError:
            pass
        finally:
            path.write_bytes(originals[path])

    given = sys.argv if any(not word.startswith("-") for word in sys.argv[1:]) else [*sys.argv, str(corpus)]
    atheris.Setup([given[0], "-max_len=20000", "-len_control=0", "-timeout=10", *given[1:]], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
