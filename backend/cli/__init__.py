# SPDX-License-Identifier: GPL-3.0-or-later
"""The command ``physhdr``: train, evaluate, benchmark, export, render, video, prepare, inspect, …"""

import errno
import sys
from pathlib import Path
from typing import Annotated, Any

from ...bridge.errors import PhysHDRError
from ...bridge.regular import require_text
from ...bridge.run_folder import CHECKPOINT_FILE
from ..memory import address_limit, gigabytes, is_out_of_memory, refuse_too_few_addresses
from ..project import version

__all__ = ["main"]


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit status. What a user can mend is one message, no traceback."""
    argv = sys.argv[1:] if argv is None else argv
    try:
        refuse_too_few_addresses()  # before any library is loaded, which would end the process in its own way
        for word in argv:
            require_text(word)
        if argv[:1] == ["check"]:
            from .check import main as check  # before any import that could fail: finding out is its task

            return check(argv[1:])
        if argv == ["--version"]:
            sys.stdout.write(f"physhdr {version()}\n")
            return 0
        return _command(argv).run()
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return 130
    except Exception as error:
        told = _in_words(error, argv)
        if told is None:
            raise
        sys.stderr.write(f"error: {told}\n")
        return 1


def _in_words(error: Exception, argv: list[str]) -> str | None:
    """What to tell of an error that a user can mend; None: it is a fault of ours."""
    run = _run_in(argv)
    if is_out_of_memory(error):
        limit = address_limit()
        allowed = "" if limit is None else f": ulimit -v leaves {gigabytes(limit)} of addresses"
        return (
            f"there is not enough memory{allowed}\n"
            f"  {'Close other programs' if limit is None else 'Lift the limit: ulimit -v unlimited'}"
            f"{_SMALLER if argv[:1] == ['train'] else ''}.{_resumption(run)}"
        )
    if isinstance(error, PhysHDRError):
        return str(error)
    if isinstance(error, ModuleNotFoundError):
        return f"{error}\n  Install what is missing; physhdr check says what that is."
    if isinstance(error, OSError):
        return f"{_what_failed(error)}\n  {_what_helps(error, run)}"
    return None


#: What needs less memory in a training, after another remedy.
_SMALLER = ", or train on smaller pictures (--downscale 2) or with fewer Gaussians (--densify.budget 20000)"


def _what_failed(error: OSError) -> str:
    """The file, where the error names one, and what the system says of it."""
    said = error.strerror or str(error) or type(error).__name__
    names = " → ".join(str(name) for name in (error.filename, error.filename2) if name is not None)
    return f"{names}: {said}" if names else said


def _what_helps(error: OSError, run: Path | None) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        where = "that disk" if error.filename is not None else f"the disk of {run or 'the output'}"
        return f"Free some space on {where}, then call again.{_resumption(run)}"
    if error.filename is not None:
        return "Check that path, its permissions, and that the disk has space."
    where = f" of {run}" if run else ""
    return f"Check the permissions and the free space{where}, then call again."


def _run_in(argv: list[str]) -> Path | None:
    """The folder of the run that ``train`` was to write or to go on with, where the command names one."""
    if argv[:1] != ["train"]:
        return None
    for option, value in zip(argv, [*argv[1:], ""], strict=True):
        name, _, given = option.partition("=")
        if name in ("--out", "--resume"):
            return Path(given or value)
    return None


def _resumption(run: Path | None) -> str:
    """How to go on with a run of which something was saved, as a further sentence."""
    if run is None or not (run / CHECKPOINT_FILE).is_file():
        return ""
    return f" Go on with what was saved: physhdr train --resume {run}"


def _command(argv: list[str]) -> Any:
    """The command as its dataclass, filled from ``argv``."""
    import tyro

    from .serve import Serve

    if argv[:1] == ["serve"]:  # parsed without the others, which import torch: it must answer at once
        return tyro.cli(Serve, prog="physhdr serve", args=argv[1:])
    from .synthesise import Synthesise, parsed

    if argv[:1] == ["synthesise"]:  # what comes after its two dashes is another program's
        return parsed(argv[1:])
    from .convert import Convert

    if argv[:1] == ["convert"]:  # without the others, which take seconds to import torch
        return tyro.cli(Convert, prog="physhdr convert", args=argv[1:])
    from .benchmark import Benchmark
    from .calibrate import Calibrate
    from .check import Check
    from .evaluate import Evaluate
    from .export import Export
    from .inspect import Inspect
    from .layout import LayOut
    from .panorama import Panorama
    from .prepare import Prepare
    from .render import Render
    from .train import Train, options_in, preset_named
    from .triangulate import Triangulate
    from .video import Video
    from .warmup import Warmup

    # The preset decides the defaults of the other options, so it is read first.
    train = Train(config=preset_named(argv), typed=options_in(argv))
    commands = (
        Annotated[Train, tyro.conf.subcommand("train", default=train)]
        | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
        | Annotated[Export, tyro.conf.subcommand("export")]
        | Annotated[Convert, tyro.conf.subcommand("convert")]
        | Annotated[Calibrate, tyro.conf.subcommand("calibrate")]
        | Annotated[Render, tyro.conf.subcommand("render")]
        | Annotated[Video, tyro.conf.subcommand("video")]
        | Annotated[Panorama, tyro.conf.subcommand("panorama")]
        | Annotated[Benchmark, tyro.conf.subcommand("benchmark")]
        | Annotated[Prepare, tyro.conf.subcommand("prepare")]
        | Annotated[Triangulate, tyro.conf.subcommand("triangulate")]
        | Annotated[LayOut, tyro.conf.subcommand("layout")]
        | Annotated[Synthesise, tyro.conf.subcommand("synthesise")]
        | Annotated[Inspect, tyro.conf.subcommand("inspect")]
        | Annotated[Warmup, tyro.conf.subcommand("warmup")]
        | Annotated[Serve, tyro.conf.subcommand("serve")]
        | Annotated[Check, tyro.conf.subcommand("check")]
    )
    return tyro.cli(commands, prog="physhdr", description=__doc__, args=argv)
