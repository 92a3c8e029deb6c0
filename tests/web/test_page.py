# SPDX-License-Identifier: GPL-3.0-or-later
"""A web page in headless Chromium, opened from disk, against ``physhdr render``'s picture of the same view.

Sliders, lists and keys are moved as a user does, through the page's own controls.
"""

import io
import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from physhdr.backend.cli import main
from physhdr.backend.runs.run import open_run

ROOT = Path(__file__).resolve().parents[2]
EARLIER = ROOT / "tests" / "fixtures" / "e7440a3"
DEMO = ROOT / "runs" / "demo"
#: What the page must keep to, against ``physhdr render``.
DECIBELS = 38.0
SIDE = 200


def psnr(one: np.ndarray, other: np.ndarray) -> float:
    """Of two ``[H, W, 3]`` uint8 pictures, dB; equal ones have 100."""
    assert one.shape == other.shape
    error = np.mean((one.astype(np.float64) - other) ** 2) / 255.0**2
    return 100.0 if error == 0.0 else -10.0 * math.log10(error)


def pixels(png: bytes | Path) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png) if isinstance(png, bytes) else png).convert("RGB"))


def rendered(run: Path, view: str, exposure: float, levels: dict[str, float], out: Path) -> np.ndarray:
    """What ``physhdr render`` makes of it."""
    named = [f"{name}={level}" for name, level in levels.items()]
    words = ["render", str(run), "--out", str(out), "--view", view, "--exposure", str(exposure)]
    assert main([*words, "--width", str(SIDE), "--lighting-levels", *named]) == 0
    return pixels(out)


@pytest.fixture(scope="session")
def two_lights(tmp_path_factory) -> tuple[Path, Path]:
    """A small run with two lights, and its page's folder."""
    folder = tmp_path_factory.mktemp("two") / "run"
    shutil.copytree(EARLIER / "default_two_lights", folder)
    data, out = EARLIER / "data_two_lights", folder.parent / "page"
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | {"data": str(data)}))
    assert main(["export", str(folder), "--web", str(out)]) == 0
    return folder, out


@pytest.fixture(scope="session")
def demo(tmp_path_factory) -> tuple[Path, Path]:
    """The demo's run, and its page as one file."""
    if not (DEMO / "checkpoint.safetensors").is_file():
        pytest.skip("there is no runs/demo: make demo trains it")
    out = tmp_path_factory.mktemp("demo") / "demo.html"
    assert main(["export", str(DEMO), "--web", str(out), "--single-file"]) == 0
    return DEMO, out


def views_of(run: Path) -> list[str]:
    """Two cameras: a test view, and one of training."""
    scene = open_run(run, pictures=False).scene
    return [f"test/{scene.test[0].index}", f"train/{scene.train[1].index}"]


@pytest.mark.parametrize("which", ["two_lights", "demo"])
def test_the_page_shows_what_render_draws(which, request, visit, tmp_path):
    run, page_path = request.getfixturevalue(which)
    page_file = page_path if page_path.is_file() else page_path / "index.html"
    lights = open_run(run, pictures=False).method.lights
    page = visit(SIDE, SIDE, reduced_motion="reduce")
    assert page.open(page_file.as_uri()) == "settled"
    page.page.locator("#unfold").click()
    found = {}
    for view in views_of(run):
        page.page.locator("#camera").select_option(label=view)
        for exposure in (0.5, 4.0):
            page.slide("exposure", math.log2(exposure))
            for stops in (-2.0, 0.0, 2.0):
                # Each light another way, so that none stands in for another.
                levels = {name: 2.0 ** (stops * (-1) ** k) for k, name in enumerate(lights)}
                for k, level in enumerate(levels.values()):
                    page.slide(f"light-{k}", math.log2(level))
                page.page.wait_for_timeout(900)  # flights between cameras end
                picture = pixels(page.picture())
                truth = rendered(run, view, exposure, levels, tmp_path / "truth.png")
                found[view, exposure, stops] = psnr(picture, truth)
    print({key: round(value, 1) for key, value in found.items()})
    assert min(found.values()) >= DECIBELS, found
    # What is compared is not black, and the controls change it.
    assert picture.max() > 64
    assert page.told == []
    # Nothing but the page's own files, and what it made itself.
    own = page_file.parent.as_uri()
    assert all(url.startswith((own, "data:", "blob:")) for url in page.asked), page.asked
