# SPDX-License-Identifier: GPL-3.0-or-later
"""A plan that tunes cannot see test views: not one of its processes opens anything of them."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from physhdr.backend.scene import read_scene
from physhdr.bridge.errors import OutputError
from physhdr.lab.benchmark.runs import data_fingerprint
from physhdr.lab.benchmark.without_test import link_without_test

#: Writes down what each Python process opens or lists.
WATCH = """
import os, sys
def _watch(event, arguments):
    if event in ("open", "os.listdir", "os.scandir") and isinstance(arguments[0], (str, bytes)):
        line = os.path.realpath(os.fsdecode(arguments[0])) + "\\n"
        os.write(_FILE, line.encode(errors="replace"))
_FILE = os.open({log!r}, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
sys.addaudithook(_watch)
"""
OF_THE_TEST = {"transforms_test.json", "exposure_test.json", "test", "test_hdr", "relit", "passes"}


def spoil(data: Path) -> None:
    """Nothing of the test split can be read any more."""
    (data / "passes").mkdir()
    (data / "passes" / "test_000.exr").write_bytes(b"x")
    for name in OF_THE_TEST:
        path = data / name
        for file in path.rglob("*") if path.is_dir() else [path]:
            if file.is_file():
                file.write_bytes(b"no such thing")


def benchmark(place: Path, data: Path, kind: str, *what: str) -> tuple[int, str, set[Path]]:
    """Status and output of the command in processes of its own, and every path they opened.

    ``what``: which methods; by default a training of the baseline.
    """
    watch = place / "watch"
    watch.mkdir(parents=True)
    (watch / "sitecustomize.py").write_text(WATCH.format(log=str(place / "opened")))
    words = ["benchmark", "--kind", kind, *(what or ("--methods", "baseline")), "--scenes", f"tiny={data}"]
    words += ["--budget", "iterations=12", "--out", place / "out"]
    command = [sys.executable, "-c", "import sys; from physhdr.backend.cli import main; sys.exit(main())"]
    path = os.pathsep.join([str(watch), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [*command, *map(str, words)], env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True
    )
    opened = {Path(line) for line in (place / "opened").read_text().splitlines()}
    return done.returncode, done.stdout + done.stderr, opened


def of_the_test(data: Path, opened: set[Path]) -> list[Path]:
    inside = [path.relative_to(data.resolve()) for path in opened if path.is_relative_to(data.resolve())]
    return [path for path in inside if OF_THE_TEST & set(path.parts)]


@pytest.mark.long
def test_no_process_of_a_plan_that_tunes_opens_test_views(validation_data: Path, tmp_path: Path) -> None:
    """Not even where a library opens it, which Python does not see: there it is garbage."""
    data = shutil.copytree(validation_data, tmp_path / "tiny")
    known = data_fingerprint(data, "tune")
    spoil(data)
    assert data_fingerprint(data, "tune") == known
    status, output, opened = benchmark(tmp_path, data, "tune")
    assert status == 0, output
    assert not of_the_test(data, opened) and of_the_test(data, {data.resolve() / "transforms_test.json"})
    for name in ("train/r_0_2.png", "val/r_1_3.png", "val_hdr/hdr_002.exr", "points3d.ply"):
        assert data.resolve() / name in opened  # what is opened is seen
    run = tmp_path / "out" / "tune" / "iterations-12" / "exp3" / "tiny" / "baseline" / "seed_0"
    evaluation = json.loads((run / "evaluation.json").read_text())
    assert evaluation["conditions"]["split"] == "val" and len(evaluation["views"]) == 3
    report = (tmp_path / "out" / "report.md").read_text()
    assert report.startswith("# Benchmark for tuning: validation views\n")
    assert "3 train, 2 lit, 3 val" in report and str(data) not in report


@pytest.mark.long
def test_of_another_programs_pictures_no_test_view_is_opened_either(
    validation_data: Path, tmp_path: Path
) -> None:
    data = shutil.copytree(validation_data, tmp_path / "tiny")
    theirs = tmp_path / "theirs" / "seed_0"
    for name in ("val", "val_hdr", "test", "test_hdr", "relit"):
        shutil.copytree(data / name, theirs / name)
    spoil(data)
    what = ("--external", f"theirs={tmp_path}/theirs/seed_{{seed}}")
    status, said, opened = benchmark(tmp_path, data, "tune", *what)
    assert status == 0, said
    assert not of_the_test(data, opened) and not of_the_test(theirs, opened)
    for name in ("val/r_1_3.png", "val_hdr/hdr_002.exr"):
        assert data.resolve() / name in opened and theirs.resolve() / name in opened
    run = tmp_path / "out" / "tune" / "iterations-12" / "exp3" / "tiny" / "theirs" / "seed_0"
    evaluation = json.loads((run / "evaluation.json").read_text())
    assert evaluation["conditions"]["split"] == "val" and evaluation["means"]["HDR"]["psnr"] == 100.0
    assert "| theirs | 100.00 |" in (tmp_path / "out" / "report.md").read_text()


def test_the_folder_of_links_follows_the_data(validation_data: Path, tmp_path: Path) -> None:
    data = shutil.copytree(validation_data, tmp_path / "data")
    (data / "notes.txt").write_text("of the test views")
    known = data_fingerprint(data, "tune")
    (data / "points3d_sfm.ply").write_bytes((data / "points3d.ply").read_bytes())  # for --points-file
    assert data_fingerprint(data, "tune") != known
    folder = link_without_test(data, tmp_path / "out" / "data")
    names = {path.name for path in folder.iterdir()}
    assert names == {path.name for path in data.iterdir()} - OF_THE_TEST - {"notes.txt"}
    scene = read_scene(folder)
    assert (len(scene.train), len(scene.test), len(scene.lit), len(scene.validation)) == (3, 0, 2, 3)
    shutil.rmtree(data / "lit_hdr")
    moved = data.rename(tmp_path / "moved")
    assert link_without_test(moved, folder) == folder
    assert {path.name for path in folder.iterdir()} == names - {"lit_hdr"}
    assert len(read_scene(folder).validation) == 3
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="cannot link the data set"):
        link_without_test(moved, tmp_path / "file" / "data")
