# SPDX-License-Identifier: GPL-3.0-or-later
"""What a reader of the report must know of the data sets and machines; kept in the benchmark's folder."""

import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ...bridge.atomic import atomic_path
from ..inspect import inspect
from .plan import SceneFolder
from .runs import Record

FACTS_FOLDER = "facts"


def scene_facts(out: Path, scene: SceneFolder, data: str) -> dict[str, Any]:
    """What ``physhdr inspect`` finds in a data set; looked at once for each ``data`` fingerprint."""
    path = out / FACTS_FOLDER / f"{scene.name}.json"
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept["data"] == data:
            return kept["facts"]
    except (OSError, ValueError, KeyError, TypeError):
        pass  # not looked at yet, or not readable: look again
    facts = dataclasses.asdict(inspect(scene.data))
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps({"data": data, "facts": facts}, indent=1) + "\n", encoding="utf-8")
    return facts


def scene_line(scene: SceneFolder, facts: dict[str, Any]) -> str:
    """``demo (interior): 200×200, 18 train, 17 test; …``."""
    parts = []
    if facts.get("resolution"):
        parts.append("×".join(str(side) for side in facts["resolution"]))
    parts += [f"{split['poses']} {name}" for name, split in facts.get("splits", {}).items()]
    if exposures := facts.get("exposures"):
        parts.append(f"exposures EV {_numbers(exposure['ev'] for exposure in exposures)}")
    parts.append(f"response {facts.get('response') or 'unknown'}")
    camera = {key: value for key, value in facts.get("camera", {}).items() if isinstance(value, int | float)}
    if camera:
        parts.append("camera: " + ", ".join(f"{key} {value:g}" for key, value in camera.items()))
    stops = (facts.get("dynamic_range") or {}).get("stops")
    if stops is not None:
        parts.append(f"{stops:g} stops")
    samples = facts.get("renders", {}).get("samples")
    if samples:
        least, most = min(samples), max(samples)
        parts.append(f"{least:g}{'' if least == most else f' … {most:g}'} samples a pixel")
    floor = facts.get("noise_floor") or {}
    if floor.get("psnr"):
        hdr = floor.get("hdr_psnr")
        parts.append(
            f"two renders agree to {_numbers(floor['psnr'])} dB"
            + (f", HDR {hdr:g} dB" if isinstance(hdr, int | float) else "")
        )
    name = facts.get("scene", "")
    return f"{scene.name}{f' ({name})' if name not in ('', scene.name) else ''}: {', '.join(parts)}"


def machine_lines(records: Iterable[Record]) -> list[str]:
    """Every kind of machine and every set of versions that runs were done with; [] for none."""
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
        kind += f"; {record.threads} thread{'s' if record.threads > 1 else ''} a run"
        kinds[kind] = kinds.get(kind, 0) + 1
        version = ", ".join(f"{name} {value}" for name, value in machine.get("versions", {}).items())
        versions[version] = versions.get(version, 0) + 1

    def told(what: str, counts: dict[str, int]) -> list[str]:
        if len(counts) == 1:
            return [f"{what}: {next(iter(counts))}"]
        return [f"{what} ({count} runs): {text}" for text, count in counts.items()]

    lines = told("machine", kinds) + told("versions", versions)
    if len(kinds) > 1:
        lines.append("**the runs are not of one machine with one number of threads: compare no seconds**")
    if len(versions) > 1:
        lines.append("the runs are of several states of the code (commits; + with changes)")
    return lines


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)
