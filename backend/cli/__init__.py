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
from .error_report import ErrorReport, describe_error

__all__ = ["main"]

#: Exit statuses, as in shells, of an interrupted command and of one whose output nobody reads any more.
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
    """Run one command; returns the exit status. Errors that a user can fix print one message, no traceback.

    With ``--json``, every command writes that message as an object, the last line of stdout
    (docs/protocol.md).
    """
    argv = sys.argv[1:] if argv is None else argv
    _prepare_streams()
    try:
        refuse_too_few_addresses()  # before loading libraries, which would crash
        for word in argv:
            require_text(word)
        _require_working_folder()  # without one, libraries crash, too
        if argv[:1] == ["check"]:
            from .check import main as check  # before any import that could fail, because it reports those

            return check(argv[1:])
        status = _run(argv)
        sys.stdout.flush()  # at exit it would be too late to report a failure
        return status
    except KeyboardInterrupt:
        if not _written_as_json(argv, ErrorReport("cancelled", "interrupted", "")):
            _complain("interrupted")
        return INTERRUPTED
    except Exception as error:
        if isinstance(error, OSError) and _nobody_reads(error):  # physhdr train --help | head
            return UNREAD
        report = describe_error(error, argv)
        if report is None:
            raise
        if not _written_as_json(argv, report):
            _complain(f"error: {report}")
        return 1


def _require_working_folder() -> None:
    try:
        os.getcwd()
    except OSError as error:
        raise FileMissingError(
            f"the working folder no longer exists: {error.strerror}",
            "Change to another one (cd) and try again.",
        ) from error


def _run(argv: list[str]) -> int:
    if argv[:1] == ["requirements"]:  # for launch.py, which makes the environment
        sys.stdout.write("\n".join(requirements(*argv[1:2])) + "\n")
        return 0
    if argv == ["--version"]:
        sys.stdout.write(f"physhdr {version()}\n")
        return 0
    try:
        return _command(argv).run()
    except SystemExit:  # from the parser, also after --help
        sys.stdout.flush()
        raise


def _prepare_streams() -> None:
    """Open missing standard streams, and escape what stdout cannot encode.

    A shell's ``>&-`` closes stdout, and a Windows program without a console has none: output is discarded,
    and no file of ours gets its descriptor. On Windows, pipes and files use a code page that lacks most
    letters: escaping keeps commands from failing at a user's file name or our own arrows.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            stream = open(os.devnull, mode, encoding="utf-8")  # noqa: SIM115
            os.set_inheritable(stream.fileno(), True)  # child processes have it, too
            setattr(sys, name, stream)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def _complain(text: str) -> None:
    """Write to stderr if possible: the exit status reports the failure in any case."""
    with suppress(OSError):
        sys.stderr.write(f"{text}\n")


def _nobody_reads(error: OSError) -> bool:
    """Whether stdout is the broken pipe; if so, the remaining output is discarded."""
    try:
        descriptor = sys.stdout.fileno()
    except (AttributeError, OSError, ValueError):  # stdout was replaced or closed
        return False
    if not _is_of_stdout(error, descriptor):
        return False
    os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)
    return True


def _is_of_stdout(error: OSError, descriptor: int) -> bool:
    """Whether the error is a broken pipe, and stdout, with this descriptor, is that pipe."""
    if sys.platform == "win32":  # no poll; reports an invalid argument (bugs.python.org/issue35754)
        if error.errno not in (errno.EINVAL, errno.EPIPE) or error.filename is not None:
            return False
        try:
            if stat.S_ISFIFO(os.fstat(descriptor).st_mode):
                os.write(descriptor, b"\n")  # the only way to find out there
        except OSError:
            return True
        return False
    if not isinstance(error, BrokenPipeError):
        return False
    poll = select.poll()
    poll.register(descriptor, 0)
    return bool(poll.poll(0))  # errors are always reported


def _written_as_json(argv: Sequence[str], report: ErrorReport) -> bool:
    """Write the report as JSON if the command has ``--json``; returns whether it was written."""
    ours = argv[: argv.index("--")] if "--" in argv else argv  # the rest is for another program
    if "--json" not in ours:
        return False
    try:
        sys.stdout.write(json.dumps({"error": asdict(report)}) + "\n")
        sys.stdout.flush()
    except OSError:  # a broken pipe, or a file on the full disk
        return False
    return True


def _command(argv: list[str]) -> Any:
    """The command as its dataclass, filled from ``argv``."""
    import tyro

    name = argv[0] if argv else ""
    if name == "synthesise":  # what follows -- is for another program
        from .synthesise import parsed

        return parsed(argv[1:])
    if name in COMMANDS:
        return tyro.cli(_options_of(name), prog=f"physhdr {name}", args=argv[1:])
    added: Table[Any] = Table("commands", {})
    commands = {name: _options_of(name) for name in COMMANDS} | dict(added)
    each = (Annotated[options, tyro.conf.subcommand(name)] for name, options in commands.items())
    options: Any = reduce(or_, each)
    return tyro.cli(options, prog="physhdr", description=__doc__, args=argv)


def _options_of(name: str) -> Any:
    """The dataclass of a command's options."""
    module, _, options = COMMANDS[name].partition(".")
    return getattr(import_module(f"{__name__}.{module}"), options)
