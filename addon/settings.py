# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user chooses: preferences of the extension, and settings of the scene (saved in the .blend)."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from ..bridge.light_words import OFF, ON, UNKNOWN
from ..bridge.limits import THREADS_MAX
from ..bridge.messages import WhenClosed
from ..bridge.presets import IN_PANEL
from ..bridge.run_folder import data_of, same_folder
from . import changes, outside
from .blender import layout_of
from .paths import PACKAGE, absolute, backend_folder
from .session.photos import PhotoOptions

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import PropertyFlagItems

RELATIVE: "set[PropertyFlagItems]" = {"PATH_SUPPORTS_BLEND_RELATIVE"}
#: After the data set's name: a folder that is proposed for its run.
RUN = "_run"
#: A number of iterations that is not found from the data begins with this: the preset Default's.
ITERATIONS = 2500
#: The property of a scene that holds its ``PHYSHDR_Settings``.
SETTINGS = "physhdr"
#: As Blender lists them: name, label, description.
PRESETS = [(preset.name, preset.label, preset.description) for preset in IN_PANEL]
EXPOSURE_MODES = [
    ("exp3", "All", "Every view is trained at each of its exposures: what you want"),
    ("exp1", "One a View", "Each view is trained at one exposure, drawn once: to compare with"),
]
DEVICES = [
    ("auto", "Automatic", "An NVIDIA card if there is one that works, else the processor"),
    ("cpu", "Processor", "The processor"),
    ("cuda", "NVIDIA card", "CUDA; needs a card, its driver and Warp"),
]
LENSES = [
    ("OPENCV", "Ordinary", "Barrel, pincushion and a little more: most lenses"),
    ("SIMPLE_RADIAL", "Simple", "One term of distortion: where places are few"),
    ("OPENCV_FISHEYE", "Fisheye", "A fisheye lens, or the widest of an action camera or drone"),
    ("PINHOLE", "None", "No distortion: rendered pictures, or photos whose lens was corrected"),
]
#: What a light does in a folder of photos: the words of ``--light`` (``bridge.light_words``).
LIGHT_WORDS = [
    (OFF, "Off", "The light is off in these photos, and on in the others"),
    (ON, "On", "The light is on in these photos alone: the others are without it"),
    ("factor", "Factor", "The light is so many times as strong as in the other photos"),
    (UNKNOWN, "Unknown", "The light has another strength, which training finds: evening, a dimmer"),
]
TONES = [
    ("linear", "Scene-Linear", "Radiance as it is; Blender's view transform shows it"),
    ("learned", "Learned", "Through the learned tone mapper, as the camera recorded it (view: Standard)"),
]
WHEN_CLOSED = [
    ("keep", "Keep Training", "Training continues; the next Blender finds it again"),
    ("stop", "Save and Stop", "Training saves a checkpoint and stops; resume continues from it"),
]
TORCH_BUILDS = [
    ("cpu", "Processor", "The small build of torch, without CUDA: about 1.8 GB"),
    ("cuda", "NVIDIA Card", "Torch for CUDA 13, or for CUDA 12 for older drivers and cards: about 7 GB"),
    ("pip", "As pip Is Set Up", "From wherever pip looks on this machine"),
]


def preferences() -> Any:
    """The extension's preferences; their defaults where it runs as a plain package, with none."""
    addon = bpy.context.preferences.addons.get(PACKAGE)
    return addon.preferences if addon and addon.preferences else _Defaults


class _Defaults:
    """What ``PHYSHDR_Preferences`` starts with, where Blender keeps none."""

    home = ""
    when_closed = "keep"
    torch = "cpu"
    research = False


def home_folder() -> Path:
    """The backend's folder: its environment, connection file, log and caches."""
    chosen = preferences().home
    return Path(absolute(chosen)) if absolute(chosen) else backend_folder()


def when_closed() -> WhenClosed:
    """What becomes of a training when this Blender closes."""
    return WhenClosed(training=preferences().when_closed)


def _close_changed(self: Any, context: bpy.types.Context) -> None:
    changes.when_closed.tell()


def _home_changed(self: Any, context: bpy.types.Context) -> None:
    changes.home.tell()


class PHYSHDR_Preferences(bpy.types.AddonPreferences):
    bl_idname = PACKAGE

    home: bpy.props.StringProperty(
        name="Backend's Folder",
        subtype="DIR_PATH",
        description="For the backend's environment, log and caches; empty: Blender's folder for extensions, "
        "on Windows the user's local one",
        update=_home_changed,
    )
    when_closed: bpy.props.EnumProperty(
        name="When Blender Closes",
        items=WHEN_CLOSED,
        description="What becomes of a training under way",
        update=_close_changed,
    )
    torch: bpy.props.EnumProperty(name="Build of torch", items=TORCH_BUILDS)
    research: bpy.props.BoolProperty(
        name="Research Methods",
        description="Offer published methods and variants, to compare with, beside Fast, Default and High",
    )

    def draw(self, context: bpy.types.Context) -> None:
        layout = layout_of(self)
        layout.use_property_split = True
        for name in ("home", "torch", "when_closed", "research"):
            layout.prop(self, name)


_respelled = ContextVar("respelled", default=False)


@contextmanager
def respelling() -> Iterator[None]:
    """Within it folders are only spelled otherwise, and are not chosen anew."""
    token = _respelled.set(True)
    try:
        yield
    finally:
        _respelled.reset(token)


def choosing(name: str) -> Callable[[Any, bpy.types.Context], None]:
    """The update function of a path: who sets it has chosen the place (``outside``)."""

    def update(self: Any, context: bpy.types.Context) -> None:
        if not _respelled.get():
            outside.choose(getattr(self, name))

    return update


def _data_chosen(self: Any, context: bpy.types.Context) -> None:
    choosing("data")(self, context)
    folder = absolute(self.data)
    if folder and not _respelled.get():
        changes.dataset.tell(folder)
        _leave_former_run(self, folder)


def _leave_former_run(chosen: Any, data: str) -> None:
    """The folder that was proposed for a run of another data set is not where the next one's goes.

    It stays where that has moved: ``data`` may be where it is now.
    """
    out = outside.chosen(chosen.out)
    trained_on = data_of(Path(out)) if out else None
    if trained_on is None or not outside.is_folder(trained_on) or same_folder(trained_on, data):
        return
    if os.path.basename(out).startswith(f"{trained_on.name}{RUN}"):
        chosen.out = ""  # another is proposed


def _is_automatic(self: Any) -> bool:
    return self.iterations == 0


def _set_automatic(self: Any, value: bool) -> None:
    self.iterations = 0 if value else ITERATIONS


class PHYSHDR_LightLevel(bpy.types.PropertyGroup):
    """The level of a light in the live preview, by the light's name."""

    level: bpy.props.FloatProperty(
        name="Level",
        default=1.0,
        min=0.0,
        soft_max=4.0,
        description="Strength of this light: 1 as captured, 0 off. Other lights stay as they are",
    )


class PHYSHDR_OtherLight(bpy.types.PropertyGroup):
    """A folder of photos under other light, and what a light does there."""

    folder: bpy.props.StringProperty(
        name="Folder",
        subtype="DIR_PATH",
        options=RELATIVE,
        description="Folder of photos under other light; nothing in it is changed",
        update=choosing("folder"),
    )
    light: bpy.props.StringProperty(name="Light", description="Name of the light, as its slider will bear it")
    word: bpy.props.EnumProperty(name="Is", items=LIGHT_WORDS)
    factor: bpy.props.FloatProperty(
        name="Factor",
        default=0.5,
        min=0.0,
        soft_max=4.0,
        max=1000.0,
        description="How many times as strong as in the other photos",
    )

    @property
    def as_option(self) -> str:
        """For ``--light``."""
        word = f"{self.factor:.4f}" if self.word == "factor" else self.word
        return f"{self.light.strip()}={outside.followed(absolute(self.folder))}:{word}"


class PHYSHDR_Capture(bpy.types.PropertyGroup):
    """Where a capture stands in the scene, by its data set's folder (``placement``). Matrices row by row."""

    matrix: bpy.props.FloatVectorProperty(
        name="Matrix", size=16, description="Where the model stands by which the capture was first set"
    )
    original: bpy.props.FloatVectorProperty(
        name="As Imported", size=16, description="Where that model stood before anything was set"
    )
    turn: bpy.props.FloatProperty(
        name="Turn", subtype="ANGLE", description="About X: what the axes of that model's file wanted"
    )
    has_floor: bpy.props.BoolProperty(name="Floor", description="The floor was set: it is at z = 0")
    has_scale: bpy.props.BoolProperty(name="Scale", description="The scale was set: it is in metres")


class PHYSHDR_Settings(bpy.types.PropertyGroup):
    """Settings of the scene; panels show them, operators take them as their defaults."""

    data: bpy.props.StringProperty(
        name="Data Set",
        subtype="DIR_PATH",
        options=RELATIVE,
        description="Folder of the data set",
        update=_data_chosen,
    )
    out: bpy.props.StringProperty(
        name="Run",
        subtype="DIR_PATH",
        options=RELATIVE,
        description="Folder for the trained model; empty: beside the .blend, or beside the data set",
        update=choosing("out"),
    )
    photos: bpy.props.StringProperty(
        name="Photos",
        subtype="DIR_PATH",
        options=RELATIVE,
        description="Folder of your photos; nothing in it is changed",
        update=choosing("photos"),
    )
    photos_out: bpy.props.StringProperty(
        name="Data Set",
        subtype="DIR_PATH",
        options=RELATIVE,
        description="Folder for the data set that is made of the photos",
        update=choosing("photos_out"),
    )
    photos_handheld: bpy.props.BoolProperty(
        name="Hand-Held",
        description="The photos of a bracket were not taken from exactly one place: each is placed by itself",
    )
    photos_borrow_poses: bpy.props.BoolProperty(
        name="Borrow Places",
        description="A photo that is too dark or too bright to be placed takes its bracket's place",
    )
    photos_width: bpy.props.IntProperty(
        name="Width at Most",
        default=1600,
        min=0,
        max=20_000,
        subtype="PIXEL",
        description="Pictures of the data set are no wider than this; 0: as wide as the photos",
    )
    photos_bracket: bpy.props.IntProperty(
        name="Photos a Place", min=0, max=64, description="How many photos each place has; 0: found out"
    )
    photos_same_exposure: bpy.props.BoolProperty(
        name="Same Exposure", description="All photos have one exposure, whatever they say of it"
    )
    photos_exposures: bpy.props.StringProperty(
        name="Exposures",
        subtype="FILE_PATH",
        options=RELATIVE,
        description="JSON or CSV of the photos' names and seconds, where the photos do not tell",
        update=choosing("photos_exposures"),
    )
    photos_lens: bpy.props.EnumProperty(name="Lens", items=LENSES)
    photos_partial: bpy.props.BoolProperty(
        name="Use What Was Found", description="Go on where less than half of the places could be found"
    )
    photos_lights: bpy.props.CollectionProperty(
        type=PHYSHDR_OtherLight, description="Folders of photos under other light"
    )
    photos_named_lights: bpy.props.BoolProperty(
        name="Folders Named by Light",
        default=True,
        description="Use folders in the photos' folder or beside it whose names say a light: pendant off",
    )
    captures: bpy.props.CollectionProperty(
        type=PHYSHDR_Capture, description="Where captures stand whose scale or ground was set"
    )
    #: Which folder the paths beside the .blend are beside; see ``blend_paths``.
    folder_key: bpy.props.IntProperty(default=-1, options={"HIDDEN"})
    preset: bpy.props.EnumProperty(name="Method", items=PRESETS, default="default")
    iterations: bpy.props.IntProperty(
        name="Iterations",
        min=0,
        max=1_000_000,
        description="Steps of the training; 0: as many as the method needs for data of this size",
    )
    iterations_automatic: bpy.props.BoolProperty(
        name="Automatic",
        description="As many iterations as the method needs for data of this size",
        get=_is_automatic,
        set=_set_automatic,
    )
    show_curves: bpy.props.BoolProperty(
        name="Curves", default=False, description="Quality and loss over the training"
    )
    exposure_mode: bpy.props.EnumProperty(name="Exposures", items=EXPOSURE_MODES)
    device: bpy.props.EnumProperty(name="Device", items=DEVICES)
    threads: bpy.props.IntProperty(
        name="Threads", min=0, max=THREADS_MAX, description="Processor threads; 0: one for each core"
    )
    preview: bpy.props.BoolProperty(
        name="Live Preview",
        description="Show the model that the backend holds in every 3D view of this scene",
    )
    dim_unseen: bpy.props.BoolProperty(
        name="Dim Unseen",
        default=True,
        description="Dim in 3D views what no training camera has seen: a model is a guess there, and flares. "
        "Renders, and views from the cameras' places, are not changed",
    )
    exposure_ev: bpy.props.FloatProperty(
        name="Exposure (EV)", soft_min=-10.0, soft_max=10.0, description="Radiance times 2 to this power"
    )
    #: The part of it that the photographs say; see ``follow_exposure``.
    photographed_ev: bpy.props.FloatProperty(options={"HIDDEN"})
    lighting_level: bpy.props.FloatProperty(
        name="Lighting Level",
        default=1.0,
        min=0.0,
        soft_max=4.0,
        description="Strength of the ambient light: 1 as captured, 0 off. Lamps stay as they are",
    )
    #: What the first light's level began with; see ``follow_lights``.
    standard_level: bpy.props.FloatProperty(options={"HIDDEN"}, default=1.0)
    further_levels: bpy.props.CollectionProperty(
        type=PHYSHDR_LightLevel, description="Levels of the lights after the first that models have had"
    )
    tone: bpy.props.EnumProperty(name="Tone Mapping", items=TONES)


def photo_options(chosen: PHYSHDR_Settings, **overrides: Any) -> PhotoOptions:
    """What is said of the photos in a scene's settings, but for what is ``given``.

    Raises ``BadValueError`` where the settings name a file in a network that the user has not chosen.
    """
    names = [each.name for each in fields(PhotoOptions)]
    of_settings = {"max_width": "photos_width"}
    found = {name: getattr(chosen, of_settings.get(name, f"photos_{name}")) for name in names}
    found["lights"] = tuple(each.as_option for each in chosen.photos_lights if each.folder)
    options = {**found, **overrides}
    if isinstance(options["lights"], str):
        options["lights"] = tuple(filter(None, options["lights"].splitlines()))
    options["exposures"] = outside.followed(absolute(options["exposures"]))
    return PhotoOptions(**options)


def follow_lights(chosen: PHYSHDR_Settings, lights: Sequence[str], standard: Sequence[float]) -> None:
    """Give each light a level that begins at its ``standard`` one, that of the photographs.

    Not from a panel's ``draw``, which may change nothing. Levels of other models' lights stay, so that each
    keeps its level while one looks at another model.
    """
    for name, level in zip(lights[1:], standard[1:], strict=True):
        if name not in chosen.further_levels:
            light = chosen.further_levels.add()
            light.name, light.level = name, level
    if standard and abs(standard[0] - chosen.standard_level) > 1e-6:  # Blender keeps a float32
        chosen.standard_level = chosen.lighting_level = standard[0]


def follow_exposure(chosen: PHYSHDR_Settings, photographed_ev: float) -> None:
    """Let the slider of exposure begin where the backend's model looks as its photographs.

    What the user has added to that stays added where the next model's is another.
    """
    change = photographed_ev - chosen.photographed_ev
    if abs(change) > 1e-3:  # Blender keeps a float32
        chosen.exposure_ev += change
        chosen.photographed_ev = photographed_ev


def preview_levels(chosen: PHYSHDR_Settings, lights: Sequence[str]) -> tuple[float, ...]:
    """The live preview's level of each of ``lights``; where none are known, of the first alone."""
    others = (chosen.further_levels.get(name) for name in lights[1:])
    return chosen.lighting_level, *(light.level if light else 1.0 for light in others)


_CLASSES = (PHYSHDR_Preferences, PHYSHDR_LightLevel, PHYSHDR_OtherLight, PHYSHDR_Capture, PHYSHDR_Settings)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    setattr(bpy.types.Scene, SETTINGS, bpy.props.PointerProperty(type=PHYSHDR_Settings))


def unregister() -> None:
    delattr(bpy.types.Scene, SETTINGS)
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
