# SPDX-License-Identifier: GPL-3.0-or-later
"""The command ``physhdr``: train, evaluate, export, render, warmup."""

import sys
from typing import Annotated

import tyro

from ...bridge.errors import PhysHDRError
from .evaluate import Evaluate
from .export import Export
from .render import Render
from .train import Train, preset_named
from .warmup import Warmup

__all__ = ["main"]


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit status. What a user can mend is one message, no traceback."""
    argv = sys.argv[1:] if argv is None else argv
    try:
        # The preset decides the defaults of the other options, so it is read first.
        train = Train(config=preset_named(argv))
        commands = (
            Annotated[Train, tyro.conf.subcommand("train", default=train)]
            | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
            | Annotated[Export, tyro.conf.subcommand("export")]
            | Annotated[Render, tyro.conf.subcommand("render")]
            | Annotated[Warmup, tyro.conf.subcommand("warmup")]
        )
        command = tyro.cli(commands, prog="physhdr", description=__doc__, args=argv)
        return command.run()
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return 130


if __name__ == "__main__":
    sys.exit(main())
