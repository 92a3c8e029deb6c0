# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene with models needs to render right, said once: what is wrong now, and what sets it right.

``render_problems`` looks, ``set_up`` sets. What is set is as little as Gaussians need: other objects' light,
edges and noise stay as the artist has them, and what is set higher than needed stays, too. A picture that
agrees with the trainer's to the last digit has jagged edges: that is asked for (``Wishes.exact``).
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

import bpy
import numpy as np

from ...synth.in_render import in_collection, in_layer, instanced_by
from ..blender import curve_of, render_size, sample_as_no_lamp, settings_of_cycles, world_of
from ..model import nodes
from ..model.cleaning import EVEN
from ..model.look import cast_no_shadow, file_has_model, is_model, models_among
from ..model.material import materials_in
from . import develop
from .render import CERTAIN_BOUNCES, TRANSPARENT_BOUNCES, let_rays_pass, sample_centres

CYCLES, EEVEE = "CYCLES", "BLENDER_EEVEE"
#: How EEVEE draws camera splats: blended by the depth of their centres, without grain, 54 dB from our
#: rasteriser (the demo's room, sRGB, 100×100, one sample). What is blended has no depth of its own: depth of
#: field takes it for what lies behind it. A wall of splats 3 m away, another wall at 9 m, f/0.2, 64 samples:
#: 19 dB from Cycles blended, wherever the focus is, and 31 (focus at 3 m) to 34 (at 9 m) by lot.
BLENDED, BY_LOT = "BLENDED", "DITHERED"
#: By lot each Gaussian is drawn in a share of the samples: with 256 the demo's room is 32 dB from our
#: rasteriser, 29 with 16: grain. Ellipsoids are always drawn so.
EEVEE_SAMPLES = 256
#: An instance shows a model where it stands if its matrix is this near to the identity.
IN_PLACE = 1e-5
#: The driver's variables, from the scene that is rendered.
WIDTH = {"width": "render.resolution_x", "percent": "render.resolution_percentage"}
WIDTH_EXPRESSION = "width * percent / 100"
#: Custom property of a model that was set to be drawn as ellipsoids on purpose.
ELLIPSOIDS = "physhdr_ellipsoids"
#: Types of objects that are models, or instances of collections, which empties alone can be. Panels ask for
#: them at every redraw (20,000 objects: 5 ms).
MODEL_OR_INSTANCE = ("POINTCLOUD", "EMPTY")
#: So many models are named in a sentence.
NAMED = 3


@dataclass(frozen=True)
class Problem:
    """What would render wrong, in a sentence. ``fixable``: whether *Set Up Render* sets it right."""

    kind: str
    text: str
    fixable: bool = True


@dataclass(frozen=True)
class Wishes:
    """What is chosen in *Set Up Render*. ``film_transparent`` and ``exact`` set their settings where True,
    and leave them where False."""

    camera_splats: bool = True
    cast_shadows: bool = False
    film_transparent: bool = False
    exact: bool = False


def settings_of_eevee(scene: bpy.types.Scene) -> bpy.types.SceneEEVEE:
    assert scene.eevee is not None  # every scene has them
    return scene.eevee


# ---- which models ------------------------------------------------------------------------------------------


#: In their order, each once.
_Models = dict[bpy.types.Object, None]


@dataclass(frozen=True)
class Shown:
    """The models that a render shows, instances of collections included, each once; and those of them that an
    instance shows elsewhere than where they stand."""

    models: list[bpy.types.Object]
    moved: list[bpy.types.Object]


def shown_in_render(scene: bpy.types.Scene) -> Shown:
    """The models that a render of the scene shows. Panels ask at every redraw."""
    models: _Models = {}
    moved: _Models = {}
    known: dict[str, tuple[_Models, _Models]] = {}
    if file_has_model():
        for layer in scene.view_layers:
            if layer.use:
                items = list(in_layer(layer.layer_collection, MODEL_OR_INSTANCE))
                further, moved_there = _by_instances(items, known)
                models |= dict.fromkeys(models_among(items)) | further
                moved |= moved_there
    return Shown(list(models), list(moved))


def models_in_render(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The models that a render of the scene shows, instances of collections included, each once."""
    return shown_in_render(scene).models


def models_of(item: bpy.types.Object | None) -> list[bpy.types.Object]:
    """The model that an object is, or the models that it shows as an instance of a collection."""
    if item is None:
        return []
    return [item] if is_model(item) else list(_by_instances([item], {})[0])


def has_model(scene: bpy.types.Scene) -> bool:
    """Whether there is any model in the scene, shown or not."""
    return file_has_model() and (any(models_among(scene.objects)) or bool(models_in_render(scene)))


def _by_instances(
    items: Iterable[bpy.types.Object], known: dict[str, tuple[_Models, _Models]]
) -> tuple[_Models, _Models]:
    """The models that instances among ``items`` show, and those of them that are moved by that.

    ``known``: what was found of a collection, by its full name; each is gone through once.
    """
    shown: _Models = {}
    moved: _Models = {}
    for each in items:
        collection = instanced_by(each)
        if collection is None:
            continue
        if collection.name_full not in known:
            inside = list(in_collection(collection, MODEL_OR_INSTANCE))
            further, moved_inside = _by_instances(inside, known)
            known[collection.name_full] = dict.fromkeys(filter(is_model, inside)) | further, moved_inside
        models, moved_inside = known[collection.name_full]
        shown |= models
        moved |= models if models and _moves(each, collection) else moved_inside
    return shown, moved


def _moves(holder: bpy.types.Object, collection: bpy.types.Collection) -> bool:
    """Whether an instance shows its collection elsewhere than where that is."""
    matrix = np.array(world_of(holder), np.float64)
    matrix[:3, 3] -= matrix[:3, :3] @ np.array(collection.instance_offset)
    return bool(np.abs(matrix - np.eye(4)).max() > IN_PLACE)


# ---- what belongs to an object -----------------------------------------------------------------------------


def follow_render_width(target: bpy.types.Object) -> None:
    """Drive the model's image width by the width of the scene that is rendered, whichever that is.

    A simple expression of Blender's own: it needs neither this extension nor Python scripts to be allowed.
    A driver or keyframes of the user's stay.
    """
    modifier = nodes.find_modifier(target)
    if modifier is None or _curve(target, modifier) is not None:
        return
    path = nodes.input_data_path(modifier, nodes.IMAGE_WIDTH)
    curve: Any = target.driver_add(path)
    driver = curve.driver
    driver.type = "SCRIPTED"
    for name, data_path in WIDTH.items():
        variable = driver.variables.new()
        variable.name, variable.type = name, "CONTEXT_PROP"
        variable.targets[0].context_property = "ACTIVE_SCENE"
        variable.targets[0].data_path = data_path
    driver.expression = WIDTH_EXPRESSION


def follows_render_width(target: bpy.types.Object) -> bool:
    """Whether the model's image width has our driver."""
    modifier = nodes.find_modifier(target)
    curve = None if modifier is None else _curve(target, modifier)
    driver = getattr(curve, "driver", None)
    return driver is not None and driver.is_valid and driver.expression == WIDTH_EXPRESSION


def _curve(target: bpy.types.Object, modifier: bpy.types.NodesModifier) -> Any:
    """The driver or the keyframes of the model's image width; None where it has neither."""
    return curve_of(target, nodes.input_data_path(modifier, nodes.IMAGE_WIDTH))


def _input(target: bpy.types.Object, name: str) -> Any:
    """The value of a model's input now; None where it has none."""
    modifier = nodes.find_modifier(target)
    if modifier is None or not nodes.has_input(modifier, name):
        return None
    return getattr(nodes.inputs_of(modifier), nodes.input_identifier(modifier, name)).value


def _set(target: bpy.types.Object, name: str, value: Any) -> None:
    modifier = nodes.find_modifier(target)
    if modifier is not None and nodes.has_input(modifier, name):
        nodes.set_input(modifier, name, value)


# ---- what would render wrong -------------------------------------------------------------------------------

Models = Sequence[bpy.types.Object]


def render_problems(scene: bpy.types.Scene) -> list[Problem]:
    """What a render of the scene would show wrong of its models, with the engine that is chosen now."""
    shown = shown_in_render(scene)
    if not shown.models:
        return []
    found: list[Problem] = []
    for check in _CHECKS:
        found += check(scene, shown)
    return found


def names_of(models: Iterable[bpy.types.Object]) -> str:
    """``room, garden and 3 more``."""
    names = [each.name for each in models]
    named, more = names[:NAMED], len(names) - NAMED
    if more > 0:
        return f"{', '.join(named)} and {more} more"
    return f"{', '.join(named[:-1])} and {named[-1]}" if len(named) > 1 else named[0]


def _modifier(scene: bpy.types.Scene, shown: Shown) -> Iterator[Problem]:
    gone = [each for each in shown.models if nodes.find_modifier(each) is None]
    if gone:
        text = f"{names_of(gone)}: no PhysHDR modifier, so nothing is rendered. Import again"
        yield Problem("MODIFIER", text, fixable=False)
    modifiers = ((each, nodes.find_modifier(each)) for each in shown.models)
    hidden = [each for each, modifier in modifiers if modifier is not None and not modifier.show_render]
    if hidden:
        yield Problem("MODIFIER", f"{names_of(hidden)}: the modifier is switched off for renders")


def _bounces(scene: bpy.types.Scene, shown: Shown) -> Iterator[Problem]:
    if scene.render.engine != CYCLES:
        return
    cycles = settings_of_cycles(scene)
    passed, certain = cycles.transparent_max_bounces, cycles.min_transparent_bounces
    if passed < CERTAIN_BOUNCES:
        text = f"A ray passes {passed} Gaussians and ends: the picture is black and blotchy"
        yield Problem("BOUNCES", f"{text} (Transparent Bounces, {TRANSPARENT_BOUNCES} are needed)")
    elif certain < CERTAIN_BOUNCES:
        text = "Rays end at random among the Gaussians: the picture is noisy"
        yield Problem("BOUNCES", f"{text} (Min Transparent Bounces {certain}, {CERTAIN_BOUNCES} are needed)")


def _shadows(scene: bpy.types.Scene, shown: Shown) -> Iterator[Problem]:
    casting = [each for each in shown.models if each.visible_shadow]
    if scene.render.engine == EEVEE and casting and _has_shadows(scene):
        text = f"{names_of(casting)}: every Gaussian casts a shadow, and EEVEE may not finish"
        yield Problem("SHADOWS", text, fixable=_editable(casting))


def _has_shadows(scene: bpy.types.Scene) -> bool:
    """Whether EEVEE draws shadows in the scene: of a lamp, or of a world that has a sun in it."""
    if not settings_of_eevee(scene).use_shadows:
        return False
    if any(lamp.use_shadow for lamp in bpy.data.lights):  # few, where objects are many
        lamps = (each for each in scene.objects if each.type == "LIGHT" and not each.hide_render)
        if any(isinstance(each.data, bpy.types.Light) and each.data.use_shadow for each in lamps):
            return True
    world: Any = scene.world
    if world is None or world.node_tree is None or not world.use_sun_shadow:
        return False
    return any(node.type in ("TEX_ENVIRONMENT", "TEX_SKY") for node in world.node_tree.nodes)


def _camera(scene: bpy.types.Scene, shown: Shown) -> Iterator[Problem]:
    if scene.camera is None:
        text = "There is no camera to render through. Import Cameras brings those of the data set"
        yield Problem("CAMERA", text, fixable=False)


def _splats(scene: bpy.types.Scene, shown: Shown) -> Iterator[Problem]:
    if scene.camera is None:
        return
    drawn = {each: _input(each, nodes.CAMERA_SPLATS) for each in shown.models}
    if _is_panorama(scene):
        cards = [each for each, splats in drawn.items() if splats]
        if cards:
            text = f"{names_of(cards)}: camera splats are for flat pictures, and the camera takes a panorama"
            yield Problem("SPLATS", text, fixable=_editable(cards))
        return
    proxies = [
        each
        for each, splats in drawn.items()
        if splats is False and ELLIPSOIDS not in each and each not in shown.moved
    ]
    if proxies:
        text = f"{names_of(proxies)}: drawn as ellipsoids, not as it was trained (Camera Splats is off)"
        yield Problem("SPLATS", text, fixable=_editable(proxies))
    stretched = [each for each, splats in drawn.items() if splats and not _is_even(each)]
    if stretched:
        text = f"{names_of(stretched)}: stretched, so drawn as ellipsoids, not as it was trained"
        yield Problem("SPLATS", f"{text}. Give it one scale for all axes", fixable=False)


def _is_even(target: bpy.types.Object) -> bool:
    """Whether a model has one scale, as the nodes ask (``splat_nodes``)."""
    sides = [abs(side) for side in world_of(target).to_scale()]
    return max(sides) <= min(sides) * EVEN


def _instances(scene: bpy.types.Scene, shown: Shown) -> Iterator[Problem]:
    """Geometry nodes are evaluated once, where the model itself stands."""
    if not shown.moved:
        return
    text = f"{names_of(shown.moved)}: an instance shows it elsewhere, but as seen where it stands"
    yield Problem("INSTANCES", f"{text}. Object > Apply > Make Instances Real", fixable=False)
    flat = [each for each in shown.moved if _input(each, nodes.CAMERA_SPLATS)]
    if flat:
        text = f"{names_of(flat)}: camera splats of an instance do not face the camera"
        yield Problem("INSTANCES", text, fixable=_editable(flat))


def _is_panorama(scene: bpy.types.Scene) -> bool:
    lens = scene.camera.data if scene.camera else None
    return isinstance(lens, bpy.types.Camera) and lens.type == "PANO"


def _width(scene: bpy.types.Scene, shown: Shown) -> Iterator[Problem]:
    wide = render_size(scene)[0]
    alike: dict[tuple[int, bool], list[bpy.types.Object]] = {}
    for each in shown.models:
        width = _input(each, nodes.IMAGE_WIDTH)
        if width in (None, wide) or follows_render_width(each):
            continue
        modifier = nodes.find_modifier(each)
        own = modifier is not None and _curve(each, modifier) is not None
        alike.setdefault((width, _editable([each]) and not own), []).append(each)
    for (width, fixable), models in alike.items():
        text = "fine detail comes out too thin"
        if width:
            text = f"fine detail is for a picture {width} pixels wide, and this one has {wide}"
        yield Problem("WIDTH", f"{names_of(models)}: {text} (Image Width)", fixable)


def _samples(scene: bpy.types.Scene, shown: Shown) -> Iterator[Problem]:
    samples = settings_of_eevee(scene).taa_render_samples
    if scene.render.engine != EEVEE or samples >= EEVEE_SAMPLES:
        return
    grainy = [each for each in shown.models if BY_LOT in _methods(each)]
    if grainy:
        text = f"{names_of(grainy)}: grainy with {samples} samples: EEVEE draws each Gaussian in some of them"
        yield Problem("SAMPLES", f"{text} ({EEVEE_SAMPLES} are needed)")


def _depth_of_field(scene: bpy.types.Scene, shown: Shown) -> Iterator[Problem]:
    if scene.render.engine != EEVEE or not _has_depth_of_field(scene):
        return
    blended = [each for each in shown.models if BLENDED in _methods(each)]
    if blended:
        text = f"{names_of(blended)}: EEVEE's depth of field takes it for what lies behind it"
        yield Problem("DEPTH", text, fixable=_editable(_materials(blended)))


def _has_depth_of_field(scene: bpy.types.Scene) -> bool:
    lens = scene.camera.data if scene.camera else None
    return isinstance(lens, bpy.types.Camera) and lens.dof is not None and lens.dof.use_dof


def _methods(target: bpy.types.Object) -> set[str]:
    """How EEVEE draws a model as it is set now."""
    return {each.surface_render_method for each in _materials([target])}


def _materials(models: Models) -> list[bpy.types.Material]:
    """What shades the models as they are set now."""
    found: list[bpy.types.Material] = []
    for each in models:
        modifier = nodes.find_modifier(each)
        splats = _input(each, nodes.CAMERA_SPLATS)
        if modifier is not None and splats is not None:
            found += materials_in(modifier.node_group, "splat" if splats else "ellipsoid")
    return found


def _tones(scene: bpy.types.Scene, shown: Shown) -> Iterator[Problem]:
    toned = develop.toned(shown.models)
    if not toned:
        return
    if develop.node_of(scene) is None:
        text = f"{names_of(toned)}: Learned Tones respond to each Gaussian before blending, as no camera does"
        yield Problem("TONES", f"{text}. {develop.LABEL} is exact", fixable=False)
    else:
        text = f"{names_of(toned)}: developed twice, by Learned Tones and in the compositor"
        yield Problem("TONES", text, fixable=all(map(develop.can_switch, toned)))


def _developed(scene: bpy.types.Scene, shown: Shown) -> Iterator[Problem]:
    """What spoils a picture that the compositor develops."""
    if develop.node_of(scene) is None:
        return
    if develop.is_off(scene):
        yield Problem("DEVELOP", "The picture is not developed: compositing or its node is switched off")
    if develop.is_apart(scene):
        text = f"The picture is not developed: its node has lost its links. {develop.LABEL} puts it back"
        yield Problem("DEVELOP", text, fixable=False)
    if faults := develop.faults_of_view(scene):
        text = f"The view changes the developed picture ({', '.join(faults)}): it is meant for Standard alone"
        yield Problem("VIEW", text)


def _editable(data: Sequence[bpy.types.ID]) -> bool:
    return all(each.library is None for each in data)


_CHECKS: tuple[Callable[[bpy.types.Scene, Shown], Iterator[Problem]], ...] = (
    *(_camera, _modifier, _bounces, _samples, _depth_of_field, _shadows, _splats, _instances, _width, _tones),
    _developed,
)


# ---- what sets it right ------------------------------------------------------------------------------------


def set_up(scene: bpy.types.Scene, wishes: Wishes | None = None) -> None:
    """Set what the scene and its models need, for Cycles and EEVEE alike, as little as that is.

    Models that are linked from another file stay as they are there. Raises as ``develop.check_developed``,
    and leaves all as it is.
    """
    develop.check_developed(scene)
    wishes = wishes or Wishes()
    if hasattr(scene, "cycles"):  # it can be switched off as an extension can
        let_rays_pass(scene)
    if wishes.film_transparent:
        scene.render.film_transparent = True
    if wishes.exact:
        sample_centres(scene)
    shown = shown_in_render(scene)
    for target in shown.models:
        if target.library is None:
            _set_up_model(scene, target, wishes, target in shown.moved)
    if any(BY_LOT in _methods(each) for each in shown.models):
        eevee = settings_of_eevee(scene)
        eevee.taa_render_samples = max(eevee.taa_render_samples, EEVEE_SAMPLES)
    develop.settle(scene, shown.models)


def _set_up_model(
    scene: bpy.types.Scene, target: bpy.types.Object, wishes: Wishes, is_instanced: bool
) -> None:
    modifier = nodes.find_modifier(target)
    if modifier is not None:
        modifier.show_render = True
    cast_no_shadow(target)
    if wishes.cast_shadows:
        target.visible_shadow = True
    _set(target, nodes.CAMERA_SPLATS, wishes.camera_splats and not (_is_panorama(scene) or is_instanced))
    if wishes.camera_splats:
        target.pop(ELLIPSOIDS, None)
    else:
        target[ELLIPSOIDS] = True
    if _input(target, nodes.IMAGE_WIDTH) is not None:
        follow_render_width(target)
    own = [each for each in _materials([target]) if each.library is None]
    for material in own:
        sample_as_no_lamp(material)  # it may have been made while Cycles was off
    if _input(target, nodes.CAMERA_SPLATS):
        for material in own:
            material.surface_render_method = BY_LOT if _has_depth_of_field(scene) else BLENDED


def wishes_from(operator: Any) -> Wishes:
    """The wishes among an operator's properties."""
    return Wishes(**{each.name: getattr(operator, each.name) for each in fields(Wishes)})
