# SPDX-License-Identifier: GPL-3.0-or-later
"""What ``physhdr prepare --json`` says of photos and of the data set made of them, for the panel. Pure.

Its results are another program's, of another version perhaps: what is missing or of another kind is passed
over, and never fails.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from ...bridge.limits import is_number
from ...bridge.words import counted
from .state import Photos, Prepared

#: What options of the command are called in the panel: its errors and warnings name them as remedies. Names
#: <pose>_<k> need no option in it.
LABELS = {
    " (--group names)": "",
    "--group none": "Photos a Place 1",
    "--light none": "Folders Named by Light switched off",
    "--light": "Other Light",
    "--handheld": "Hand-Held",
    "--bracket": "Photos a Place",
    "--same-exposure": "Same Exposure",
    "--exposures": "Exposures",
    "--borrow-poses": "Borrow Places",
    "--max-width": "Width at Most",
    "--camera": "Lens",
    "--partial": "Use What Was Found",
}
#: So many files that are passed over are named each with its reason; the rest are counted.
NAMED = 3


@dataclass(frozen=True)
class PhotoOptions:
    """What a user may say of photos; the defaults let ``physhdr prepare`` find it out.

    ``bracket``: photos at each place; ``lens``: COLMAP's name of its model; ``exposures``: a file of them;
    ``partial``: continue where less than half of the places were found. ``lights``: folders of photos under
    other light, as ``--light`` takes them; ``named_lights``: use those whose names say it, too.
    """

    handheld: bool = False
    bracket: int = 0
    same_exposure: bool = False
    exposures: str = ""
    borrow_poses: bool = False
    max_width: int = 1600
    lens: str = "OPENCV"
    partial: bool = False
    lights: tuple[str, ...] = ()
    named_lights: bool = True

    @property
    def to_look(self) -> tuple[str, ...]:
        """Those that change what is understood of the photos."""
        options = ["--handheld"] if self.handheld else []
        options += ["--bracket", str(self.bracket)] if self.bracket else []
        options += ["--same-exposure"] if self.same_exposure else []
        options += ["--exposures", self.exposures] if self.exposures else []
        options += [f"--light={light}" for light in self.lights]
        options += [] if self.named_lights else ["--light=none"]
        return tuple(options)

    @property
    def to_prepare(self) -> tuple[str, ...]:
        """All of them."""
        options = [*self.to_look, "--max-width", str(self.max_width), "--camera", self.lens]
        options += ["--borrow-poses"] if self.borrow_poses else []
        options += ["--partial"] if self.partial else []
        return tuple(options)


def look_command(photos: str, options: tuple[str, ...]) -> list[str]:
    """The arguments of the backend's command that looks at a folder of photos and writes nothing."""
    return ["prepare", photos, *options, "--look", "--json"]


def prepare_command(photos: str, out: str, options: tuple[str, ...], overwrite: bool) -> list[str]:
    """The arguments of the backend's command that makes a data set ``out`` of a folder of photos."""
    return ["prepare", photos, "--out", out, *options, *(["--overwrite"] if overwrite else []), "--json"]


def in_panel_words(text: str) -> str:
    """A sentence of the command with its options as the panel calls them."""
    options = r" \(--group names\)|--group none\b|--light none\b|--[a-z][a-z-]*"
    return re.sub(options, lambda found: LABELS.get(found[0], found[0]), text)


def understood(photos: Photos, result: dict[str, Any]) -> Photos:
    """``photos`` with what the look at them found."""
    seconds: Any = result.get("estimate_seconds")
    return replace(
        photos,
        lines=_described(result) or _texts(result.get("lines")) or ("Photos were found",),
        warnings=(*_texts(result.get("warnings")), *_skipped(result.get("skipped"))),
        seconds=float(seconds) if is_number(seconds) else -1.0,
        problem=None,
    )


def prepared(result: dict[str, Any], in_words: Callable[[str], str] = in_panel_words) -> Prepared:
    """What came of the long work: the folder, and how well the places were found. ``in_words``: how the panel
    puts a warning."""
    folder = result.get("folder")
    placed, places, error = (result.get(name) for name in ("placed", "places", "reprojection_error"))
    lines = []
    if is_number(placed) and is_number(places):
        lines.append(f"{placed} of {places} places found")
    if is_number(error):
        lines.append(f"reprojection error {error:.2f} pixels")
    return Prepared(
        folder if isinstance(folder, str) else "", ", ".join(lines), _texts(result.get("warnings"), in_words)
    )


def _described(result: dict[str, Any]) -> tuple[str, ...]:
    """The numbers in lines as short as a panel is narrow; () where the program reported none."""
    found: Any = result
    photos, places, each = (found.get(name) for name in ("photos", "places", "per_place"))
    size, seconds, stops = (found.get(name) for name in ("size", "exposures", "stops"))
    lines = []
    if is_number(photos):
        is_size = isinstance(size, list) and len(size) == 2
        lines.append(f"{photos} photos" + (f", {size[0]} × {size[1]}" if is_size else ""))
    if is_number(places):
        lines.append(f"{places} places" + (f", {each} photos each" if is_number(each) and each > 1 else ""))
    if isinstance(seconds, list) and seconds and all(is_number(one) and one > 0 for one in seconds):
        times = [_time(min(seconds)), _time(max(seconds))] if len(seconds) > 1 else [_time(seconds[0])]
        over = f", {stops:.1f} stops" if is_number(stops) and len(seconds) > 1 else ""
        lines.append(f"{counted(len(seconds), 'exposure')}: {' to '.join(times)}{over}")
    if lines and isinstance(how := result.get("how"), str) and how:
        lines.append(f"Found {how}")
    return (*lines, *_lights(result.get("lights")))


def _lights(listed: Any) -> tuple[str, ...]:
    """A line for each group of photos under other light."""
    groups = [entry for entry in listed if isinstance(entry, dict)] if isinstance(listed, list) else []
    return tuple(
        f"{entry.get('group')}: {counted(entry['places'], 'place')}"
        for entry in groups
        if is_number(entry.get("places"))
    )


def _time(seconds: float) -> str:
    """An exposure as cameras write it."""
    return f"1/{1.0 / seconds:.0f} s" if seconds < 0.3 else f"{seconds:.3g} s"


def _skipped(listed: Any) -> tuple[str, ...]:
    """A sentence for each of the first files that are passed over, and one for the rest."""
    files = [entry for entry in listed if isinstance(entry, dict)] if isinstance(listed, list) else []
    lines = [f"Left out: {entry.get('name', '?')}, {entry.get('why', '')}" for entry in files[:NAMED]]
    if len(files) > NAMED:
        lines.append(f"Left out: {len(files) - NAMED} more files")
    return tuple(lines)


def _texts(listed: Any, in_words: Callable[[str], str] = in_panel_words) -> tuple[str, ...]:
    texts = [text for text in listed if isinstance(text, str)] if isinstance(listed, list) else []
    return tuple(map(in_words, texts))
