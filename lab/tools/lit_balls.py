# SPDX-License-Identifier: GPL-3.0-or-later
"""A chrome and a grey ball in a built-in scene: as they look there, and as a panorama of the place lights
them.

    .venvs/run-blender lab/tools/lit_balls.py -- photograph interior --out DATA
    .venvs/run-blender lab/tools/lit_balls.py -- truth interior --out BALLS
    .venvs/run-blender lab/tools/lit_balls.py -- lit BALLS
    physhdr render runs/demo --at -0.1 -0.7 1.2 --out PROBE
    .venvs/run-blender lab/tools/lit_balls.py -- lit BALLS --model runs/demo/model.safetensors \\
        --probe PROBE --name demo
    .venvs/backend/bin/python lab/tools/lit_balls_sheet.py BALLS --image docs/images/lit_balls.jpg

``photograph`` makes a data set of the scene by cameras that stand all around the balls' place, for a capture
that is made to light CG. ``truth`` renders the scene with each ball in it, and from the ball's middle the
panorama that no photographer can take: all around, clean, each light by itself. ``lit`` renders the balls
alone: by that panorama, the most that light taken at one place can reach, and by it at level 1 times the
level, a plain HDRI. With ``--model`` *Light From Here* lights them, from a capture that never had a ball in
it. ``lit_balls_sheet`` compares.

A lamp that is invisible to cameras shines on no ball: no panorama can show it, and no photograph.
"""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from physhdr.bridge.errors import PhysHDRError
from physhdr.bridge.lights import AMBIENT
from physhdr.synth import exr, folder, passes, rig, settings
from physhdr.synth.assets import Assets
from physhdr.synth.built_in import SCENES, BuiltInScene, built
from physhdr.synth.dataset import make
from physhdr.synth.options import Options
from physhdr.synth.passes import Passes
from physhdr.synth.progress import Report
from physhdr.synth.renderer import renderer, view_seed
from physhdr.synth.stage import Stage

#: Where the balls hang, a point of free space in the middle of the scene, and their radius: metres.
PLACES = {"interior": (-0.1, -0.7, 1.2)}
RADIUS = 0.12
#: Base colour, metallic, roughness.
BALLS = {"chrome": ((1.0, 1.0, 1.0), 1.0, 0.0), "grey": ((0.5, 0.5, 0.5), 0.0, 1.0)}
#: Of the ambient light.
LEVELS = (0.25, 1.0, 4.0)
#: Pixels of a picture of a ball, and how many radii it is wide.
SIZE, WIDE = 160, 2.6
PANORAMA = (512, 256)
#: The panorama looks along +X, as Blender's *Environment Texture* has it in its middle.
AXES = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
ABOUT = "balls.json"
#: Cameras all around stand so many metres from the place, between these elevations, this wide (radians):
#: across the place they see all walls, floor and ceiling.
AWAY, ELEVATION, ANGLE = 0.9, (-0.55, 0.65), 1.4


def main() -> int:
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    given = _parser().parse_args(arguments)
    try:
        given.step(given)
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error.message}{': ' + error.hint if error.hint else ''}\n")
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    steps = made.add_subparsers(required=True)
    true = steps.add_parser("truth", help="render the scene with the balls, and the panorama of their place")
    true.add_argument("scene", choices=list(PLACES))
    true.add_argument("--out", type=Path, required=True)
    true.add_argument("--samples", type=int, default=192)
    true.add_argument("--panorama-samples", type=int, default=64)
    true.set_defaults(step=truth)
    around = steps.add_parser("photograph", help="make a data set by cameras all around the place")
    around.add_argument("scene", choices=list(PLACES))
    around.add_argument("--out", type=Path, required=True)
    around.add_argument("--size", type=int, default=128)
    around.add_argument("--views", type=int, default=40)
    around.add_argument("--lit-views", type=int, default=16)
    around.add_argument("--samples", type=int, default=32)
    around.set_defaults(step=photograph)
    alone = steps.add_parser("lit", help="render the balls alone, lit by a panorama")
    alone.add_argument("balls", type=Path)
    alone.add_argument("--model", type=Path, help="a trained model: its own light, not the true panorama's")
    alone.add_argument("--probe", type=Path, help="what physhdr render --at drew of it at the balls' place")
    alone.add_argument("--name", default="demo", help="what the pictures with --model are called")
    alone.add_argument("--samples", type=int, default=256)
    alone.set_defaults(step=lit)
    return made


# ---- a capture around the place ----------------------------------------------------------------------------


def photograph(given: argparse.Namespace) -> None:
    """A data set as ``synth/make_scene.py`` makes it, by cameras that look at the place from all sides."""
    place = PLACES[given.scene]
    plain = SCENES[given.scene]

    def build(scene: bpy.types.Scene, assets: Assets) -> Stage:
        stage = plain(scene, assets)
        hints = replace(stage.cameras, target=place, centre=(place[0], place[1] - AWAY, place[2]))
        hints = replace(hints, orbit_radius=AWAY, orbit_arc=2.0 * np.pi, elevation=ELEVATION, angle_x=ANGLE)
        return replace(stage, cameras=hints)

    SCENES[name := f"{given.scene} around"] = BuiltInScene(build, plain.evs)
    make(
        given.out,
        Options(
            scene=name,
            resolution=(given.size, given.size),
            samples=given.samples,
            views=given.views,
            lit_views=given.lit_views,
            camera_rig="hemisphere",
        ),
        Report(),
    )


# ---- truth -------------------------------------------------------------------------------------------------


def truth(given: argparse.Namespace) -> None:
    place = np.array(PLACES[given.scene])
    for name in (*BALLS, "panorama"):
        path = given.out / "truth" / f"{name}.exr"
        if path.exists():
            continue
        with built(given.scene) as stage:
            if name == "panorama":
                seen = _panorama(stage, place, given.panorama_samples, path)
            else:
                _keep_away_the_unseen(stage, _add_ball(stage.scene.collection, name, place))
                seen = _portrait(stage, place, given.samples, path)
        passes.write(path, seen)
        print(f"{path}: {seen.facts}", flush=True)
    with built(given.scene) as stage:
        pose, angle = _toward(stage, place)
        lights = list(stage.lights)
    about = {"scene": given.scene, "place": place.tolist(), "radius": RADIUS, "lights": lights}
    about |= {"camera_to_world": pose.tolist(), "angle": angle, "size": [SIZE, SIZE]}
    about |= {"distance": float(np.linalg.norm(place - pose[:3, 3]))}
    folder.write_json(given.out / ABOUT, about)


def _toward(stage: Stage, place: np.ndarray) -> tuple[np.ndarray, float]:
    eye = np.array(stage.cameras.centre)
    width = WIDE * RADIUS / np.linalg.norm(place - eye)
    return rig.look_at(eye, place), float(2.0 * np.arctan(width / 2.0))


def _portrait(stage: Stage, place: np.ndarray, samples: int, path: Path) -> Passes:
    pose, angle = _toward(stage, place)
    return _rendered(stage, pose, (SIZE, SIZE), samples, path, angle)


def _panorama(stage: Stage, place: np.ndarray, samples: int, path: Path) -> Passes:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = AXES, place

    def all_around(camera: Any) -> None:
        camera.type, camera.panorama_type = "PANO", "EQUIRECTANGULAR"

    return _rendered(stage, pose, PANORAMA, samples, path, stage.cameras.angle_x, all_around)


def _rendered(
    stage: Stage,
    pose: np.ndarray,
    size: tuple[int, int],
    samples: int,
    path: Path,
    angle: float,
    prepare: Callable[[Any], None] | None = None,
) -> Passes:
    stage = replace(stage, cameras=replace(stage.cameras, angle_x=angle))
    wanted = settings.ground_truth(size, samples)
    with settings.applied(stage.scene, wanted), renderer(stage, denoise=True) as camera:
        if prepare:
            prepare(camera.camera.data)
        return camera.render(pose, view_seed(0, path.stem), path.with_suffix(".scratch.exr"))


def _add_ball(collection: bpy.types.Collection, name: str, place: np.ndarray) -> bpy.types.Object:
    colour, metallic, roughness = BALLS[name]
    material = bpy.data.materials.new(name)
    assert material.node_tree is not None
    nodes: Any = material.node_tree.nodes
    nodes.clear()
    out = nodes.new("ShaderNodeOutputMaterial")
    kind = "ShaderNodeBsdfAnisotropic" if metallic else "ShaderNodeBsdfDiffuse"
    surface = nodes.new(kind)
    surface.inputs["Color"].default_value = (*colour, 1.0)
    surface.inputs["Roughness"].default_value = roughness if metallic else 0.0  # Lambert's
    material.node_tree.links.new(surface.outputs[0], out.inputs[0])
    from physhdr.synth.scenes.props import ball

    item = ball(collection, name, tuple(place), RADIUS, material, 6)
    item.pass_index = 1
    return item


def _keep_away_the_unseen(stage: Stage, item: bpy.types.Object) -> None:
    """Lamps that no camera sees and that stand for no visible one do not light the ball."""
    away = bpy.data.collections.new("not lit by what is unseen")
    away.objects.link(item)
    away.collection_objects[0].light_linking.link_state = "EXCLUDE"
    for lamp in stage.scene.objects:
        if lamp.type == "LIGHT" and lamp.data.type == "AREA" and not lamp.visible_camera:
            lamp.light_linking.receiver_collection = away


# ---- lit ---------------------------------------------------------------------------------------------------


def lit(given: argparse.Namespace) -> None:
    about = json.loads((given.balls / ABOUT).read_text(encoding="utf-8"))
    if given.model:
        _render_in_capture(given, about)
        return
    true = passes.read(given.balls / "truth" / "panorama.exr", about["lights"], PANORAMA)
    plain = true.radiance({})
    for level in LEVELS:
        _render_under(given, about, "panorama", level, true.radiance({AMBIENT: level}))
        _render_under(given, about, "scaled", level, plain * level)


def _render_under(
    given: argparse.Namespace, about: dict, kind: str, level: float, panorama: np.ndarray
) -> None:
    """Balls alone under a panorama [H, W, 3]."""
    target = given.balls / kind
    folder.write(target / f"panorama_{level:g}.exr", exr.encode_rgb(panorama.astype(np.float32)))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    world = bpy.data.worlds.new("panorama")
    scene.world = world
    assert world.node_tree is not None
    nodes: Any = world.node_tree.nodes
    background = next(node for node in nodes if node.type == "BACKGROUND")
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(str((target / f"panorama_{level:g}.exr").absolute()))
    world.node_tree.links.new(texture.outputs[0], background.inputs["Color"])
    balls_under_world(scene, about, given.samples, target, level)


def _render_in_capture(given: argparse.Namespace, about: dict) -> None:
    """Balls where a capture lights the scene, at the levels of its model's slider."""
    from physhdr import addon
    from physhdr.addon.model import model_import, nodes

    addon.register()
    for level in LEVELS:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = bpy.context.scene
        model = model_import.import_model(str(given.model))
        bpy.context.view_layer.objects.active = model
        operators: Any = bpy.ops
        operators.physhdr.light_from_here(folder=str(given.probe.absolute()), model=model.name)
        modifier = nodes.find_modifier(model)
        assert modifier is not None
        nodes.set_input(modifier, nodes.LIGHTING_LEVEL, level)
        model.hide_render = True
        balls_under_world(scene, about, given.samples, given.balls / given.name, level)


def balls_under_world(scene: bpy.types.Scene, about: dict, samples: int, target: Path, level: float) -> None:
    """Each ball in its place under the scene's world, with what else there is in the scene unseen."""
    pose, angle = np.array(about["camera_to_world"]), about["angle"]
    from physhdr.addon.rendering import render

    render.prepare_cycles(scene, samples)
    cycles: Any = scene.cycles
    cycles.max_bounces, cycles.use_denoising = 4, True
    cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 1.5
    scene.render.film_transparent = True
    render.set_resolution(scene, SIZE, SIZE)
    render.add_camera(scene, pose, angle)
    for name in BALLS:
        item = _add_ball(scene.collection, name, np.array(about["place"]))
        path = target / f"{name}_{level:g}.exr"
        render.render_exr(scene, path)
        bpy.data.objects.remove(item)
        print(path, flush=True)


if __name__ == "__main__":
    sys.exit(main())
