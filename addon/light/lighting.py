# SPDX-License-Identifier: GPL-3.0-or-later
"""The world lit by a capture: nodes that add up a model's light at its probes, driven by its own sliders.

Where the camera looks past everything it sees what the former world shows; all other rays see
(fixed + Σ level · light) · 2^EV of the probes. Levels and exposure are drivers on the model's modifier, so
that keyframes of the model relight what stands in it. The former world stays as it is, and is remembered.
"""

import json
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import bpy

from ...bridge.blend_file import FORMER_WORLD, LIGHT_MODEL
from ...bridge.errors import DataMismatchError, FileMissingError
from ...bridge.probe import Probe
from .. import outside
from ..blender import cloud_of, settings_of_cycles
from ..model import nodes
from ..model.node_builder import Field, NodeBuilder
from ..model.point_cloud import lights_of, photographed_light_of
from .probes import FOLDER, KNOWN, is_probe, known

#: What mirrors and glass see of the capture.
Mirrors = Literal["ENVIRONMENT", "SPLATS"]

#: Custom properties of a world that is lit by a capture: the model, the former world (if there was one), and
#: what is measured from for the weights of several probes.
MODEL, FORMER, SUBJECT = LIGHT_MODEL, FORMER_WORLD, "physhdr_light_subject"
#: And the visibility to rays that the model had before. Older versions kept it on the model: with a library
#: override that is not saved.
VISIBILITY = "physhdr_former_visibility"
#: Of such a world and its model: a text of their own, by which copies of the model are known that were made
#: while it is hidden from rays.
HIDDEN = "physhdr_hidden_from_rays"
#: Of such a world: the width of the map in which Cycles is to look for what is bright, as we set it.
SAMPLED = "physhdr_sampled_width"
#: Custom property of our nodes in it.
OURS = "physhdr_light"
#: The rays that would see the model beside the environment; mirrors and glass may be let see it.
LIGHTING_RAYS = ("visible_diffuse", "visible_volume_scatter", "visible_shadow")
MIRROR_RAYS = ("visible_glossy", "visible_transmission")
#: Added to the squared distances to probes, m²: at a probe its weight is 1, and no division by 0.
LEAST_SQUARE = 1e-9


def is_lit(world: bpy.types.World | None) -> bool:
    """Whether a world is lit by a capture."""
    return world is not None and MODEL in world


def lost_probes(scene: bpy.types.Scene) -> bool:
    """Whether the scene's world shows panoramas that no probe of the scene has: one was deleted, or its light
    was taken again for another scene."""
    world = scene.world
    if world is None or MODEL not in world or world.node_tree is None:
        return False
    shown = (node for node in world.node_tree.nodes if isinstance(node, bpy.types.ShaderNodeTexEnvironment))
    paths = {str(node.image[KNOWN]) for node in shown if node.image is not None and KNOWN in node.image}
    there = {str(each[FOLDER]).rstrip("/") for each in scene.objects if is_probe(each)}
    return any(path.rpartition("/")[0] not in there for path in paths)


def light(
    scene: bpy.types.Scene,
    model: bpy.types.Object,
    probes: Sequence[bpy.types.Object],
    mirrors: Mirrors = "ENVIRONMENT",
    subject: bpy.types.Object | None = None,
) -> bpy.types.World:
    """Let a model's probes light the scene; with several, by the inverse squared distance to ``subject``.

    ``subject``: the scene's camera if ``None``. Raises ``DataMismatchError`` and ``FileMissingError``.
    """
    if not probes:
        raise DataMismatchError("there is no probe of this model", "Use Light From Here first.")
    lights = lights_of(cloud_of(model))
    for probe in probes:
        if not set(known(probe).lights) <= set(lights):
            raise DataMismatchError(
                f"{probe.name} has the lights {', '.join(known(probe).lights)}, {model.name} has "
                f"{', '.join(lights)}",
                "Take its light again.",
            )
    images = [load_images(probe) for probe in probes]
    world = _lit_world(scene)
    if world.get(MODEL) != model:
        show_to_rays(world)
    world[MODEL] = model
    if subject is not None:
        world[SUBJECT] = subject
    elif SUBJECT in world:
        del world[SUBJECT]
    _Assembly(world, scene, model, lights).build(list(probes), images)
    _sample_as_wide_as(world, max(known(probe).width for probe in probes))
    hide_from_rays(world, model, mirrors)
    _remove_unused()
    return world


def choices_of(
    world: bpy.types.World, model: bpy.types.Object
) -> tuple[Mirrors, bpy.types.Object | None] | None:
    """The ``mirrors`` and the ``subject`` that a model lights a world with; None where it does not."""
    if world.get(MODEL) != model:
        return None
    subject = world.get(SUBJECT)
    mirrors: Mirrors = "SPLATS" if all(getattr(model, name) for name in MIRROR_RAYS) else "ENVIRONMENT"
    return mirrors, subject if isinstance(subject, bpy.types.Object) else None


def reset(scene: bpy.types.Scene) -> None:
    """Give the scene its former world back, and the model its visibility to rays."""
    world = scene.world
    if world is None or MODEL not in world:
        return
    former = world.get(FORMER)
    scene.world = former if isinstance(former, bpy.types.World) else None
    if not any(each.world == world for each in bpy.data.scenes):  # a copy of the scene may be lit by it, too
        show_to_rays(world)
    if not world.users:
        bpy.data.worlds.remove(world)


def hide_from_rays(world: bpy.types.World, model: bpy.types.Object, mirrors: Mirrors) -> None:
    """Let CG get its light from the environment alone; ``mirrors`` see that, or the splats before it."""
    if VISIBILITY not in world and VISIBILITY not in model:
        lit = [*_others_lit_by(model, world), *_marked_worlds(model.get(HIDDEN))]
        hidden = next((each for each in lit if VISIBILITY in each), None)
        now = {name: getattr(model, name) for name in LIGHTING_RAYS + MIRROR_RAYS}
        world[VISIBILITY] = hidden[VISIBILITY] if hidden is not None else json.dumps(now)
    world[HIDDEN] = model[HIDDEN] = model.get(HIDDEN) or uuid.uuid4().hex
    for name in LIGHTING_RAYS:
        setattr(model, name, False)
    for name in MIRROR_RAYS:
        setattr(model, name, mirrors == "SPLATS")


def show_to_rays(world: bpy.types.World) -> None:
    """Give the model that lights a world, and copies made since, the visibility back that it had before;
    not what lights another scene's world, too."""
    model, before, mark = world.get(MODEL), world.pop(VISIBILITY, None), world.pop(HIDDEN, None)
    hidden = [each for each in bpy.data.objects if mark and each.get(HIDDEN) == mark and each.library is None]
    if isinstance(model, bpy.types.Object):
        if _others_lit_by(model, world):
            return
        before = model.pop(VISIBILITY, None) or before
        hidden = [model, *(each for each in hidden if each != model)]
    for each in hidden:
        if _others_lit_by(each, world):
            continue
        each.pop(HIDDEN, None)
        for name, value in json.loads(before or "{}").items():
            if name in LIGHTING_RAYS + MIRROR_RAYS:
                setattr(each, name, bool(value))


def _others_lit_by(model: bpy.types.Object, world: bpy.types.World) -> list[bpy.types.World]:
    """Worlds of scenes, other than ``world``, that a model lights."""
    worlds = (scene.world for scene in bpy.data.scenes)
    return [each for each in worlds if each is not None and each != world and each.get(MODEL) == model]


def _marked_worlds(mark: str | None) -> list[bpy.types.World]:
    """Worlds of scenes whose model is hidden under that mark."""
    worlds = (scene.world for scene in bpy.data.scenes)
    return [each for each in worlds if mark and each is not None and each.get(HIDDEN) == mark]


def _sample_as_wide_as(world: bpy.types.World, width: int) -> None:
    """Let Cycles look for what is bright in a map of ``width``, unless the user chose one.

    By itself it takes one of 4096 for nodes like ours, and ten CPU seconds for it at each render.
    """
    if not hasattr(world, "cycles"):  # it can be switched off as an extension can
        return
    cycles = settings_of_cycles(world)
    if cycles.sampling_method == "AUTOMATIC" or cycles.sample_map_resolution == world.get(SAMPLED):
        cycles.sampling_method, cycles.sample_map_resolution = "MANUAL", width
        world[SAMPLED] = width


# ---- pictures ----------------------------------------------------------------------------------------------


def load_images(probe: bpy.types.Object) -> list[bpy.types.Image]:
    """A probe's panoramas, the fixed part first; packed where the file is not saved, or they are so already.

    Raises ``FileMissingError`` where one is neither in the file nor on disk.
    """
    folder, found = str(probe[FOLDER]), []
    for name in known(probe).files:
        path = f"{folder.rstrip('/')}/{name}"
        on_disk = Path(bpy.path.abspath(path))
        image = next((each for each in bpy.data.images if each.get(KNOWN) == path), None)
        if outside.is_file(on_disk):
            if image is None:
                image = bpy.data.images.load(str(on_disk), check_existing=False)
                image[KNOWN] = path
            elif image.packed_file:
                image.unpack(method="REMOVE")
            image.filepath = path
            image.reload()
            if not path.startswith("//"):
                image.pack()
        elif image is None or not (
            # The .blend was saved elsewhere: Blender has led its own path back to the former folder.
            image.packed_file or outside.is_file(Path(bpy.path.abspath(image.filepath)))
        ):
            raise FileMissingError(f"{on_disk} is missing", f"Take the light at {probe.name} again.")
        image.name = f"{probe.name} {name.removesuffix('.exr')}"
        settings = image.colorspace_settings
        assert settings is not None
        settings.is_data = True  # the model's numbers, as its splats show them
        image.alpha_mode = "NONE"
        found.append(image)
    return found


def _remove_unused() -> None:
    """Forget panoramas that no world shows any more: those of a probe that is gone, or has another folder."""
    for image in list(bpy.data.images):
        if KNOWN in image and not image.users and image.library is None:
            bpy.data.images.remove(image)


# ---- nodes -------------------------------------------------------------------------------------------------


def _lit_world(scene: bpy.types.Scene) -> bpy.types.World:
    """The scene's world where it is lit by a capture already, else a copy of it, without nodes of ours."""
    world = scene.world
    if world is None or MODEL not in world:
        former = world
        world = former.copy() if former else bpy.data.worlds.new("World")
        world.name = "PhysHDR Light"
        if former:
            world[FORMER] = former
        else:
            world.color = (0.0, 0.0, 0.0)
            if world.node_tree:
                world.node_tree.nodes.clear()
        scene.world = world
    return world


class _Assembly:
    """Builds our part of a world's nodes, in place of an older one."""

    def __init__(
        self, world: bpy.types.World, scene: bpy.types.Scene, model: bpy.types.Object, lights: tuple[str, ...]
    ) -> None:
        assert world.node_tree is not None  # every world has one since Blender 5
        self.world, self.scene, self.model, self.lights = world, scene, model, lights
        self.tree = world.node_tree
        self.modifier = nodes.find_modifier(model)

    def build(self, probes: list[bpy.types.Object], images: list[list[bpy.types.Image]]) -> None:
        output = self._output()
        surface: Any = output.inputs["Surface"]
        behind = self._cleared(surface)
        before = set(self.tree.nodes)
        self.make = make = NodeBuilder(self.tree)
        with make.frame("Direction, in the model's space"):
            direction = self._direction()
        standard = photographed_light_of(cloud_of(self.model))[0].of(self.lights)
        with make.frame("The model's sliders"):
            levels = [
                self._driven(f"Level of {name}", nodes.level_input(self.lights, index), level)
                for index, (name, level) in enumerate(zip(self.lights, standard, strict=True))
            ]
            exposure = make.math("POWER", 2.0, self._driven("Exposure", nodes.EXPOSURE, 0.0), label="2^EV")
        weights = self._weights(probes)
        total: Field | None = None
        for probe, pictures, weight in zip(probes, images, weights, strict=True):
            with make.frame(f"{probe.name}: fixed + Σ level · light"):
                there = self._light(known(probe), pictures, direction, levels)
                there = there if weight is None else there * weight
            total = there if total is None else total + there
        assert total is not None
        with make.frame("Light; the camera sees what was behind"):
            background = make.field("ShaderNodeBackground", total * exposure, 1.0)
            is_camera = make.field("ShaderNodeLightPath", output="Is Camera Ray")
            mix = make.node("ShaderNodeMixShader", is_camera, background)
        if behind is not None:
            self.tree.links.new(behind, mix.inputs[2])
        self.tree.links.new(mix.outputs[0], surface)
        ours = [node for node in self.tree.nodes if node not in before]
        for node in ours:
            node[OURS] = True
        _arranged(self.tree, make, output)

    def _output(self) -> bpy.types.Node:
        outputs = [node for node in self.tree.nodes if node.type == "OUTPUT_WORLD"]
        active = [node for node in outputs if getattr(node, "is_active_output", False)]
        return (active or outputs or [self.tree.nodes.new("ShaderNodeOutputWorld")])[0]

    def _cleared(self, surface: Any) -> bpy.types.NodeSocket | None:
        """Remove our former nodes; the socket of what the user's own world shows, if it shows anything."""
        behind = surface.links[0].from_socket if surface.links else None
        if behind is not None and OURS in behind.node:
            link = behind.node.inputs[2].links
            behind = link[0].from_socket if link else None
        if self.tree.animation_data:
            for curve in list(self.tree.animation_data.drivers):
                name = curve.data_path.split('"')[1] if '"' in curve.data_path else ""
                node = self.tree.nodes.get(name)
                if node is not None and OURS in node:
                    self.tree.animation_data.drivers.remove(curve)
        for node in [each for each in self.tree.nodes if OURS in each]:
            self.tree.nodes.remove(node)
        return behind

    def _direction(self) -> Field:
        """The direction that is looked along, turned as the model is: a driver follows its rotation."""
        coordinates = self.make.field("ShaderNodeTexCoord", output="Generated")
        mapping = self.make.node("ShaderNodeMapping", coordinates, vector_type="TEXTURE", label="turned")
        for axis, channel in enumerate(("ROT_X", "ROT_Y", "ROT_Z")):
            rotation: Any = mapping.inputs["Rotation"]
            driver = rotation.driver_add("default_value", axis).driver
            driver.type = "SUM"
            variable = driver.variables.new()
            variable.type = "TRANSFORMS"
            variable.targets[0].id = self.model
            variable.targets[0].transform_type = channel
            variable.targets[0].transform_space = "WORLD_SPACE"
            variable.targets[0].rotation_mode = "XYZ"
        return self.make.output(mapping, "Vector")

    def _driven(self, label: str, socket: str, default: float) -> Field:
        """A number that is always the model's input of that label."""
        node = self.make.node("ShaderNodeValue", label=label)
        target: Any = node.outputs[0]
        target.default_value = default
        if self.modifier is not None and nodes.has_input(self.modifier, socket):
            driver = target.driver_add("default_value").driver
            driver.type = "SUM"
            variable = driver.variables.new()
            variable.type = "SINGLE_PROP"
            variable.targets[0].id = self.model
            variable.targets[0].data_path = nodes.input_data_path(self.modifier, socket)
        return Field(self.make, target)

    def _weights(self, probes: list[bpy.types.Object]) -> list[Field | None]:
        """Of each probe: its inverse squared distance to the subject, over the sum of all; None of one.

        A probe that is deleted later weighs nothing.
        """
        if len(probes) == 1:
            return [None]
        make, nearness = self.make, []
        subject = self.world.get(SUBJECT) or self.scene.camera
        if not isinstance(subject, bpy.types.Object):  # nothing to be near to: all alike
            subject = None
        text = f"how near each probe is to {subject.name}" if subject else "all probes alike"
        with make.frame(f"Weights: {text}"):
            for probe in probes:
                near = self._presence(probe)
                if subject is not None:
                    distance = self._distance(subject, probe)
                    near = near / (distance * distance + LEAST_SQUARE)
                nearness.append(near)
            total = nearness[0]
            for each in nearness[1:]:
                total = total + each
            return [each / total for each in nearness]

    def _presence(self, probe: bpy.types.Object) -> Field:
        """1 while there is the probe, else 0: a driver whose target was deleted gives 0, and the size that an
        empty is drawn with is always more."""
        node = self.make.node("ShaderNodeValue", label=f"{probe.name} is there")
        target: Any = node.outputs[0]
        driver = target.driver_add("default_value").driver
        driver.type = "SUM"
        variable = driver.variables.new()
        variable.type = "SINGLE_PROP"
        variable.targets[0].id, variable.targets[0].data_path = probe, "empty_display_size"
        return self.make.math("GREATER_THAN", Field(self.make, target), 0.0)

    def _distance(self, subject: bpy.types.Object, probe: bpy.types.Object) -> Field:
        """Metres from one to the other, wherever they move."""
        node = self.make.node("ShaderNodeValue", label=f"Distance to {probe.name}")
        target: Any = node.outputs[0]
        driver = target.driver_add("default_value").driver
        driver.type = "SUM"
        variable = driver.variables.new()
        variable.type = "LOC_DIFF"
        variable.targets[0].id, variable.targets[1].id = subject, probe
        return Field(self.make, target)

    def _light(
        self, probe: Probe, pictures: list[bpy.types.Image], direction: Field, levels: list[Field]
    ) -> Field:
        total: Field | None = None
        for index, image in enumerate(pictures):
            node = self.make.node("ShaderNodeTexEnvironment", direction, label=image.name)
            assert isinstance(node, bpy.types.ShaderNodeTexEnvironment)
            node.image, node.interpolation = image, "Linear"
            part = self.make.output(node, "Color")
            if index:
                part = part * levels[self.lights.index(probe.lights[index - 1])]
            total = part if total is None else total + part
        assert total is not None
        return total


def _arranged(tree: bpy.types.NodeTree, make: NodeBuilder, output: bpy.types.Node) -> None:
    """Lay our nodes out below the user's own."""
    own = [node for node in tree.nodes if OURS not in node and node.type != "FRAME"]
    places = {node.name: (node.location[0], node.location[1]) for node in own}
    make.arrange()
    lowest = min((y - 400.0 for _, y in places.values()), default=0.0)
    for node in tree.nodes:
        if OURS in node and node.type != "FRAME":
            x, y = node.location[0], node.location[1]
            node.location = (x - 2400.0, y + lowest)
    for name, (x, y) in places.items():
        tree.nodes[name].location = (x, y)
