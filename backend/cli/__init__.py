# SPDX-License-Identifier: GPL-3.0-or-later
"""The command ``physhdr``: train, evaluate, benchmark, export, render, video, prepare, inspect, …"""

import sys
from typing import Annotated, Any

from ...bridge.errors import PhysHDRError

__all__ = ["main"]


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit status. What a user can mend is one message, no traceback."""
    argv = sys.argv[1:] if argv is None else argv
    try:
        if argv[:1] == ["check"]:
            from .check import main as check  # before any import that could fail: finding out is its task

            return check(argv[1:])
        return _command(argv).run()
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    except ModuleNotFoundError as error:
        sys.stderr.write(f"error: {error}\n  Install what is missing; physhdr check says what that is.\n")
        return 1
    except OSError as error:  # a full disk, a file in the way of a folder: the message names the path
        sys.stderr.write(
            f"error: {error}\n  Check that path, its permissions, and that the disk has space.\n"
        )
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return 130


def _command(argv: list[str]) -> Any:
    """The command as its dataclass, filled from ``argv``."""
    import tyro

    from .serve import Serve

    if argv[:1] == ["serve"]:  # parsed without the others, which import torch: it must answer at once
        return tyro.cli(Serve, prog="physhdr serve", args=argv[1:])
    from .benchmark import Benchmark
    from .check import Check
    from .evaluate import Evaluate
    from .export import Export
    from .inspect import Inspect
    from .prepare import Prepare
    from .render import Render
    from .train import Train, preset_named
    from .video import Video
    from .warmup import Warmup

    # The preset decides the defaults of the other options, so it is read first.
    train = Train(config=preset_named(argv))
    commands = (
        Annotated[Train, tyro.conf.subcommand("train", default=train)]
        | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
        | Annotated[Export, tyro.conf.subcommand("export")]
        | Annotated[Render, tyro.conf.subcommand("render")]
        | Annotated[Video, tyro.conf.subcommand("video")]
        | Annotated[Benchmark, tyro.conf.subcommand("benchmark")]
        | Annotated[Prepare, tyro.conf.subcommand("prepare")]
        | Annotated[Inspect, tyro.conf.subcommand("inspect")]
        | Annotated[Warmup, tyro.conf.subcommand("warmup")]
        | Annotated[Serve, tyro.conf.subcommand("serve")]
        | Annotated[Check, tyro.conf.subcommand("check")]
    )
    return tyro.cli(commands, prog="physhdr", description=__doc__, args=argv)
