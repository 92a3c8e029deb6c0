# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr check``: is everything there, and does it work? Imports, device, kernels, one training step.

Standard library only at the top: what is missing must be found and named, be it numpy or torch.
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
from .findings import CheckFailedError, Findings, MissingModuleError

#: What a requirement is imported as, where its name differs.
MODULES = {"pillow": "PIL"}
#: The extra that physhdr prepare needs: what is missing of it is told, and no reason not to train.
PHOTOS = "prepare"
#: Where in the whole the parts end, for the bar.
IMPORTED, KERNELS_READY = 0.3, 0.9


@dataclass(frozen=True)
class Check:
    """Is everything installed, and does it work? If not, it says what is wrong and what to do."""

    #: Progress, result and error as one JSON object a line on stdout.
    json: bool = False

    def run(self) -> int:
        findings = check(self._tell)
        told = json.dumps({"result": vars(findings)}) + "\n" if self.json else _in_words(findings)
        sys.stdout.write(told)
        return 0

    def _tell(self, fraction: float, message: str) -> None:
        line = json.dumps({"progress": round(fraction, 3), "message": message}) if self.json else message
        sys.stdout.write(line + "\n")
        sys.stdout.flush()


def main(argv: list[str]) -> int:
    """The command line, without tyro: that it is missing would be a finding."""
    parser = argparse.ArgumentParser(prog="physhdr check", description=Check.__doc__, allow_abbrev=False)
    parser.add_argument("--json", action="store_true", help="one JSON object a line on stdout")
    return Check(**vars(parser.parse_args(argv))).run()


def check(tell: Callable[[float, str], None]) -> Findings:
    """Everything in turn; raises a ``PhysHDRError`` that names what does not work and the remedy."""
    findings = Findings(version=version())
    with findings.timed("imports"):
        wanted = requirements()
        for_photos = [each for each in requirements(PHOTOS) if each not in wanted]
        for done, requirement in enumerate(wanted):
            name = _name_of(requirement)
            tell(IMPORTED * done / len(wanted), f"importing {name}")
            findings.versions[name] = _imported(name, requirement)
        for requirement in for_photos:
            try:
                findings.versions[_name_of(requirement)] = _imported(_name_of(requirement), requirement)
            except MissingModuleError as error:
                findings.missing.append(requirement)
                findings.warnings.append(f"photos cannot be prepared: {error.message}")
        for requirement in [*wanted, *for_photos]:
            found = findings.versions.get(name := _name_of(requirement))
            if found is not None and not _fits(found, requirement):
                findings.warnings.append(f"{name} {found} was not tested: {requirement}")
    _listen()
    from . import trial_step  # torch and all the rest of ours

    with findings.timed("device"):
        findings.device, findings.why = trial_step.device()
    if findings.device == "cpu":
        tell(IMPORTED, "compiling kernels, once: half a minute to some minutes")
        with findings.timed("kernels"):
            furthest = IMPORTED

            def compiled(what: str, done: int, total: int) -> None:
                nonlocal furthest  # they are gone through again after processes have compiled them
                fraction = IMPORTED + (KERNELS_READY - IMPORTED) * done / total
                if fraction > furthest:
                    furthest = fraction
                    tell(fraction, f"compiled kernels {done}/{total}: {what}")

            trial_step.compile_for_presets(compiled)
    tell(KERNELS_READY, "training one step")
    with findings.timed("training step"):
        findings.loss, findings.gaussians = trial_step.one_step(findings.device)
    tell(1.0, "everything works")
    return findings


def _name_of(requirement: str) -> str:
    return re.split(r"[^\w.-]", requirement.strip(), maxsplit=1)[0]


def _imported(name: str, requirement: str) -> str:
    """Import what ``requirement`` brings; returns its version."""
    module = MODULES.get(name, name)
    hint = f"Install the backend again, or: {pip_install(requirement)}"
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        what = f"{name} cannot be imported: it" if error.name != module else f"the Python {sys.executable}"
        raise MissingModuleError(f"{what} has no module {error.name}", hint) from error
    except Exception as error:  # libraries fail in their own ways, e.g. OSError for a missing .so
        told = (str(error).strip().splitlines() or [""])[0]
        raise MissingModuleError(
            f"{name} cannot be imported: {type(error).__name__}: {told}", hint
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
            f"a program cannot listen on 127.0.0.1: {error.strerror or error}",
            "Blender talks to the backend there: look at the firewall.",
        ) from error


def _in_words(findings: Findings) -> str:
    seconds = ", ".join(f"{part} {value:g} s" for part, value in findings.seconds.items())
    versions = ", ".join(f"{name} {value}" for name, value in findings.versions.items())
    lines = [
        f"PhysHDR {findings.version}, Python {findings.python}: {versions}",
        f"computes {findings.why}; a training step's loss was {findings.loss:.4f}",
        *(f"warning: {warning}" for warning in findings.warnings),
        f"took: {seconds}",
    ]
    return "\n".join(lines) + "\n"
