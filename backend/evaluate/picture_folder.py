# SPDX-License-Identifier: GPL-3.0-or-later
"""A folder of pictures of a split's views, made by any program: read for an evaluation, and written.

They have the names of the data set's files: ``test/r_0_0.png`` at the first exposure of pose 0, the name of
the true radiance for HDR (``test_hdr/hdr_000.exr``), that of the relit truth under other light
(``relit/level_4/hdr_000.exr``), and others in other layouts. Where the data set's picture is no PNG, a
``.png`` of the same name is accepted, because a JPEG loses information.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch

from ...bridge.atomic import all_at_once
from ...bridge.data_set import TEST
from ...bridge.errors import BadValueError, DataMismatchError, FileMissingError, PhysHDRError
from ...bridge.lights import AMBIENT, Levels, as_levels
from ...bridge.regular import resolved
from ..scene.camera import Camera
from ..scene.encoding import LARGEST
from ..scene.pictures import picture_size, read_codes, write_exr, write_png
from ..scene.scene import Scene, View
from . import truth
from .pictures import finite
from .renderer import Renderer, standard_of
from .results import VIEWS_OF

REMEDY = "Write it again with the name and size of the data set's picture; see lab/compare.md."
ALL_OR_NONE = "Write it, or none of its kind: a mean over some of the views cannot be compared."
#: White of a 16-bit picture.
DEEP = float(LARGEST[np.dtype(np.uint16)])


class PictureFolder(Renderer):
    """The pictures in ``folder``, one for each view of ``split`` at each exposure, as a renderer.

    It only renders the cameras of these views. ``has_hdr``: whether there are HDR pictures; ``shows``:
    whether there are pictures of a mix of lights. The constructor checks that all files exist and have the
    right size before any is read.

    Raises ``FileMissingError`` for a missing picture (all HDR ones may be missing, or all of a mix),
    ``DataMismatchError`` for one of another size and ``FileDamagedError`` for an unreadable one.
    """

    def __init__(self, folder: Path, scene: Scene, split: str = TEST) -> None:
        self.folder, self._split = Path(folder), split
        if not self.folder.is_dir():
            raise FileMissingError(f"there is no folder of pictures {folder}", "Check the path.")
        views = scene.splits[split]
        self._views = {view.camera: view for view in views}
        assert len(self._views) == len(views)  # every pose has its own camera
        self._ldr = {view.camera: self._ldr_paths(scene, view) for view in views}
        self._require([path for paths in self._ldr.values() for path in paths.values()])
        self._find_hdr(scene, views)
        self._find_relit(scene)
        for view in views:
            relit = [path for (index, _), path in self._relit.items() if index == view.index]
            hdr = [self._hdr[view.camera]] if view.camera in self._hdr else []
            for path in [*self._ldr[view.camera].values(), *hdr, *relit]:
                _require_size(path, view.camera)

    def _ldr_paths(self, scene: Scene, view: View) -> dict[int, Path]:
        """A camera's pictures by position in the view's exposures; others are compared through HDR."""
        paths = {}
        for k, source in enumerate(view.sources):
            if not view.encodings[k].is_known:
                path = self._at(scene, source.path)
                other = path.with_suffix(".png")
                paths[k] = other if not path.exists() and other.exists() else path
        return paths

    def _find_hdr(self, scene: Scene, views: Sequence[View]) -> None:
        paths = {view.camera: self._at(scene, hdr_path(scene, self._split, view)) for view in views}
        read = [view.camera for view in views if any(encoding.is_known for encoding in view.encodings)]
        self._require([paths[camera] for camera in read])
        judged = truth.has_hdr_truth(scene.root, self._split)
        self.has_hdr = judged and self._is_whole(list(paths.values()), "HDR")
        self._hdr = paths if self.has_hdr else {camera: paths[camera] for camera in read}

    def _find_relit(self, scene: Scene) -> None:
        there = truth.relit_truth(scene.root) if self._split == TEST else []
        names = [name for item in there for name in item.levels]
        self.lights = tuple(dict.fromkeys([AMBIENT, *names]))
        self._standard = standard_of(self, scene)
        self._relit: dict[tuple[int, tuple[float, ...]], Path] = {}
        for condition in dict.fromkeys(item.condition for item in there):
            items = [item for item in there if item.condition == condition]
            paths = [self._at(scene, item.path) for item in items]
            if self._is_whole(paths, condition):
                keys = [(item.index, item.levels_of(self.lights, self._standard)) for item in items]
                self._relit |= dict(zip(keys, paths, strict=True))
        if self._relit and not self.has_hdr:
            raise FileMissingError(
                f"{self.folder} has relit pictures, but no HDR ones",
                "Write these as well: relit pictures are compared with them.",
            )

    def _at(self, scene: Scene, path: Path) -> Path:
        """The counterpart of a file of the data set."""
        return self.folder / name_in(scene, path)

    def _require(self, paths: Sequence[Path]) -> None:
        missing = [path for path in paths if not path.exists()]
        if missing:
            more = f" ({len(missing)} of {len(paths)} are)" if len(missing) > 1 else ""
            raise FileMissingError(
                f"{missing[0]} is missing{more}",
                f"Each of the {len(self._views)} {VIEWS_OF[self._split]} needs a picture at each of its "
                "exposures, named like the data set's own.",
            )

    def _is_whole(self, paths: Sequence[Path], kind: str) -> bool:
        """Whether all exist; raises ``FileMissingError`` if only some do."""
        missing = [path for path in paths if not path.exists()]
        if missing and len(missing) < len(paths):
            raise FileMissingError(
                f"{missing[0]} is missing ({len(missing)} of {len(paths)} {kind} pictures are)", ALL_OR_NONE
            )
        return not missing

    def shows(self, item: truth.RelitTruth) -> bool:
        """Whether there are pictures under this light."""
        return (item.index, item.levels_of(self.lights, self._standard)) in self._relit

    @property
    def remarks(self) -> tuple[str, ...]:
        return ("Pictures that another program made: how it was trained is not known here.",)

    def hdr(self, camera: Camera, lighting_level: Levels | None = None) -> torch.Tensor:
        view = self._view(camera)
        levels = self._standard if lighting_level is None else as_levels(lighting_level, self.lights)
        is_standard = levels == self._standard
        path = self._hdr.get(camera) if is_standard else self._relit.get((view.index, levels))
        if path is None:
            raise BadValueError(f"{self.folder} has no HDR picture of {view.name} at the levels {levels}")
        with _of_a_picture():
            return truth.radiance_in(path)

    def ldr(self, camera: Camera, exposure: float, lighting_level: Levels | None = None) -> torch.Tensor:
        return next(iter(self.ldr_bracket(camera, [exposure], lighting_level)))

    def ldr_bracket(
        self, camera: Camera, exposures: Sequence[float], lighting_level: Levels | None = None
    ) -> Iterator[torch.Tensor]:
        """As of any renderer; equal exposures in one bracket are returned in order."""
        view, left = self._view(camera), dict(self._ldr[camera])
        for exposure in exposures:
            k = next((k for k in left if view.exposures[k] == exposure), None)
            if k is None:
                raise BadValueError(f"{self.folder} has no picture of {view.name} at {exposure:g} s")
            with _of_a_picture():
                codes, _ = read_codes(left.pop(k))
            yield torch.from_numpy(codes / float(LARGEST[codes.dtype])).permute(2, 0, 1).contiguous()

    def photographed(
        self,
        camera: Camera,
        exposures: Sequence[float],
        effects: Sequence[torch.Tensor],
        lighting_level: Levels | None = None,
    ) -> Iterator[torch.Tensor]:
        """Never called, because this learns nothing about a camera."""
        raise BadValueError(f"{self.folder} only has finished pictures")

    def _view(self, camera: Camera) -> View:
        if camera not in self._views:
            raise BadValueError(f"{self.folder} only has pictures of the {VIEWS_OF[self._split]}")
        return self._views[camera]


def _require_size(path: Path, camera: Camera) -> None:
    with _of_a_picture():
        width, height = picture_size(path)
    if (width, height) != (camera.width, camera.height):
        raise DataMismatchError(
            f"{path} is {width}×{height}, the data set's picture is evaluated at "
            f"{camera.width}×{camera.height}",
            "Render at that size; --downscale evaluates at another.",
        )


@contextmanager
def _of_a_picture() -> Iterator[None]:
    """Errors of readers with a remedy for pictures outside a data set."""
    try:
        yield
    except PhysHDRError as error:
        raise type(error)(error.message, REMEDY) from error


# ---- names, and writing --------------------------------------------------------------------------------


def name_in(scene: Scene, path: Path) -> str:
    """A file of the data set as named within it, ``test/r_0_0.png``."""
    return os.path.relpath(os.path.abspath(path), os.path.abspath(scene.root))


def hdr_path(scene: Scene, split: str, view: View) -> Path:
    """Where the data set stores the view's true radiance, or would."""
    return truth.hdr_truth_path(scene.root, split, view.index)


@torch.no_grad()
def write_pictures(
    renderer: Renderer,
    scene: Scene,
    folder: Path,
    split: str = TEST,
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> int:
    """Write what ``PictureFolder`` reads for every view of ``split``; returns the number of files.

    Camera pictures as 16-bit PNG, radiance as OpenEXR, also under every light of the relit truth that the
    model has a level for; all without learned vignetting. Existing files of these names are replaced at the
    end, when all are written, so that an interruption never mixes two models. ``progress`` is called with
    (views done, all, the next one). Raises ``BadValueError`` if ``folder`` is the data set itself or the
    model renders NaN, and ``OutputError``.
    """
    if resolved(folder) == resolved(scene.root):
        raise BadValueError(
            f"{folder} is the data set, whose pictures would be replaced", "Give another folder."
        )
    relit = truth.relit_truth(scene.root) if split == TEST else []
    views, standard, count = scene.splits[split], standard_of(renderer, scene), 0
    _require_none_stays(renderer, scene, folder, views, relit)
    with all_at_once(folder) as unfinished:
        for done, view in enumerate(views):
            progress(done, len(views), view.name)
            places = [k for k, encoding in enumerate(view.encodings) if not encoding.is_known]
            exposures = [view.exposures[k] for k in places]
            drawn = renderer.ldr_bracket(view.camera, exposures) if places else ()
            for k, picture in zip(places, drawn, strict=True):
                codes = finite(picture, view.name).clamp(0.0, 1.0).double() * DEEP
                path = (unfinished / name_in(scene, view.sources[k].path)).with_suffix(".png")
                write_png(path, _planes_last(codes.round()).astype(np.uint16))
            conditions = [item for item in relit if item.index == view.index]
            conditions = [item for item in conditions if item.can_be_shown(renderer.lights)]
            radiance = {hdr_path(scene, split, view): renderer.hdr(view.camera)}
            radiance |= {
                item.path: renderer.hdr(view.camera, item.levels_of(renderer.lights, standard))
                for item in conditions
            }
            for path, picture in radiance.items():
                write_exr(unfinished / name_in(scene, path), _planes_last(finite(picture, view.name)))
            count += len(places) + len(radiance)
    progress(len(views), len(views), "")
    return count


def _require_none_stays(
    renderer: Renderer, scene: Scene, folder: Path, views: Sequence[View], relit: Sequence[truth.RelitTruth]
) -> None:
    """Raises ``BadValueError`` for other pictures that ``PictureFolder`` would read with the renderer's."""
    pictures = [
        source.path
        for view in views
        for source, encoding in zip(view.sources, view.encodings, strict=True)
        if not encoding.is_known and source.path.suffix != ".png"
    ]
    unknown = [item.path for item in relit if not item.can_be_shown(renderer.lights)]
    for path in (folder / name_in(scene, path) for path in (*pictures, *unknown)):
        if path.exists():
            raise BadValueError(
                f"{path} exists and would be taken for this model's",
                "Give another folder, or remove what is in it.",
            )


def _planes_last(picture: torch.Tensor) -> np.ndarray:
    return np.ascontiguousarray(picture.permute(1, 2, 0).numpy())
