# SPDX-License-Identifier: GPL-3.0-or-later
"""Facts about data sets and machines for the report; stored in the benchmark's folder."""

import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ...backend.inspect import inspect
from ...backend.inspect.findings import Inspection, floor_in_words, samples_in_words
from ...bridge.atomic import atomic_path
from ...bridge.words import counted
from .runs import Record

FACTS_FOLDER = "facts"


def scene_facts(
    out: Path, name: str, folder: Path, data: str, downscale: float | None, color_space: str | None
) -> dict[str, Any]:
    """The result of ``physhdr inspect`` for the data set in ``folder``, named ``name`` in the plan.

    ``downscale``, ``color_space``: as in the plan. The truth's noise is that of full-size pictures, and
    omitted for reduced ones. Inspected once for each ``data`` fingerprint and way of reading.
    """
    path = out / FACTS_FOLDER / f"{name}.json"
    wanted = {field.name for field in dataclasses.fields(Inspection)}
    read = {"data": data, "downscale": downscale, "color_space": color_space}
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        if read.items() <= stored.items() and stored["facts"].keys() == wanted:
            return stored["facts"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        pass  # not inspected yet, or unreadable
    facts = dataclasses.asdict(inspect(folder, downscale, color_space))
    if downscale not in (None, 1.0):
        facts |= {"noise_floor": None, "reference_floor": None}
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(read | {"facts": facts}, indent=1) + "\n", encoding="utf-8")
    return facts


def scene_line(name: str, facts: dict[str, Any]) -> str:
    """``demo (interior): 200×200, 18 train, 17 test; …``, for the data set named ``name`` in the plan."""
    parts = []
    if facts.get("resolution"):
        parts.append("×".join(str(side) for side in facts["resolution"]))
    parts += [f"{split['poses']} {name}" for name, split in facts.get("splits", {}).items()]
    if points := facts.get("points"):
        kind = facts.get("points_origin") or "kind unknown"
        parts.append(f"{points:,} points of its own ({kind})")
    if exposures := facts.get("exposures"):
        parts.append(f"exposures EV {_numbers(exposure['ev'] for exposure in exposures)}")
    parts.append(f"response {facts.get('response') or 'unknown'}")
    camera = {key: value for key, value in facts.get("camera", {}).items() if isinstance(value, int | float)}
    if camera:
        parts.append("camera: " + ", ".join(f"{key} {value:g}" for key, value in camera.items()))
    stops = (facts.get("dynamic_range") or {}).get("stops")
    if stops is not None:
        parts.append(f"{stops:g} stops")
    if samples := facts.get("samples"):
        parts.append(f"{samples_in_words(samples)} samples a pixel")
    if floor := facts.get("noise_floor"):
        parts.append(f"two renders of a test view agree to {floor_in_words(floor)}")
    if floor := facts.get("reference_floor"):
        parts.append(f"the stored one and one without denoising to {floor_in_words(floor)}")
    scene = facts.get("scene", "")
    return f"{name}{f' ({scene})' if scene not in ('', name) else ''}: {', '.join(parts)}"


def machine_lines(records: Iterable[Record]) -> list[str]:
    """All kinds of machines and sets of versions used for runs; [] for none."""
    kinds: dict[str, int] = {}
    versions: dict[str, int] = {}
    for record in records:
        machine = record.machine
        if not machine:
            continue
        memory = f", {machine['memory'] / 2**30:.0f} GiB" if machine.get("memory") else ""
        on = machine.get("device", "cpu")
        device = "" if on == "cpu" else f", on {on}"
        kind = f"{machine.get('cpu')}, {machine.get('cores')} cores{memory}, {machine.get('system')}{device}"
        kind += f"; {counted(record.threads, 'thread')} a run"
        kinds[kind] = kinds.get(kind, 0) + 1
        version = ", ".join(f"{name} {value}" for name, value in machine.get("versions", {}).items())
        versions[version] = versions.get(version, 0) + 1

    def lines_of(what: str, counts: dict[str, int]) -> list[str]:
        if len(counts) == 1:
            return [f"{what}: {next(iter(counts))}"]
        return [f"{what} ({count} runs): {text}" for text, count in counts.items()]

    lines = lines_of("machine", kinds) + lines_of("versions", versions)
    if len(kinds) > 1:
        lines.append("**the runs are from different machines or numbers of threads: do not compare seconds**")
    if len(versions) > 1:
        lines.append("the runs are from several states of the code (commits; + with changes)")
    return lines


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)
