# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr check``: is everything installed, and does it work? Imports, device, kernels, one training step.

Only the standard library is imported at the top, so that even a missing numpy or torch is reported.
"""

import argparse
import importlib
import json
import re
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass

from ..project import requirements, version, version_of
from ..shell import pip_install
from .check_report import CheckFailedError, CheckReport, MissingModuleError

#: What a requirement is imported as, where its name differs.
MODULES = {"pillow": "PIL"}
#: The extra that physhdr prepare needs: missing packages are reported but do not prevent training.
PHOTOS = "prepare"
#: Fractions of the progress bar at which the parts end.
IMPORTED, KERNELS_READY = 0.3, 0.9


@dataclass(frozen=True)
class Check:
    """Check that everything is installed and works; if not, report what is wrong and what to do."""

    #: Write progress, result and error as JSON, one object per line.
    json: bool = False

    def run(self) -> int:
        report = check(self._show)
        text = json.dumps({"result": vars(report)}) + "\n" if self.json else _as_text(report)
        sys.stdout.write(text)
        return 0

    def _show(self, fraction: float, message: str) -> None:
        line = json.dumps({"progress": round(fraction, 3), "message": message}) if self.json else message
        sys.stdout.write(line + "\n")
        sys.stdout.flush()


def main(argv: list[str]) -> int:
    """The command line, without tyro, which may be missing."""
    parser = argparse.ArgumentParser(prog="physhdr check", description=Check.__doc__, allow_abbrev=False)
    parser.add_argument("--json", action="store_true", help="write JSON, one object per line")
    return Check(**vars(parser.parse_args(argv))).run()


def check(show: Callable[[float, str], None]) -> CheckReport:
    """Check everything in turn; raises a ``PhysHDRError`` that names what does not work and the remedy."""
    report = CheckReport(version=version())
    with report.timed("imports"):
        wanted = requirements()
        for_photos = [each for each in requirements(PHOTOS) if each not in wanted]
        for done, requirement in enumerate(wanted):
            name = _name_of(requirement)
            show(IMPORTED * done / len(wanted), f"importing {name}")
            report.versions[name] = _imported(name, requirement)
        for requirement in for_photos:
            try:
                report.versions[_name_of(requirement)] = _imported(_name_of(requirement), requirement)
            except MissingModuleError as error:
                report.missing.append(requirement)
                report.warnings.append(f"photos cannot be prepared: {error.message}")
        for requirement in [*wanted, *for_photos]:
            found = report.versions.get(name := _name_of(requirement))
            if found is not None and not _fits(found, requirement):
                report.warnings.append(f"{name} {found} was not tested: {requirement}")
    _listen()
    from . import trial_step  # torch and all the rest of ours

    with report.timed("device"):
        report.device, report.why = trial_step.device()
    if report.device == "cpu":
        show(IMPORTED, "compiling kernels, once: half a minute to some minutes")
        with report.timed("kernels"):
            furthest = IMPORTED

            def compiled(what: str, done: int, total: int) -> None:
                nonlocal furthest  # after other processes have compiled them, they are counted again
                fraction = IMPORTED + (KERNELS_READY - IMPORTED) * done / total
                if fraction > furthest:
                    furthest = fraction
                    show(fraction, f"compiled kernels {done}/{total}: {what}")

            trial_step.compile_for_presets(compiled)
    show(KERNELS_READY, "training one step")
    with report.timed("training step"):
        report.loss, report.gaussians = trial_step.one_step(report.device)
    show(1.0, "everything works")
    return report


def _name_of(requirement: str) -> str:
    return re.split(r"[^\w.-]", requirement.strip(), maxsplit=1)[0]


def _imported(name: str, requirement: str) -> str:
    """Import the module of ``requirement``; returns its version."""
    module = MODULES.get(name, name)
    hint = f"Install the backend again, or: {pip_install(requirement)}"
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        what = f"{name} cannot be imported: it" if error.name != module else f"Python {sys.executable}"
        raise MissingModuleError(f"{what} has no module {error.name}", hint) from error
    except Exception as error:  # libraries fail in their own ways, e.g. OSError for a missing .so
        reason = (str(error).strip().splitlines() or [""])[0]
        raise MissingModuleError(
            f"{name} cannot be imported: {type(error).__name__}: {reason}", hint
        ) from error
    return version_of(name)


def _fits(found: str, requirement: str) -> bool:
    """Whether a version is within the bounds of a requirement (``>=``, ``<`` and ``==`` are what we use)."""

    def numbers(text: str) -> tuple[int, ...]:
        return tuple(int(n) for n in re.findall(r"\d+", text.partition("+")[0])[:3])

    have = numbers(found)
    for sign, bound in re.findall(r"(>=|==|<)\s*([\d.]+)", requirement):
        limit = numbers(bound)
        if not {">=": have >= limit, "==": have == limit, "<": have < limit}[sign]:
            return False
    return True


def _listen() -> None:
    try:
        with socket.create_server(("127.0.0.1", 0)):
            pass
    except OSError as error:
        raise CheckFailedError(
            f"cannot listen on 127.0.0.1: {error.strerror or error}",
            "Blender talks to the backend there: check the firewall.",
        ) from error


def _as_text(report: CheckReport) -> str:
    seconds = ", ".join(f"{part} {value:g} s" for part, value in report.seconds.items())
    versions = ", ".join(f"{name} {value}" for name, value in report.versions.items())
    lines = [
        f"PhysHDR {report.version}, Python {report.python}: {versions}",
        f"computes {report.why}; a training step's loss was {report.loss:.4f}",
        *(f"warning: {warning}" for warning in report.warnings),
        f"took: {seconds}",
    ]
    return "\n".join(lines) + "\n"
