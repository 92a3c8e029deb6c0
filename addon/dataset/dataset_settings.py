# SPDX-License-Identifier: GPL-3.0-or-later
"""What is chosen for a data set of the open scene: kept in the scene, so that an error or a closed dialog
loses nothing that was typed. The operator has the same properties as arguments for scripts.
"""

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import bpy

from ...bridge.errors import BadValueError
from ...bridge.lights import AMBIENT
from ...synth.light_choice import candidates
from ...synth.light_names import COLLECTION, GROUP, LightChoice
from .. import changes
from ..settings import choosing
from .denoiser import can_denoise

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import PropertyFlagEnumItems, PropertyFlagItems

#: The property of a scene that holds its ``PHYSHDR_DatasetSettings``.
DATASET = "physhdr_dataset"
#: Of a last call an operator remembers nothing: the scene does.
GIVEN: "set[PropertyFlagItems]" = {"SKIP_SAVE"}
CHOICE: "set[PropertyFlagEnumItems]" = {"SKIP_SAVE"}
PATH: "set[PropertyFlagItems]" = {"SKIP_SAVE", "PATH_SUPPORTS_BLEND_RELATIVE"}

RIGS = [
    ("GRID", "Grid", "A flat grid around your camera, facing the scene"),
    ("ORBIT", "Orbit", "On an arc around what your camera looks at, at its height"),
    ("HEMISPHERE", "Hemisphere", "On a part of a sphere around what your camera looks at"),
    ("PATH", "Camera Animation", "Along your camera's own animation; all else stands still"),
]
RESPONSES = [
    ("reinhard-gamma", "Reinhard, Gamma", "The camera of HDR-NeRF's synthetic data"),
    ("srgb", "sRGB", "Clipped at white"),
    ("filmic", "Filmic", "Blender's Filmic, medium contrast"),
    ("file", "From a File", "A measured curve: pairs of exposure × radiance and code value"),
]
DEVICES = [
    ("CPU", "Processor", "The processor: the same seed gives the same bytes on any machine of its kind"),
    ("GPU", "Graphics Card", "The card that is chosen in Preferences > System, else the first that works"),
]


def _cameras_changed(self: Any, context: bpy.types.Context) -> None:
    changes.rig.tell()


class RenderOptions:
    """The properties that the scene's settings and the operator have in common."""

    out: bpy.props.StringProperty(
        name="Folder",
        subtype="DIR_PATH",
        options=PATH,
        update=choosing("out"),
        description="A new folder, or one to continue",
    )
    rig: bpy.props.EnumProperty(name="Cameras", items=RIGS, options=CHOICE, update=_cameras_changed)
    views: bpy.props.IntProperty(
        name="Views",
        default=35,
        min=2,
        max=10_000,
        options=GIVEN,
        update=_cameras_changed,
        description="Every second one is for training, the others for testing",
    )
    rig_distance: bpy.props.FloatProperty(
        name="Distance",
        min=0.0,
        subtype="DISTANCE",
        options=GIVEN,
        update=_cameras_changed,
        description="From your camera to what the rig looks at; 0: its focus, else what it sees",
    )
    rig_width: bpy.props.FloatProperty(
        name="Grid Width",
        min=0.0,
        subtype="DISTANCE",
        options=GIVEN,
        update=_cameras_changed,
        description="0: half the distance",
    )
    rig_height: bpy.props.FloatProperty(
        name="Grid Height",
        min=0.0,
        subtype="DISTANCE",
        options=GIVEN,
        update=_cameras_changed,
        description="0: three tenths of the distance",
    )
    rig_arc: bpy.props.FloatProperty(
        name="Arc",
        default=math.radians(90.0),
        min=math.radians(0.1),
        max=math.tau,
        subtype="ANGLE",
        options=GIVEN,
        update=_cameras_changed,
        description="Azimuth of orbit and hemisphere, your camera in its middle",
    )
    exposures: bpy.props.StringProperty(
        name="Exposures (EV)",
        default="-3 -1 1 3 5",
        options=GIVEN,
        description="A list such as '-3 -1 1 3 5', or start:step:count such as '-3:2:5'; EV 0 is 1 second",
    )
    response: bpy.props.EnumProperty(name="Camera Response", items=RESPONSES, options=CHOICE)
    response_file: bpy.props.StringProperty(
        name="Curve",
        subtype="FILE_PATH",
        options=PATH,
        update=choosing("response_file"),
        description="JSON or text of the response, where it is a file's",
    )
    resolution_x: bpy.props.IntProperty(
        name="Width", default=400, min=8, max=8192, subtype="PIXEL", options=GIVEN, update=_cameras_changed
    )
    resolution_y: bpy.props.IntProperty(
        name="Height",
        min=0,
        max=8192,
        subtype="PIXEL",
        options=GIVEN,
        update=_cameras_changed,
        description="0: as the scene's render resolution says",
    )
    samples: bpy.props.IntProperty(name="Samples", default=64, min=1, max=2**20, options=GIVEN)
    denoise: bpy.props.BoolProperty(
        name="Denoise", default=True, options=GIVEN, description="With OpenImageDenoise"
    )
    seed: bpy.props.IntProperty(name="Seed", min=0, options=GIVEN, description="Of the noise")
    device: bpy.props.EnumProperty(name="Device", items=DEVICES, options=CHOICE)
    lit_views: bpy.props.IntProperty(
        name="Views Under Other Light",
        default=12,
        min=0,
        max=10_000,
        options=GIVEN,
        update=_cameras_changed,
        description="Further training views at other levels of the lights that vary",
    )
    lit_levels: bpy.props.StringProperty(
        name="Their Levels", default="0.25 4", options=GIVEN, description="Factors on the lights that vary"
    )
    relit_views: bpy.props.IntProperty(
        name="Relit Test Views",
        default=4,
        min=0,
        max=5000,
        options=GIVEN,
        description="Test views that are made at each level too, to measure relighting; costs no rendering",
    )
    ambient_levels: bpy.props.StringProperty(
        name="At Levels",
        default="0.125 0.5 2 8",
        options=GIVEN,
        description="Factors on each of the lights that vary",
    )


#: Names of those properties.
OPTIONS = tuple(RenderOptions.__annotations__)


class PHYSHDR_LightChoice(bpy.types.PropertyGroup):
    """A light group or a collection of lights, and whether its level varies in the data set."""

    kind: bpy.props.StringProperty(name="Kind")
    light: bpy.props.StringProperty(name="Light", description="Its name in the data set")
    words: bpy.props.StringProperty(name="What Shines")
    vary: bpy.props.BoolProperty(
        name="Vary",
        description="Views under other light turn it, and the trained model has a level for it",
    )


class PHYSHDR_DatasetSettings(RenderOptions, bpy.types.PropertyGroup):
    """What the dialog of a scene shows."""

    #: The folder that was proposed, and for which file: where that is another now, another is proposed.
    #: A path as ``out`` is one, so that both follow the file alike (``blend_paths``).
    proposed: bpy.props.StringProperty(subtype="DIR_PATH", options={"HIDDEN", "PATH_SUPPORTS_BLEND_RELATIVE"})
    proposed_for: bpy.props.StringProperty(options={"HIDDEN"})
    show_advanced: bpy.props.BoolProperty(
        name="Advanced", description="Show what has good values by itself, too"
    )
    show_cameras: bpy.props.BoolProperty(
        name="Show in the 3D View",
        default=True,
        update=_cameras_changed,
        description="Draw the cameras while you choose: training views orange, test views blue, views under "
        "other light yellow",
    )
    vary_ambient: bpy.props.BoolProperty(
        name="Ambient",
        default=True,
        description="The world, and suns that are in no light chosen here",
    )
    lights: bpy.props.CollectionProperty(type=PHYSHDR_LightChoice)
    #: Seconds for a sample of a pixel of this scene, with what and by what they are known; 0: they are not.
    rate: bpy.props.FloatProperty(options={"HIDDEN"})
    rate_device: bpy.props.StringProperty(options={"HIDDEN"})
    rate_by: bpy.props.StringProperty(options={"HIDDEN"})


def settings_of(scene: bpy.types.Scene) -> PHYSHDR_DatasetSettings:
    """A scene's own."""
    return getattr(scene, DATASET)


def chosen(
    scene: bpy.types.Scene, operator: bpy.types.Operator | None = None, lights: str = ""
) -> SimpleNamespace:
    """What counts: arguments that were ``given``, else the scene's settings.

    ``lights`` and ``light_choices`` are names of those that vary, and the ``LightChoice``s among them.
    Raises what ``parse_lights`` does.
    """
    settings = settings_of(scene)
    values = {
        name: getattr(
            operator if operator is not None and operator.properties.is_property_set(name) else settings, name
        )
        for name in OPTIONS
    }
    if lights:
        known = [each.choice for each in candidates(scene, bpy.context.view_layer)]
        names, choices = parse_lights(lights, known)
    else:
        choices = [LightChoice(each.light, each.kind, each.name) for each in settings.lights if each.vary]
        names = [AMBIENT] * settings.vary_ambient + [choice.name for choice in choices]
    return SimpleNamespace(**values, lights=tuple(names), light_choices=tuple(choices))


def parse_lights(text: str, known: Sequence[LightChoice]) -> tuple[list[str], list[LightChoice]]:
    """``"ambient; key"`` or ``"ambient; key=collection:Key Things"`` → names, and the choices among them.

    A name alone is one of ``known``, as the dialog lists them. Raises ``BadValueError``.
    """
    by_name = {choice.name: choice for choice in known}
    names, choices = [], []
    for part in filter(None, (part.strip() for part in text.split(";"))):
        name, equals, rest = part.partition("=")
        kind, _, what = rest.partition(":")
        choice = LightChoice(name, kind, what) if equals else by_name.get(part)
        if kind not in (GROUP, COLLECTION) if equals else choice is None and part != AMBIENT:
            raise BadValueError(
                f"there is no light {part!r} in this scene",
                f"It has {', '.join([AMBIENT, *by_name])}; or write NAME={COLLECTION}:… or NAME={GROUP}:…",
            )
        names.append(name)
        if choice:
            choices.append(choice)
    return names, choices


def look_for_lights(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> None:
    """List the light groups and collections that shine now; what was ticked stays so.

    Not from ``draw``, which may change nothing.
    """
    settings = settings_of(scene)
    ticked = {(each.kind, each.name) for each in settings.lights if each.vary}
    settings.lights.clear()
    for found in candidates(scene, layer):
        entry = settings.lights.add()
        entry.name, entry.kind, entry.light = found.choice.what, found.choice.kind, found.choice.name
        entry.words = found.in_words
        entry.vary = (entry.kind, entry.name) in ticked


def without_denoiser(scene: bpy.types.Scene) -> None:
    """Denoising is off where this Blender cannot; the dialog says so."""
    if not can_denoise():
        settings_of(scene).denoise = False


_CLASSES = (PHYSHDR_LightChoice, PHYSHDR_DatasetSettings)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    setattr(bpy.types.Scene, DATASET, bpy.props.PointerProperty(type=PHYSHDR_DatasetSettings))


def unregister() -> None:
    delattr(bpy.types.Scene, DATASET)
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
