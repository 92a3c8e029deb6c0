# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the lights of a built scene, each in one of Cycles' light groups, with the knobs that turn it."""

import math
from typing import Any

import bpy
from mathutils import Vector

from ...bridge.lights import AMBIENT
from ..blender import Point, light_of
from ..stage import LightKnob
from .materials import emission
from .props import ball
from .shading import Colour, Graph, Socket, unsampled
from .skies import Sky


class Lighting:
    """The lights of one scene. ``groups`` is what ``Stage.lights`` wants: ``AMBIENT`` first.

    Names of groups are lower-case words; they become layers of EXR files and names of sliders.
    """

    def __init__(self, scene: bpy.types.Scene) -> None:
        self.scene = scene
        self.groups: dict[str, list[LightKnob]] = {}
        self._enter(AMBIENT)

    def sky(self, colour: Sky, strength: float, group: str = AMBIENT) -> None:
        """The world. ``colour``: from the graph and the direction (unit vector, Z up) to the sky's colour;
        ``strength``: its radiance where that colour is white."""
        world = bpy.data.worlds.new("sky")
        self.scene.world = world
        assert world.node_tree is not None
        graph = Graph(world.node_tree)
        direction = graph.add("ShaderNodeTexCoord").outputs["Generated"]
        background = graph.add(
            "ShaderNodeBackground", {"Color": colour(graph, direction), "Strength": strength}
        )
        graph.add("ShaderNodeOutputWorld", {"Surface": background.outputs[0]})
        world.lightgroup = group
        self._enter(group).append(LightKnob(background.inputs["Strength"], "default_value", strength))

    def portal(self, location: Point, toward: Point, size: tuple[float, float]) -> None:
        """An opening through which the sky comes in: Cycles samples it there. It gives no light itself."""
        portal: Any = bpy.data.lights.new("portal", "AREA")
        portal.shape, portal.size, portal.size_y = "RECTANGLE", *size
        portal.cycles.is_portal = True
        self._place("portal", portal, location, toward)

    def sun(
        self,
        toward: Point,
        irradiance: float,
        colour: Colour = (1.0, 0.82, 0.60),
        angle: float = 1.5,
        group: str = AMBIENT,
    ) -> bpy.types.Object:
        """Parallel light along ``toward``; ``angle``: the disk's diameter in degrees, so shadows are soft."""
        sun: Any = bpy.data.lights.new("sun", "SUN")
        sun.energy, sun.angle, sun.color = irradiance, math.radians(angle), colour
        return self._shine(group, self._place("sun", sun, (0.0, 0.0, 0.0), toward))

    def area(
        self,
        name: str,
        location: Point,
        toward: Point,
        size: tuple[float, float],
        watts: float,
        colour: Colour = (1.0, 1.0, 1.0),
        group: str = AMBIENT,
    ) -> bpy.types.Object:
        """A soft light from a rectangle that neither cameras nor mirrors see."""
        light: Any = bpy.data.lights.new(name, "AREA")
        light.shape, light.size, light.size_y = "RECTANGLE", *size
        light.energy, light.color = watts, colour
        item = self._place(name, light, location, toward)
        item.visible_camera = item.visible_glossy = False
        return self._shine(group, item)

    def bulb(
        self, group: str, name: str, location: Point, radius: float, radiance: float, colour: Colour
    ) -> bpy.types.Object:
        """A bare bulb: the sphere that the camera sees, which is returned, and the light that it gives.

        The light is a point light of the same size and radiance: Cycles samples it by its solid angle, with
        less noise and time than a luminous mesh.
        """
        glow, strength = emission(f"bulb {name}", colour, radiance)
        unsampled(glow)
        sphere = ball(self.scene.collection, f"bulb {name}", location, radius, glow, 3)
        for ray in ("diffuse", "glossy", "transmission", "shadow"):
            setattr(sphere, f"visible_{ray}", False)
        self.glow(group, sphere, strength)
        light: Any = bpy.data.lights.new(f"bulb {name}", "POINT")
        light.shadow_soft_size, light.use_soft_falloff, light.color = radius, False, colour
        light.energy = 4.0 * math.pi**2 * radius**2 * radiance  # watts of a sphere of that radiance
        item = self._place(f"bulb light {name}", light, location, (0.0, 0.0, -1.0))
        item.visible_camera = False
        self._shine(group, item)
        return sphere

    def spot(
        self,
        group: str,
        name: str,
        location: Point,
        toward: Point,
        watts: float,
        colour: Colour,
        cone: float = 60.0,
        radius: float = 0.03,
    ) -> bpy.types.Object:
        """A lamp with a shade: light within a cone of ``cone`` degrees."""
        light: Any = bpy.data.lights.new(name, "SPOT")
        light.energy, light.color, light.spot_size = watts, colour, math.radians(cone)
        light.spot_blend, light.shadow_soft_size = 0.4, radius
        item = self._place(name, light, location, toward)
        item.visible_camera = False
        return self._shine(group, item)

    def glow(self, group: str, item: bpy.types.Object, strength: Socket) -> None:
        """An object whose material shines: a screen, a flame.

        ``strength``: the input of the material that its light is linear in. A material may be on several
        objects, all of one group.
        """
        item.lightgroup = group
        knobs = self._enter(group)
        if not any(knob.owner == strength for knob in knobs):
            knobs.append(LightKnob(strength, "default_value", strength.default_value))

    def _shine(self, group: str, item: bpy.types.Object) -> bpy.types.Object:
        item.lightgroup = group
        light = light_of(item)
        self._enter(group).append(LightKnob(light, "energy", light.energy))
        return item

    def _place(self, name: str, light: bpy.types.Light, location: Point, toward: Point) -> bpy.types.Object:
        item = bpy.data.objects.new(name, light)
        item.location = location
        item.rotation_euler = Vector(toward).to_track_quat("-Z", "Z").to_euler()
        self.scene.collection.objects.link(item)
        return item

    def _enter(self, group: str) -> list[LightKnob]:
        if group not in self.groups:
            self.groups[group] = []
            self.scene.view_layers[0].lightgroups.add(name=group)
        return self.groups[group]
