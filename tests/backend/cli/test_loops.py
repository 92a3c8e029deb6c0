# SPDX-License-Identifier: GPL-3.0-or-later
"""Symbolic links that lead to themselves or to nothing, wherever a command takes a path."""

import os
from pathlib import Path

import pytest

from physhdr.backend.cli import main


@pytest.mark.parametrize(
    "words",
    [
        "inspect @",
        "inspect @ --json",
        "train @ --out RUN",
        "train DATA --out @",
        "train DATA --out @/run",
        "train DATA --out RUN --points-file @",
        "train DATA --out RUN --calibration @",
        "train --resume @",
        "evaluate @",
        "evaluate --pictures @ --data DATA",
        "evaluate --pictures DATA --data @",
        "export @",
        "render @ --out x.exr",
        "render @ --camera @ --out x_####.exr",
        "export @ x.ply",
        "export @.ply x.ply",
        "prepare @ NEW",
        "prepare DATA/lit @ --same-exposure",
        "prepare @ --look",
        "calibrate @ --out c.json",
        "render @ --out v.mp4",
        "render @ --at 0 0 0 --out NEW",
        "prepare @ --triangulate",
        "prepare @ NEW --layout colmap",
        "benchmark --plan @ --out NEW",
        "benchmark --scenes @ --methods default --out NEW",
        "benchmark --scenes DATA --methods default --budget iterations=1 --out @",
        "serve --home @",
    ],
)
@pytest.mark.parametrize("target", ["loop", "round", "nowhere"])
def test_a_command_says_so_in_one_message(
    tmp_path: Path, tiny_data: Path, monkeypatch, capsys, words: str, target: str
) -> None:
    if target == "nowhere" and words.startswith(("prepare DATA", "benchmark --scenes DATA")):
        pytest.skip("a folder that is not there yet: it is made")
    monkeypatch.chdir(tmp_path)
    for suffix in ("", ".ply"):
        link = tmp_path / f"loop{suffix}"
        link.symlink_to(target + suffix)
        if target == "round":
            (tmp_path / f"round{suffix}").symlink_to(link)
    before = sorted(os.listdir(tmp_path))
    filled = (
        words.replace("@", "loop").replace("DATA", str(tiny_data)).replace("RUN", "run").replace("NEW", "new")
    )
    status = main(filled.split())
    said = capsys.readouterr()
    told = said.out + said.err
    assert status == 1, told
    assert any(name in told for name in ("loop", target)) and "Traceback" not in told and "bug" not in told
    assert set(os.listdir(tmp_path)) - set(before) <= {"nowhere", "run"}
