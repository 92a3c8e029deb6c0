# SPDX-License-Identifier: GPL-3.0-or-later
"""Start the backend from wherever it lies: ``python …/backend/launch.py serve|check|requirements|…``.

Blender's extension brings the trainer's code, but not as an installed package, in a folder of any name. This
file makes that folder the package ``physhdr`` and calls the command line. Standard library only, and old
syntax: whatever Python a user has must come as far as a clear message.

    launch.py requirements [EXTRA]    what pip has to install, one requirement a line
    launch.py check [--json]          whether everything is there and works
    launch.py module MODULE …         main of a module of ours, as one of our processes starts it (child.py)
    launch.py COMMAND …               as the command physhdr
"""

import importlib
import importlib.util
import json
import os
import sys

OLDEST = (3, 11)
#: The word that is not the command line's.
MODULE = "module"
HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(HERE)


def _bootstrap():
    """Make ``ROOT`` the package ``physhdr``, and let nothing be written into it.

    At the module's level, for the processes that compile kernels: they import this file by its path.
    """
    # Bytecode is not written unless the caller says where: a prefix would also hide what pip compiled of
    # torch (seconds), and ours is compiled in a moment. In the environment, for processes that are started
    # from here. A module of ours in a process of its own has that from whoever started it; nobody who has
    # installed the package has set it.
    if sys.argv[1:2] != [MODULE] and not sys.pycache_prefix:
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        sys.dont_write_bytecode = True
    # Python puts a script's own folder first: there, "export" or "train" would be ours for everybody.
    sys.path[:] = [path for path in sys.path if os.path.abspath(path or ".") != HERE]
    spec = importlib.util.spec_from_file_location(
        "physhdr", os.path.join(ROOT, "__init__.py"), submodule_search_locations=[ROOT]
    )
    assert spec is not None and spec.loader is not None
    package = importlib.util.module_from_spec(spec)
    sys.modules["physhdr"] = package
    spec.loader.exec_module(package)


def _refuse_python(arguments):
    found, oldest = (".".join(map(str, numbers[:2])) for numbers in (sys.version_info, OLDEST))
    message = f"this is Python {found}; the backend needs {oldest} or newer"
    hint = f"Choose another Python ({sys.executable} is this one)."
    if "--json" in arguments:
        error = {"code": "python_too_old", "message": message, "hint": hint}
        sys.stdout.write(json.dumps({"error": error}) + "\n")
    sys.stderr.write(f"error: {message}\n  {hint}\n")
    return 1


def _main(arguments):
    if sys.version_info < OLDEST:
        return _refuse_python(arguments)
    if arguments[:1] == [MODULE]:
        return importlib.import_module(arguments[1]).main(arguments[2:])
    from physhdr.backend.cli import main  # pyright: ignore[reportMissingImports]

    return main(arguments)


if sys.version_info >= OLDEST:
    _bootstrap()

if __name__ == "__main__":
    sys.exit(_main(sys.argv[1:]))
