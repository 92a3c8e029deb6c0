# SPDX-License-Identifier: GPL-3.0-or-later
"""Training as a whole, on a data set of 60 Gaussians whose truth is known."""

import dataclasses
import json
import math
import shutil
import signal

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from scipy.spatial import KDTree

from physhdr.backend.evaluate.protocol import evaluate
from physhdr.backend.kernels.activations import LOG_RADIANCE_RANGE
from physhdr.backend.runs.monitor import view_monitor
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.encoding import LogEncoding
from physhdr.backend.scene.pictures import read_exr, write_exr, write_png
from physhdr.backend.scene.scene import Points
from physhdr.backend.train.begin import begin, resume
from physhdr.backend.train.checkpoint import METADATA, load_checkpoint, read_metadata, save_checkpoint
from physhdr.backend.train.config import fingerprint, in_iterations, read_config, write_config
from physhdr.backend.train.densify import GaussiansConfig
from physhdr.backend.train.growth import NoGaussiansLeftError
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.saver import load_method, save
from physhdr.backend.train.state import TrainingDivergedError
from physhdr.backend.train.trainer import run, step
from physhdr.backend.train.views import log_radiance_range
from physhdr.bridge.errors import (
    BadValueError,
    DataMismatchError,
    FileDamagedError,
    FileMissingError,
    OutputError,
)
from physhdr.bridge.run_folder import CHECKPOINT_FILE
from physhdr.lab.anchors.config import AnchorsConfig
from physhdr.lab.peers.hdr_nerf import HDRNeRFConfig

#: One preset of each method on Gaussians; others differ from them in numbers alone.
ON_GAUSSIANS = ["default", "baseline", "paper", "gausshdr", "hdr-gs"]
#: HDR-NeRF at its published size is too slow for a test; the small one is the same code.
EVERY_METHOD = [*ON_GAUSSIANS, "default-scaffold", "hdr-nerf-small"]
ON_ANCHORS = [f"{name}-scaffold" for name in ("baseline", "paper", "gausshdr")]


def short(preset: str, iterations: int = 24, **changes):
    """A preset, shortened so that densification and an opacity reset still happen."""
    config = PRESETS[preset]
    if isinstance(config.backbone, GaussiansConfig):
        density = dataclasses.replace(
            config.backbone, start=5, every=6, stop=0.8, threshold=1e-5, reset_every=15, prune_scale=10.0
        )
        config = dataclasses.replace(config, backbone=density)
    return dataclasses.replace(config, iterations=iterations, sh_degree_every=6, **changes)


def train(scene, config, folder, stop_at=None):
    folder.mkdir(parents=True, exist_ok=True)
    state = begin(scene, config)
    # With the monitor that the command line uses: it may look at the truth, training must not notice.
    stop = lambda: stop_at is not None and state.iteration >= stop_at  # noqa: E731
    for _ in run(state, folder, should_stop=stop, monitor=view_monitor(scene), monitor_every=20):
        pass
    return state


def weights(folder):
    return load_checkpoint(folder / CHECKPOINT_FILE)[0]


def assert_identical(first, second):
    assert first.keys() == second.keys()
    for name in first:
        assert torch.equal(first[name], second[name]), name


@pytest.mark.long
def test_a_schedule_given_for_another_length_is_stretched(tiny_data, tmp_path):
    """For 240 iterations, in a training of 24: each step is a tenth, and nothing else differs."""
    config = short("paper")
    steps = dataclasses.replace(config.backbone, start=50, every=60, reset_every=150)
    given = dataclasses.replace(config, backbone=steps, sh_degree_every=60, schedule_for=240)
    scene = read_scene(tiny_data)
    for name, each in (("plain", config), ("stretched", given)):
        train(scene, each, tmp_path / name)
    assert_identical(weights(tmp_path / "plain"), weights(tmp_path / "stretched"))
    shown = [
        load_method(tmp_path / name, each, scene.response_anchor)[0].active_sh_degree
        for name, each in (("plain", config), ("stretched", given))
    ]
    assert shown == [3, 3]


def test_steps_of_a_stretched_schedule_are_whole_and_at_least_one():
    paper = dataclasses.replace(PRESETS["paper"], iterations=1000, schedule_for=30_000)
    there = in_iterations(paper)
    assert (there.sh_degree_every, there.backbone.every, there.backbone.reset_every) == (33, 3, 100)
    assert in_iterations(dataclasses.replace(paper, iterations=10)).backbone.every == 1
    never = in_iterations(dataclasses.replace(PRESETS["default"], iterations=5000, schedule_for=2500))
    assert (never.backbone.reset_every, never.backbone.every, never.sh_degree_every) == (0, 200, 300)
    assert in_iterations(PRESETS["default"]) == PRESETS["default"]


@pytest.mark.parametrize(
    ("preset", "data"),
    [
        *((name, "tiny_data") for name in ON_GAUSSIANS if name != "paper"),
        pytest.param("paper", "tiny_data", marks=pytest.mark.long),
        ("default", "two_lights_data"),
    ],
)
def test_a_stopped_and_resumed_run_is_bit_identical(preset, data, request, tmp_path):
    scene, config = read_scene(request.getfixturevalue(data)), short(preset)
    whole = train(scene, config, tmp_path / "whole")
    train(scene, config, tmp_path / "parts", stop_at=10)
    assert load_checkpoint(tmp_path / "parts" / CHECKPOINT_FILE)[1]["iteration"] == "10"
    resumed = resume(tmp_path / "parts", scene, config)
    for _ in run(resumed, tmp_path / "parts"):
        pass
    assert len(whole.method.gaussians) > 60  # densification took part
    assert_identical(weights(tmp_path / "whole"), weights(tmp_path / "parts"))


def test_a_resumed_training_searches_no_points_and_goes_on_counting_seconds(tiny_data, tmp_path, monkeypatch):
    scene, config = read_scene(tiny_data), short("default", iterations=12)
    stopped = train(scene, config, tmp_path, stop_at=5)
    spent = stopped.seconds, stopped.cpu_seconds
    monkeypatch.delattr("physhdr.backend.train.begin.place")
    resumed = resume(tmp_path, scene, config)
    assert (resumed.seconds, resumed.cpu_seconds) == pytest.approx(spent, abs=1e-3)
    *_, last = run(resumed, tmp_path)
    assert last.seconds > spent[0] and last.cpu_seconds > spent[1]
    assert not last.stopped and last.iteration == 12


@pytest.mark.parametrize(
    "preset", [*EVERY_METHOD, *(pytest.param(name, marks=pytest.mark.long) for name in ON_ANCHORS)]
)
def test_ground_truth_is_not_read(preset, tiny_data, tmp_path):
    """Law 6: with every true radiance replaced by noise, training gives the same weights."""
    spoiled = tmp_path / "spoiled"
    shutil.copytree(tiny_data, spoiled)
    rng = np.random.default_rng(1)
    truths = [*spoiled.glob("*_hdr/*.exr"), *spoiled.glob("relit/*/*.exr")]
    assert len(truths) == 6 + 2 + 2
    for path in truths:
        write_exr(path, rng.uniform(0, 100, read_exr(path).shape).astype(np.float32))
    (spoiled / "passes").mkdir()  # the light of each group, which the tiny data do not have
    write_exr(spoiled / "passes" / "train_000.exr", rng.uniform(0, 100, (24, 32, 3)).astype(np.float32))
    config = short(preset, iterations=12)
    train(read_scene(tiny_data), config, tmp_path / "clean_run")
    train(read_scene(spoiled), config, tmp_path / "spoiled_run")
    assert_identical(weights(tmp_path / "clean_run"), weights(tmp_path / "spoiled_run"))


@pytest.mark.long
def test_training_recovers_radiance_and_light(tiny_data, tmp_path):
    """After a few hundred iterations test views, their absolute HDR scale and relighting are right."""
    scene = read_scene(tiny_data)
    # The truth has a Gaussian at each first point and no directions: three small views would overfit more.
    config = dataclasses.replace(
        PRESETS["default"], iterations=300, sh_degree_every=1000, backbone=GaussiansConfig(stop=0.0)
    )
    state = train(scene, config, tmp_path / "run")
    view = scene.test[0]

    def db(image, truth, peak):
        return -10 * np.log10(np.mean((image - truth) ** 2) / peak**2)

    truth = read_exr(tiny_data / "test_hdr" / "hdr_000.exr")
    hdr = state.method.hdr(view.camera).numpy().transpose(1, 2, 0)
    ratio = np.median(hdr / truth)
    assert 0.9 < ratio < 1.1
    relit_truth = read_exr(tiny_data / "relit" / "level_2" / "hdr_000.exr")
    relit = state.method.hdr(view.camera, 2.0).numpy().transpose(1, 2, 0)
    assert db(relit, relit_truth, relit_truth.max()) > db(2.0 * truth, relit_truth, relit_truth.max()) + 3


def test_training_separates_two_lights(two_lights_data, tmp_path):
    """Pairs of levels between and beyond the trained ones: far nearer than the best that scaling could do."""
    scene = read_scene(two_lights_data)
    config = dataclasses.replace(
        PRESETS["default"], iterations=300, sh_degree_every=1000, backbone=GaussiansConfig(stop=0.0)
    )
    state = train(scene, config, tmp_path / "run")
    assert state.method.lights == ("ambient", "pendant") and len(state.views) == 3 + 6
    result = evaluate(state.method, scene)
    assert len(result.relit_conditions) == 6
    mean = result.relit_mean()
    assert mean is not None and mean.gain_over_best_scaled_truth > 8.0 and mean.ours > 29.0
    for row in result.relit:
        assert row.gain_over_best_scaled_truth > 5.0, row
        assert 0.85 < row.scale_ratio < 1.15, row
    opened, _ = load_method(tmp_path / "run", config, scene.response_anchor)
    assert opened.lights == state.method.lights
    camera = scene.test[0].camera
    assert torch.equal(opened.hdr(camera, (0.5, 2.0)), state.method.hdr(camera, (0.5, 2.0)))


def test_a_checkpoint_names_its_lights(tiny_data, two_lights_data, tmp_path):
    config = short("default", iterations=12)
    for data, lights in ((tiny_data, ["ambient"]), (two_lights_data, ["ambient", "pendant"])):
        folder = tmp_path / str(len(lights))
        train(read_scene(data), config, folder)
        tensors, metadata = load_checkpoint(folder / CHECKPOINT_FILE)
        assert json.loads(metadata["lights"]) == lights
        assert tensors["gaussians.light_share_logits"].shape[1:] == (len(lights), 3)
    for folder, other in (("1", two_lights_data), ("2", tiny_data)):
        with pytest.raises(DataMismatchError, match=r"has levels of ambient[\s\S]*begun with"):
            resume(tmp_path / folder, read_scene(other), config)


def test_metadata_are_part_of_the_digest(tiny_data, tmp_path):
    """An iteration that is smaller, a name that is there twice: each would be believed."""
    scene, config = read_scene(tiny_data), short("default", iterations=12)
    train(scene, config, tmp_path, stop_at=5)
    path = tmp_path / CHECKPOINT_FILE
    good = path.read_bytes()
    _, metadata = load_checkpoint(path)
    others = {name: value + "0" for name, value in metadata.items()} | {
        "lights": '["lamp"]',
        "iteration": "4",
    }
    assert others.keys() >= {*METADATA, "digest"}
    for name, value in others.items():
        path.write_bytes(good)
        with safe_open(path, "pt") as file:
            save_file({key: file.get_tensor(key) for key in file.keys()}, path, metadata | {name: value})  # noqa: SIM118
        with pytest.raises((FileDamagedError, DataMismatchError), match=CHECKPOINT_FILE):
            resume(tmp_path, scene, config)
    path.write_bytes(good)
    assert resume(tmp_path, scene, config).iteration == 5


def test_a_checkpoint_may_hold_a_tensor_without_numbers(tmp_path):
    """Such as the learned levels of light, where all levels are known."""
    path = tmp_path / CHECKPOINT_FILE
    save_checkpoint(
        path, {"empty": torch.from_numpy(np.zeros(0)), "one": torch.ones(1)}, dict.fromkeys(METADATA, "")
    )
    tensors, _ = load_checkpoint(path)
    assert tensors["empty"].shape == (0,) and tensors["one"] == 1.0


@pytest.mark.parametrize("at", [b'"iteration":"5"', b'"networks.tone_mapper.b1":{', b'"__metadata__":{'])
def test_a_name_that_stands_twice_in_a_checkpoint_is_refused(at, tiny_data, tmp_path):
    """The library takes the last of them, another program the first."""
    scene, config = read_scene(tiny_data), short("default", iterations=12)
    train(scene, config, tmp_path, stop_at=5)
    path = tmp_path / CHECKPOINT_FILE
    good = path.read_bytes()
    size = int.from_bytes(good[:8], "little")
    header = good[8 : 8 + size].rstrip()
    start = header.index(at)
    end = header.index(b"}" if at.endswith(b"{") else b'"', start + len(at) - 1) + 1
    twice = header[:end] + b"," + header[start:end] + header[end:]
    assert json.loads(twice) == json.loads(header)
    path.write_bytes(len(twice).to_bytes(8, "little") + twice + good[8 + size :])
    for read in (load_checkpoint, read_metadata):
        with pytest.raises(FileDamagedError, match=CHECKPOINT_FILE):
            read(path)


def test_methods_that_know_one_light_train_on_two(two_lights_data, tmp_path):
    """They do not use the lit views."""
    scene = read_scene(two_lights_data)
    for preset in ("paper", "baseline"):
        state = train(scene, short(preset, iterations=4), tmp_path / preset)
        assert state.method.lights == ("ambient",) and len(state.views) == 3


def test_exp1_keeps_one_exposure_for_each_view(tiny_data):
    scene = read_scene(tiny_data)
    state = begin(scene, short("default", exposure_mode="exp1"))
    seen = {}
    for iteration in range(60):
        view, (k,) = state.draw(iteration)
        seen.setdefault(view.name, set()).add(k)
    assert all(len(ks) == 1 for ks in seen.values()) and len(seen) == 5
    everything = begin(scene, short("default"))
    drawn = [everything.draw(i) for i in range(300)]
    assert {k for _, ks in drawn for k in ks} == {0, 2, 4}
    whole = begin(scene, short("default", supervision="bracket"))
    assert whole.draw(0)[1] == (0, 2, 4)
    # each epoch shows each view once
    assert len({view.name for view, _ in drawn[:5]}) == 5


def test_lit_views_are_used_only_where_the_method_knows_light(tiny_data):
    scene = read_scene(tiny_data)
    assert len(begin(scene, short("default")).views) == 5
    assert len(begin(scene, short("paper")).views) == 3
    assert len(begin(scene, short("baseline")).views) == 3


def test_the_saved_method_renders_as_the_trained_one(tiny_data, tmp_path):
    scene, config = read_scene(tiny_data), short("paper")
    state = train(scene, config, tmp_path)
    method, iteration = load_method(tmp_path, config, scene.response_anchor)
    assert iteration == 24
    camera = scene.test[0].camera
    assert torch.equal(method.ldr(camera, 2.0), state.method.ldr(camera, 2.0))


def with_exposures_times(scene, factor):
    """The same pictures of a scene as much brighter; the response is not anchored, as of photographs."""

    def changed(views):
        scaled = lambda view: tuple(factor * exposure for exposure in view.exposures)  # noqa: E731
        return [dataclasses.replace(view, exposures=scaled(view)) for view in views]

    train, test = changed(scene.train), changed(scene.test)
    return dataclasses.replace(scene, train=train, test=test, lit=[], response_anchor=None)


def error_of(state):
    """Mean absolute difference from the training pictures."""
    errors = []
    for view in state.plan.seen.scene.train:
        for k, exposure in enumerate(view.exposures):
            picture = torch.from_numpy(view.values(k)).permute(2, 0, 1)
            errors.append((state.method.ldr(view.camera, exposure) - picture).abs().mean().item())
    return np.mean(errors)


@pytest.mark.parametrize(
    "preset", ["default", *(pytest.param(name, marks=pytest.mark.long) for name in ("baseline", "paper"))]
)
def test_the_unit_of_light_is_nothing_to_a_training(preset, tiny_data, tmp_path):
    """Photos in the sun take 1/8000 s, and white is a radiance of 8000, at ``LOG_RADIANCE_RANGE``'s end."""
    scene = read_scene(tiny_data)
    usual = train(with_exposures_times(scene, 1.0), short(preset), tmp_path / "usual")
    sun = train(with_exposures_times(scene, 2.0**-14), short(preset), tmp_path / "sun")
    assert error_of(sun) < 1.1 * error_of(usual)
    camera = scene.test[0].camera
    method, _ = load_method(tmp_path / "sun", short(preset), None)
    assert torch.equal(method.hdr(camera), sun.method.hdr(camera)), "its bounds are in the checkpoint"
    assert method.log_radiance_range[1] > LOG_RADIANCE_RANGE[1]


def test_bounds_of_radiance_are_those_of_the_pictures(tiny_data):
    views = read_scene(tiny_data).train
    every = [tuple(range(len(view.exposures))) for view in views]
    assert log_radiance_range(views, every) == LOG_RADIANCE_RANGE
    with_one = [dataclasses.replace(views[0], exposures=(0.1, 1.0, 10.0, 100.0, 1000.0)), *views[1:]]
    assert log_radiance_range(with_one, every) == (math.log(1 / 5000 / 1000.0), 9.0)
    assert log_radiance_range(with_one, [(0, 1, 2), *every[1:]]) == LOG_RADIANCE_RANGE, (
        "seen by training alone"
    )
    short_one = [dataclasses.replace(views[0], exposures=(1e-4, 1.0, 2.0, 3.0, 4.0)), *views[1:]]
    assert log_radiance_range(short_one, every) == (-12.0, math.log(200 / 1e-4))


def test_bounds_of_radiance_reach_as_far_as_pictures_of_radiance(tiny_data):
    """The sun's disc is 2e7 W/m²/sr; codes hold 5002 times the scale."""
    view = read_scene(tiny_data).train[0]
    source = dataclasses.replace(view.sources[0], encoding=LogEncoding(1e4))
    bright = dataclasses.replace(view, exposures=(1.0,), sources=(source,), bracket=())
    low, high = log_radiance_range([bright], [(0,)])
    assert (low, high) == (-12.0, pytest.approx(math.log(1e4 * 5001.0**2 / 5000.0)))


def test_a_diverged_run_says_so_and_keeps_the_last_good_checkpoint(tiny_data, tmp_path):
    scene, config = read_scene(tiny_data), short("default")
    state = begin(scene, config)
    good = save(state, tmp_path)
    with torch.no_grad():
        state.method.tone_mapper.b1.fill_(float("nan"))
    with pytest.raises(TrainingDivergedError, match="diverged at iteration"):
        list(run(state, tmp_path))
    assert load_checkpoint(tmp_path / CHECKPOINT_FILE)[1]["iteration"] == str(good.iteration)


def test_gaussians_that_are_not_finite_are_told_as_a_divergence(tiny_data, tmp_path):
    state = begin(read_scene(tiny_data), short("default"))
    with torch.no_grad():
        state.method.gaussians.parameters["means"][7] = math.nan
    with pytest.raises(TrainingDivergedError, match=r"diverged at iteration 0: means\[7\] of the Gaussians"):
        list(run(state, tmp_path))


def test_where_all_gaussians_would_go_training_ends_and_keeps_the_last_good_checkpoint(tiny_data, tmp_path):
    """Of cameras that only turn 3DGS's pruning by size, a share of how far they stand apart, leaves none."""
    scene = read_scene(tiny_data)

    def turned(view):
        pose = view.camera.camera_to_world.copy()
        pose[:3, 3] = (0.0, -4.0, 0.0)
        return dataclasses.replace(view, camera=dataclasses.replace(view.camera, camera_to_world=pose))

    scene = dataclasses.replace(scene, train=[turned(view) for view in scene.train], lit=[])
    config = short("hdr-gs", initial_points="file")
    config = dataclasses.replace(config, backbone=dataclasses.replace(config.backbone, prune_scale=0.1))
    state = begin(scene, config)
    save(state, tmp_path)
    with pytest.raises(NoGaussiansLeftError, match="after iteration 18 would remove all"):
        list(run(state, tmp_path))
    method, iteration = load_method(tmp_path, config, scene.response_anchor)
    assert iteration == 0 and len(method.gaussians) == len(scene.points.positions)


def first_message(state, folder):
    folder.mkdir(parents=True)
    return next(iter(run(state, folder))).message


def test_training_works_without_a_points_file(tiny_data, tmp_path):
    data = tmp_path / "data"
    shutil.copytree(tiny_data, data)
    (data / "points3d.ply").unlink()
    scene = read_scene(data)
    with pytest.raises(BadValueError, match=r"points3d\.ply(.|\n)*--initial-points auto"):
        begin(scene, short("default", initial_points="file"))
    state = begin(scene, short("default", initial_points="random", random_points=200))
    assert len(state.method.gaussians) == 200
    assert "200 random points (as asked for)" in first_message(state, tmp_path / "random")
    state = begin(scene, short("default"))
    step(state)
    assert "points by stereo" in first_message(state, tmp_path / "stereo")
    lonely = dataclasses.replace(scene, train=scene.train[:1], lit=[])
    state = begin(lonely, short("default", random_points=150))
    step(state)
    assert "150 random points (the data set has no points" in first_message(state, tmp_path / "one view")
    with pytest.raises(BadValueError, match=r"stereo found 0 points(.|\n)*--initial-points random"):
        begin(lonely, short("default", initial_points="stereo"))


def test_stereo_adds_points_where_the_data_set_has_none(tiny_data, tmp_path):
    scene = read_scene(tiny_data)
    positions = scene.points.positions
    left = positions[:, 0] < np.median(positions[:, 0])
    half = Points(positions[left], scene.points.colours[left])

    def start(points, source):
        state = begin(dataclasses.replace(scene, points=points), short("default", initial_points=source))
        return state, {tuple(p) for p in state.method.gaussians.means.detach().tolist()}

    (_, given), (_, seen) = start(half, "file"), start(half, "stereo")
    state, both = start(half, "both")
    assert given < both <= given | seen and f"{len(both - given):,} more by stereo" in state.start_message
    spare = np.array(sorted(seen - both))  # these have a given point near them, the added ones have none
    nearest = KDTree(positions[left]).query
    assert nearest(spare)[0].max() < np.median(nearest(np.array(sorted(both - given)))[0])
    assert len(start(scene.points, "both")[1]) - len(positions) < len(both - given)
    lonely = dataclasses.replace(scene, train=scene.train[:1], lit=[])  # no stereo: the data set's alone
    assert len(begin(lonely, short("default")).method.gaussians) == len(positions)


def test_the_start_sees_only_what_training_may(tiny_data, tmp_path):
    """Points by stereo stay the same when everything is noise that is not for training (at this light)."""
    clean, spoiled = tmp_path / "clean", tmp_path / "spoiled"
    shutil.copytree(tiny_data, clean)
    (clean / "points3d.ply").unlink()
    shutil.copytree(clean, spoiled)
    rng = np.random.default_rng(1)

    def spoil(*patterns):
        paths = [path for pattern in patterns for path in spoiled.glob(pattern)]
        for path in paths:
            write_png(path, rng.integers(0, 256, (32, 32, 3), dtype=np.uint8))
        return len(paths)

    def means(data, **changes):
        config = short("default", initial_points="stereo")
        tone_mapper = dataclasses.replace(config.method.tone_mapper, **changes)
        method = dataclasses.replace(config.method, tone_mapper=tone_mapper)
        return begin(read_scene(data), dataclasses.replace(config, method=method)).method.gaussians.means

    for path in [*spoiled.glob("*_hdr/*.exr"), *spoiled.glob("relit/*/*.exr")]:
        write_exr(path, rng.uniform(0, 100, read_exr(path).shape).astype(np.float32))
    assert spoil("test/*.png", "lit/r_?_[13].png", "train/r_?_[13].png") == 15 + 4 + 6
    assert len(means(clean)) > 100
    assert torch.equal(means(clean), means(spoiled))
    # Pictures under other light tell of the camera's response, but nothing else of this light.
    assert spoil("lit/*.png") == 10
    line = {"initial_curve": "line"}
    assert torch.equal(means(clean, **line), means(spoiled, **line))
    assert not torch.equal(means(clean)[:100], means(spoiled)[:100])
    spoil("train/r_?_[024].png")  # and what it may see, it does see
    assert not torch.equal(means(clean, **line)[:100], means(spoiled, **line)[:100])


def test_exposures_that_the_data_do_not_have_are_refused(tiny_data):
    with pytest.raises(DataMismatchError, match="--training-exposures"):
        begin(read_scene(tiny_data), short("default", training_exposures=(7,)))


def test_a_configuration_file_reproduces_the_configuration(tmp_path):
    for name, config in PRESETS.items():
        write_config(tmp_path / "config.json", config, tmp_path, name)
        written = read_config(tmp_path / "config.json")
        assert written == (config, tmp_path.resolve(), name, fingerprint(config))
    (tmp_path / "config.json").write_text('{"data": "x", "preset": "y", "config": {"wrong": 1}}')
    with pytest.raises(FileDamagedError, match="wrong"):
        read_config(tmp_path / "config.json")
    with pytest.raises(FileMissingError):
        read_config(tmp_path / "none.json")


def test_a_damaged_checkpoint_is_refused(tiny_data, tmp_path):
    state = begin(read_scene(tiny_data), short("default"))
    save(state, tmp_path)
    path = tmp_path / CHECKPOINT_FILE
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(FileDamagedError, match=CHECKPOINT_FILE):
        load_checkpoint(path)
    with pytest.raises(FileMissingError, match="physhdr train"):
        load_checkpoint(tmp_path / "none.safetensors")


def rewritten(path, change=lambda tensors: tensors, **metadata):
    """The checkpoint at ``path`` with other tensors and metadata (None takes one out), and their digest."""
    tensors, written = load_checkpoint(path)
    written = {name: value for name, value in (written | metadata).items() if value is not None}
    save_checkpoint(path, change(tensors), written)


def test_a_checkpoint_belongs_to_its_configuration(tiny_data, tmp_path):
    """Old weights beside a new configuration, as a kill in a bad moment once left them, are no run."""
    scene, config = read_scene(tiny_data), short("default", iterations=12)
    train(scene, config, tmp_path, stop_at=5)
    for other in (
        short("default", iterations=12, half_size_until=0.2),
        short("default", iterations=12, seed=77),
    ):
        with pytest.raises(DataMismatchError, match="another configuration"):
            resume(tmp_path, scene, other)
        with pytest.raises(DataMismatchError, match="another configuration"):
            load_method(tmp_path, other, scene.response_anchor)
    assert resume(tmp_path, scene, config).iteration == 5


def test_what_was_read_of_a_checkpoint_is_no_longer_the_file(tmp_path):
    """Windows lets nobody replace a file that is mapped: a resumed training could not have saved."""
    path = tmp_path / CHECKPOINT_FILE
    save_checkpoint(path, {"a": torch.arange(100_000, dtype=torch.float32)}, dict.fromkeys(METADATA, ""))
    tensors, _ = load_checkpoint(path)
    with open(path, "r+b") as file:
        file.write(bytes(path.stat().st_size))
    assert torch.equal(tensors["a"], torch.arange(100_000, dtype=torch.float32))


def test_a_checkpoint_belongs_to_the_bounds_of_radiance_of_its_pictures(tiny_data, tmp_path):
    scene, config = read_scene(tiny_data), short("default", iterations=12)
    sunny = dataclasses.replace(scene, train=[in_the_sun(view) for view in scene.train])
    state = train(sunny, config, tmp_path, stop_at=5)
    assert state.plan.seen.range == pytest.approx(
        (-12.0, math.log(200.0 * 8000.0))
    )  # 200 times white in 1/8000 s
    assert resume(tmp_path, sunny, config).iteration == 5
    with pytest.raises(DataMismatchError, match="bounds of radiance"):
        resume(tmp_path, scene, config)


def in_the_sun(view):
    """The same bracket in 1/8000 s and more."""
    times = view.exposures[0] * 8000.0
    return dataclasses.replace(view, exposures=tuple(seconds / times for seconds in view.exposures))


def test_a_setting_that_is_added_some_day_leaves_the_fingerprint_alone(tmp_path):
    """It is of the file's words; their order does not matter, values do."""
    path = tmp_path / "config.json"
    write_config(path, PRESETS["default"], tmp_path, "default")
    content = json.loads(path.read_text())
    fingerprints = set()
    for change in (
        lambda c: None,
        lambda c: c.update(config=dict(reversed(c["config"].items()))),
        lambda c: c.update(data="/somewhere/else", preset="mine"),
    ):
        changed = json.loads(json.dumps(content))
        change(changed)
        path.write_text(json.dumps(changed))
        fingerprints.add(read_config(path).fingerprint)
    assert fingerprints == {fingerprint(PRESETS["default"])}
    del content["config"]["supervision"]
    path.write_text(json.dumps(content))
    assert read_config(path).config == PRESETS["default"]
    assert read_config(path).fingerprint not in fingerprints


@pytest.mark.parametrize(
    "where", ["iterations", "seed", "training_exposures", "method", "optimiser", "backbone"]
)
@pytest.mark.parametrize("value", [{"splat_bytes": 1}, [[]], "1", True, -1, 10**400, {"name": 5}, 0.5])
def test_a_configuration_with_something_else_in_a_number_s_place_is_damaged(where, value, tmp_path):
    path = tmp_path / "config.json"
    write_config(path, PRESETS["default"], tmp_path, "default")
    content = json.loads(path.read_text())
    content["config"][where] = value
    path.write_text(json.dumps(content))
    with pytest.raises(FileDamagedError, match=r"config\.json is not a run's configuration"):
        read_config(path)


@pytest.mark.parametrize(
    "preset",
    [
        "default",
        *(pytest.param(name, marks=pytest.mark.long) for name in ("default-scaffold", "hdr-nerf-small")),
    ],
)
def test_checkpoints_are_believed_in_nothing(preset, tiny_data, tmp_path):
    """Made by hand, one thing wrong in each: resuming and opening say so, and never a traceback."""
    scene, config = read_scene(tiny_data), short(preset, iterations=12)
    train(scene, config, tmp_path, stop_at=5)
    path = tmp_path / CHECKPOINT_FILE
    good = path.read_bytes()
    whole, _ = load_checkpoint(path)
    names = list(whole)

    def refused(changes=(), without=(), **metadata):
        path.write_bytes(good)
        tensors = {name: tensor for name, tensor in whole.items() if name not in without} | dict(changes)
        rewritten(path, lambda _: tensors, **metadata)  # the numbers shall be looked at themselves
        with pytest.raises(FileDamagedError, match=CHECKPOINT_FILE):
            resume(tmp_path, scene, config)

    for iteration in (None, "13", "1000000000", "-1", "", "5.0", "1e0", "٣", "1_0", "nan"):
        refused(iteration=iteration)
    for name in ("seconds", "cpu_seconds"):
        for seconds in ("-1", "nan", "inf", "five", ""):
            refused(**{name: seconds})
    model = [name for name in names if name.startswith(("gaussians.", "networks."))]
    counted = [name for name in names if name.startswith("statistics.")]
    moments = [name for name in names if name.startswith("adam.")]
    for name in (model[0], model[-1], *counted[:1], moments[0], moments[-1]):
        tensor = whole[name]
        refused(without=[name])
        refused({name: tensor.double()} if tensor.dtype == torch.float32 else {name: tensor.float()})
        refused({name: torch.cat([tensor.reshape(-1), tensor.reshape(-1)])})
        if tensor.is_floating_point() and tensor.numel():
            refused({name: torch.full_like(tensor, torch.nan)})
            refused({name: torch.full_like(tensor, torch.inf)})
    refused({"networks.not_there": torch.zeros(3)})
    refused({"adam.not_there.0.step": torch.zeros(())})
    kinds = [[name for name in moments if name.endswith(kind)] for kind in ("step", "exp_avg_sq")]
    for name in [*counted, *(kind[place] for kind in kinds for place in (0, -1))]:
        refused({name: whole[name] - 1e9})
    if preset != "hdr-nerf-small":
        rows = {name: whole[name][:0] for name in names if name.startswith("gaussians.")}
        refused(rows)  # no Gaussians
    path.write_bytes(good)
    assert resume(tmp_path, scene, config).iteration == 5


def test_a_bit_that_tipped_over_is_noticed(tiny_data, tmp_path):
    """Anywhere in the numbers, though what it makes of one is a good number, too."""
    scene, config = read_scene(tiny_data), short("default", iterations=12)
    train(scene, config, tmp_path, stop_at=5)
    path = tmp_path / CHECKPOINT_FILE
    good = path.read_bytes()
    start = 8 + int.from_bytes(good[:8], "little")
    for at in np.random.default_rng(3).integers(start, len(good), 20):
        path.write_bytes(good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :])
        with pytest.raises(FileDamagedError, match="its content is not what was written"):
            load_method(tmp_path, config, scene.response_anchor)
    path.write_bytes(good)
    assert load_method(tmp_path, config, scene.response_anchor)[1] == 5


@pytest.mark.parametrize(
    "change",
    [
        {"backbone": GaussiansConfig(every=0)},
        {"backbone": GaussiansConfig(threshold=float("nan"))},
        {"sh_degree_every": 0},
        {"initial_opacity": 1.0},
        {"backbone": AnchorsConfig(feature_size=10**6)},
        {"initial_thickness": 0.0},
        {"initial_thickness": 1.1},
        {"random_points": -1},
        {"backbone": AnchorsConfig(hidden=0)},
        {"method": HDRNeRFConfig(rays_per_iteration=0)},
        {"method": HDRNeRFConfig(learning_rate=float("inf"))},
    ],
)
def test_settings_that_cannot_be_are_refused_when_they_are_made(change):
    with pytest.raises(BadValueError, match="--"):
        dataclasses.replace(PRESETS["default"], **change)


def test_a_state_with_numbers_that_are_none_is_not_saved(tiny_data, tmp_path):
    """A step may spoil the weights while the loss that led to it was a number."""
    state = train(read_scene(tiny_data), short("default", iterations=12), tmp_path, stop_at=5)
    before = (tmp_path / CHECKPOINT_FILE).read_bytes()
    with torch.no_grad():
        state.method.gaussians.log_scales[0, 0] = torch.inf
    with pytest.raises(TrainingDivergedError, match=r"gaussians\.log_scales has values that are not numbers"):
        save(state, tmp_path)
    assert (tmp_path / CHECKPOINT_FILE).read_bytes() == before


def test_checkpoints_are_written_by_time(tiny_data, tmp_path, monkeypatch):
    """Every so many seconds, and writing takes a fiftieth of the time at most; a clock that is told."""
    now = [0.0]
    monkeypatch.setattr("physhdr.backend.train.trainer.time.perf_counter", lambda: now[0])
    state = begin(read_scene(tiny_data), short("default", iterations=40))
    saved_at = []

    def slow_step(advanced):
        now[0] += 10.0
        return step(advanced)

    def slow_save(saved, folder):
        saved_at.append(now[0])
        now[0] += 2.0  # of 2 %: nothing for 100 seconds
        return save(saved, folder)

    monkeypatch.setattr("physhdr.backend.train.trainer.step", slow_step)
    monkeypatch.setattr("physhdr.backend.train.saver.save", slow_save)
    list(run(state, tmp_path, checkpoint_seconds=30.0))
    # The last one is the end's: 40 iterations and 4 saves.
    assert saved_at == [30.0, 132.0, 234.0, 336.0, 408.0]


def test_a_full_disk_leaves_the_checkpoint_before(tiny_data, tmp_path):
    state = train(read_scene(tiny_data), short("default", iterations=12), tmp_path, stop_at=5)
    before = (tmp_path / CHECKPOINT_FILE).read_bytes()
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))  # a disk that is full after a page
    try:
        with pytest.raises(OutputError, match=rf"cannot write the checkpoint \S*{CHECKPOINT_FILE}"):
            save(state, tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert (tmp_path / CHECKPOINT_FILE).read_bytes() == before
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_a_checkpoint_that_is_replaced_while_it_is_read_is_of_one_moment(tiny_data, tmp_path, monkeypatch):
    """The library opens the file twice, and a training may come between: once in some thousand reads."""
    scene, config = read_scene(tiny_data), short("default", iterations=12)
    train(scene, config, tmp_path / "early", stop_at=3)
    train(scene, config, tmp_path / "late", stop_at=9)
    path = tmp_path / "early" / CHECKPOINT_FILE
    expected = weights(tmp_path / "late")
    opened = torch.UntypedStorage.from_file

    def replaced_before_it_is_opened_again(*arguments, **options):
        (tmp_path / "late" / CHECKPOINT_FILE).replace(path)
        monkeypatch.setattr(torch.UntypedStorage, "from_file", opened)
        return opened(*arguments, **options)

    monkeypatch.setattr(torch.UntypedStorage, "from_file", replaced_before_it_is_opened_again)
    assert_identical(expected, load_checkpoint(path)[0])
    assert torch.UntypedStorage.from_file is opened  # it was in the way of the read


def test_numbers_of_a_type_that_no_run_has_are_refused(tiny_data, tmp_path):
    scene, config = read_scene(tiny_data), short("default", iterations=12)
    train(scene, config, tmp_path, stop_at=5)
    means = "gaussians.means"
    rewritten(tmp_path / CHECKPOINT_FILE, lambda tensors: tensors | {means: tensors[means].bfloat16()})
    with pytest.raises(FileDamagedError, match=CHECKPOINT_FILE):
        load_method(tmp_path, config, scene.response_anchor)


@pytest.mark.parametrize("damage", ["empty", "text", "dtype", "header", "deep", "offsets"])
def test_whatever_is_wrong_with_the_container_is_one_error(damage, tiny_data, tmp_path):
    save(begin(read_scene(tiny_data), short("default")), tmp_path)
    path = tmp_path / CHECKPOINT_FILE
    data = path.read_bytes()
    size = int.from_bytes(data[:8], "little")
    header, body = data[8 : 8 + size], data[8 + size :]
    if damage == "dtype":
        header = header.replace(b'"F32"', b'"F99"', 1)
    elif damage == "header":
        header = header.replace(b"{", b"[", 1)
    elif damage == "deep":
        header = b'{"a":' * 20_000
    elif damage == "offsets":
        header = header.replace(b'"data_offsets":[0,', b'"data_offsets":[9,', 1)
    content = len(header).to_bytes(8, "little") + header + body
    path.write_bytes({"empty": b"", "text": b"hello"}.get(damage, content))
    assert path.read_bytes() != data
    with pytest.raises(FileDamagedError, match=CHECKPOINT_FILE):
        load_checkpoint(path)


@pytest.mark.parametrize(
    "bounds", ["", "9", "[9]", "[9, -12]", "[NaN, 9]", "[-12, 80]", '["a", 1]', "[[], 1]"]
)
def test_bounds_of_radiance_that_are_none_are_refused(bounds, tiny_data, tmp_path):
    config = short("default", iterations=5)
    train(read_scene(tiny_data), config, tmp_path)
    rewritten(tmp_path / CHECKPOINT_FILE, log_radiance_range=bounds)
    with pytest.raises(FileDamagedError, match="radiance"):
        load_method(tmp_path, config, None)
