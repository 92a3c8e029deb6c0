# SPDX-License-Identifier: GPL-3.0-or-later
"""The user's hands in Blender: operators and panels. bpy and numpy; torch never.

``panels`` show, ``operators`` do; what they show and do is in ``dataset`` (of the open scene), ``light`` and
``rendering``, ``viewport`` (the 3D view), ``capture`` (where a model stands, its cameras), ``model`` (a point
cloud with nodes), ``session`` (the trainer and child processes) and ``layouts`` (of data sets' folders). Each
imports from those below it, never from above (``tests/backend/test_rooms.py``).

A module that has classes to register is named in ``_MODULES``, in the order in which they depend on
each other, and has a ``register`` and an ``unregister`` of its own.
"""

import tomllib
from contextlib import ExitStack
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from ..bridge.errors import FileMissingError

_MODULES = (
    "outside",
    "settings",
    "dataset.dataset_settings",
    "dataset.dataset_presets",
    "blend_paths",
    "capture.originals",
    "model.pose",
    "operators.model_files",
    "operators.backend",
    "operators.dataset",
    "operators.outside",
    "operators.originals",
    "dataset.rig_preview",
    "operators.photos",
    "operators.training",
    "operators.capture",
    "operators.cleaning",
    "operators.render",
    "operators.photographed_light",
    "light.probes",
    "light.probe_checks",
    "operators.lighting",
    "operators.results",
    "operators.bake",
    "operators.native",
    "operators.cg",
    "viewport",
    "plot",
    "runtime",
    "panels.backend",
    "panels.training",
    "panels.status",
    "panels.capture",
    "panels.model",
    "panels.lighting",
    "panels.cleaning",
    "panels.scale",
    "panels.render",
    "panels.status_bar",
    "panels.menus",
)


def _modules() -> list[ModuleType]:
    return [import_module(f"{__name__}.{name}") for name in _MODULES]


def require_bundled() -> None:
    """Raise ``FileMissingError`` where the packages of the manifest's wheels cannot be imported.

    So it is with the repository's own zip, which Blender installs as readily as a release: wheels are fetched
    when the release is built.
    """
    root = Path(__file__).resolve().parents[1]
    manifest = tomllib.loads((root / "blender_manifest.toml").read_text(encoding="utf-8"))
    packages = [Path(wheel).name.partition("-")[0] for wheel in manifest.get("wheels", ())]
    missing = ", ".join(name for name in packages if find_spec(name) is None)
    if not missing:
        return
    is_source = not (root / "wheels").is_dir()
    what = "This is PhysHDR's source code, without" if is_source else "Blender has not set up"
    raise FileMissingError(
        f"{what} the packages that a release bundles: {missing}",
        f"Remove it, and install physhdr-{manifest['version']}.zip from the project's releases page "
        "(Get Extensions, Install from Disk).",
    )


def register() -> None:
    """Register all; where one module cannot be, none is left registered, so that it can be tried again."""
    require_bundled()
    with ExitStack() as undo:
        for module in _modules():
            module.register()
            undo.callback(module.unregister)
        undo.pop_all()


def unregister() -> None:
    for module in reversed(_modules()):
        module.unregister()
