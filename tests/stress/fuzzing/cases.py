# SPDX-License-Identifier: GPL-3.0-or-later
"""A bad input, what is tried with it, and what came out."""

import base64
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, Literal

from physhdr.bridge.errors import PhysHDRError

#: What takes the place of a file: other bytes, or something that is no file at all; ``live``: an attack on a
#: process, which is made again by its seed alone.
Form = Literal["bytes", "gone", "folder", "fifo", "loop", "live"]
#: A message longer than this is no sentence: it repeats the input.
MESSAGE_MAX = 2000


class InsaneError(Exception):
    """A bad input was accepted, and the result is not what its type promises."""


@dataclass(frozen=True)
class Case:
    """One bad input: in the seed ``variant`` the file ``file`` is changed."""

    variant: str
    file: str
    form: Form
    content: bytes = b""


@dataclass(frozen=True)
class Target:
    """One row of the table.

    ``prepare``: writes whole inputs, each a folder (a variant) of the folder it is given. ``attempt``: given
    a variant's folder, the name of the changed file and its bytes, opens what is there and raises
    ``InsaneError`` where it accepts what it should not. ``refusals``: errors that are an answer. ``count``:
    cases of a whole run; ``in_memory``: no file is written, ``attempt`` takes the bytes. ``chosen``: names of
    files that may be changed, as patterns. ``patience``: seconds that a case may take. ``names_place``: a
    refusal must name the file or its folder. ``whole_refused``: undamaged inputs may be refused, too.
    ``needs``: a module without which the row is skipped.
    """

    name: str
    prepare: Callable[[Path], None]
    attempt: Callable[[Path, str, bytes], None]
    count: int
    refusals: tuple[type[Exception], ...] = (PhysHDRError,)
    in_memory: bool = False
    chosen: tuple[str, ...] = ("*",)
    patience: float = 30.0
    names_place: bool = True
    whole_refused: bool = False
    needs: str = ""

    def may_change(self, file: str) -> bool:
        """Whether this file of a variant is one that cases change."""
        return any(fnmatch(file, pattern) for pattern in self.chosen)


@dataclass(frozen=True)
class Finding:
    """A case that ended as none may. ``kind``: one word; ``where``: what distinguishes it from others."""

    target: str
    seed: int
    number: int
    kind: str
    where: str
    detail: str
    case: Case

    @property
    def key(self) -> tuple[str, str, str]:
        return self.target, self.kind, self.where

    def write(self, folder: Path) -> Path:
        """As a file from which ``read_finding`` makes the case again."""
        name = "".join(c if c.isalnum() else "-" for c in f"{self.target} {self.kind}")
        path = folder / f"{name}-{self.seed}-{self.number}.json"
        content: dict[str, Any] = {
            "target": self.target,
            "seed": self.seed,
            "number": self.number,
            "found": {"kind": self.kind, "where": self.where},
            "variant": self.case.variant,
            "file": self.case.file,
            "form": self.case.form,
        }
        try:
            content["text"] = self.case.content.decode("ascii")
        except UnicodeDecodeError:
            content["base64"] = base64.b64encode(self.case.content).decode()
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        return path


def read_finding(path: Path) -> Finding:
    """What ``Finding.write`` wrote."""
    content = json.loads(path.read_text(encoding="utf-8"))
    data = content["text"].encode() if "text" in content else base64.b64decode(content["base64"])
    case = Case(content["variant"], content["file"], content["form"], data)
    found = content["found"]
    return Finding(
        content["target"],
        content["seed"],
        content["number"],
        found["kind"],
        found["where"],
        "",
        case,
    )


@dataclass
class Tally:
    """A row of the table: how many cases, and how they ended.

    ``skipped``: why it could not be tried here; ``broken``: why it did not finish, which is a fault.
    """

    name: str
    tried: int = 0
    outcomes: dict[str, int] = field(default_factory=dict)
    findings: dict[tuple[str, str, str], Finding] = field(default_factory=dict)
    seconds: float = 0.0
    skipped: str = ""
    broken: str = ""

    def count(self, outcome: str, number: int = 1) -> None:
        self.tried += number
        self.outcomes[outcome] = self.outcomes.get(outcome, 0) + number

    def found(self, finding: Finding) -> None:
        """Keep the smallest case of each kind of finding."""
        known = self.findings.get(finding.key)
        if known is None or len(finding.case.content) < len(known.case.content):
            self.findings[finding.key] = finding
