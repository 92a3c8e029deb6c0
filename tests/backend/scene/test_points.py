# SPDX-License-Identifier: GPL-3.0-or-later
"""What kind of points a PLY holds: its comments say."""

import dataclasses
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from physhdr.backend.cli import main
from physhdr.backend.inspect import inspect
from physhdr.backend.scene.points import EXACT, STRUCTURE_FROM_MOTION, read_points
from physhdr.lab.benchmark.facts import scene_line

ROOT = Path(__file__).resolve().parents[3]
#: What our generator writes; read from its source, for it runs in Blender's Python alone.
OF_SYNTH = re.findall(r'"comment (.*?)"', (ROOT / "synth" / "points.py").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("comments", "origin"),
    [
        (OF_SYNTH, EXACT),
        (["made on a Tuesday", "structure from motion: by another program"], STRUCTURE_FROM_MOTION),
        (["made on a Tuesday"], ""),
        (["not structure from motion"], ""),
        ([], ""),
    ],
)
def test_the_kind_of_points_is_what_the_comments_say(comments, origin, tmp_path):
    path = tmp_path / "points.ply"
    lines = ["ply", "format ascii 1.0", *(f"comment {comment}" for comment in comments), "element vertex 1"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"property uchar {name}" for name in ("red", "green", "blue")]
    path.write_text("\n".join([*lines, "end_header", "1 2 3 255 0 51"]) + "\n")
    points = read_points(path)
    assert points.origin == origin
    assert str(points) == "1 points of the data set" + (f" ({origin})" if origin else "")


@pytest.mark.parametrize(
    ("kind", "largest"),
    [("uchar", 255), ("ushort", 65535), ("float", 1.0), ("float", 255.0), ("double", 255.0)],
)
def test_colours_of_points_are_of_bytes_of_sixteen_bits_or_of_floats(kind, largest, tmp_path):
    """Some programs write 16 bits, or bytes as floats: taken for bytes or for 0…1 all would be white."""
    path = tmp_path / "points.ply"
    lines = ["ply", "format ascii 1.0", "element vertex 2", *(f"property float {axis}" for axis in "xyz")]
    lines += [*(f"property {kind} {name}" for name in ("red", "green", "blue")), "end_header"]
    shares = np.array([[1.0, 0.2, 0.0], [0.4, 0.6, 0.8]])
    for share in (shares * largest).tolist():
        lines.append("1 2 3 " + " ".join(f"{value:g}" for value in share))
    path.write_text("\n".join(lines) + "\n")
    np.testing.assert_allclose(read_points(path).colours, shares, atol=1e-6)


def test_inspect_and_a_benchmarks_conditions_say_it(tiny_data, tmp_path, capsys):
    data = tmp_path / "data"
    shutil.copytree(tiny_data, data)
    assert main(["inspect", str(data)]) == 0
    assert "points 60: of unknown origin" in " ".join(capsys.readouterr().out.split())
    assert "60 points of its own (kind unknown)" in scene_line("night", dataclasses.asdict(inspect(data)))
    path = data / "points3d.ply"
    path.write_bytes(path.read_bytes().replace(b"\nelement", f"\ncomment {OF_SYNTH[0]}\nelement".encode(), 1))
    assert main(["inspect", str(data)]) == 0
    assert f"points 60: {EXACT}" in " ".join(capsys.readouterr().out.split())
    assert f"60 points of its own ({EXACT})" in scene_line("night", dataclasses.asdict(inspect(data)))
