# SPDX-License-Identifier: GPL-3.0-or-later
"""Options shared by all kinds of ``physhdr render``, and the cameras they name."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ...bridge.errors import BadValueError
from ...bridge.layouts import NERFSTUDIO
from ...bridge.layouts.transforms import TRANSFORMS_FILE
from ...bridge.shots import Shots
from ..device import DeviceName
from ..evaluate.camera_file import read_camera_file
from ..rasterize import Implementation
from ..scene import Camera, Scene


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """What to render, with what, and where to."""

    #: Folder of the run; with --at also an exported model file (.safetensors, .ply).
    source: tyro.conf.Positional[Path]
    #: What to write: .exr (scene-linear radiance) or .png (through the learned response); a video (.mp4, .mov
    #: and .mkv need the package av; web pages loop .webp); or a folder: of a video's frames (PNG), of
    #: all views (--split), of the light at a place (--at). A video and a folder may both be given.
    out: Annotated[list[Path], tyro.conf.UseAppendAction]
    #: Width in pixels (the height follows); default: the data set's, or that of --camera; of --at a power of
    #: two, by default 1024.
    width: int | None = None
    #: The data set, if it has moved since training.
    data: Path | None = None
    rasteriser: Implementation = "auto"
    device: DeviceName = "auto"
    #: Write progress and the result or error as JSON, one object per line.
    json: bool = False

    @property
    def only_out(self) -> Path:
        """The one output; raises ``BadValueError`` for several."""
        if len(self.out) != 1:
            raise BadValueError(f"expected one --out, got {len(self.out)}", "Give one.")
        return self.out[0]


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """One camera of the data set, or a file of cameras, one per frame."""

    #: Which camera: SPLIT/POSE; default: the first test view.
    view: str | None = None
    #: A file of cameras instead: of Blender's panel (docs/formats.md), with exposure, levels and frame rate;
    #: a path of nerfstudio's viewer (JSON), or a USD camera. One camera gives a picture, several give
    #: frames/name_####.exr (or .png), a folder, or a video.
    camera: Path | None = None
    #: Which of a USD file's cameras, by path or name, if it has several.
    camera_prim: str | None = None
    #: dataparser_transforms.json of the nerfstudio training whose viewer made the path, to convert its axes.
    camera_space: Path | None = None

    def require_file(self) -> None:
        """Raises ``BadValueError`` for options of --camera without it."""
        for name in ("camera_prim", "camera_space"):
            if self.camera is None and getattr(self, name) is not None:
                raise BadValueError(
                    f"--{name.replace('_', '-')} only works with --camera FILE",
                    "Leave it out, or give a file.",
                )

    def shots(self, scene: Scene, file: Path, fewest: int = 1) -> Shots:
        """The frames of the ``file`` of cameras in the scene's world; errors as ``read_camera_file``."""
        return shots_in(scene, file, self.camera_prim, self.camera_space, fewest)


@dataclass(frozen=True, kw_only=True)
class LookOptions:
    """Light and exposure."""

    #: Seconds; not for .exr. Default: the middle exposure of the data set.
    exposure: float | None = None
    #: Level of the first light (the ambient one if that has levels), relative to the standard views.
    lighting_level: float | None = None
    #: Lights by name: NAME=VALUE …; the others are as in the standard photos (mostly 1).
    lighting_levels: tuple[str, ...] = ()


def camera_named(scene: Scene, name: str | None) -> Camera:
    """The camera of ``test/3``, ``train/0`` or ``lit/2``; None: the first test view, or training view.

    Raises ``BadValueError`` listing those that exist.
    """
    if name is None:
        return (scene.test or scene.train)[0].camera
    split, slash, index = name.partition("/")
    index = index.removeprefix("r_")
    if not slash or not index.isdigit():
        raise BadValueError(
            f"--view must be like test/3, got '{name}'", "SPLIT/POSE, split train, test or lit."
        )
    return scene.find(split, int(index)).camera


def shots_in(scene: Scene, file: Path, prim: str | None, space: Path | None, fewest: int = 1) -> Shots:
    """The frames of a file of cameras in the scene's world; arguments and errors as ``read_camera_file``."""
    poses = scene.root / TRANSFORMS_FILE if scene.layout == NERFSTUDIO.name else None
    return read_camera_file(file, camera_named(scene, None), prim, space, fewest, poses)
