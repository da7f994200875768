"""Where numba keeps compiled code: a folder that belongs to exactly these sources.

Numba checks only the file of a cached function, not the functions it calls in other files. A folder named
after all sources that are compiled cannot hold stale code.
"""

import hashlib
import os
from pathlib import Path

_FOLDERS = ("mech", "cosim/loop")


def cache_folder() -> str:
    """Return the folder for `NUMBA_CACHE_DIR`; the user's own setting wins."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return chosen
    root = Path(__file__).resolve().parent.parent
    stamp = hashlib.sha256()
    for folder in _FOLDERS:
        for path in sorted((root / folder).rglob("*.py")):
            about = path.stat()
            stamp.update(f"{path.relative_to(root)} {about.st_mtime_ns} {about.st_size}\n".encode())
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return str(base / "cosim" / f"numba-{stamp.hexdigest()[:16]}")
