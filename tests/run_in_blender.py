# SPDX-License-Identifier: GPL-3.0-or-later
"""Run pytest inside Blender: ``.venvs/run-blender tests/run_in_blender.py -- tests/addon …``.

Works with the bpy wheel and in ``blender -b -P``.
"""

import sys
from pathlib import Path

import pytest

arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
# A blender binary does not have the package installed; the wheel's environment does.
try:
    import physhdr  # noqa: F401
except ImportError:
    import importlib.util

    root = Path(__file__).resolve().parent.parent
    spec = importlib.util.spec_from_file_location(
        "physhdr", root / "__init__.py", submodule_search_locations=[str(root)]
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules["physhdr"] = module
    spec.loader.exec_module(module)

sys.exit(pytest.main(arguments or ["tests/bridge", "tests/synth", "tests/addon"]))
