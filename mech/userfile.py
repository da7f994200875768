"""A Python file of the user's own, loaded as a module without a trace in their folder."""

import importlib.util
import sys
from hashlib import sha256
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType

__all__ = ["load_file"]


class _Fresh(SourceFileLoader):
    """Compiles the file as it is now: no ``__pycache__`` is read or written.

    Python trusts a cached file by time and size, so that an edit within its clock's grain would not be seen.
    """

    def get_code(self, fullname: str) -> CodeType:
        return self.source_to_code(self.get_data(self.path), self.path)


def load_file(path: Path) -> ModuleType:
    """Run a Python file and return its module; what the file raises is passed on.

    The module is found under its name in `sys.modules`, where dataclasses and pickle look for it.
    """
    name = f"_user_{path.stem}_{sha256(str(path.resolve()).encode()).hexdigest()[:8]}"
    spec = importlib.util.spec_from_file_location(name, path, loader=_Fresh(name, str(path)))
    assert spec is not None  # a loader is given
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    kept, sys.dont_write_bytecode = sys.dont_write_bytecode, True  # for what the file imports from beside it
    try:
        _Fresh(name, str(path)).exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    finally:
        sys.dont_write_bytecode = kept
    return module
