# SPDX-License-Identifier: GPL-3.0-or-later
"""How well photographs relight: rendered rooms, photographed, prepared, trained and evaluated.

    .venvs/backend/bin/python lab/tools/relight_photos.py CAPTURE … --out FOLDER --places 1 2 4 8 16

Of each capture, photos of all its places by a camera with faults, and of as many places as ``--places`` says
with each lamp off, and in the evening (daylight at an unknown level). Each set of photos is trained from as a
user would. Beside them stand the same photos without groups, and raw files of a camera without faults with
true poses and levels. FOLDER/table.md has the test views under light that no photo has, against true
radiance. What is there is not made again: interrupted, the same command resumes.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
TOOLS, PYTHON = ROOT / "lab" / "tools", Path(sys.executable)
PHYSHDR = PYTHON.parent / "physhdr"
#: The camera: hand-held, ISO 800, an sRGB-like response, and what automatic settings get wrong.
CAMERA = ("--bracket=-3,0,3", "--crf", "srgb", "--iso", "800")
FAULTS = ("--exposure-jitter", "0.1", "--white-balance-jitter", "0.05", "--vignetting", "0.5")
#: Daylight in the evening, as a factor on that of the standard photos; training has to find it.
AMBIENT, DAYLIGHT, EVENING = "ambient", "daylight", 0.2
LEVELS = (0.0, 0.25, 4.0)
#: Places of each group where the number of places is not what is varied.
USUAL = 8


@dataclass(frozen=True)
class Case:
    """One training. ``places`` of each group, 0 without any; ``exact``: raw files, true poses and levels."""

    places: int
    exact: bool = False

    @property
    def name(self) -> str:
        return "exact" if self.exact else f"places_{self.places}"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--places", type=int, nargs="+", default=[USUAL])
    parser.add_argument("--iterations", type=int, default=None, help="of each training")
    given = parser.parse_args()
    cases = [*(Case(places) for places in sorted({0, *given.places})), Case(USUAL, exact=True)]
    rows: dict[str, dict[str, Any]] = {}
    for capture in given.captures:
        for case in cases:
            folder = given.out / capture.name / case.name
            rows[f"{capture.name} {case.name}"] = _measured(capture, case, folder, given.iterations)
            (given.out / "table.md").write_text(_table(rows), encoding="utf-8")
    return 0


def _measured(capture: Path, case: Case, folder: Path, iterations: int | None) -> dict[str, Any]:
    """The evaluation of one case; makes what is missing of it in ``folder``."""
    lights = json.loads((capture / "capture.json").read_text(encoding="utf-8"))["lights"]
    lamps = [light for light in lights if light != AMBIENT]
    photos, data, run = folder / "taken", folder / "data", folder / "run"
    if not (photos / "done").exists():
        _take(capture, case, lamps, photos)
        (photos / "done").touch()
    if not (data / "test_hdr").exists():
        _prepare(capture, case, lamps, photos, data)
    if not (run / "trained").exists():
        length = () if iterations is None else ("--iterations", str(iterations))
        _run(PHYSHDR, "train", data, "--out", run, "--overwrite", *length)
        (run / "trained").touch()
    if not (run / "evaluation.json").exists():
        _run(PHYSHDR, "evaluate", run)
    return json.loads((run / "evaluation.json").read_text(encoding="utf-8"))


def _take(capture: Path, case: Case, lamps: Sequence[str], photos: Path) -> None:
    """Photos under the standard light, and from ``case.places`` of the places under each other one."""
    levels = {f"{lamp} off": f"{lamp}=0" for lamp in lamps} | {f"{DAYLIGHT} evening": f"{AMBIENT}={EVENING}"}
    camera = (*CAMERA, *(("--format", "dng") if case.exact else FAULTS))
    groups = [("--group", name, level, str(case.places)) for name, level in levels.items() if case.places]
    words = [word for group in groups for word in group]
    _run(PYTHON, TOOLS / "take_photos.py", capture, "--out", photos, *camera, *words)


def _prepare(capture: Path, case: Case, lamps: Sequence[str], photos: Path, data: Path) -> None:
    """The data set as a user gets it, and beside its test views true radiance, also under other light."""
    evening = str(EVENING) if case.exact else "evening"
    lights = [f"{lamp}={photos / f'{lamp} off'}:off" for lamp in lamps]
    lights += [f"{DAYLIGHT}={photos / f'{DAYLIGHT} evening'}:{evening}"]
    words = [word for light in lights if case.places for word in ("--light", light)]
    poses = ("--poses", photos / "truth") if case.exact else ()
    _run(PHYSHDR, "prepare", photos / "photos", "--out", data, "--overwrite", *words, *poses)
    relit = [",".join(f"{light}={level:g}" for light, level in each.items()) for each in _mixtures(lamps)]
    called = ("--called", f"{DAYLIGHT}={AMBIENT}")
    _run(PYTHON, TOOLS / "capture_truth.py", data, capture, photos, "--relit", *relit, *called)


def _mixtures(lamps: Sequence[str]) -> Iterator[Mapping[str, float]]:
    """Each light at each of ``LEVELS``, and two of them changed at once."""
    lights = [*lamps, DAYLIGHT]
    for light in lights:
        yield from ({light: level} for level in LEVELS)
    for one, other in zip(lights, [*lights[1:], lights[0]], strict=True):
        yield {one: 0.0, other: 4.0}


def _run(*words: str | Path) -> None:
    print("+", *words, flush=True)
    subprocess.run([str(word) for word in words], check=True)


def _table(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Means in dB; ``light left``: of the light that is off and of which most remains."""
    heading = "photos | LDR | HDR aligned | held-out lit photos | gain | relit | level × truth | best × truth"
    heading += " | light left"
    lines = [f"| {heading} |", "|---" + "|---:" * heading.count("|") + "|"]
    for name, found in rows.items():
        means, relit = found["means"], found["relit_means"]
        lit = found["lit_means"].get("all") or {}
        left = [each["light_left"] for each in relit.values() if each["light_left"] is not None]
        cells = [_cell((means.get(part) or {}).get("psnr")) for part in ("LDR-OE", "HDR, scale aligned")]
        cells += [_cell(lit.get("ours")), _cell(lit.get("gain"), "+.2f")]
        parts = ("ours", "scaled_truth", "best_scaled_truth")
        cells += [_cell(relit.get("all", {}).get(part)) for part in parts]
        cells += [_cell(max(left, key=abs) if left else None, "+.1%")]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _cell(value: float | None, form: str = ".2f") -> str:
    return "–" if value is None else format(value, form)


if __name__ == "__main__":
    sys.exit(main())
