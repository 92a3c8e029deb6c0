# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder is what docs/formats.md says, resumes, and is never half written."""

import hashlib
import json
import pickle
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from physhdr.bridge import data_set
from physhdr.synth import dataset, folder, passes, plan, renderer
from physhdr.synth.camera_model import CameraModel
from physhdr.synth.errors import ConflictError, DamagedFileError, NotFiniteRenderError, OutputFolderError
from physhdr.tests.synth import conftest as readers

ROOT = Path(__file__).parents[2]
T = [0.125, 0.5, 2.0, 8.0, 32.0]


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """The interior, tiny, by the command line as a user runs it."""
    out = tmp_path_factory.mktemp("interior") / "data"
    options = "--resolution 32x24 --samples 2 --views 5 --lit-views 2 --relit-views 1 --ambient-levels 1/2"
    command = [sys.executable, ROOT / "synth/make_scene.py", "--", "--out", out, *options.split()]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out, done


def test_layout_is_the_documented_one(room):
    out, done = room
    expected = {"dataset.json", "points3d.ply"}
    for split, count in (("train", 3), ("test", 2), ("lit", 2)):
        expected |= {f"transforms_{split}.json", f"exposure_{split}.json"}
        expected |= {f"{split}_hdr/hdr_{i:03d}.exr" for i in range(count)}
        expected |= {f"{split}/r_{i}_{k}.png" for i in range(count) for k in range(5)}
        expected |= {f"passes/{split}_{i:03d}.exr" for i in range(count)}
    expected |= {"relit/level_0.5/hdr_001.exr"}
    assert {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()} == expected
    assert "render [" in done.stdout and "s left" in done.stdout
    assert "Saved" not in done.stdout and "WARNING" not in done.stdout


def test_poses_and_exposures(room):
    out, _ = room
    for split, count in (("train", 3), ("test", 2), ("lit", 2)):
        transforms = readers.read_json(out / f"transforms_{split}.json")
        assert transforms["camera_angle_x"] == pytest.approx(np.radians(62))
        assert [f["file_path"] for f in transforms["frames"]] == [f"./{split}/r_{i}" for i in range(count)]
        for frame in transforms["frames"]:
            pose = np.array(frame["transform_matrix"])
            assert pose.shape == (4, 4) and pose[3].tolist() == [0, 0, 0, 1]
            assert ("lighting_level" in frame) == ("lighting_levels" in frame) == (split == "lit")
        exposures = readers.read_json(out / f"exposure_{split}.json")
        assert exposures == {f"./{split}/r_{i}_{k}.png": T[k] for i in range(count) for k in range(5)}
    assert sorted(f["lighting_level"] for f in transforms["frames"]) == [0.25, 4.0]
    assert [f["lighting_levels"]["ambient"] for f in transforms["frames"]] == [
        f["lighting_level"] for f in transforms["frames"]
    ]
    assert transforms["lights"] == ["ambient"]


def test_pictures_are_the_passes_under_their_levels(room):
    out, _ = room
    told = readers.read_json(out / "dataset.json")
    frames = readers.read_json(out / "transforms_lit.json")["frames"]
    assert told["lights"] == ["ambient", "pendant", "standing"] and told["lit_lights"] == ["ambient"]
    assert told["relit"] == [{"folder": "relit/level_0.5", "levels": {"ambient": 0.5}}]
    levels = {"train": [1.0] * 3, "test": [1.0] * 2, "lit": [f["lighting_level"] for f in frames]}
    given = [(f"{s}_{i:03d}", f"{s}_hdr/hdr_{i:03d}", v) for s in levels for i, v in enumerate(levels[s])]
    for name, picture, level in [*given, ("test_001", "relit/level_0.5/hdr_001", 0.5)]:
        rendered = passes.read(out / f"passes/{name}.exr", told["lights"], (32, 24))
        light = {key: value.astype(np.float64) for key, value in rendered.lights.items()}
        expected = level * light["ambient"] + light["pendant"] + light["standing"]
        np.testing.assert_allclose(readers.read_exr(out / f"{picture}.exr"), expected, rtol=1e-6, atol=1e-9)
        assert rendered.samples.max() == 2.0 and (rendered.index >= 0).all()
        assert rendered.index.max() <= max(told["objects"].values())


def test_every_frame_is_described(room):
    out, _ = room
    frames = readers.read_json(out / "dataset.json")["frames"]
    assert list(frames) == [*(f"train/{k}" for k in range(3)), "test/0", "test/1", "lit/0", "lit/1"]
    for name, frame in frames.items():
        split, index = name.split("/")
        assert frame["file"] == f"passes/{split}_{int(index):03d}.exr"
        assert frame["sha256"] == hashlib.sha256((out / frame["file"]).read_bytes()).hexdigest()
        assert frame["samples"] == 2.0 and 10.0 < frame["noise_psnr"] < 50.0
    assert len({frame["seed"] for frame in frames.values()}) == len(frames)


def test_brackets_are_the_response_of_the_exr(room):
    out, _ = room
    for split, count in (("train", 3), ("test", 2), ("lit", 2)):
        for i in range(count):
            radiance = readers.read_exr(out / f"{split}_hdr/hdr_{i:03d}.exr").astype(np.float64)
            assert radiance.shape == (24, 32, 3)
            for k, t in enumerate(T):
                x = radiance * t
                code = np.floor(255 * (x / (1 + x)) ** (1 / 2.2) + 0.5)
                png = readers.read_png(out / f"{split}/r_{i}_{k}.png")
                assert (png[..., 3] == 255).all()
                np.testing.assert_array_equal(png[..., :3], code)


def test_dataset_json(room):
    out, _ = room
    told = readers.read_json(out / "dataset.json")
    assert (told["format"], told["version"]) == ("physhdr-dataset", 1)
    assert told["generator"]["blender"] == bpy.app.version_string
    assert (told["resolution"], told["samples"], told["scene"]) == ([32, 24], 2, "interior")
    assert told["denoised"] == "OpenImageDenoise" and told["working_space"] == "Linear Rec.709"
    assert told["exposures"] == T and told["splits"] == {"train": 3, "test": 2, "lit": 2}
    assert told["lighting_levels"] == {"lit": [0.25, 4.0], "relit": [0.5], "relit_views": [1]}
    assert told["response"] == {"name": "reinhard-gamma", "anchor": [1.0, pytest.approx(0.5 ** (1 / 2.2))]}
    settings = told["render_settings"]
    for path, value in {
        "scene.render.engine": "CYCLES",
        "scene.render.dither_intensity": 0.0,
        "scene.cycles.sample_clamp_indirect": 0.0,
        "scene.cycles.sample_clamp_direct": 0.0,
        "scene.cycles.film_exposure": 1.0,
        "scene.view_settings.view_transform": "Standard",
        "bpy.data.colorspace.working_space": "Linear Rec.709",
    }.items():
        assert settings[path] == value
    floor = told["noise_floor"]
    assert floor["seeds"][0] != floor["seeds"][1] and floor["view"] == 1
    assert len(floor["psnr"]) == 5 and all(5 < value < 99 for value in [*floor["psnr"], floor["hdr_psnr"]])
    radiance = np.stack([readers.read_exr(out / f"train_hdr/hdr_{i:03d}.exr") for i in range(3)])
    luminance = radiance.astype(np.float64) @ [0.2126, 0.7152, 0.0722]
    ranges = told["dynamic_range"]
    assert ranges["percentile_1"] == pytest.approx(np.percentile(luminance, 1), rel=1e-6)
    assert ranges["maximum"] == pytest.approx(luminance.max(), rel=1e-6)
    assert ranges["stops"] == pytest.approx(np.log2(ranges["maximum"] / ranges["percentile_1"]), abs=0.01)


def test_points_lie_on_the_surfaces(tmp_path, small):
    """The ball has radius 1, the floor is at −1: no other place is possible, and normals follow."""
    dataset.make(tmp_path, small)
    points = readers.read_ply(tmp_path / "points3d.ply")
    place = np.stack([points[k] for k in "xyz"], -1).astype(np.float64)
    normal = np.stack([points[k] for k in ("nx", "ny", "nz")], -1).astype(np.float64)
    on_ball = np.abs(np.linalg.norm(place, axis=1) - 1) < 2e-3
    on_floor = np.abs(place[:, 2] + 1) < 1e-3
    on_bulb = np.abs(np.linalg.norm(place - [1.6, -1.5, 0.2], axis=1) - 0.35) < 1e-2
    on_rim = np.abs(np.abs(place[:, :2]).max(1) - 6) < 1e-3
    assert (on_ball | on_floor | on_bulb | on_rim).all()
    assert on_ball.sum() > 50 and on_floor.sum() > 50 and len(points) < 3 * 32 * 24
    assert (np.einsum("ij,ij->i", normal[on_ball], place[on_ball]) > 0.99).all()
    assert (normal[on_floor & ~on_ball & ~on_rim, 2] > 0.99).all()
    colour = np.stack([points[k] for k in ("red", "green", "blue")], -1)
    assert np.median(colour[on_bulb]) == pytest.approx(255, abs=3)  # radiance 50 at t = 2 is white
    # t=2, grey (0.5, 0.4, 0.3): red is the brightest wherever there is light
    assert (colour[on_ball, 0] >= colour[on_ball, 2]).all()


def _stamps(out: Path) -> dict[str, int]:
    return {str(p.relative_to(out)): p.stat().st_mtime_ns for p in out.rglob("*") if p.is_file()}


def test_resume_renders_only_what_is_missing_and_the_same(tmp_path, small, monkeypatch):
    out = tmp_path / "d"
    dataset.make(out, small)
    before = _stamps(out)
    lost = ["passes/test_001.exr", "lit_hdr/hdr_000.exr", "train/r_1_2.png", "relit/level_2/hdr_001.exr"]
    content = {name: (out / name).read_bytes() for name in [*lost, "dataset.json"]}
    for name in lost:
        (out / name).unlink()
    rendered = counted(monkeypatch)
    dataset.make(out, small)
    assert len(rendered) == 1  # all else follows from the passes
    after = _stamps(out)
    assert after.keys() == before.keys()
    assert {name for name in before if before[name] != after[name]} == {*lost, "dataset.json"}
    assert {name: (out / name).read_bytes() for name in content} == content


def counted(monkeypatch):
    """The poses that are rendered from now on."""
    real, calls = renderer.Renderer.render, []

    def render(self, pose, *rest):
        calls.append(pose)
        return real(self, pose, *rest)

    monkeypatch.setattr(renderer.Renderer, "render", render)
    return calls


def test_the_same_seed_gives_the_same_bytes(tmp_path, small):
    """Of every file, wherever it lies and in whatever order its poses are made."""
    noisy = replace(small, camera=CameraModel(iso=3200, white_balance_jitter=0.1), denoise=True)
    dataset.make(tmp_path / "a", noisy)
    dataset.make(tmp_path / "b", noisy)
    for name in ("passes/train_000.exr", "test/r_1_2.png", "points3d.ply"):
        (tmp_path / "b" / name).unlink()
    dataset.make(tmp_path / "b", noisy)
    names = sorted(str(p.relative_to(tmp_path / "a")) for p in (tmp_path / "a").rglob("*") if p.is_file())
    assert len(names) == 7 * (1 + 1 + 5) + 2 + 6 + 2
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name
    dataset.make(tmp_path / "c", replace(noisy, seed=1))
    other = "passes/train_000.exr"
    assert (tmp_path / "a" / other).read_bytes() != (tmp_path / "c" / other).read_bytes()
    told = readers.read_json(tmp_path / "a/dataset.json")
    assert told["camera_model"]["iso"] == 3200


def test_a_camera_with_faults_changes_the_brackets_and_not_the_truth(tmp_path, small):
    dataset.make(tmp_path / "a", small)
    dataset.make(tmp_path / "b", replace(small, camera=CameraModel(vignetting=2.0)))
    for name in ("passes/test_000.exr", "test_hdr/hdr_000.exr", "relit/level_2/hdr_001.exr"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    ideal, real = (readers.read_png(tmp_path / x / "train/r_0_2.png")[..., :3].astype(int) for x in "ab")
    assert (real <= ideal).all() and (real < ideal).mean() > 0.3


def test_lights_that_vary_come_in_every_combination(tmp_path, small):
    options = replace(small, lit_views=8, lit_lights=("lamp", "ambient"), relit_views=None, samples=1)
    dataset.make(tmp_path, options)
    told = readers.read_json(tmp_path / "dataset.json")
    transforms = readers.read_json(tmp_path / "transforms_lit.json")
    assert transforms["lights"] == told["lit_lights"] == ["ambient", "lamp"]
    pairs = [tuple(frame["lighting_levels"].values()) for frame in transforms["frames"]]
    assert sorted(pairs) == sorted(2 * [(0.25, 0.25), (0.25, 4.0), (4.0, 0.25), (4.0, 4.0)])
    assert pairs != sorted(pairs) and [f["lighting_level"] for f in transforms["frames"]] == [
        p[0] for p in pairs
    ]
    settings = {entry["folder"]: entry["levels"] for entry in told["relit"]}
    assert settings == {
        "relit/level_0.5": {"ambient": 0.5},
        "relit/level_2": {"ambient": 2.0},
        "relit/lamp_0.5": {"lamp": 0.5},
        "relit/lamp_2": {"lamp": 2.0},
        "relit/ambient_0.5+lamp_2": {"ambient": 0.5, "lamp": 2.0},
        "relit/ambient_2+lamp_0.5": {"ambient": 2.0, "lamp": 0.5},
        "relit/ambient_0.125+lamp_8": {"ambient": 0.125, "lamp": 8.0},
        "relit/ambient_8+lamp_0.125": {"ambient": 8.0, "lamp": 0.125},
    }
    assert told["lighting_levels"]["relit_views"] == [0, 1]
    for name, levels in settings.items():
        for k in (0, 1):
            light = passes.read(tmp_path / f"passes/test_{k:03d}.exr", told["lights"], (32, 24)).lights
            expected = sum(levels.get(key, 1.0) * value.astype(np.float64) for key, value in light.items())
            truth = readers.read_exr(tmp_path / name / f"hdr_{k:03d}.exr")
            np.testing.assert_allclose(truth, expected, rtol=1e-6, atol=1e-9)
    asked = replace(options, mixed_levels=((("lamp", 3.0), ("ambient", 1.0)),), ambient_levels=())
    assert [light.levels for light in plan.relightings(asked, told["lights"])] == [{"lamp": 3.0}]


def test_several_scenes_by_one_command(tmp_path, capsys, monkeypatch, small):
    from physhdr.synth import several
    from physhdr.synth.built_in import SCENES
    from physhdr.synth.progress import JsonReport

    monkeypatch.setitem(SCENES, "ball 2", replace(SCENES["ball"], evs=(-4.0, -2.0, 0.0)))
    report = JsonReport()
    report.end(several.make_all(tmp_path, ["ball", "ball 2"], small, report))
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    fractions = [line["progress"] for line in lines if "progress" in line]
    assert fractions[0] == 0.0 and fractions[-1] == 1.0 and fractions == sorted(fractions)
    assert lines[0]["message"] == "rendering ball train_000"
    assert {"rendering ball 2 lit_001", "ball 2 points"} <= {line.get("message") for line in lines}
    assert list(lines[-1]["result"]["scenes"]) == ["ball", "ball 2"]
    for name, evs in (("ball", [-3, -1, 1, 3, 5]), ("ball 2", [-4, -2, 0])):
        told = readers.read_json(tmp_path / name / "dataset.json")
        assert (told["scene"], told["evs"]) == (name, evs) and told["exposures"] == [2.0**ev for ev in evs]


@pytest.mark.long
def test_two_processes_share_a_folder(tmp_path, small):
    """Both end well, and what comes out is what one alone makes; nothing is left behind."""
    script = tmp_path / "make.py"
    script.write_text(PROCESS.format(tests=Path(__file__).parent, root=ROOT.parent))
    options = replace(small, views=8)
    (tmp_path / "options.pickle").write_bytes(pickle.dumps(options))
    command = [sys.executable, str(script), str(tmp_path / "options.pickle"), str(tmp_path / "two")]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) for _ in range(2)]
    told = [process.communicate(timeout=300) for process in running]
    assert [process.returncode for process in running] == [0, 0], told
    dataset.make(tmp_path / "one", options)
    names = {str(p.relative_to(tmp_path / "one")) for p in (tmp_path / "one").rglob("*") if p.is_file()}
    made = {str(p.relative_to(tmp_path / "two")) for p in (tmp_path / "two").rglob("*") if p.is_file()}
    assert made == names
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes(), name
    counts = [out.decode().count("rendered here") for out, _ in told]
    assert min(counts) > 0 and sum(counts) == 8 + 2 + 1, counts  # and the noise floor


PROCESS = """
import importlib.util, os, pickle, sys, time
from pathlib import Path
sys.path.insert(0, "{root}")
from physhdr.synth import dataset, renderer
from physhdr.synth.built_in import SCENES, BuiltInScene
spec = importlib.util.spec_from_file_location("conftest", "{tests}/conftest.py")
conftest = importlib.util.module_from_spec(spec)
spec.loader.exec_module(conftest)
SCENES["ball"] = BuiltInScene(conftest.build_ball)
real, here = renderer.Renderer.render, Path(sys.argv[1]).parent / f"begun-{{os.getpid()}}"
def render(self, *arguments):
    here.touch()
    while len(list(here.parent.glob("begun-*"))) < 2:  # else one is done before the other has begun
        time.sleep(0.05)
    print("rendered here")
    return real(self, *arguments)
renderer.Renderer.render = render
dataset.make(Path(sys.argv[2]), pickle.loads(Path(sys.argv[1]).read_bytes()))
"""


def test_a_complete_data_set_is_left_as_it_is(tmp_path, small, capsys):
    dataset.make(tmp_path / "d", small)
    before = _stamps(tmp_path / "d")
    dataset.make(tmp_path / "d", small)
    assert _stamps(tmp_path / "d") == before
    assert "complete already" in capsys.readouterr().out


def test_one_killed_between_the_two_last_steps_is_complete(tmp_path, small):
    """dataset.json was there, and what stood for it until then was not gone yet."""
    dataset.make(tmp_path / "d", small)
    before = _stamps(tmp_path / "d")
    (tmp_path / "d/dataset.partial.json").write_text("{}")
    assert data_set.is_unfinished(tmp_path / "d")
    dataset.make(tmp_path / "d", small)
    assert _stamps(tmp_path / "d") == before


@pytest.mark.parametrize("locks", [True, False])
def test_what_another_may_still_write_is_left_where_nothing_keeps_it_out(
    tmp_path, small, monkeypatch, capsys, locks
):
    if not locks:
        fcntl = pytest.importorskip("fcntl")

        def refuse(*_):
            raise OSError(38, "Function not implemented")  # ENOSYS

        monkeypatch.setattr(fcntl, "flock", refuse)
    theirs = folder.scratch(tmp_path / "noise_floor.exr")
    theirs.write_bytes(b"half an EXR")
    dataset.make(tmp_path, small)
    assert (tmp_path / "dataset.json").exists() and theirs.exists() == (not locks)
    assert capsys.readouterr().out.count("cannot be locked (Function not implemented)") == (not locks)


def test_another_version_does_not_mix_into_a_data_set(tmp_path, small, monkeypatch):
    dataset.make(tmp_path / "d", small)
    (tmp_path / "d/passes/test_001.exr").unlink()
    monkeypatch.setitem(dataset.GENERATOR, "version", "9.9")
    before = _stamps(tmp_path / "d")
    with pytest.raises(ConflictError, match=r"was made by .*0\.2\.0.*this is .*9\.9"):
        dataset.make(tmp_path / "d", small)
    assert _stamps(tmp_path / "d") == before


def test_interrupted_run_goes_on(tmp_path, small, monkeypatch):
    out = tmp_path / "d"
    real, calls = renderer.Renderer.render, []

    def interrupted(self, pose, seed, scratch):
        calls.append(scratch)
        if len(calls) == 3:  # as a kill in the middle of writing leaves it
            scratch.write_bytes(b"half an EXR")
            folder.scratch(out / "passes/test_000.exr").write_bytes(b"half an EXR")
            (out / "passes/.test_000.exr.1f2bbed2.tmp").write_bytes(b"an earlier version's")
            raise KeyboardInterrupt
        return real(self, pose, seed, scratch)

    monkeypatch.setattr(renderer.Renderer, "render", interrupted)
    with pytest.raises(KeyboardInterrupt):
        dataset.make(out, small)
    assert not (out / "dataset.json").exists() and (out / "dataset.partial.json").exists()
    monkeypatch.setattr(renderer.Renderer, "render", real)
    rendered = counted(monkeypatch)
    dataset.make(out, small)
    assert len(rendered) == 5 + 2 + 1 - 2  # all poses and the noise floor, less the two that were whole
    assert (out / "dataset.json").exists() and not (out / "dataset.partial.json").exists()
    assert not list(out.rglob("*.tmp*"))


def test_other_options_change_nothing(tmp_path, small):
    out = tmp_path / "d"
    dataset.make(out, small)
    before = _stamps(out)
    changes = ({"resolution": (16, 16)}, {"seed": 1}, {"crf": "srgb"}, {"exposures": (1.0, 2.0)})
    for change in (*changes, {"noise_threshold": 0.1}, {"camera": CameraModel(iso=100)}):
        with pytest.raises(ConflictError, match=next(iter(change))):
            dataset.make(out, replace(small, **change))
    assert _stamps(out) == before


@pytest.mark.parametrize(
    "name", ["passes/train_001.exr", "train_hdr/hdr_001.exr", "relit/level_0.5/hdr_001.exr"]
)
def test_a_damaged_exr_is_named_and_kept(tmp_path, small, name):
    out = tmp_path / "d"
    dataset.make(out, small)
    (out / name).write_bytes((out / name).read_bytes()[:-100])
    (out / "test/r_0_0.png").unlink()
    before = _stamps(out)
    with pytest.raises(DamagedFileError, match=rf"{Path(name).name}'.*delete it"):
        dataset.make(out, small)
    assert _stamps(out) == before


def test_a_foreign_folder_is_left_alone(tmp_path, small):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(OutputFolderError, match="empty folder"):
        dataset.make(tmp_path, small)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.txt"]


def test_a_folder_that_cannot_be_written(tmp_path, small):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputFolderError, match="cannot write"):
        dataset.make(tmp_path / "file" / "data", small)


def test_nothing_is_left_in_blender(tmp_path, small):
    def inventory():
        kinds = ("scenes", "objects", "meshes", "materials", "lights", "cameras", "worlds", "images")
        return {kind: sorted(block.name for block in getattr(bpy.data, kind)) for kind in kinds}

    before = inventory()
    dataset.make(tmp_path, small)
    assert inventory() == before
    shutil.rmtree(tmp_path)


def test_a_rare_value_that_is_no_number_is_rendered_again(tmp_path, monkeypatch, small):
    """The first render of each pose fails so; another seed does not, and is what the file tells."""
    real, failed = renderer.Renderer.render, set()

    def render(self, pose, seed, scratch):
        if scratch.name not in failed and "noise_floor" not in scratch.name and len(failed) < 2:
            failed.add(scratch.name)
            raise NotFiniteRenderError("NaN")
        return real(self, pose, seed, scratch)

    monkeypatch.setattr(renderer.Renderer, "render", render)
    dataset.make(tmp_path, small)
    told = readers.read_json(tmp_path / "dataset.json")
    seeds = {name: frame["seed"] for name, frame in told["frames"].items()}
    assert len(failed) == 2
    assert seeds["train/0"] == renderer.view_seed(small.seed, "train_000/finite")
    assert seeds["test/0"] == renderer.view_seed(small.seed, "test_000")
