# SPDX-License-Identifier: GPL-3.0-or-later
"""Many runs in one table: means, spreads, places, and the paper's numbers where the data are the paper's."""

import csv
import io
import json
import statistics
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from physhdr.backend.evaluate.comparison import (
    ComparedRun,
    column,
    comparison_table,
    load_evaluation,
    published_entries,
)
from physhdr.backend.evaluate.published import BENCHMARKS, data_set_of, published_means
from physhdr.backend.evaluate.report import write_report
from physhdr.backend.evaluate.results import Evaluation, HdrRow, LdrRow, Metrics
from physhdr.backend.scene import Camera, Scene, read_scene
from physhdr.bridge.errors import BadValueError, FileDamagedError, FileMissingError


def entry(
    method: str, scene: str = "room", seed: int | None = 0, psnr: float | None = 30.0, **more
) -> ComparedRun:
    means = {"LDR-OE": {"psnr": psnr, "ssim": more.pop("ssim", 0.9), "lpips": None, "lpips_01": None}}
    means |= {"LDR-NE": None, "HDR": None}
    evaluation = {"means": means, "scale_ratio": more.pop("scale", None), "conditions": {}}
    evaluation["conditions"]["data_set"] = more.pop("data_set", "")
    evaluation["conditions"] |= more.pop("conditions", {})
    return ComparedRun(method, scene, more.pop("setting", "exp3"), seed, evaluation, **more)


def cells(table, key: str) -> dict[str, object]:
    i = [each.key for each in table.columns].index(key)
    return {row.labels[-1]: row.cells[i] for row in table.rows}


def test_the_mean_is_over_seeds_then_scenes_and_the_spread_over_seeds() -> None:
    numbers = {("a", 0): 30.0, ("a", 1): 32.0, ("a", 2): 31.0, ("b", 0): 40.0, ("b", 1): 41.0, ("b", 2): 45.0}
    table = comparison_table([entry("ours", scene, seed, psnr) for (scene, seed), psnr in numbers.items()])
    cell = cells(table, "LDR-OE.psnr")["ours"]
    assert cell.mean == pytest.approx((31.0 + 42.0) / 2)
    assert cell.spread == pytest.approx(statistics.stdev([35.0, 36.5, 38.0]))
    assert (cell.seeds, cell.scenes) == (3, ("a", "b"))
    assert "36.50 ± 1.50" in table.markdown()
    assert any("mean over scenes over 3 seeds" in note for note in table.notes)


def test_best_and_second_are_marked_and_equal_printed_numbers_share_a_place() -> None:
    runs = [("a", 36.004, 0.91), ("b", 36.001, 0.95), ("c", 35.9, 0.92), ("d", 30.0, 0.90)]
    table = comparison_table([entry(name, psnr=psnr, ssim=ssim) for name, psnr, ssim in runs])
    assert [cell.rank for cell in cells(table, "LDR-OE.psnr").values()] == [1, 1, 2, 0]
    assert [cell.rank for cell in cells(table, "LDR-OE.ssim").values()] == [0, 1, 2, 0]
    text = table.markdown()
    assert "| a | **36.00** | 0.9100 |" in text and "| c | <u>35.90</u> | <u>0.9200</u> |" in text
    console = Console(width=120, record=True, file=io.StringIO(), force_terminal=True)
    console.print(table.rich())
    assert "\x1b[1m36.00" in console.export_text(styles=True)


def test_less_is_better_for_lpips_and_for_how_far_the_scale_is_off() -> None:
    entries = [entry("bright", scale=1.05), entry("dark", scale=0.97), entry("right", scale=1.01)]
    for each, distance in zip(entries, (0.1, 0.3, 0.2), strict=True):
        each.evaluation["means"]["LDR-OE"]["lpips_01"] = distance
    table = comparison_table(entries)
    assert {name: cell.rank for name, cell in cells(table, "scale_error").items()} == {
        "bright": 0,
        "dark": 2,
        "right": 1,
    }
    assert {name: cell.rank for name, cell in cells(table, "LDR-OE.lpips_01").items()} == {
        "bright": 1,
        "dark": 0,
        "right": 2,
    }


def test_scales_that_are_off_to_either_side_do_not_make_a_right_one() -> None:
    runs = [entry("steady", scene, scale=1.01) for scene in "abc"]
    runs += [
        entry("half and twice", scene, scale=scale) for scene, scale in {"a": 0.5, "b": 2.0, "c": 0.5}.items()
    ]
    table = comparison_table(runs, metrics=("scale", "scale_error"))
    means = {name: cell.mean for name, cell in cells(table, "scale").items()}
    assert means == {"steady": pytest.approx(1.01), "half and twice": pytest.approx(1.0)}
    assert not any(cell.rank for cell in cells(table, "scale").values())
    off = cells(table, "scale_error")
    assert (off["steady"].rank, off["half and twice"].rank) == (1, 2)
    assert off["half and twice"].mean == pytest.approx(100.0 * 0.6931472)
    assert "| steady | 1.010 | **1.0** |" in table.markdown()
    assert column("scale_error").value(entry("black", scale=0.0)) is None


def test_a_method_that_lacks_a_scene_is_not_ranked() -> None:
    table = comparison_table(
        [entry("a", "easy", psnr=50), entry("b", "easy", psnr=40), entry("b", "hard", psnr=20)]
    )
    assert [cell.rank for cell in cells(table, "LDR-OE.psnr").values()] == [0, 0]
    assert "50.00 (1 scene)" in table.markdown() and "fewer scenes" in table.markdown()


def test_uneven_seeds_spread_over_those_that_every_scene_has() -> None:
    numbers = {("a", 0): 30.0, ("a", 1): 32.0, ("b", 0): 40.0}
    table = comparison_table([entry("ours", scene, seed, psnr) for (scene, seed), psnr in numbers.items()])
    cell = cells(table, "LDR-OE.psnr")["ours"]
    assert (cell.mean, cell.spread, cell.seeds, cell.runs) == (35.5, None, 1, 3)
    note = "1 to 2 seeds, no two of them common to all scenes of a method: no spread is known"
    assert note in table.notes and not any("one seed" in each for each in table.notes)


def test_a_method_that_lacks_seeds_is_not_ranked() -> None:
    runs = [("a", 0, 30.0), ("a", 1, 32.0), ("b", 0, 40.0), ("b", 1, 41.0), ("c", 0, 50.0)]
    table = comparison_table([entry(method, seed=seed, psnr=psnr) for method, seed, psnr in runs])
    assert {name: cell.rank for name, cell in cells(table, "LDR-OE.psnr").items()} == {"a": 2, "b": 1, "c": 0}
    assert "| c | 50.00 (1 run) |" in table.markdown()
    assert "numbers over fewer scenes or seeds than others have are not ranked" in table.notes
    assert (
        "±: standard deviation of the number over 2 seeds; none where fewer than two are common to the scenes"
        in table.notes
    )


def test_nor_are_those_of_other_views() -> None:
    """Runs of one data set may have splits of their own, where photographs were added between them."""

    def of(method: str, *names: str) -> ComparedRun:
        found = entry(method, psnr=30.0 + len(names), conditions={"resolution": [400, 300]})
        return replace(found, evaluation=found.evaluation | {"views": [{"view": name} for name in names]})

    table = comparison_table([of("a", "1", "2"), of("b", "1", "3"), of("c", "2", "1")])
    assert not any(cell.rank for cell in cells(table, "LDR-OE.psnr").values())
    note = "room is evaluated on 2 views of its own (a, c), on 2 views of its own (b)"
    assert f"NOT COMPARABLE, not ranked: {note}" in table.notes
    table = comparison_table([of("a", "1", "2"), replace(of("b"), evaluation=entry("b").evaluation)])
    assert not any("NOT COMPARABLE" in note for note in table.notes)


def test_the_papers_numbers_lack_no_seeds() -> None:
    ours = [entry(m, "box", seed, data_set="HDR-NeRF-Real") for m in ("a", "b") for seed in (0, 1)]
    table = comparison_table(ours)
    assert len(table.rows) > 2 and not any(cell.partial for row in table.rows for cell in row.cells)


def test_one_seed_is_said_only_where_there_is_one_everywhere() -> None:
    said = "one seed: no spread is known"
    assert said in comparison_table([entry("a"), entry("b")]).notes
    assert said in comparison_table([entry("a", "x"), entry("a", "y")]).notes


def test_evaluations_of_other_pictures_are_not_ranked() -> None:
    whole, half = {"resolution": [400, 300], "split": "test"}, {"resolution": [200, 150], "split": "test"}
    both = [entry("a", conditions=whole), entry("b", psnr=31.0, conditions=half)]
    table = comparison_table(both)
    assert [cell.rank for cell in cells(table, "LDR-OE.psnr").values()] == [0, 0]
    note = "room is evaluated on test at 400×300 (a), on test at 200×150 (b)"
    assert f"NOT COMPARABLE, not ranked: {note}" in table.notes
    # Scenes may differ, and an evaluation of before may not say.
    for others in ([entry("a", "hall", conditions=half), entry("b", "hall", conditions=half)], [entry("c")]):
        table = comparison_table([*others, both[0], entry("b", conditions=whole)])
        assert not any("NOT COMPARABLE" in note for note in table.notes)


def test_an_interrupted_run_is_told() -> None:
    done, stopped = {"iteration": 1000, "iterations": 1000}, {"iteration": 500, "iterations": 1000}
    table = comparison_table([entry("a", conditions=done), entry("b", conditions=stopped)])
    assert "b on room, seed 0: 500 of 1000 iterations" in table.notes
    assert not any(note.startswith("a on") for note in table.notes)


def test_blocks_by_scene_and_setting_rank_by_themselves() -> None:
    runs = [
        ("a", "x", "exp1", 1.0),
        ("b", "x", "exp1", 2.0),
        ("a", "y", "exp3", 4.0),
        ("b", "y", "exp3", 3.0),
    ]
    table = comparison_table(
        [entry(m, s, psnr=p, setting=setting) for m, s, setting, p in runs], group=("scene", "setting")
    )
    assert table.label_headings == ("scene", "setting", "method")
    best = [row.labels for row in table.rows if row.cells[0].rank == 1]
    assert best == [("x", "exp1", "b"), ("y", "exp3", "a")]


def test_costs_have_columns_but_no_places() -> None:
    runs = [entry("a", cost={"cpu_seconds": 161.4}), entry("b", cost={"cpu_seconds": 9.87})]
    table = comparison_table(runs, metrics=("LDR-OE.psnr", "cost.cpu_seconds"))
    assert "| a | 30.00 | 161 |" in table.markdown() and "| b | 30.00 | 9.87 |" in table.markdown()


def test_columns_and_labels_that_say_nothing_are_left_out() -> None:
    table = comparison_table([entry("a"), entry("b")])
    assert [each.key for each in table.columns] == ["LDR-OE.psnr", "LDR-OE.ssim"]
    assert table.label_headings == ("method",) and "setting: exp3" in table.notes
    kept = comparison_table([entry("a")], metrics=("HDR.psnr",), keep_empty=True)
    assert "| a | – |" in kept.markdown()


def test_csv_holds_full_precision() -> None:
    table = comparison_table([entry("a, b", seed=0, psnr=1 / 3), entry("a, b", seed=1, psnr=2 / 3)])
    (row,) = csv.DictReader(io.StringIO(table.csv()))
    assert row["method"] == "a, b" and float(row["LDR-OE.psnr"]) == 0.5 and row["LDR-OE.psnr seeds"] == "2"
    assert float(row["LDR-OE.psnr spread"]) == pytest.approx(statistics.stdev([1 / 3, 2 / 3]))


@pytest.mark.parametrize(
    ("entries", "options", "message"),
    [
        ([], {}, "nothing to compare"),
        ([entry("a"), entry("a")], {}, "two runs of a on room, exp3, seed 0"),
        ([entry("a")], {"metrics": ("LDR-OE.mse",)}, "no column 'LDR-OE.mse'"),
        ([entry("a"), entry("a", setting="exp1")], {"group": ("scene",)}, "exp1, exp3 is meaningless"),
    ],
)
def test_what_cannot_be_compared(entries, options, message) -> None:
    with pytest.raises(BadValueError, match=message):
        comparison_table(entries, **options)


# ---- evaluations on disk -----------------------------------------------------------------------------


def test_a_written_evaluation_is_what_a_column_reads(tmp_path: Path) -> None:
    ldr = [LdrRow(f"r_{i}", i, k, 2.0**k, Metrics(30.0 + k + i, 0.9)) for i in (0, 1) for k in range(5)]
    hdr = [HdrRow("r_0", 0, 8.0, 1.02, Metrics(38.0, 0.97, 0.02, 0.01), Metrics(39.0, 0.98))]
    write_report(Evaluation("room", "test", "exp3", (8, 8), ldr, hdr, []), tmp_path)
    for path in (tmp_path, tmp_path / "evaluation.json"):
        loaded = ComparedRun("ours", "room", "exp3", 0, load_evaluation(path))
        assert column("LDR-OE.psnr").value(loaded) == pytest.approx(32.5)
        assert column("LDR-NE.psnr").value(loaded) == pytest.approx(32.5)
        assert column("HDR.lpips_01").value(loaded) == 0.01
        assert column("HDR-aligned.psnr").value(loaded) == 39.0
        assert column("scale").value(loaded) == 1.02
        assert column("relit.gain").value(loaded) is None


def test_evaluations_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(FileMissingError, match=r"no evaluation at .*evaluation.json\n.*physhdr evaluate"):
        load_evaluation(tmp_path)
    path = tmp_path / "evaluation.json"
    for text in ("{", "[]", '{"format": "physhdr-evaluation", "version": 9}', '{"format": "other"}'):
        path.write_text(text)
        with pytest.raises(FileDamagedError, match=r"evaluation\.json"):
            load_evaluation(path)


# ---- the paper's numbers -----------------------------------------------------------------------------


def test_the_papers_means_are_those_of_its_scenes() -> None:
    """method.md, section 7: they reproduce within rounding, but for HDR-NeRF's HDR column in exp3."""
    checked = 0
    for name, benchmark in BENCHMARKS.items():
        for setting in ("exp1", "exp3"):
            means = published_means(name, "mean", setting)
            for method, parts in means.items():
                if method.startswith("ablation:"):
                    continue
                scenes = [published_means(name, scene, setting).get(method, {}) for scene in benchmark.scenes]
                for part, numbers in parts.items():
                    if (name, setting, method, part) == ("HDR-NeRF-Syn", "exp3", "HDR-NeRF", "HDR"):
                        continue
                    each = [scene[part]["psnr"] for scene in scenes if part in scene]
                    assert numbers["psnr"] == pytest.approx(statistics.fmean(each), abs=0.011)
                    checked += 1
    assert checked > 75


def test_published_figures_by_hand() -> None:
    """Three cells of the paper's tables."""
    exp3 = published_means("HDR-NeRF-Syn", "Bathroom", "exp3")
    assert exp3["PhysHDR-GS†"]["LDR-OE"]["psnr"] == 43.25 and exp3["PhysHDR-GS"]["HDR"]["psnr"] == 36.05
    assert published_means("HDR-NeRF-Real", "mean", "exp3")["HDR-GS"]["LDR-OE"] == {
        "psnr": 34.87,
        "ssim": 0.9697,
        "lpips_01": 0.021,
    }
    assert published_means("HDR-NeRF-Syn", "interior", "exp3") == {}


def test_the_papers_numbers_stand_below_ours_unranked_in_italics() -> None:
    ours = [
        entry(m, s, data_set="HDR-NeRF-Real", psnr=10.0 + len(m))
        for m in ("ab", "c")
        for s in ("box", "flower")
    ]
    table = comparison_table(ours)
    gausshdr = cells(table, "LDR-OE.psnr")["GaussHDR† (published)"]
    box, flower = (
        published_means("HDR-NeRF-Real", scene, "exp3")["GaussHDR†"] for scene in ("box", "flower")
    )
    assert gausshdr.mean == pytest.approx((box["LDR-OE"]["psnr"] + flower["LDR-OE"]["psnr"]) / 2)
    assert gausshdr.rank == 0 and cells(table, "LDR-OE.psnr")["ab"].rank == 1
    assert f"| *GaussHDR† (published)* | *{gausshdr.mean:.2f}* |" in table.markdown()
    assert any("evaluate/published.csv" in note for note in table.notes)
    assert len(comparison_table(ours, published=False).rows) == 2
    assert published_entries([entry("a", "box")]) == [], "ours, whatever the scene is called"


def test_the_papers_numbers_do_not_stand_beside_what_was_trained_on_its_test_exposures() -> None:
    said = {"conditions": {"training_exposures": [0, 1, 2, 3, 4]}, "data_set": "HDR-NeRF-Real"}
    all_of_them = entry("all", "box", **said)
    table = comparison_table([all_of_them])
    assert not any(row.published for row in table.rows)
    as_theirs = entry("theirs", "box", **said | {"conditions": {"training_exposures": [0, 2, 4]}})
    table = comparison_table([all_of_them, as_theirs])
    assert any(row.published for row in table.rows)
    assert [note for note in table.notes if "that LDR-NE is of" in note] == [
        "all on box was trained on exposures that LDR-NE is of: the published figures are not"
    ]


def scene_like(name: str, layout: str, size: tuple[int, int], views: int, like: Scene, info: dict) -> Scene:
    view = like.test[0]
    camera = Camera(view.camera.camera_to_world, *size, 100.0, 100.0, size[0] / 2, size[1] / 2)
    return replace(like, name=name, layout=layout, test=[replace(view, camera=camera)] * views, info=info)


@pytest.mark.parametrize(
    ("name", "layout", "size", "views", "info", "expected"),
    [
        ("bathroom", "HDR-NeRF-Syn", (400, 400), 17, {}, "HDR-NeRF-Syn"),
        ("bathroom", "HDR-NeRF-Syn", (400, 400), 17, {"format": "physhdr-dataset"}, ""),
        ("bathroom", "HDR-NeRF-Syn", (800, 800), 17, {}, ""),
        ("bathroom", "HDR-GS", (400, 400), 17, {}, ""),
        ("kitchen", "HDR-NeRF-Syn", (400, 400), 17, {}, ""),
        ("desk", "GaussHDR", (400, 400), 17, {}, "HDR-NeRF-Syn"),
        ("desk", "GaussHDR", (992, 746), 13, {}, "HDR-Plenoxels-Real"),
        ("box", "HDR-NeRF-Real", (804, 534), 17, {}, "HDR-NeRF-Real"),
    ],
)
def test_whose_scene_it_is(data_set: Path, name, layout, size, views, info, expected) -> None:
    assert data_set_of(scene_like(name, layout, size, views, read_scene(data_set), info)) == expected


def test_our_own_bathroom_is_not_the_papers(small, tmp_path: Path) -> None:
    """Even where everything but the maker is alike."""
    root = small.write_data_set(tmp_path / "bathroom")
    info = json.loads((root / "dataset.json").read_text()) | {"scene": "bathroom"}
    (root / "dataset.json").write_text(json.dumps(info))
    scene = read_scene(root)
    like = scene_like(scene.name, scene.layout, (400, 400), 17, scene, scene.info)
    assert like.name == "bathroom" and data_set_of(like) == ""
    original = small.write_data_set(tmp_path / "original" / "bathroom", original=True)
    scene = read_scene(original)
    assert (
        data_set_of(scene_like(scene.name, scene.layout, (400, 400), 17, scene, scene.info)) == "HDR-NeRF-Syn"
    )
