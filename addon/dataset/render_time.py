# SPDX-License-Identifier: GPL-3.0-or-later
"""About how long a data set will take to render: as the last one of this scene did, else as the last one on
this computer. Where there was none nothing is claimed.
"""

import json
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import bpy

from ...bridge.atomic import atomic_path
from ...bridge.data_set import passes_files
from ...bridge.errors import PhysHDRError
from ...bridge.regular import read_json_object
from . import dataset_command
from .dataset_settings import settings_of

#: In the backend's folder: device → seconds for a sample of a pixel, and of which scene.
RATES_FILE = "render_rates.json"
UNKNOWN = "How long it takes is not known yet"


@dataclass(frozen=True)
class Started:
    """A data set whose rendering began."""

    out: Path
    #: Samples of pixels in one picture.
    samples: int
    device: str
    #: Pictures that were there already.
    had: int
    began: float
    #: What is photographed, by ``session_uid``: an undo or a new name may come before the end.
    originals: frozenset[int]


def begun(
    chosen: SimpleNamespace, scene: bpy.types.Scene, out: Path, originals: Iterable[bpy.types.Object]
) -> Started:
    """A data set of these ``originals`` begins to render now."""
    uids = frozenset(item.session_uid for item in originals)
    return Started(out, _samples(chosen, scene), chosen.device, rendered(out), time.monotonic(), uids)


def ended(started: Started, scene: bpy.types.Scene | None, home: Path) -> None:
    """It is complete: remember how fast it went, in the scene and for other scenes on this computer."""
    new = rendered(started.out) - started.had
    if new < 1:
        return
    rate = (time.monotonic() - started.began) / ((new + 1) * started.samples)
    _keep(rate, started.device, scene, "as the last data set of this scene went")
    rates = _rates(home)
    rates[started.device] = {"seconds": rate, "file": Path(bpy.data.filepath).stem}
    with suppress(PhysHDRError), atomic_path(home / RATES_FILE) as pending:
        pending.write_text(json.dumps(rates), encoding="utf-8")


def tried(chosen: SimpleNamespace, scene: bpy.types.Scene, seconds: float) -> None:
    """A picture as ``chosen`` took so long, tried before the data set."""
    _keep(seconds / _samples(chosen, scene), chosen.device, scene, "as two pictures went that were tried")


def _keep(rate: float, device: str, scene: bpy.types.Scene | None, by: str) -> None:
    if scene is not None:
        settings = settings_of(scene)
        settings.rate, settings.rate_device, settings.rate_by = rate, device, by


def estimate(
    chosen: SimpleNamespace, scene: bpy.types.Scene, home: Path, out: Path | None
) -> tuple[float, str]:
    """Seconds, negative where nobody knows, and by what they are estimated."""
    pictures = max(1, dataset_command.pictures(chosen) - (rendered(out) if out else 0))
    work = pictures * _samples(chosen, scene)
    settings = settings_of(scene)
    if settings.rate > 0.0 and settings.rate_device == chosen.device:
        return work * settings.rate, settings.rate_by
    found = _rates(home).get(chosen.device)
    match found:
        case {"seconds": float(rate), "file": str(file)} if rate > 0.0:
            return (
                work * rate,
                f"if it renders like {file!r}, the last one" if file else "as the last one went",
            )
    return -1.0, UNKNOWN


def rendered(out: Path) -> int:
    """How many pictures a data set's folder has."""
    try:
        return len(passes_files(out))
    except OSError:
        return 0


def _samples(chosen: SimpleNamespace, scene: bpy.types.Scene) -> int:
    width, height = dataset_command.size(chosen, scene)
    return width * height * chosen.samples


def _rates(home: Path) -> dict[str, object]:
    try:
        return read_json_object(home / RATES_FILE)
    except PhysHDRError:  # there is none yet, or it is damaged: then nothing is known
        return {}
