# SPDX-License-Identifier: GPL-3.0-or-later
"""Furniture: models from a folder of the user's where there are any, else what the scene builds itself.

A folder holds Sweet Home 3D catalogues (``.sh3f``, as in Debian's ``sweethome3d-furniture``), or models named
after the kind: ``sofa.obj``, ``teddy.glb``, ``armchair/…/armchair.obj``.
"""

import math
import re
import shutil
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath

import bpy
from mathutils import Matrix, Vector

from .archive import inner_path
from .blender import Point, mesh_of
from .errors import AssetError
from .progress import quiet

BUILT_IN = "built-in"
MODELS = (".obj", ".glb", ".gltf")
CATALOGUE = "PluginFurnitureCatalog.properties"
FREE = ("public domain", "cc0", "cc-0")
#: What a kind is called in the catalogues, where that is not the kind itself; the best first.
CALLED = {
    "teddy": ("teddy bear",),
    "bear": ("teddy bear",),
    "sofa": ("sofa", "winchester sofa", "couch"),
    "armchair": ("winchester armchair", "armchair"),
    "plant": ("plant", "decorative plant", "little plant"),
    "toilet": ("toilets unit", "toilet"),
    "bathtub": ("bath", "bathtub"),
    "television": ("tv", "television"),
    "screen": ("screen", "computer screen"),
    "table": ("oak table", "table"),
    "chair": ("oak chair", "chair"),
    "bookshelf": ("bookcase", "shelves"),
}


@dataclass(frozen=True)
class _Model:
    """A model that can be imported: a file, or a member of a catalogue."""

    name: str
    path: Path
    member: str = ""
    rotation: Matrix = field(default_factory=lambda: Matrix.Identity(4))
    licence: str = ""

    @property
    def label(self) -> str:
        return f"{self.path.name}:{self.member}" if self.member else str(self.path)


class Assets:
    """Places furniture by kind, and remembers where each came from.

    Raises:
        AssetError: ``folder`` is given and is no folder.
    """

    def __init__(self, folder: Path | None = None) -> None:
        if folder is not None and not folder.is_dir():
            raise AssetError(
                f"there is no folder of models '{folder}'",
                "give --assets a folder with .sh3f, .obj or .glb files "
                "(Debian's sweethome3d-furniture has /usr/share/sweethome3d/furniture)",
            )
        self.folder = folder
        #: Kind → the model's file, or ``built-in``. For dataset.json.
        self.used: dict[str, str] = {}

    def place(
        self,
        kind: str,
        room: bpy.types.Collection,
        foot: Point,
        size: Point,
        turn: float,
        stand_in: Callable[[], None],
        fill: bool = False,
    ) -> None:
        """Put a model of ``kind`` (``sofa``, ``armchair``, ``teddy`` …) in the room, or call ``stand_in``.

        ``foot``: the middle of its base; ``size``: width, depth, height it must fit into, with its own
        proportions kept, or with ``fill`` stretched to that size (a table: things stand on it); ``turn``:
        radians about Z, 0 faces −Y (toward the camera of a grid rig).

        Raises:
            AssetError: the model is there and cannot be read.
        """
        model = self._find(kind)
        if model is None:
            stand_in()
            self.used[kind] = BUILT_IN
            return
        items = _imported(model)
        _fit(items, room, foot, size, turn, fill)
        self.used[kind] = model.label

    def _find(self, kind: str) -> _Model | None:
        wanted = [*CALLED.get(kind, ()), kind]
        for name in wanted:
            for model in self._models:
                if model.name == name:
                    return model
        return None

    @cached_property
    def _models(self) -> list[_Model]:
        """All there are: single files first, then catalogues, those in the public domain before others."""
        if self.folder is None:
            return []
        files = sorted(path for path in self.folder.rglob("*") if path.suffix.lower() in MODELS)
        single = [_Model(_plain(path.stem), path) for path in files]
        listed = [model for path in sorted(self.folder.rglob("*.sh3f")) for model in _read_catalogue(path)]
        return single + sorted(listed, key=lambda model: model.licence.lower() not in FREE)


def _plain(name: str) -> str:
    """``TeddyBear_2`` → ``teddy bear``: file names as people write them."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|[_\-.]+", " ", name)
    return re.sub(r"[\s\d]+$", "", spaced).strip().lower()


def _read_catalogue(path: Path) -> list[_Model]:
    """The models of a Sweet Home 3D catalogue: a zip with a Java properties file that names them."""
    try:
        with zipfile.ZipFile(path) as file:
            text = file.read(CATALOGUE).decode("latin-1")
            members = set(file.namelist())
    except (OSError, KeyError, zipfile.BadZipFile, zipfile.LargeZipFile, RuntimeError) as error:
        raise AssetError(
            f"cannot read the catalogue '{path}' ({error})", "remove it from --assets"
        ) from error
    pairs = dict(line.split("=", 1) for line in text.splitlines() if "=" in line and not line.startswith("#"))
    found = []
    for key, value in pairs.items():
        number = key.removeprefix("model#")
        member = value.strip().lstrip("/")
        if key == number or member not in members or not member.lower().endswith(".obj"):
            continue
        found.append(
            _Model(
                pairs.get(f"name#{number}", "").strip().lower(),
                path,
                member,
                _rotation(pairs.get(f"modelRotation#{number}", "")),
                pairs.get("license", "").strip(),
            )
        )
    return found


def _rotation(text: str) -> Matrix:
    """Nine numbers, row by row, in the model's own axes (Y up); none is no rotation."""
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        values = []
    if len(values) != 9 or not all(math.isfinite(value) for value in values):
        return Matrix.Identity(4)
    return Matrix((values[0:3], values[3:6], values[6:9])).to_4x4()


def _imported(model: _Model) -> list[bpy.types.Object]:
    """The model's objects, Z up and facing −Y, with their pictures packed."""
    former = set(bpy.data.objects), set(bpy.data.images)
    try:
        if model.member:
            with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
                _import(_extracted(model, Path(scratch)))
                _pack(set(bpy.data.images) - former[1])
        else:
            _import(model.path)
            _pack(set(bpy.data.images) - former[1])
    except (OSError, RuntimeError, zipfile.BadZipFile) as error:
        raise AssetError(
            f"cannot read the model '{model.label}' ({str(error).strip()})",
            "remove it from the folder, or leave out --assets",
        ) from error
    items = [item for item in bpy.data.objects if item not in former[0]]
    if not any(item.type == "MESH" and len(mesh_of(item).vertices) for item in items):
        raise AssetError(f"the model '{model.label}' has no faces", "remove it, or leave out --assets")
    # To Blender's axes, around the rotation that is stated in the model's.
    up = Matrix.Rotation(math.pi / 2, 4, "X")
    turned = up @ model.rotation @ up.inverted()
    for item in items:
        if item.parent is None:
            item.matrix_world = turned @ item.matrix_world
    return items


def _extracted(model: _Model, scratch: Path) -> Path:
    """The folder of a catalogue's model (its materials and pictures are beside it), unpacked.

    Raises ``AssetError`` where a file of it has a name that would leave the folder, on any platform.
    """
    folder = PurePosixPath(model.member).parent
    with zipfile.ZipFile(model.path) as file:
        for entry in file.infolist():
            if entry.is_dir() or folder not in PurePosixPath(entry.filename).parents:
                continue
            name = inner_path(entry.filename)
            if name is None:
                raise AssetError(
                    f"the catalogue '{model.path}' holds {entry.filename!r}, a name that no file may have",
                    "remove the catalogue from --assets: it is damaged, or made to write elsewhere",
                )
            target = scratch / name.relative_to(folder)
            target.parent.mkdir(parents=True, exist_ok=True)
            with file.open(entry) as source, open(target, "wb") as copy:
                shutil.copyfileobj(source, copy)
    return scratch / PurePosixPath(model.member).name


def _import(path: Path) -> None:
    with quiet():
        if path.suffix.lower() == ".obj":
            done = bpy.ops.wm.obj_import(filepath=str(path), forward_axis="NEGATIVE_Z", up_axis="Y")
        else:
            done = bpy.ops.import_scene.gltf(filepath=str(path))
    if "FINISHED" not in done:
        raise RuntimeError("Blender could not import it")


def _pack(images: set[bpy.types.Image]) -> None:
    """Into memory: the files may be gone when the picture is rendered."""
    for image in images:
        if image.source == "FILE" and not image.packed_file:
            image.pack()


def _fit(
    items: list[bpy.types.Object],
    room: bpy.types.Collection,
    foot: Point,
    size: Point,
    turn: float,
    fill: bool,
) -> None:
    """Scale into ``size``, stand on ``foot``, turn about the vertical; move to ``room``."""
    for item in items:
        for collection in list(item.users_collection):
            collection.objects.unlink(item)
        room.objects.link(item)
    bpy.context.view_layer.update()
    # Of objects in no view layer of the context, matrix_world is not evaluated: multiply up the parents.
    world = {item: _world(item) for item in items}
    corners = [
        world[item] @ Vector(corner) for item in items if item.type == "MESH" for corner in item.bound_box
    ]
    low = Vector([min(corner[axis] for corner in corners) for axis in range(3)])
    high = Vector([max(corner[axis] for corner in corners) for axis in range(3)])
    extent = high - low
    factors = [size[axis] / extent[axis] if extent[axis] > 1e-9 else math.inf for axis in range(3)]
    if not fill:
        factors = [min(factors)] * 3
    factors = [factor if math.isfinite(factor) else 1.0 for factor in factors]
    centre = Vector(((low.x + high.x) / 2, (low.y + high.y) / 2, low.z))
    placed = (
        Matrix.Translation([*foot])
        @ Matrix.Rotation(turn, 4, "Z")
        @ Matrix.Diagonal((*factors, 1.0))
        @ Matrix.Translation([*-centre])
    )
    for item in items:
        if item.parent is None:
            item.matrix_world = placed @ world[item]


def _world(item: bpy.types.Object) -> Matrix:
    if item.parent is None:
        return item.matrix_basis.copy()
    return _world(item.parent) @ item.matrix_parent_inverse @ item.matrix_basis
