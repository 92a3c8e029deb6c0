# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluations and weights of LPIPS that are damaged, hostile, or no files: one error each."""

import json
import os
import zipfile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from physhdr.backend.evaluate.comparison import ComparedRun, comparison_table, load_evaluation
from physhdr.backend.evaluate.lpips import SHAPES, Lpips
from physhdr.bridge.errors import FileDamagedError, PhysHDRError

pytestmark = pytest.mark.usefixtures("never_waits")

EVALUATION = {
    "format": "physhdr-evaluation",
    "version": 1,
    "means": {"LDR-OE": {"psnr": 30.0, "ssim": 0.9, "lpips": 0.1, "lpips_01": None}, "HDR": None},
    "scale_ratio": 1.0,
    "relit_means": {"all": {"ours": 30.0, "gain_over_scaled_truth": 1.0}},
    "conditions": {"data_set": "", "resolution": [4, 5], "split": "test", "iteration": 1, "iterations": 2},
}
METRICS = ("LDR-OE.psnr", "HDR.psnr", "scale", "relit.psnr", "relit.gain")


def table(folder: Path) -> str:
    entry = ComparedRun("ours", "room", "exp3", 0, load_evaluation(folder))
    return comparison_table([entry], metrics=METRICS).markdown()


def test_any_value_anywhere_in_an_evaluation(tmp_path: Path, fuzzing: ModuleType) -> None:
    path = tmp_path / "evaluation.json"
    path.write_text(json.dumps(EVALUATION))
    assert "30.00" in table(tmp_path)
    cases = [*fuzzing.JSON_TEXTS, *map(fuzzing.json_bytes, fuzzing.json_mutations(EVALUATION, 400, 1))]
    for case, text in enumerate(cases):
        path.write_bytes(text)
        try:
            table(tmp_path)
        except PhysHDRError as error:
            assert str(path) in error.message, f"case {case}"


@pytest.mark.parametrize("part", ["relit_means", "means"])
@pytest.mark.parametrize("value", [7, [1], {"all": 3, "HDR": 3}])
def test_parts_that_are_no_objects(tmp_path: Path, part: str, value: object) -> None:
    (tmp_path / "evaluation.json").write_text(json.dumps(EVALUATION | {part: value}))
    with pytest.raises(FileDamagedError, match=r"evaluation\.json is not a physhdr-evaluation"):
        load_evaluation(tmp_path)


def test_numbers_that_no_float_holds_are_not_measured(tmp_path: Path) -> None:
    (tmp_path / "evaluation.json").write_text(json.dumps(EVALUATION | {"scale_ratio": 10**400}))
    columns = comparison_table(
        [ComparedRun("ours", "room", "exp3", 0, load_evaluation(tmp_path))], metrics=METRICS
    ).columns
    assert [column.key for column in columns] == ["LDR-OE.psnr", "relit.psnr", "relit.gain"]


def test_pipes(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "evaluation.json")
    with pytest.raises(FileDamagedError, match="is a pipe, not a file\n  Run physhdr evaluate"):
        load_evaluation(tmp_path)
    os.mkfifo(tmp_path / "weights.npz")
    with pytest.raises(FileDamagedError, match=r"is a pipe, not a file\n.*skip LPIPS"):
        Lpips.from_file(tmp_path / "weights.npz")


# ---- the weights of LPIPS ----------------------------------------------------------------------------


def weights() -> dict[str, np.ndarray]:
    arrays = {}
    for i, (name, (wide, deep, side)) in enumerate(SHAPES.items()):
        arrays |= {f"{name}.weight": np.zeros((wide, deep, side, side), np.float32)}
        arrays |= {
            f"{name}.bias": np.zeros(wide, np.float32),
            f"lin{i}": np.ones((1, wide, 1, 1), np.float32),
        }
    return arrays


def test_heads_with_and_without_their_ones_are_read(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "w.npz", **weights())
    Lpips.from_file(tmp_path / "w.npz")


def test_damaged_weights(tmp_path: Path, fuzzing: ModuleType) -> None:
    path = tmp_path / "w.npz"
    np.savez_compressed(path, **weights())
    for case, damaged in enumerate(fuzzing.mutations(path.read_bytes(), 60, 1)):
        path.write_bytes(damaged)
        try:
            Lpips.from_file(path)
        except PhysHDRError as error:
            assert "w.npz does not hold the weights of LPIPS" in error.message, f"case {case}"


@pytest.mark.parametrize(
    ("name", "array", "why"),
    [
        ("conv3.weight", np.zeros((192, 64, 5, 4), np.float32), "cannot reshape"),
        ("lin2", np.full(384, np.nan, np.float32), "lin2 holds NaN"),
        ("conv0.bias", np.array(["text"] * 64), "could not convert"),
    ],
)
def test_weights_of_another_network(tmp_path: Path, name: str, array: np.ndarray, why: str) -> None:
    np.savez(tmp_path / "w.npz", **weights() | {name: array})
    with pytest.raises(FileDamagedError, match=rf"does not hold the weights of LPIPS \({why}"):
        Lpips.from_file(tmp_path / "w.npz")


def test_a_small_file_that_unpacks_to_much(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "w.npz", **weights())
    with zipfile.ZipFile(tmp_path / "w.npz", "a", zipfile.ZIP_DEFLATED) as file:
        file.writestr("more.npy", bytes(1 << 27))
    with pytest.raises(FileDamagedError, match=r"more\.npy has more than 67108864 bytes"):
        Lpips.from_file(tmp_path / "w.npz")
