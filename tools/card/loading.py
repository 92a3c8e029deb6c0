# SPDX-License-Identifier: GPL-3.0-or-later
"""Get the package ``physhdr`` from this checkout on a machine where it is not installed.

A machine with a card may have torch and Warp and little else. What reads files (OpenEXR, PNG, PLY,
safetensors) is then replaced by names that refuse to be used: nothing here reads a file. Numba is needed by
the CPU's kernels only; without it the plain-torch reference stands in for them.
"""

import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import sys
import types
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]

#: Packages that the trainer imports and this check can do without.
DISPENSABLE = ("OpenEXR", "PIL", "plyfile", "safetensors", "scipy", "numba", "llvmlite")


class Absent(types.ModuleType):
    """Something from a package that is not here: it may be imported, named and subclassed, never used."""

    loading = True  # decorators are called while modules are loaded

    def __init__(self, name: str, *_: Any) -> None:
        super().__init__(name)
        vars(self)["__path__"] = []  # a package: what is below it may be imported, too

    def __getattr__(self, name: str) -> "Absent":
        if name.startswith("__"):
            raise AttributeError(name)
        return Absent(f"{self.__name__}.{name}")

    def __call__(self, *_: Any, **__: Any) -> "Absent":
        if not Absent.loading:
            package = self.__name__.partition(".")[0]
            raise ModuleNotFoundError(f"this needs the package {package}, which is not installed")
        return self


class _AbsentFinder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def __init__(self, packages: Sequence[str]) -> None:
        self.packages = packages

    def find_spec(
        self, fullname: str, path: Any, target: Any = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname.partition(".")[0] in self.packages:
            return importlib.machinery.ModuleSpec(fullname, self, is_package=True)
        return None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> types.ModuleType:
        return Absent(spec.name)

    def exec_module(self, module: types.ModuleType) -> None:
        pass


def find_physhdr() -> None:
    """Make this checkout the package ``physhdr``. Before torch is imported: it says how threads wait."""
    spec = importlib.util.spec_from_file_location(
        "physhdr", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)]
    )
    assert spec is not None and spec.loader is not None
    package = importlib.util.module_from_spec(spec)
    sys.modules["physhdr"] = package
    spec.loader.exec_module(package)
    importlib.import_module("physhdr.backend")


def load_physhdr(without: Sequence[str] = ()) -> list[str]:
    """After ``find_physhdr``: import the trainer; returns the dispensable packages that are not here.

    ``without``: treat these as not here, too (tests).
    """
    absent = [name for name in DISPENSABLE if name in without or not _imports(name)]
    if absent:
        sys.meta_path.insert(0, _AbsentFinder(absent))
    Absent.loading = True
    importlib.import_module("physhdr.backend.train.trainer")
    importlib.import_module("physhdr.backend.rasterize.cpu")
    Absent.loading = False
    return absent


def _imports(name: str) -> bool:
    """Whether a package is there and works (Numba refuses a NumPy that is too new for it)."""
    try:
        importlib.import_module(name)
    except ImportError:
        for module in [m for m in sys.modules if m.partition(".")[0] == name]:
            del sys.modules[module]
        return False
    return True
