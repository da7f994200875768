"""Extracted models on disk, by the content of the deck they came from.

The name of a file is the hash of all that the model depends on, so nothing is ever out of date; files are
written atomically, and one that cannot be read is ignored.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.circuits.linear_circuit import LinearCircuit

__all__ = ["Asked", "folder", "load", "load_arrays", "store", "store_arrays"]

#: To be raised with every change of the algorithm that changes a model.
VERSION = 9


@dataclass(frozen=True)
class Asked:
    """All that a model depends on.

    Attributes
    ----------
    text
        The flat deck.
    model, band_hz, tolerance
        As `extract` takes them.
    """

    text: str
    model: str
    band_hz: float
    tolerance: float

    @property
    def digest(self) -> str:
        """SHA-256 of everything."""
        rest = f"{VERSION} {self.model} {self.band_hz!r} {self.tolerance!r}\n"
        return hashlib.sha256((rest + self.text).encode()).hexdigest()


def folder() -> Path:
    """Return the cache's folder, which need not exist."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "cosim" / "circuits"


def load(asked: Asked) -> tuple[LinearCircuit | None, str]:
    """Return the model, if it is cached, and the reason why a file was not usable."""
    path = folder() / f"{asked.digest}.npz"
    try:
        raw = path.read_bytes()
    except OSError:
        return None, ""
    try:
        with np.load(io.BytesIO(raw), allow_pickle=False) as stored:
            about = json.loads(str(stored["about"]))
            if about["digest"] != asked.digest:
                raise ValueError("it belongs to another board")
            arrays = {name: stored[name] for name in stored.files if name != "about"}
        return LinearCircuit(about["joints"], about["model"], **arrays, certificate=about["certificate"]), ""
    except Exception as error:  # whatever is wrong with it, the board itself is at hand
        return None, f"ignored the damaged cache file {path}: {error}"


def load_arrays(name: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]] | None:
    """Return what `store_arrays` has written; None where it is missing or not readable."""
    try:
        with np.load(io.BytesIO((folder() / f"{name}.npz").read_bytes()), allow_pickle=False) as stored:
            arrays = {key: stored[key] for key in stored.files if key != "about"}
            return json.loads(str(stored["about"])), arrays
    except Exception:  # whatever is wrong with it, the board itself is at hand
        return None


def store(asked: Asked, circuit: LinearCircuit) -> None:
    """Keep a model; where nothing can be written, nothing is kept."""
    about = {
        "digest": asked.digest,
        "joints": circuit.joints,
        "model": circuit.model,
        "certificate": circuit.certificate,
    }
    store_arrays(asked.digest, about, circuit.arrays())


def store_arrays(name: str, about: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays and their description under a digest; a folder that cannot be written is no error."""
    packed = io.BytesIO()
    np.savez(packed, about=np.array(json.dumps(about)), **arrays)  # type: ignore[arg-type]
    target = folder() / f"{name}.npz"
    with contextlib.suppress(OSError):
        folder().mkdir(parents=True, exist_ok=True)
        handle, part = tempfile.mkstemp(dir=folder(), suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(packed.getbuffer())
            os.replace(part, target)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(part)
            raise
