# SPDX-License-Identifier: GPL-3.0-or-later
"""Which room of the house may import which: the picture of ``docs/architecture.md``, kept by a test.

Read from the sources, without importing them; an import inside a function counts as one at the top.
"""

import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

#: Each room's own modules, and the rooms that it may import beside itself.
MAY_IMPORT = {
    "bridge": (),
    "synth": ("bridge",),
    "addon": ("bridge", "synth"),
    "backend": ("bridge",),
    "lab": ("bridge", "backend"),
}

#: Programs that make the lab's data and figures, in whichever Python each needs. They belong to no package,
#: so that nothing can import them.
PROGRAMS = "lab/tools"

#: Modules of others that are Blender's, and those that only the backend's environment has.
OF_BLENDER = {"bpy", "bmesh", "mathutils", "gpu", "gpu_extras", "bpy_extras", "bl_math", "blf", "imbuf"}
OF_THE_BACKEND = {"torch", "numba", "scipy", "safetensors", "OpenEXR", "PIL", "tyro", "rich", "tensorboard"}
#: What the contracts may need: both sides must have it.
OF_THE_BRIDGE = {*sys.stdlib_module_names, "numpy", "plyfile", "filelock"}

#: A room from top to bottom: a module imports from its own place and from lines below its own, never from
#: above, nor from others on its line. A module that is named for itself has its own place.
Floors = tuple[tuple[str, ...], ...]
BACKEND: Floors = (
    # Programs that are started by their names: nobody imports them.
    ("launch",),
    ("cli",),
    ("serve",),
    # A run's folder · work that other processes do.
    ("runs", "jobs"),
    ("train", "export"),
    ("methods",),
    # What a training starts from, and what a method draws from its brackets at once.
    ("start",),
    ("model",),
    # Measures the noise of true radiance, which evaluation alone may read.
    ("inspect",),
    ("evaluate", "device"),
    ("surface",),
    # Compiling ahead of time calls the rasteriser, too.
    ("kernels",),
    ("rasterize",),
    ("simd", "scene", "formats"),
    # Rows that packages add.
    ("tables",),
    # Standard library alone (and the bridge's errors): asked before anything else is there.
    ("memory", "project", "optional", "child", "bounds"),
    ("shell",),
)
ADDON: Floors = (
    # Programs that are started by their paths: nobody imports them.
    ("scripts",),
    ("panels",),
    ("operators",),
    ("blend_paths",),
    ("dataset", "light"),
    ("rendering", "runtime"),
    ("viewport", "plot"),
    ("capture",),
    ("model",),
    ("chosen_run",),
    ("settings",),
    ("session",),
    # What of the places that a file names may be looked at.
    ("outside",),
    # Without Blender (as is the session): folders of data sets, similarities · What Blender's types lack.
    ("layouts", "similarity", "blender", "changes", "paths"),
)
LAB: Floors = (
    # A program that is started by its name: nobody imports it.
    ("benchmark.child",),
    ("command",),
    ("benchmark", "presets"),
    ("peers", "anchors"),
)
FLOORS = {"backend": BACKEND, "addon": ADDON, "lab": LAB}


@dataclass(frozen=True)
class Import:
    """``source`` imports ``target`` in ``line``: names of modules with dots, ours without ``physhdr``."""

    source: str
    target: str
    line: int

    def __str__(self) -> str:
        return f"{self.source}:{self.line} imports {self.target}"


def module_name(path: Path, root: Path) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def modules_in(root: Path) -> dict[str, Path]:
    """Every module of the house by its name, such as ``backend.train.trainer``."""
    paths = (path for room in MAY_IMPORT for path in sorted((root / room).rglob("*.py")))
    return {module_name(path, root): path for path in paths if path.parent != root / PROGRAMS}


def imports_of(name: str, path: Path, modules: dict[str, Path]) -> Iterator[Import]:
    """What a module imports: of ours the module itself, where a package's name is imported the package."""
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Import(name, alias.name.removeprefix("physhdr."), node.lineno)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*above, node.module or ""]).strip(".").removeprefix("physhdr").strip(".")
            for alias in node.names:
                whole = f"{base}.{alias.name}".strip(".")
                yield Import(name, whole if whole in modules else base, node.lineno)


def all_imports(root: Path) -> list[Import]:
    modules = modules_in(root)
    found = (each for name, path in modules.items() for each in imports_of(name, path, modules))
    return list(dict.fromkeys(each for each in found if each.target != each.source))


def room_of(name: str) -> str:
    return name.partition(".")[0]


def place_of(name: str) -> tuple[int, str] | None:
    """The line of its room's floors on which a module stands, and as what; None: on none."""
    room, _, rest = name.partition(".")
    fitting = [
        (len(place), line, place)
        for line, places in enumerate(FLOORS[room])
        for place in places
        if rest == place or rest.startswith(f"{place}.")
    ]
    return max(fitting)[1:] if fitting else None


def wrong_between_rooms(imports: list[Import]) -> list[str]:
    """Imports that lead from one room into another that it must not know."""
    wrong = []
    for each in imports:
        room, other = room_of(each.source), room_of(each.target)
        if other in MAY_IMPORT:
            if other != room and other not in MAY_IMPORT[room]:
                allowed = " and ".join(MAY_IMPORT[room]) or "nothing of ours"
                wrong.append(f"{each}: {room}/ may import {allowed}")
        elif room == "bridge" and other not in OF_THE_BRIDGE:
            wrong.append(f"{each}: bridge/ has the standard library, numpy, plyfile and filelock")
        elif room in ("backend", "lab") and other in OF_BLENDER:
            wrong.append(f"{each}: Blender is another process")
        elif room in ("addon", "synth") and other in OF_THE_BACKEND:
            wrong.append(f"{each}: Blender's Python has no {other}")
    return wrong


def wrong_between_floors(imports: list[Import]) -> list[str]:
    """Imports inside a room that lead up, or to a neighbour on the same line."""
    wrong = []
    for each in imports:
        room = room_of(each.source)
        if room not in FLOORS or room_of(each.target) != room or room in (each.source, each.target):
            continue  # or the package itself, which holds nothing that others need
        source, target = place_of(each.source), place_of(each.target)
        if source is None or target is None:
            unplaced = each.source if source is None else each.target
            wrong.append(f"{each}: {unplaced} has no place in {room.upper()}")
        elif target[0] < source[0]:
            wrong.append(f"{each}: {target[1]} is above {source[1]}; what both need belongs further down")
        elif target[0] == source[0] and target[1] != source[1]:
            wrong.append(f"{each}: {target[1]} is a neighbour of {source[1]}, on one line")
    return wrong


def circles_in(imports: list[Import]) -> list[str]:
    """Circles of modules that import each other, each as ``a → b → a`` (a shortest one)."""
    targets: dict[str, set[str]] = {}
    for each in imports:
        targets.setdefault(each.source, set()).add(each.target)
    circles: dict[frozenset[str], str] = {}
    for start in sorted(targets):
        way_to = {start: [start]}
        queue = [start]
        for name in queue:  # breadth first
            for target in sorted(targets.get(name, ())):
                if target == start:
                    circles.setdefault(frozenset(way_to[name]), " → ".join([*way_to[name], start]))
                elif target not in way_to:
                    way_to[target] = [*way_to[name], target]
                    queue.append(target)
    return sorted(circles.values())


@pytest.fixture(scope="module")
def imports() -> list[Import]:
    return all_imports(ROOT)


def test_rooms_import_only_what_they_may(imports: list[Import]) -> None:
    assert not (wrong := wrong_between_rooms(imports)), "\n".join(wrong)


def test_inside_a_room_imports_go_down(imports: list[Import]) -> None:
    assert not (wrong := wrong_between_floors(imports)), "\n".join(wrong)


def test_no_modules_import_each_other_in_a_circle(imports: list[Import]) -> None:
    assert not (circles := circles_in(imports)), "\n".join(circles)


def test_every_place_of_the_picture_is_there() -> None:
    there = {place for name in modules_in(ROOT) for place in (name, name.rpartition(".")[0])}
    places = {f"{room}.{place}" for room, floors in FLOORS.items() for line in floors for place in line}
    assert not (missing := places - there), f"there is no {', '.join(sorted(missing))}"


# -- the test itself: each kind of wrong import is found -----------------------------------------------------


@pytest.fixture
def house(tmp_path: Path):
    """Builds a house of the given modules and returns what is wrong with it."""

    def build(**sources: str) -> str:
        for name, text in sources.items():
            path = tmp_path.joinpath(*name.split("__")).with_suffix(".py")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        imports = all_imports(tmp_path)
        return "\n".join(
            [*wrong_between_rooms(imports), *wrong_between_floors(imports), *circles_in(imports)]
        )

    return build


@pytest.mark.parametrize(
    "where, line, told",
    [
        ("bridge__a", "import torch", "bridge.a:1 imports torch: bridge/ has the standard library"),
        ("bridge__a", "from ..synth.b import c", "bridge.a:1 imports synth.b: bridge/ may import nothing"),
        ("synth__a", "from ..addon import b", "synth.a:1 imports addon: synth/ may import bridge"),
        ("addon__a", "from ..backend import memory", "addon/ may import bridge and synth"),
        ("addon__a", "import torch.nn", "Blender's Python has no torch"),
        ("backend__train__a", "import bpy", "Blender is another process"),
        ("backend__train__a", "from physhdr.addon import b", "backend/ may import bridge"),
        ("backend__train__a", "from ...lab.peers import b", "backend/ may import bridge"),
        ("lab__peers__a", "from ..command import b", "command is above peers"),
        ("backend__serve__a", "from ..cli.b import c", "cli is above serve"),
        ("backend__serve__a", "def f():\n    from ..cli import b", "serve.a:2 imports backend.cli: cli is"),
        ("backend__methods__a", "from ..train import b", "train is above methods"),
        ("backend__simd__a", "from ..scene import b", "scene is a neighbour of simd"),
        ("backend__attic__a", "from ..scene import b", "backend.attic.a has no place in BACKEND"),
        ("addon__model__a", "from ..capture.b import c", "capture is above model"),
        ("addon__light__a", "def f():\n    from ..dataset import b", "dataset is a neighbour of light"),
    ],
)
def test_a_wrong_import_is_told(house, where: str, line: str, told: str) -> None:
    assert told in house(**{where: line})


def test_right_imports_are_not_told(house) -> None:
    assert not house(
        bridge__a="import json\nimport numpy as np\nfrom plyfile import PlyData",
        synth__a="import bpy\nfrom ..bridge.a import b",
        addon__paths="from ..synth import a\nfrom ..bridge import a as b\nimport websockets",
        addon__panels__a="from ..operators import b\nfrom .. import paths",
        backend__cli__a="def f():\n    from ..serve.b import c\n    import torch",
        backend__train__a="from . import b\nfrom ..methods.c import d\nfrom ...bridge import a",
        backend__train__b="from ..scene import Scene",
    )


def test_a_circle_is_told(house) -> None:
    assert "backend.model.a → backend.model.b → backend.model.a" in house(
        backend__model__a="from .b import c", backend__model__b="def f():\n    from . import a"
    )
