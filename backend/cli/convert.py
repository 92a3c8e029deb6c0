# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr export IN OUT.spz``: a run, a model or another program's Gaussians in another format."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ...bridge.axes import Up, turn_of_up
from ...bridge.display import FITTED_COMMENT, TONE_WORDS, Tone, display_colour_sh, look_comment, look_words
from ...bridge.errors import BadValueError
from ...bridge.gaussian_import import upright
from ...bridge.gaussian_ply import UP_WORDS, write_standard_ply
from ...bridge.lights import Levels
from ...bridge.limits import EV_MAX
from ...bridge.model_file import SUFFIX, Model, read_model, write_model
from ...bridge.ply_model import PROVENANCE, PlyModel, model_of_cloud, read_model_or_cloud
from ...bridge.regular import regular_file
from ...bridge.run_folder import CONFIG_FILE
from ...bridge.splat_files import SplatCloud, format_of, turned, write_spz
from ...bridge.splat_files.reading import read_any
from ...bridge.splat_files.usable import left_out_note, only_usable
from ..formats.colours import (
    display_of_linear,
    exposed,
    linear_of_display,
    lost_by_decoding,
    radiance_sh,
)
from ..formats.table import Target, target_of
from ..project import version
from ..runs.terminal import console
from .exporting import BakedLook, Exporting
from .lighting import requested_levels
from .output import ShowProgress, printer, progress

if TYPE_CHECKING:  # they load torch, which takes seconds and only a run needs
    from ..runs.run import Run
    from ..scene.camera import Camera

#: EV at which radiance is written: its own value.
RADIANCE_EV = 0.0
#: Colour losses are reported from half an 8-bit code.
SEEN = 0.5 / 255.0
#: Default version of SPZ.
SPZ_VERSION = 3

ColorWords = Literal["srgb", "linear"]


@dataclass(frozen=True, eq=False)
class Source:
    """What was read: either ``model`` or ``cloud`` is set.

    ``is_linear``: the cloud's colours are linear values, not sRGB codes. ``up``: which way is up in its axes.
    ``left_out``: unusable Gaussians of a cloud (a model's ``notes`` report them). ``facts``: provenance, as
    in a PLY's header. ``run``: the run whose model it is.
    """

    model: Model | None = None
    cloud: SplatCloud | None = None
    is_linear: bool = False
    up: Up = "z"
    left_out: int = 0
    notes: tuple[str, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()
    run: "Run | None" = None


@dataclass(frozen=True)
class Look:
    """Light, exposure and response at which a model is written."""

    exposure_ev: float
    levels: Levels
    tone: Tone


@dataclass(frozen=True, kw_only=True)
class FormatOptions:
    """Formats of other programs, read or written."""

    #: Which way is up in the file; default: its format's convention (SPZ and glTF y, the others z).
    up: Up | None = None
    #: Which way is up in the source; default: as it says, or its format's convention (others' PLY: colmap).
    from_up: Up | None = None
    #: A model's response: learned, or the sRGB curve; default: learned if it has one.
    tone: Literal["learned", "srgb"] | None = None
    #: Colour space of another program's colours, where the file does not say; default: srgb.
    color_space: ColorWords | None = None
    #: glTF only: linear colours (lin_rec709_display), which a viewer blends before the sRGB curve, as we do.
    blend_linear: bool = False
    #: USD only: keep another program's display colours (srgb_rec709_scene) instead of converting them to
    #: radiance, which cannot be converted back exactly.
    display_colors: bool = False
    #: For a model file: the run or data set whose cameras captured it. Display colours are fitted to the
    #: model's images from there, as those of a run always are. docs/other-programs.md
    cameras: Path | None = None
    #: Version of SPZ: 3 (default) is read by more programs, 4 is smaller.
    spz_version: Literal[3, 4] | None = None


@dataclass(frozen=True, kw_only=True)
class Convert(Exporting, BakedLook, FormatOptions):
    """Write Gaussians in another program's format, which the output's suffix sets."""

    def work(self) -> dict[str, Any]:
        target = target_of(self.file)
        self._refuse_what_does_not_fit(target)
        say = printer(self.json)
        source = read_source(self.source, self.data, self.color_space, say)
        source = replace(source, up=self.from_up or source.up)
        up, clipped = self.up or target.up, ()
        if target.holds == "model":
            source, without = self._with_confidence(source)
            model, too_bright, described = _as_model(self.source, source)
            described += without
            source = replace(source, left_out=source.left_out + too_bright)
            write_model(self.file, model)
            count = model.count
        else:
            linear = self._wants_linear(target)
            with progress("colours", "step", self.json) as show:
                cloud, described = self._coloured(source, linear, show)
            changed = self._changed(source, cloud) if linear else ()
            cloud = turned(cloud, turn_of_up(source.up, up)) if up != source.up else cloud
            cloud = replace(cloud, up=up)
            facts = [f"{PROVENANCE}{key}: {value}" for key, value in source.facts]
            clipped = (
                *changed,
                *self._limited(source, linear),
                *self._write(target, cloud, [*facts, described]),
            )
            count = cloud.count
        left_out = [left_out_note(source.left_out)] if source.left_out else []
        notes = [*left_out, *source.notes, *clipped]
        lost = f"; {target.loses}" if source.model is not None and target.loses else ""
        for note in notes:
            say(note)
        axes = f", from {UP_WORDS[source.up]} to {UP_WORDS[up]}" if up != source.up else ""
        say(f"wrote {self.file}: {count} Gaussians, {described}{axes}{lost}")
        return {"out": str(self.file), "gaussians": count, "up": up, "told": described, "notes": notes}

    @property
    def file(self) -> Path:
        """The file to write."""
        assert self.out is not None
        return self.out

    def _with_confidence(self, source: Source) -> tuple[Source, str]:
        """A run's model with its confidence, and a note if that is unknown; other sources unchanged."""
        if source.run is None:
            return source, ""
        from .run_files import NO_CONFIDENCE

        with progress("confidence", "view", self.json) as show:
            model = source.run.model(show)
        return replace(source, model=model), "" if model.confidence is not None else f", {NO_CONFIDENCE}"

    def _refuse_what_does_not_fit(self, target: Target) -> None:
        """Raises ``BadValueError`` before anything is read."""
        if self.up is not None and self.up not in target.ups:
            raise BadValueError(
                f"{target.name} has {UP_WORDS[target.ups[0]]}, not {UP_WORDS[self.up]}",
                f"--up may be {' or '.join(target.ups)} there.",
            )
        if self.exposure_ev is not None and not abs(self.exposure_ev) <= EV_MAX:
            raise BadValueError(f"--exposure-ev is {self.exposure_ev}", f"Give −{EV_MAX:g} to {EV_MAX:g}.")
        if self.blend_linear and (target.name != "glTF" or self.tone == "learned"):
            raise BadValueError(
                "--blend-linear only works with glTF and the sRGB curve",
                "Leave it out, or write .glb with --tone srgb.",
            )
        if self.display_colors and target.name != "USD":
            raise BadValueError(
                f"--display-colors only works with USD, not {self.file.name}", "Leave it out."
            )
        if self.spz_version is not None and target.name != "SPZ":
            raise BadValueError(f"--spz-version only works with SPZ, not {self.file.name}", "Leave it out.")
        if (self.cameras is not None or self.quick) and (target.holds != "display" or self.blend_linear):
            raise BadValueError(
                f"--{'quick' if self.quick else 'cameras'} needs display colours: {self.file.name} has none",
                "Leave it out.",
            )
        if self.cameras is not None and self.quick:
            raise BadValueError("--quick does not fit colours to --cameras", "Leave one of them out.")
        if target.holds == "model" and (self._asks_for_light() or self.exposure_ev is not None or self.tone):
            raise BadValueError(
                "a model keeps all of its light and exposures", "Leave out lighting, exposure and tone."
            )
        if target.holds == "radiance" and self.tone is not None:
            raise BadValueError("USD stores radiance, without any response", "Leave --tone out.")

    def _wants_linear(self, target: Target) -> bool:
        """Whether linear colours are written, rather than display colours."""
        return self.blend_linear or (target.holds == "radiance" and not self.display_colors)

    def _asks_for_light(self) -> bool:
        return self.lighting_level is not None or bool(self.lighting_levels)

    def _coloured(self, source: Source, linear: bool, show: ShowProgress) -> tuple[SplatCloud, str]:
        """The source's Gaussians with linear or display-referred colours for the file, and a description."""
        if source.model is not None:
            if self.display_colors:
                raise BadValueError(f"{self.source} has radiance already", "Leave --display-colors out.")
            return self._of_model(source, source.model, linear, show)
        assert source.cloud is not None
        for option, changed in (("cameras", self.cameras is not None), ("quick", self.quick)):
            if changed:
                raise BadValueError(
                    f"{self.source} has its own colours, which are not fitted", f"Leave --{option} out."
                )
        if self._asks_for_light():
            raise BadValueError(f"{self.source} has no light that could change", "Leave the lighting out.")
        if self.tone == "learned":
            raise BadValueError(f"{self.source} has no learned response", "Leave --tone out.")
        if self.tone is not None and not source.is_linear and not linear:
            raise BadValueError(
                f"{self.source} has display colours, which --tone does not change",
                "Leave it out.",
            )
        cloud, sh = source.cloud, source.cloud.colour_sh
        ev = self.exposure_ev
        if source.is_linear:
            if linear:
                ev = RADIANCE_EV if ev is None else ev
                return replace(cloud, colour_sh=exposed(sh, 2.0**ev)), f"its linear colours at EV {ev:g}"
            ev = 0.0 if ev is None else ev
            described = f"display-referred colour through {TONE_WORDS['SRGB']}, EV {ev:g}"
            return replace(cloud, colour_sh=display_of_linear(sh, 2.0**ev)), described
        if ev is not None and not linear:
            raise BadValueError(
                f"{self.source} has display colours, which exposure does not change",
                "Leave --exposure-ev out, or give --color-space linear.",
            )
        if not linear:
            return cloud, "its own colours"
        described = f"its colours linearised as sRGB, EV {ev or 0.0:g}"
        return replace(cloud, colour_sh=exposed(linear_of_display(sh), 2.0 ** (ev or 0.0))), described

    def _changed(self, source: Source, linear: SplatCloud) -> tuple[str, ...]:
        """A note where converting display colours to linear ones loses accuracy."""
        if source.cloud is None or source.is_linear:
            return ()
        sh = exposed(linear.colour_sh, 2.0 ** -(self.exposure_ev or 0.0))
        lost = lost_by_decoding(source.cloud.colour_sh, sh)
        if lost < SEEN:
            return ()
        instead = "Leave --blend-linear out" if self.blend_linear else "Give --display-colors"
        return (
            "Its display colours were converted to linear ones, refitted over each Gaussian's directions: "
            f"displayed, they differ by {lost:.3f} (root mean square, white is 1). {instead} to keep them.",
        )

    def _levels(self, source: Source, model: Model, linear: bool) -> tuple[float, ...]:
        """The level of each light that is written: the requested one where colours are fitted to images of
        the run itself, else limited to the levels that the model knows."""
        asked = self._requested(model)
        of_pictures = source.run is not None and not (linear or self.quick) and self._tone(model) == "LEARNED"
        return asked if of_pictures else model.known_levels(asked)

    def _requested(self, model: Model) -> tuple[float, ...]:
        return requested_levels(
            self.lighting_level, self.lighting_levels, model.lights, model.standard_levels
        )

    def _limited(self, source: Source, linear: bool) -> tuple[str, ...]:
        """A note where a model does not know its light at the requested level."""
        model = source.model
        if model is None or not model.levels:
            return ()
        asked = self._requested(model)
        levels = self._levels(source, model, linear)
        if levels == asked:
            return ()
        known = f"{model.levels[0]:g} to {model.levels[-1]:g}"
        return (f"Its lighting is known at levels {known}: written at {levels[0]:g}, not {asked[0]:g}.",)

    def _tone(self, model: Model) -> Tone:
        return "SRGB" if self.tone == "srgb" or model.tone_curve is None else "LEARNED"

    def _of_model(
        self, source: Source, model: Model, linear: bool, show: ShowProgress
    ) -> tuple[SplatCloud, str]:
        levels = self._levels(source, model, linear)
        ev = self.exposure_ev
        if linear:
            ev = (model.developed_ev if self.blend_linear else RADIANCE_EV) if ev is None else ev
            described = f"scene-linear radiance × 2^EV, {look_words(ev, levels, model.lights)}"
            return _cloud_of(model, radiance_sh(model, 2.0**ev, levels)), described
        tone = self._tone(model)
        look = Look(model.developed_ev if ev is None else ev, levels, tone)
        comment = look_comment(look.exposure_ev, levels, tone, model.lights)
        colours = developed(model, look)
        cameras = [] if self.quick else self._cameras(source)
        if not cameras:
            return _cloud_of(model, colours), f"{comment}, each Gaussian by itself"
        return _cloud_of(model, fitted(source, colours, look, cameras, show)), f"{comment}, {FITTED_COMMENT}"

    def _cameras(self, source: Source) -> "list[Camera]":
        """The cameras to fit colours from; none where unknown."""
        if source.run is not None:
            if self.cameras is not None:
                raise BadValueError("a run has its own cameras", "Leave --cameras out.")
            return [view.camera for view in source.run.scene.train]
        if self.cameras is None:
            return []
        from ..runs.views import training_cameras

        return training_cameras(self.cameras)

    def _write(self, target: Target, cloud: SplatCloud, comments: Sequence[str]) -> tuple[str, ...]:
        """Write the file; returns notes on what the format could not store."""
        if target.name == "PLY":
            arrays = (cloud.position, cloud.rotation, cloud.scale, cloud.opacity, cloud.colour_sh)
            write_standard_ply(self.file, *arrays, comments=comments, up=cloud.up)
        elif target.name == "SPZ":
            return write_spz(self.file, cloud, self.spz_version or SPZ_VERSION)
        elif target.name == "glTF":
            from ..formats.gltf import write_gltf

            space = "lin_rec709_display" if self.blend_linear else "srgb_rec709_display"
            write_gltf(self.file, cloud, space, f"PhysHDR {version()}")
        else:
            from ..formats.usd import DISPLAY, RADIANCE, write_usd

            comment = "\n".join([f"PhysHDR {version()}", *comments])
            write_usd(self.file, cloud, cloud.up, comment, DISPLAY if self.display_colors else RADIANCE)
        return ()


def developed(model: Model, look: Look) -> np.ndarray:
    """``[N, K, 3]``: SH of the display colours (colour = Σ sh·Y + ½) of a model's look, not fitted.

    Raises what ``display_colour_sh`` raises.
    """
    return display_colour_sh(model, 2.0**look.exposure_ev, look.levels, look.tone)


def fitted(
    source: Source, colours: np.ndarray, look: Look, cameras: "Sequence[Camera]", show: ShowProgress
) -> np.ndarray:
    """``colours`` of ``developed``, fitted so that they blend to the image of the model, or of the run."""
    from ..export.fitted_bake import fitted_colour_sh, method_picture, model_picture

    assert source.model is not None
    exposure = 2.0**look.exposure_ev
    if source.run is not None and look.tone == "LEARNED":
        picture = method_picture(source.run.method, exposure, look.levels)
    else:
        picture = model_picture(source.model, exposure, look.levels, look.tone)
    return fitted_colour_sh(source.model, colours, cameras, picture, show)


def read_source(
    path: Path,
    data: Path | None = None,
    color_space: ColorWords | None = None,
    say: Callable[[str], None] = console.print,
) -> Source:
    """Read a run's folder, or a file of Gaussians in any known format.

    ``data``: the run's data set, if it moved; ``color_space``: of a file that does not say (default sRGB);
    ``say`` is called with remarks about a run. Raises what reading raises, and ``BadValueError`` where no
    Gaussian is usable, or ``data`` or ``color_space`` would have no effect.
    """
    if path.is_dir() and (path / CONFIG_FILE).exists():
        _refuse_color_space(path, color_space)
        return _of_run(path, data, say)
    if data is not None:
        raise BadValueError("--data only applies to a run, and this is a file", "Leave it out.")
    if path.is_dir():
        if not (path / "meta.json").is_file():
            raise BadValueError(f"{path} is neither a run nor a SOG", "Name a file of Gaussians.")
        path = path / "meta.json"
    regular_file(path, "Check the path.")
    if path.name.lower().endswith(SUFFIX):
        _refuse_color_space(path, color_space)
        model = read_model(path)
        return Source(model, facts=tuple(model.metadata.items()))
    kind = format_of(path).name
    if kind in ("glTF", "USD"):
        _refuse_color_space(path, color_space)
    if kind == "PLY":
        read, _ = read_model_or_cloud(path)
        if isinstance(read, PlyModel):
            _refuse_color_space(path, color_space)
            return Source(read.model, notes=read.notes, facts=tuple(read.model.metadata.items()))
        return _of_cloud(path, read, color_space == "linear")
    if kind == "SOG":
        from ..formats.sog import read_sog

        return _of_cloud(path, read_sog(path), color_space == "linear")
    if kind == "glTF":
        from ..formats.gltf import read_gltf

        splats = read_gltf(path)
        return _of_cloud(path, splats.cloud, splats.color_space == "lin_rec709_display")
    if kind == "USD":
        from ..formats.usd import read_usd

        stage = read_usd(path)
        return _of_cloud(path, stage.cloud, stage.is_radiance)
    return _of_cloud(path, read_any(path), color_space == "linear")


def _refuse_color_space(path: Path, color_space: ColorWords | None) -> None:
    """Raises ``BadValueError`` where a colour space was given for a file that states its own."""
    if color_space is not None:
        raise BadValueError(
            f"--color-space only works with PLY and others that do not state it: {path} does",
            "Leave it out.",
        )


def _of_run(folder: Path, data: Path | None, say: Callable[[str], None]) -> Source:
    from ..runs.run import open_run

    run = open_run(folder, data, report=say, pictures=False)
    return Source(run.model(with_confidence=False), facts=tuple(run.provenance.items()), run=run)


def _of_cloud(path: Path, cloud: SplatCloud, is_linear: bool) -> Source:
    cloud, left_out = only_usable(path, cloud)
    return Source(cloud=cloud, is_linear=is_linear, up=cloud.up, left_out=left_out, notes=cloud.notes)


def _as_model(path: Path, source: Source) -> tuple[Model, int, str]:
    """The source as a model in Blender's world, how many Gaussians were too bright, and its description."""
    if source.model is not None:
        return upright(source.model, source.up), 0, "the model"
    assert source.cloud is not None
    turn = turn_of_up(source.up, "z")
    read = model_of_cloud(path, turned(source.cloud, turn), "LINEAR" if source.is_linear else "SRGB")
    described = "its linear colours as radiance" if source.is_linear else "its colours linearised as sRGB"
    return read.model, read.left_out, f"{described}; its light is unknown"


def _cloud_of(model: Model, colour_sh: np.ndarray) -> SplatCloud:
    rotation = model.rotation / np.linalg.norm(model.rotation, axis=1, keepdims=True)
    return SplatCloud(model.position, rotation, model.scale, model.opacity, colour_sh)
