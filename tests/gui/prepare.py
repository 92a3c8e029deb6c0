# SPDX-License-Identifier: GPL-3.0-or-later
"""What all GUI tests begin with: the extension installed and its backend checked, once. In ``blender -b``.

Leaves ``OUT/check.json`` with how long the check took. tools/gui_test.py runs it before the tests, where the
extension, its Python or Blender are not those of the time before.
"""

import importlib
import json
import os
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
from driver import EXTENSION, arguments

#: Numba knows a source file by its path and time: an extension that is installed again has the same.
SOURCE_TIME = 1_700_000_000


def main() -> None:
    options = arguments()
    bpy.ops.extensions.package_install_files(
        filepath=str(options.zip), repo="user_default", enable_on_install=True
    )
    root = Path(importlib.import_module(EXTENSION).__file__).parent
    for source in root.rglob("*.py"):
        os.utime(source, (SOURCE_TIME, SOURCE_TIME))
    session = importlib.import_module(f"{EXTENSION}.addon.runtime").session()
    was_warm = any((session.home / "cache").iterdir())
    begun = time.perf_counter()
    bpy.ops.physhdr.backend_use(filepath=str(options.python))
    seconds = time.perf_counter() - begun
    backend = session.state.backend
    assert backend.ready and backend.missing == (), backend
    told = {"seconds": round(seconds, 1), "kernels were compiled": was_warm, "load": os.getloadavg()[0]}
    (options.out / "check.json").write_text(json.dumps(told))


main()
