# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder of a light probe: the panoramas of a trained model's light at a place, and ``probe.json``.

``fixed.exr`` is what no light turns, ``light_0.exr`` … what each light alone causes at level 1; all are
scene-linear radiance of 32 bits (``panorama`` says which way they look), so that the light at levels l is
fixed + Σ l · light, whatever they are. ``probe.json`` is written last: without it the folder is not whole.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .atomic import MARK, atomic_path
from .errors import BadValueError, FileDamagedError, OutputError
from .lights import check_lights
from .limits import is_number
from .regular import read_json_object

FORMAT, VERSION = "physhdr-probe", 1
PROBE_FILE = "probe.json"
FIXED_FILE = "fixed.exr"
#: Pixels across: the narrowest that tells directions apart, and the widest that Blender can take well.
NARROWEST, WIDEST = 16, 16384
WIDTH = 1024
#: Above this share of the sphere that was never seen, the guess is more than a touch-up.
MUCH_UNSEEN = 0.35


def light_file(index: int) -> str:
    """The panorama of a light, by its place among the lights."""
    return f"light_{index}.exr"


@dataclass(frozen=True)
class Probe:
    """What is known of a probe.

    ``at``: metres, in the model's own space. ``lights``: those that have a panorama each; () where the model
    cannot tell its lights apart, and ``fixed.exr`` is all of its light. ``unseen``: the share of the sphere
    that nothing covered, filled from its rim. ``near``: metres within which Gaussians were left out, and
    ``left_out`` how many. ``gaussians``: of the model. ``made_by``: physhdr, or Blender.
    """

    at: tuple[float, float, float]
    width: int
    lights: tuple[str, ...]
    unseen: float
    near: float
    left_out: int
    gaussians: int
    made_by: str
    source: str = ""

    @property
    def files(self) -> tuple[str, ...]:
        """Its panoramas' names: the fixed part's, and each light's."""
        return (FIXED_FILE, *(light_file(index) for index in range(len(self.lights))))


def check_width(width: int) -> int:
    """``width`` where a panorama can have it; raises ``BadValueError``."""
    if not NARROWEST <= width <= WIDEST or width & (width - 1):
        raise BadValueError(
            f"a panorama cannot be {width} pixels wide",
            f"Give a power of two from {NARROWEST} to {WIDEST}, such as {WIDTH}.",
        )
    return width


def begin(folder: Path) -> None:
    """Make ``folder`` ready for a new probe: what is left of one is no longer whole.

    Raises ``OutputError`` where there is anything that is no probe's.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        names = [each.name for each in folder.iterdir()]
        foreign = [name for name in names if not _is_ours(name)]
        if foreign:
            raise OutputError(
                f"{folder} holds {foreign[0]}, which is not a light probe's",
                "Choose an empty folder, or that of a probe, which is replaced.",
            )
        (folder / PROBE_FILE).unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(
            f"cannot write to {folder}: {error.strerror or error}", "Choose another folder for the probe."
        ) from error


def finish(folder: Path, probe: Probe) -> None:
    """Write ``probe.json``, and remove panoramas of a former probe that had more lights."""
    for path in folder.glob("light_*.exr"):
        if path.name not in probe.files:
            path.unlink(missing_ok=True)
    content = {"format": FORMAT, "version": VERSION, **asdict(probe)}
    with atomic_path(folder / PROBE_FILE) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_probe(folder: Path) -> Probe:
    """The probe in a folder; raises ``FileMissingError`` and ``FileDamagedError``."""
    path = folder / PROBE_FILE
    content = read_json_object(path)
    if content.get("format") != FORMAT or content.get("version") != VERSION:
        raise FileDamagedError(f"{path} is not a light probe of this version", "Make it again.")
    try:
        probe = Probe(
            at=_numbers(content["at"], 3),
            width=check_width(int(content["width"])),
            lights=check_lights(content["lights"], str(path)) if content["lights"] else (),
            unseen=float(content["unseen"]),
            near=float(content["near"]),
            left_out=int(content["left_out"]),
            gaussians=int(content["gaussians"]),
            made_by=str(content["made_by"]),
            source=str(content["source"]),
        )
    except (KeyError, TypeError, ValueError, OverflowError, BadValueError) as error:
        raise FileDamagedError(f"{path} cannot be understood: {error}", "Make the probe again.") from error
    if not (0.0 <= probe.unseen <= 1.0 and math.isfinite(probe.near)):
        raise FileDamagedError(f"{path} cannot be understood: it has absurd numbers", "Make it again.")
    return probe


def _numbers(values: Any, count: int) -> Any:
    if not isinstance(values, Sequence) or len(values) != count or not all(map(is_number, values)):
        raise ValueError(f"{values!r:.80} are not {count} numbers")
    return tuple(float(value) for value in values)


def _is_ours(name: str) -> bool:
    stem, _, suffix = name.rpartition(".")
    stem = stem.split(MARK)[0]  # what a writer left that was killed
    if f"{stem}.{suffix}" in (PROBE_FILE, FIXED_FILE):
        return True
    return suffix == "exr" and stem.startswith("light_") and stem.removeprefix("light_").isdecimal()
