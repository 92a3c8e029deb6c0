# SPDX-License-Identifier: GPL-3.0-or-later
"""What a training is said to take: against the peak of a real one, and what is told where it cannot fit."""

import dataclasses
import json
import re
import subprocess
import sys

import pytest
import torch

from physhdr.backend import memory as rooms
from physhdr.backend.memory import LEAST_OF_PICTURES, NotEnoughMemoryError, Room, picture_room
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.encoding import SRGB
from physhdr.backend.scene.scene import PictureCache
from physhdr.backend.train.config import TrainConfig
from physhdr.backend.train.forecast import memory
from physhdr.backend.train.forecast.memory import check_memory, estimate, sizes_of
from physhdr.backend.train.plan import planned
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.settings import assigned, with_settings
from physhdr.backend.train.targets import TARGET_BYTES

CPU = torch.device("cpu")

#: Trains in a process of its own, whose peak is its own too; prints what was estimated and what it was.
TRAINING = """
import dataclasses, json, sys
from pathlib import Path
from physhdr.backend.scene import read_scene
from physhdr.backend.train.forecast.memory import estimate, sizes_of
from physhdr.backend.train.plan import planned
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.begin import begin
from physhdr.backend.train.trainer import step

preset, data, count = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
config = PRESETS[preset]
config = dataclasses.replace(
    config, iterations=30, initial_points="random", random_points=count, half_size_until=0.0,
    backbone=dataclasses.replace(config.backbone, start=5, every=5, stop=0.9, budget=count),
)
scene = read_scene(data)
state = begin(scene, config)
for _ in range(config.iterations):
    step(state)
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
needed = estimate(sizes_of(planned(scene, config)))
print(json.dumps([needed.total, int(peak.split()[1]) * 1024, state.method.size]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads the peak from /proc")
@pytest.mark.long
@pytest.mark.parametrize(("preset", "count"), [("default", 60_000), ("paper", 30_000)])
def test_the_estimate_holds_for_a_training(preset, count, tiny_data):
    command = [sys.executable, "-c", TRAINING, preset, str(tiny_data), str(count)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    needed, peak, size = json.loads(done.stdout.splitlines()[-1])
    assert size == count
    assert 0.9 < needed / peak < 1.5


@pytest.fixture(scope="module")
def scene(tiny_data):
    return read_scene(tiny_data)


@pytest.fixture(autouse=True)
def picture_room_of_this_machine():
    """What a test has said of the room is asked anew after it."""
    yield
    rooms.picture_room.cache_clear()


def with_room(monkeypatch, megabytes: float, bound: str = "machine") -> None:
    """The estimates', and of pictures, which ask ``backend.memory`` itself."""
    there = Room(int(megabytes * 1e6), bound)
    monkeypatch.setattr(memory, "room", lambda: there)
    monkeypatch.setattr(rooms, "room", lambda: there)
    rooms.picture_room.cache_clear()


def test_a_line_says_what_a_training_takes_and_what_is_free(monkeypatch, scene):
    with_room(monkeypatch, 21_000)
    told = []
    needed = check_memory(planned(scene, PRESETS["default"]), CPU, told.append)
    assert len(told) == 1
    assert re.fullmatch(
        r"training will take about 0\.\d GB: less than 0\.1 for pictures, 0\.2 for 60,000 Gaussians, "
        r"0\.\d for the program and one iteration; 21 GB are free",
        told[0],
    )
    larger = max(needed.start, needed.iteration)
    assert needed.total == needed.program + needed.pictures + needed.gaussians + larger


def settings_in(error: NotEnoughMemoryError) -> list[str]:
    """The settings that a refusal names, each with its value."""
    found = re.findall(r"--set ([\w.]+=\d+)|--(downscale) (\d+)", error.hint)
    return [assignment or f"{name}={value}" for assignment, name, value in found]


@pytest.mark.parametrize("preset", ["default", "paper", "default-scaffold", "gausshdr"])
def test_what_cannot_fit_is_refused_with_options_of_which_each_makes_it_fit(monkeypatch, preset, tiny_data):
    config = dataclasses.replace(PRESETS[preset], initial_points="random", random_points=8000)
    config = dataclasses.replace(config, backbone=dataclasses.replace(config.backbone, budget=1_000_000))
    with_room(monkeypatch, 1500)
    with pytest.raises(NotEnoughMemoryError, match=r"1,000,000 Gaussians.*1\.5 GB are free") as refused:
        check_memory(planned(read_scene(tiny_data), config), CPU, lambda _: None)
    assert refused.value.code == "not_enough_memory" and "Close other programs" in refused.value.hint
    found = settings_in(refused.value)
    assert found
    for assignment in found:
        changed = with_settings(config, assigned(config, [assignment]))
        check_memory(planned(read_scene(tiny_data, changed.downscale), changed), CPU, lambda _: None)


def test_large_pictures_are_refused_with_the_size_that_fits(monkeypatch, tiny_data):
    scene = read_scene(tiny_data)
    large = [dataclasses.replace(view, camera=view.camera.resized(4000)) for view in scene.train]
    scene = dataclasses.replace(scene, train=large, lit=[])
    with_room(monkeypatch, 6000, "container")
    with pytest.raises(NotEnoughMemoryError, match=r"the container's limit leaves 6\.0 GB") as refused:
        check_memory(planned(scene, PRESETS["default"]), CPU, lambda _: None)
    assert "downscale=2" in settings_in(refused.value) and "container's memory" in refused.value.hint


@pytest.mark.parametrize(
    ("megabytes", "kept"), [(600, LEAST_OF_PICTURES), (4000, LEAST_OF_PICTURES), (64_000, 16_000_000_000)]
)
def test_pictures_are_kept_in_a_quarter_of_the_room(monkeypatch, megabytes, kept, tiny_data):
    with_room(monkeypatch, megabytes)
    assert picture_room() == kept == PictureCache().budget
    sizes = dataclasses.replace(
        sizes_of(planned(read_scene(tiny_data), PRESETS["default"])), picture_bytes=1 << 40
    )
    assert estimate(dataclasses.replace(sizes, merges=False)).pictures == kept + TARGET_BYTES
    assert estimate(dataclasses.replace(sizes, merges=True)).pictures == 2 * kept + TARGET_BYTES
    monkeypatch.setattr(rooms, "room", lambda: Room(10**12, "machine"))
    assert picture_room() == kept, "what was told before a training holds"


def test_of_a_run_that_goes_on_no_option_is_named(monkeypatch, scene):
    with_room(monkeypatch, 600, "addresses")
    with pytest.raises(NotEnoughMemoryError, match=r"ulimit -v leaves 0\.6 GB") as refused:
        check_memory(planned(scene, PRESETS["default"]), CPU, lambda _: None, resumed=True)
    assert not settings_in(refused.value) and "ulimit -v unlimited" in refused.value.hint


def test_growth_without_a_bound_is_told_as_a_guess(monkeypatch, scene):
    with_room(monkeypatch, 90_000)
    told = []
    check_memory(planned(scene, PRESETS["paper"]), CPU, told.append)
    assert "for perhaps" in told[0]


def test_a_method_without_gaussians_has_an_estimate(monkeypatch, scene):
    with_room(monkeypatch, 21_000)
    told = []
    check_memory(planned(scene, PRESETS["hdr-nerf"]), CPU, told.append)
    assert "Gaussians" not in told[0]


def test_asking_changes_no_random_number(scene):
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    estimate(sizes_of(planned(scene, PRESETS["paper"])))
    assert torch.equal(torch.rand(4), expected)


def test_on_a_card_its_own_memory_counts_beside_the_machine_s(monkeypatch, scene):
    with_room(monkeypatch, 21_000)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda _: (300_000_000, 8_000_000_000))
    monkeypatch.setattr(torch.cuda, "memory_reserved", lambda _: 0)
    with pytest.raises(NotEnoughMemoryError, match=r"0\.3 GB are free on the card") as refused:
        check_memory(planned(scene, PRESETS["default"]), torch.device("cuda"), lambda _: None)
    assert "--device cpu" in refused.value.hint


def test_threads_that_seek_the_first_points_take_the_machine_s_memory_and_no_card_s(monkeypatch, scene):
    """Of a machine with many cores they take gigabytes, and a card of four has none for them."""
    with_room(monkeypatch, 21_000)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda _: (8_000_000_000, 8_000_000_000))
    monkeypatch.setattr(torch.cuda, "memory_reserved", lambda _: 0)

    def told(cores: int) -> tuple[int, int]:
        monkeypatch.setattr(memory, "cores", lambda: cores)
        needed = [
            check_memory(planned(scene, PRESETS["default"]), torch.device(kind), lambda _: None)
            for kind in ("cuda", "cpu")
        ]
        return needed[0].total, needed[1].total

    (few_on_card, few), (many_on_card, many) = told(2), told(128)
    assert many_on_card == few_on_card < few
    assert many > few
    with_room(monkeypatch, 600)
    monkeypatch.setattr(memory, "cores", lambda: 128)
    with pytest.raises(NotEnoughMemoryError, match=r"about \d\.\d GB; 0\.6 GB are free\n"):
        check_memory(planned(scene, PRESETS["default"]), torch.device("cuda"), lambda _: None)


def test_developed_pictures_have_16_bits_and_a_mask_has_8_of_a_pixel(scene):
    def with_sources(**changes):
        views = [
            dataclasses.replace(
                view, sources=tuple(dataclasses.replace(source, **changes) for source in view.sources)
            )
            for view in scene.train
        ]
        return sizes_of(planned(dataclasses.replace(scene, train=views, lit=[]), TrainConfig())).picture_bytes

    of_8_bits = with_sources()
    assert with_sources(encoding=SRGB) == 2 * of_8_bits
    assert with_sources(mask_path=scene.root / "mask.png") == of_8_bits * 4 // 3
