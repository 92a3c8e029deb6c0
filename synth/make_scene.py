# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes a synthetic HDR data set with Cycles: of a built-in scene, or of any scene of yours.

    blender -b -P synth/make_scene.py -- --out data/demo
    python synth/make_scene.py -- --out data/demo          (with the bpy wheel)
    blender -b -P synth/make_scene.py -- --scene all --out data/synthetic
    blender -b my.blend -P synth/make_scene.py -- --from-file current --out data/mine
    python synth/make_scene.py -- --from-file my.blend --out data/mine

Interrupted and started again with the same options it renders only what is missing; started several times
at once on one machine, the processes share the work. Over several machines ``physhdr synthesise`` spreads it.
"""

import errno
import importlib.util
import signal
import sys
import traceback
from pathlib import Path

#: What the system says of a full disk, and of a user's share of it that is used up.
FULL = (errno.ENOSPC, errno.EDQUOT)


def _load_package() -> None:
    """Make the repository's root, wherever it lies and whatever it is called, the package ``physhdr``."""
    root = Path(__file__).resolve().parent.parent
    spec = importlib.util.spec_from_file_location(
        "physhdr", root / "__init__.py", submodule_search_locations=[str(root)]
    )
    assert spec and spec.loader
    sys.modules["physhdr"] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    # For a Blender in which the extension is not installed: what it bundles (filelock), pure Python, which
    # runs zipped. `make extension` fetches it by its hash; without it nothing is locked, which is reported.
    sys.path += [str(wheel) for wheel in sorted((root / "wheels").glob("*.whl"))]


if not globals().get("__package__"):  # run as a script: make it a module of the package (PEP 366)
    _load_package()
    __package__ = "physhdr.synth"


def main(arguments: list[str]) -> int:
    """Exit code: 0 done, 1 an error the message explains, 2 wrong usage, 130 interrupted."""
    from ..bridge.errors import PhysHDRError
    from .arguments import options, parser
    from .parse import parse_scenes
    from .progress import JsonReport, Report
    from .several import make_all
    from .workers import WorkerReport, helping

    args = parser().parse_args(arguments)
    report: Report
    if args.worker_of:
        report, others = WorkerReport(args.worker_of), 0
    else:
        report, others = JsonReport() if args.progress_json else Report(), args.workers - 1
    try:
        wanted, scenes = options(args), parse_scenes(args.scene)
        with helping(others, arguments, args.from_file):
            report.end(make_all(Path(args.out), scenes, wanted, report))
    except PhysHDRError as error:
        report.fail(error.code, error.message, error.hint)
        return 1
    except OSError as error:
        hint = "make room, and give the same command again" if error.errno in FULL else ""
        report.fail("file", f"{error.strerror or error}: '{error.filename or args.out}'", hint)
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("interrupted: the same command resumes where it stopped\n")
        return 130
    except Exception as error:  # noqa: BLE001 (Blender would end with status 0, as if all were well)
        traceback.print_exc()
        report.fail(
            "internal", f"{type(error).__name__}: {error}", "this is a fault of the program: report it"
        )
        return 1
    return 0


def _run(arguments: list[str]) -> int:
    """``main`` where CTRL-C raises KeyboardInterrupt; Blender would take it for itself."""
    from .interrupts import signals

    for each in signals():
        signal.signal(each, signal.default_int_handler)
    return main(arguments)


if __name__ == "__main__":
    # Blender's own arguments end at '--'; so do ours where the wheel's Python runs the script.
    after = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    sys.exit(_run(after))
