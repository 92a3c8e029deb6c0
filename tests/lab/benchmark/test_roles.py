# SPDX-License-Identifier: GPL-3.0-or-later
"""Which scenes a plan may use, and what its report says of them."""

import json
import re
from pathlib import Path

import pytest

from physhdr.backend.cli import main
from physhdr.bridge.data_set import MAKER
from physhdr.bridge.errors import BadValueError, PhysHDRError
from physhdr.lab.benchmark.plan import make_plan, read_plan, write_plan
from physhdr.lab.benchmark.roles import (
    HELD_OUT,
    ROLES,
    SEALED,
    TUNING,
    require_allowed,
    role_lines,
    role_of,
    room_of,
)

ROOT = Path(__file__).parents[3]


def folder(place: Path, scene: str, validation: bool = True, **changes) -> Path:
    """A data set as far as its role goes: ``dataset.json`` and the names of its splits' files."""
    place.mkdir()
    info = {"format": "physhdr-dataset", "version": 1, "scene": scene, "generator": {"name": MAKER}}
    (place / "dataset.json").write_text(json.dumps(info | changes))
    for split in ("train", "test", *(("val",) if validation else ())):
        (place / f"transforms_{split}.json").write_text("{}")
        (place / f"exposure_{split}.json").write_text("{}")
    return place


def plan_of(place: Path, *scenes: Path, **content):
    given = {"methods": ["default"], "scenes": [str(scene) for scene in scenes], "budgets": ["iterations=5"]}
    return make_plan(given | content, place)


def test_every_built_in_scene_has_one_role() -> None:
    """As synth's own file names the scenes: neither room may import the other."""
    table = re.search(r"^SCENES\b.*?^}", (ROOT / "synth/built_in.py").read_text(), re.M | re.S)
    assert table and set(re.findall(r'^ {4}"(\w+)":', table.group(), re.M)) == set(ROLES)
    by_role = {role: sorted(name for name in ROLES if ROLES[name] == role) for role in ROLES.values()}
    assert by_role == {
        TUNING: ["bathroom", "interior", "sponza"],
        HELD_OUT: ["bear", "diningroom", "dog", "sofa"],
        SEALED: ["chair", "desk"],
    }


def test_a_role_is_known_by_what_rendered_the_data_not_by_the_folder(tmp_path: Path) -> None:
    assert role_of(folder(tmp_path / "kitchen", "desk")) == SEALED
    assert role_of(folder(tmp_path / "desk", "kitchen")) == ""
    assert role_of(folder(tmp_path / "mine", "desk", source={"file": "desk.blend"})) == ""
    assert role_of(folder(tmp_path / "other", "desk", generator={"name": "another"})) == ""
    assert role_of(folder(tmp_path / "none", "desk", generator=None)) == ""
    (tmp_path / "dog").mkdir()  # published data are called so, and have no dataset.json
    assert role_of(tmp_path / "dog") == ""


def test_data_sets_of_one_room_are_known_by_what_they_show(tmp_path: Path) -> None:
    """Not by what they are called: captures lie in folders ``data``, and scenes are saved as scene.blend."""

    def own(place: str, file: str = "scene.blend", also: str = "Bed") -> Path:
        objects = {"Floor": 1, "Lamp": 2, also: 3}
        (tmp_path / place).mkdir()
        source = {"file": file, "scene": "Scene", "camera": place}
        return folder(tmp_path / place / "data", "scene", source=source, objects=objects)

    assert room_of(folder(tmp_path / "a", "dog")) == room_of(folder(tmp_path / "b", "dog", camera_model={}))
    assert room_of(folder(tmp_path / "c", "sofa")) != room_of(tmp_path / "a")
    assert room_of(own("kitchen")) == room_of(own("from the door"))
    others = [own("garden", also="Tree"), own("attic", also="Beam"), own("copy", file="kitchen.blend")]
    assert len({room_of(data) for data in [*others, tmp_path / "kitchen" / "data"]}) == 4
    captures = []
    for name in ("one", "two"):
        (tmp_path / name / "data").mkdir(parents=True)
        captures.append(tmp_path / name / "data")
    assert room_of(captures[0]) != room_of(captures[1])
    laid_out = folder(tmp_path / "other", "data", generator={"name": "another"})
    assert room_of(laid_out) == room_of(tmp_path / "one" / ".." / "other") != room_of(captures[0])


def test_a_data_set_that_is_not_whole_yet_has_its_role(tmp_path: Path) -> None:
    """Every picture may be there while its noise is still measured, and readers take it."""
    for name, more, role in (("a", {}, SEALED), ("b", {"from_file": True}, "")):
        data = folder(tmp_path / name, "ignored")
        (data / "dataset.json").unlink()
        told = {"generator": {"name": MAKER}, "options": {"scene": "desk", **more}}
        (data / "dataset.partial.json").write_text(json.dumps(told))
        assert role_of(data) == role
    with pytest.raises(BadValueError, match="is sealed"):
        require_allowed(plan_of(tmp_path, tmp_path / "a"))


@pytest.mark.parametrize(
    ("kind", "scene", "refused"),
    [
        *(("tune", name, False) for name in ("interior", "bathroom", "sponza")),
        *(("tune", name, True) for name in ("bear", "diningroom", "dog", "sofa", "chair", "desk")),
        *(("report", name, False) for name in ("sponza", "sofa", "dog")),
        *(("report", name, True) for name in ("chair", "desk")),
    ],
)
def test_what_a_plan_of_each_kind_may_open(tmp_path: Path, kind: str, scene: str, refused: bool) -> None:
    plan = plan_of(tmp_path, folder(tmp_path / "a", "kitchen"), folder(tmp_path / "b", scene), kind=kind)
    if not refused:
        require_allowed(plan)
        return
    with pytest.raises(BadValueError, match=rf"'b' is {ROLES[scene]}") as caught:
        require_allowed(plan)
    assert caught.value.hint


def test_a_plan_without_a_kind_reports_and_keeps_sealed_scenes_closed(tmp_path: Path) -> None:
    sealed = folder(tmp_path / "desk", "desk")
    assert plan_of(tmp_path, sealed).kind == "report"
    with pytest.raises(BadValueError, match="open_sealed = true"):
        require_allowed(plan_of(tmp_path, sealed))
    opened = plan_of(tmp_path, sealed, open_sealed=True)
    require_allowed(opened)
    assert "sealed scenes (desk): opened by this plan" in role_lines(opened)[0]
    with pytest.raises(BadValueError, match="is sealed"):  # no plan tunes on it, whatever it says
        require_allowed(plan_of(tmp_path, sealed, kind="tune", open_sealed=True))


def test_a_plan_that_tunes_needs_validation_views(tmp_path: Path) -> None:
    for without in (folder(tmp_path / "a", "sponza", validation=False), tmp_path):
        with pytest.raises(BadValueError, match="no validation views") as caught:
            require_allowed(plan_of(tmp_path, without, kind="tune"))
        assert "--validation-views N" in caught.value.hint and '"report"' in caught.value.hint


def test_the_report_tells_the_roles(tmp_path: Path) -> None:
    scenes = [folder(tmp_path / name, name) for name in ("sponza", "bathroom", "dog", "kitchen")]
    lines = role_lines(plan_of(tmp_path, *scenes))
    assert len(lines) == 2 and lines[0].startswith("tuning scenes (sponza, bathroom): choices were made on")
    assert "test views" in lines[0] and lines[1].startswith("held-out scenes (dog): no rate, threshold or")
    # As the notebook has it: what led to how the response begins had been seen on these three.
    assert all(f"`{name}`" in lines[1].partition("reports on")[2] for name in ("bear", "dog", "sofa"))
    assert role_lines(plan_of(tmp_path, scenes[3])) == []


def test_kind_and_opening_survive_being_written(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, folder(tmp_path / "a", "desk"), kind="report", open_sealed=True)
    write_plan(plan, tmp_path / "plan.toml")
    assert make_plan(read_plan(tmp_path / "plan.toml"), tmp_path) == plan
    for wrong, said in (
        ({"kind": "look"}, "no kind of plan 'look'"),
        ({"open_sealed": "yes"}, "open_sealed.*cannot be read"),
    ):
        with pytest.raises(PhysHDRError, match=said):
            plan_of(tmp_path, tmp_path / "a", **wrong)


def test_the_command_refuses_before_it_opens_anything(tmp_path: Path, capsys) -> None:
    out = tmp_path / "out"
    words = ["benchmark", "--methods", "default", "--budget", "iterations=5", "--out", str(out)]
    for scene, more, said in (
        ("desk", [], "is sealed"),
        ("desk", ["--report-only"], "is sealed"),
        ("dog", ["--kind", "tune"], "is held-out"),
    ):
        data = folder(tmp_path / f"{scene}{len(more)}", scene)
        assert main([*words, "--scenes", str(data), *more]) == 1
        assert said in capsys.readouterr().err and not out.exists()
