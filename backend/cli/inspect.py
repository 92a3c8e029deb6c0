# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr inspect``: reports what a data set contains, and its faults."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich import box
from rich.table import Table
from rich.text import Text

from ...bridge.data_set import SPLITS
from ...bridge.errors import BadValueError, DataMismatchError
from ...bridge.limits import is_number
from ..inspect import inspect
from ..inspect.findings import (
    DynamicRange,
    Exposure,
    Inspection,
    floor_in_words,
    samples_in_words,
    span,
)
from ..runs.terminal import console
from ..scene.hdr_nerf_syn import OURS
from .output import run_and_report, write_json

#: What an empty cell shows.
NONE = "–"
#: Up to this many poses are listed one by one.
FEW = 6
USES = {"OE": "training (OE)", "NE": "evaluation (NE)"}


@dataclass(frozen=True)
class Inspect:
    """Report a data set's views, exposures, lights, dynamic range and noise, and all its faults."""

    #: Folders of data sets; several are listed in one line each.
    folders: tyro.conf.Positional[tuple[Path, ...]]
    #: Reduce pictures by this factor; default: that of the layout's authors.
    downscale: float | None = None
    #: Colour space of pictures that hold radiance, as --color-space of training; default: as each file says.
    color_space: str | None = None
    #: Write what each folder contains, and the result or error, as JSON, one object per line.
    json: bool = False

    def run(self) -> int:
        return run_and_report(self._work, self.json)

    def _work(self) -> dict[str, Any]:
        if not self.folders:
            raise BadValueError("no data set was given", "For example: physhdr inspect data/demo")
        all_found = []
        for folder in self.folders:
            found = inspect(folder, self.downscale, self.color_space)
            all_found.append(found)
            if self.json:
                write_json(found=dataclasses.asdict(found))
        if not self.json:
            if len(all_found) == 1:
                _show(all_found[0])
            else:
                console.print(_table(all_found))
                for found in all_found:
                    _show_faults(found, f"{found.folder}: ")
        _complain(all_found)
        return {"folders": len(all_found)}


def _complain(all_found: list[Inspection]) -> None:
    """Raise one error that counts all faults and names the first with its remedy."""
    faults = [
        (found.folder, *fault)
        for found in all_found
        for fault in zip(found.errors, found.remedies, strict=True)
    ]
    if not faults:
        return
    many = f"{len(faults)} faults, the first: " if len(faults) > 1 else ""
    folders = ", ".join(dict.fromkeys(folder for folder, _, _ in faults))
    raise DataMismatchError(f"{folders}: {many}{faults[0][1]}", faults[0][2])


# ---- one data set ------------------------------------------------------------------------------------


def _show(found: Inspection) -> None:
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in _facts(found):
        table.add_row(name, text)
    console.print(Text(f"{found.scene} · {found.folder}", style="bold"), soft_wrap=True)
    console.print(table)
    if found.exposures:
        console.print(_exposure_table(found.exposures))
    _show_faults(found)


def _facts(found: Inspection) -> list[tuple[str, str]]:
    facts = []
    if found.layout:
        facts.append(("layout", found.layout))
    facts += [("" if k else "read as", message) for k, message in enumerate(found.messages)]
    if found.made_by:
        facts.append(("made by", found.made_by))
    if found.resolution:
        others = f", the middle one of {found.resolutions} sizes" if found.resolutions > 1 else ""
        facts.append(("resolution", _size(found) + others))
    for name, split in found.splits.items():
        truth = f"true HDR of {split.hdr}" if split.hdr else "no true HDR"
        levels = "; ".join(f"{light} at {_numbers(values)}" for light, values in split.levels.items())
        facts.append((name, f"{split.poses} poses, {truth}" + (f"; {levels}" if levels else "")))
    if found.lights:
        facts.append(("lights", ", ".join(found.lights)))
        facts += [("", sentence) for sentence in found.turnable]
    if found.relit:
        facts += [("relit truth" if k == 0 else "", text) for k, text in enumerate(_relit(found))]
    elif found.splits and found.layout == OURS:
        facts.append(("relit truth", "none"))
    if found.passes:
        facts.append(("passes", f"for {found.passes} poses: any mix of the lights can be made from them"))
    if found.points is not None:
        kind = found.points_origin or "of unknown origin"
        facts.append(("points", f"{found.points:,}: {kind}"))
    if found.response or found.camera:
        faults = ", ".join(f"{key} {value:g}" for key, value in found.camera.items() if is_number(value))
        facts.append(("camera", (found.response or "unknown response") + (f"; {faults}" if faults else "")))
    if found.exposure_modes:
        facts.append(("exposure modes", " and ".join(found.exposure_modes)))
    if found.dynamic_range:
        facts.append(("dynamic range", _range_in_words(found.dynamic_range)))
    if found.splits and found.layout == OURS:
        floor = found.noise_floor
        facts.append(("noise floor", floor_in_words(floor) if floor else "not measured"))
    if found.reference_floor:
        facts.append(("reference floor", f"{floor_in_words(found.reference_floor)}, not denoised"))
    if found.samples:
        samples = samples_in_words(found.samples)
        facts.append(
            ("renders", f"{samples} samples a pixel, noise {span(found.noise_psnr)} dB before denoising")
        )
    return facts


def _relit(found: Inspection) -> list[str]:
    """One line for each set of levels: which, and of which test poses."""
    lines = []
    for entry in found.relit:
        levels = ", ".join(f"{light} × {level:g}" for light, level in entry["levels"].items())
        poses = entry["poses"]
        which = f"test poses {_numbers(poses)}" if len(poses) <= FEW else f"{len(poses)} test poses"
        lines.append(f"{levels or entry['folder']}: {which}")
    return lines


def _range_in_words(measured: DynamicRange) -> str:
    ends = f"{measured.percentile_1:.3g} … {measured.maximum:.3g}"
    if measured.estimated:
        bound = "at least " if measured.at_least else ""
        return f"{bound}about {measured.stops} stops: an estimate from the pictures ({ends}), no true HDR"
    if measured.stops is None:
        return f"black at the 1st percentile, maximum {measured.maximum:.3g}"
    return f"{measured.stops} stops: 1st percentile to maximum of the training views ({ends})"


def _exposure_table(exposures: list[Exposure]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, title="exposures", title_justify="left")
    for column in ("", "seconds", "EV", "white", "black"):
        table.add_column(column, justify="right")
    table.add_column("used for")
    for exposure in exposures:
        shares = [NONE if v is None else f"{v:.1%}" for v in (exposure.white, exposure.black)]
        table.add_row(
            f"{exposure.place}", f"{exposure.seconds:g}", f"{exposure.ev:+.3g}", *shares, USES[exposure.use]
        )
    return table


def _show_faults(found: Inspection, prefix: str = "") -> None:
    for warning in found.warnings:
        console.print(Text(f"warning: {prefix}{warning}", style="yellow"), soft_wrap=True)
    several = len(set(found.remedies)) > 1  # a single one is printed at the end, with the first fault
    for k, (error, remedy) in enumerate(zip(found.errors, found.remedies, strict=True)):
        console.print(Text(f"fault: {prefix}{error}", style="red"), soft_wrap=True)
        if several and remedy and remedy not in found.remedies[k + 1 : k + 2]:
            console.print(Text(f"  {remedy}", style="dim"), soft_wrap=True)


# ---- several -----------------------------------------------------------------------------------------


def _table(all_found: list[Inspection]) -> Table:
    table = Table(
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        caption=f"views: {'/'.join(SPLITS)}; stops: ≈ an estimate, no true HDR; noise: dB of HDR",
        caption_justify="left",
    )
    for column in ("scene", "size", "views", "EV", "stops", "lights", "relit", "noise", ""):
        table.add_column(column, no_wrap=True)
    for found in all_found:
        counts = (found.splits[name].poses if name in found.splits else 0 for name in SPLITS)
        evs = sorted(exposure.ev for exposure in found.exposures)
        noise = (found.noise_floor or {}).get("hdr_psnr")
        table.add_row(
            found.scene,
            _size(found) if found.resolution else NONE,
            "/".join(str(count) for count in counts),
            f"{evs[0]:+.3g}…{evs[-1]:+.3g}" if evs else NONE,
            _stops(found.dynamic_range),
            f"{len(found.lights)}",
            f"{sum(len(entry['poses']) for entry in found.relit)}",
            f"{noise:.1f}" if is_number(noise) else NONE,
            f"{len(found.errors)} faults" if found.errors else "warnings" if found.warnings else "good",
        )
    return table


def _stops(measured: DynamicRange | None) -> str:
    if measured is None or measured.stops is None:
        return NONE
    mark = "≥" if measured.at_least else "≈"
    return f"{mark}{measured.stops:g}" if measured.estimated else f"{measured.stops:.1f}"


def _size(found: Inspection) -> str:
    return "×".join(str(side) for side in found.resolution or ())


def _numbers(values: list[float]) -> str:
    return ", ".join(f"{value:g}" for value in values) or NONE
