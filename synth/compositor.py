# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's compositor as the way out of a render: each light's pass, denoised by itself, and the geometry.

Denoised apart the lights still add up: against the denoised whole their sum has 52 dB μ-law PSNR (interior,
200×200, 64 samples), far above the noise itself.
"""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from . import animation
from .blender import cycles
from .settings import called_here
from .stage import Stage

#: The layer of the whole picture before denoising, from which noise is measured.
RAW = "raw"
PLANES = {"depth": "Depth", "index": "Object Index", "samples": "Debug Sample Count"}
NORMAL = "Normal"


#: How OIDN takes albedo and normal: noisy as they are and together with the picture, or denoised before it.
TOGETHER, BEFORE = "Fast", "Accurate"

#: What is set of the view layer, here and by ``open_scene``: keyframes and drivers must not win over it.
_OF_LAYER = (
    "samples",
    "use_pass_z",
    "use_pass_normal",
    "use_pass_object_index",
    "use_grease_pencil",
    "cycles.use_denoising",
    "cycles.denoising_store_passes",
    "cycles.pass_debug_sample_count",
)


@dataclass(frozen=True)
class Outlet:
    """The nodes that a render leaves by."""

    file: bpy.types.CompositorNodeOutputFile
    denoisers: tuple[Any, ...]

    def aim(self, path: Path) -> None:
        """Let the file be ``path``, whose name ends in .exr."""
        self.file.directory = _literal(str(path.parent.absolute()))
        self.file.file_name = _literal(path.name.removesuffix(".exr"))

    def prefilter(self, way: str) -> None:
        """``TOGETHER`` or ``BEFORE``."""
        for node in self.denoisers:
            node.inputs["Prefilter"].default_value = way


def _literal(text: str) -> str:
    """A path for Blender to write to, which takes ``{…}`` for the name of a variable to fill in."""
    return text.replace("{", "{{").replace("}", "}}")


@contextmanager
def connected(stage: Stage, denoise: bool) -> Iterator[Outlet]:
    """Switch the passes on and connect them to a file; all is put back on the way out.

    Layers of the file: ``light_0``, ``light_1`` … in the order of ``stage.lights``, ``RAW``, ``PLANES`` and
    ``normal``. Its folder and name are the caller's to set.
    """
    scene, layer = stage.scene, stage.view_layer
    with ExitStack() as undo:
        undo.enter_context(animation.muted(scene, animation.layer_paths(scene, layer, _OF_LAYER)))
        for owner, attribute, value in (
            (layer, "use_pass_z", True),
            (layer, "use_pass_normal", True),
            (layer, "use_pass_object_index", True),
            (layer, "use_grease_pencil", False),  # drawn over the picture, it is in no light
            (cycles(layer), "denoising_store_passes", denoise),
            (cycles(layer), "pass_debug_sample_count", True),
            (scene, "compositing_node_group", scene.compositing_node_group),
        ):
            undo.callback(setattr, owner, attribute, getattr(owner, attribute))
            setattr(owner, attribute, value)
        tree = bpy.data.node_groups.new("physhdr passes", "CompositorNodeTree")
        undo.callback(bpy.data.node_groups.remove, tree)
        scene.compositing_node_group = tree
        undo.callback(setattr, scene, "compositing_node_group", None)
        yield _Wiring(tree, scene, layer, denoise).connect(stage)


class _Wiring:
    """The nodes of one compositor tree."""

    def __init__(
        self, tree: bpy.types.NodeTree, scene: bpy.types.Scene, layer: bpy.types.ViewLayer, denoise: bool
    ) -> None:
        self.tree, self.denoise = tree, denoise
        self.denoisers: list[Any] = []
        self.render: Any = tree.nodes.new("CompositorNodeRLayers")
        self.render.scene, self.render.layer = scene, layer.name
        self.file: Any = tree.nodes.new("CompositorNodeOutputFile")
        picture = self.file.format
        picture.media_type, picture.file_format = "MULTI_LAYER_IMAGE", "OPEN_EXR_MULTILAYER"
        picture.color_depth, picture.exr_codec = "32", "NONE"  # read once, and at once
        picture.use_exr_interleave = True  # one part
        # Colours are converted as they are written, from whatever working space a user's file has.
        picture.color_management = "OVERRIDE"
        space = picture.linear_colorspace_settings
        space.name = called_here(space, "name")

    def connect(self, stage: Stage) -> Outlet:
        groups = {name: stage.groups.get(name, name) for name in stage.lights}
        rest = self.render.outputs["Image"]
        for group in groups.values():
            if group and "" in groups.values():
                rest = self._subtracted(rest, self.render.outputs[f"Combined_{group}"])
        for k, group in enumerate(groups.values()):
            light = self.render.outputs[f"Combined_{group}"] if group else rest
            self._save("RGBA", f"light_{k}", self._denoised(light))
        self._save("RGBA", RAW, self.render.outputs["Image"])
        for name, output in PLANES.items():
            self._save("FLOAT", name, self.render.outputs[output])
        self._save("VECTOR", "normal", self.render.outputs[NORMAL])
        return Outlet(self.file, tuple(self.denoisers))

    def _save(self, kind: str, name: str, value: bpy.types.NodeSocket) -> None:
        self.file.file_output_items.new(kind, name)
        self.tree.links.new(value, self.file.inputs[name])

    def _denoised(self, light: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
        if not self.denoise:
            return light
        node: Any = self.tree.nodes.new("CompositorNodeDenoise")
        self.denoisers.append(node)
        node.inputs["HDR"].default_value = True
        # Measured at 64 samples: BEFORE costs a third of a second a frame and gains 0.2 dB.
        node.inputs["Prefilter"].default_value = TOGETHER
        node.inputs["Quality"].default_value = "High"
        for name, value in (
            ("Image", light),
            ("Albedo", self.render.outputs["Denoising Albedo"]),
            ("Normal", self.render.outputs["Denoising Normal"]),
        ):
            self.tree.links.new(value, node.inputs[name])
        return node.outputs[0]

    def _subtracted(self, whole: bpy.types.NodeSocket, part: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
        node: Any = self.tree.nodes.new("ShaderNodeMix")
        node.data_type, node.blend_type, node.clamp_result = "RGBA", "SUBTRACT", False
        colours = [socket for socket in node.inputs if socket.type == "RGBA"]
        node.inputs["Factor"].default_value = 1.0
        self.tree.links.new(whole, colours[0])
        self.tree.links.new(part, colours[1])
        return next(socket for socket in node.outputs if socket.type == "RGBA")
