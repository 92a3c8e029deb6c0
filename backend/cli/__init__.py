# SPDX-License-Identifier: GPL-3.0-or-later
"""The command ``physhdr``: train, evaluate, benchmark, export, render, prepare, inspect, …"""

import errno
import io
import json
import os
import select
import stat
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import reduce
from importlib import import_module
from operator import or_
from typing import Annotated, Any

from ...bridge.errors import FileMissingError
from ...bridge.regular import require_text
from ..memory import refuse_too_few_addresses
from ..project import requirements, version
from ..tables import Table
from .words import Words, words_of

__all__ = ["main"]

#: What an interrupted command ends with, and one whose reader has gone, as shells have it.
INTERRUPTED = 130
UNREAD = 141
#: Module and dataclass of each command. Only the one that is called is imported: others need seconds.
COMMANDS = {
    "train": "train.Train",
    "evaluate": "evaluate.Evaluate",
    "export": "export.Export",
    "calibrate": "calibrate.Calibrate",
    "render": "render.Render",
    "prepare": "prepare.Prepare",
    "synthesise": "synthesise.Synthesise",
    "inspect": "inspect.Inspect",
    "serve": "serve.Serve",
    "check": "check.Check",
}


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit status. What a user can fix is one message, no traceback.

    With ``--json`` that message is an object, the last line of stdout, whatever the command
    (docs/protocol.md).
    """
    argv = sys.argv[1:] if argv is None else argv
    _prepare_streams()
    try:
        refuse_too_few_addresses()  # before any library is loaded, which would end the process in its own way
        for word in argv:
            require_text(word)
        _require_working_folder()  # without one, libraries end the process in their own way, too
        if argv[:1] == ["check"]:
            from .check import main as check  # before any import that could fail: finding out is its task

            return check(argv[1:])
        status = _answered(argv)
        sys.stdout.flush()  # at the end of the process it would be too late to say what failed
        return status
    except KeyboardInterrupt:
        if not _tells_programs(argv, Words("cancelled", "interrupted", "")):
            _complain("interrupted")
        return INTERRUPTED
    except Exception as error:
        if isinstance(error, OSError) and _nobody_reads(error):  # physhdr train --help | head
            return UNREAD
        told = words_of(error, argv)
        if told is None:
            raise
        if not _tells_programs(argv, told):
            _complain(f"error: {told}")
        return 1


def _require_working_folder() -> None:
    try:
        os.getcwd()
    except OSError as error:
        raise FileMissingError(
            f"the folder that this command is called in is not there any more: {error.strerror}",
            "Go to another one (cd), and call again.",
        ) from error


def _answered(argv: list[str]) -> int:
    if argv[:1] == ["requirements"]:  # for whoever makes the environment (launch.py)
        sys.stdout.write("\n".join(requirements(*argv[1:2])) + "\n")
        return 0
    if argv == ["--version"]:
        sys.stdout.write(f"physhdr {version()}\n")
        return 0
    try:
        return _command(argv).run()
    except SystemExit:  # the parser's, after --help, too
        sys.stdout.flush()
        raise


def _prepare_streams() -> None:
    """Open the standard streams that this process was started without, and escape what stdout cannot encode.

    A shell's ``>&-`` closes stdout, and a program without a window on Windows has none: what is said there
    goes nowhere, and no file of ours gets its descriptor. No command fails at a user's file name, or at an
    arrow of ours: on Windows a pipe or a file takes a code page, which lacks most letters.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            stream = open(os.devnull, mode, encoding="utf-8")  # noqa: SIM115
            os.set_inheritable(stream.fileno(), True)  # processes that are started from here have it, too
            setattr(sys, name, stream)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def _complain(text: str) -> None:
    """On stderr, if that can be written to: the exit status says that something failed in any case."""
    with suppress(OSError):
        sys.stderr.write(f"{text}\n")


def _nobody_reads(error: OSError) -> bool:
    """Whether it is stdout that is broken; what is still to be written then is dropped."""
    try:
        descriptor = sys.stdout.fileno()
    except (AttributeError, OSError, ValueError):  # something in place of stdout, or it is closed
        return False
    if not _is_of_stdout(error, descriptor):
        return False
    os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)
    return True


def _is_of_stdout(error: OSError, descriptor: int) -> bool:
    """Whether the error says that nobody reads a pipe, and stdout, of this descriptor, is that pipe."""
    if sys.platform == "win32":  # has no poll, and calls it an invalid argument (bugs.python.org/issue35754)
        if error.errno not in (errno.EINVAL, errno.EPIPE) or error.filename is not None:
            return False
        try:
            if stat.S_ISFIFO(os.fstat(descriptor).st_mode):
                os.write(descriptor, b"\n")  # the only way to ask there
        except OSError:
            return True
        return False
    if not isinstance(error, BrokenPipeError):
        return False
    asked = select.poll()
    asked.register(descriptor, 0)
    return bool(asked.poll(0))  # errors are told unasked


def _tells_programs(argv: Sequence[str], told: Words) -> bool:
    """Whether the command answers a program, which then has been told."""
    ours = argv[: argv.index("--")] if "--" in argv else argv  # what follows is of another program
    if "--json" not in ours:
        return False
    try:
        sys.stdout.write(json.dumps({"error": asdict(told)}) + "\n")
        sys.stdout.flush()
    except OSError:  # nobody reads, or it is a file on the disk that is full
        return False
    return True


def _command(argv: list[str]) -> Any:
    """The command as its dataclass, filled from ``argv``."""
    import tyro

    name = argv[0] if argv else ""
    if name == "synthesise":  # what comes after its two dashes is another program's
        from .synthesise import parsed

        return parsed(argv[1:])
    if name in COMMANDS:
        return tyro.cli(_options_of(name), prog=f"physhdr {name}", args=argv[1:])
    added: Table[Any] = Table("commands", {})
    commands = {name: _options_of(name) for name in COMMANDS} | dict(added)
    each = (Annotated[options, tyro.conf.subcommand(name)] for name, options in commands.items())
    return tyro.cli(reduce(or_, each), prog="physhdr", description=__doc__, args=argv)


def _options_of(name: str) -> Any:
    """The dataclass of a command's options."""
    module, _, options = COMMANDS[name].partition(".")
    return getattr(import_module(f"{__name__}.{module}"), options)
