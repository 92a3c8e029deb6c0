# SPDX-License-Identifier: GPL-3.0-or-later
"""Develop as Photographed: a model's learned response, applied to the rendered picture by the compositor.

The camera responded to the light of a pixel, all Gaussians and CG in it; the modifier's *Learned tone mapper*
responds to each Gaussian, and what is blended then is codes. Here a group (``model.response_nodes``) stands
before the output of the scene's compositor, after whatever nodes a user has there. One response for the
picture, whichever models are in it: a picture has one camera. What else shows the codes or spoils them is set
along with it, remembered, and given back by ``remove``: the modifiers' switches and the view.
"""

from collections.abc import Iterable
from typing import Any

import bpy

from ...bridge.errors import BadValueError
from ..blender import cloud_of, curve_of, curves_of
from ..model import nodes, response_nodes
from ..model.look import is_model, models_among
from ..model.point_cloud import read_tone_curve
from ..model.response_nodes import response_mark
from ..model.tone_curve import ToneCurve
from . import cg_compositor

#: Custom property of the nodes and trees that are ours, and what they are.
MARK = "physhdr_develop"
NODE, LAYER, OWN_TREE = "node", "layer", "tree"
#: Custom property of a model whose *Learned tone mapper* was switched off for the developed picture.
SWITCHED_OFF = "physhdr_developed"
#: The view that shows a developed picture's codes as they are, in the order in which it is set.
NEUTRAL: dict[str, Any] = {
    "look": "None",
    "view_transform": "Standard",
    "exposure": 0.0,
    "gamma": 1.0,
    "use_curve_mapping": False,
    "use_white_balance": False,
}
LABEL = "Develop as Photographed"
#: Units of the node editor by which the output makes room.
ROOM = 220.0


def response_of(target: bpy.types.Object | None) -> ToneCurve | None:
    """A model's learned response, where it is a model and has one."""
    return read_tone_curve(cloud_of(target)) if is_model(target) else None


def node_of(scene: bpy.types.Scene) -> Any:
    """The node that develops the scene's picture, with an *Exposure (EV)* among its inputs; None without."""
    tree: Any = scene.compositing_node_group
    if tree is None:
        return None
    return next((node for node in tree.nodes if node.get(MARK) == NODE), None)


def has_response_of(node: Any, target: bpy.types.Object | None) -> bool:
    """Whether the node develops by the response of this model, or of another one with the same."""
    curve = response_of(target)
    tree = node.node_tree
    if curve is None or tree is None:
        return False
    return tree.get(response_nodes.MARK) == response_mark(curve)


# ---- in and out of the compositor --------------------------------------------------------------------------


def develop(scene: bpy.types.Scene, target: bpy.types.Object, models: Iterable[bpy.types.Object]) -> None:
    """Develop the scene's picture by the response of ``target``; where it is developed already, renew that.

    ``models``: those in the picture, whose own switches are turned off. Raises ``BadValueError`` where the
    model has no response, where no node can be put into the scene's compositor, or where there is no view to
    show its codes, and leaves all as it is.
    """
    curve = response_of(target)
    if curve is None:
        text = f"{target.name!r} has no learned response"
        raise BadValueError(text, "Train with several exposures, or choose a model that has one.")
    tree: Any = scene.compositing_node_group
    node = node_of(scene)
    if tree is not None:
        _check_source(_output(tree), node)
    _check_view(scene)
    node = node or _new_node(scene)
    before = node.node_tree
    node.node_tree = response_nodes.response_tree(curve, target.name)  # values and links stay, by name
    node.label = f"Photographed as {target.name}"
    if before is not None and before != node.node_tree and not before.users:
        bpy.data.node_groups.remove(before)
    if not _is_linked(node):
        _insert(scene.compositing_node_group, node)
    settle(scene, models)


def settle(scene: bpy.types.Scene, models: Iterable[bpy.types.Object]) -> None:
    """Set what else a developed picture needs: the compositor on, the view neutral, no model toned twice.

    Raises as ``check_developed``, and leaves all as it is.
    """
    check_developed(scene)
    node = node_of(scene)
    if node is None:
        return
    node.mute = False
    if not scene.render.use_compositing:
        scene.render.use_compositing = True
        node["compositing_was_off"] = True
    view = view_of(scene)
    if "view" not in node:
        node["view"] = {name: getattr(view, name) for name in NEUTRAL}
    for name, value in NEUTRAL.items():
        if getattr(view, name) != value:
            setattr(view, name, value)
    for each in toned(models):
        if can_switch(each):
            _switch(each, False)
            each[SWITCHED_OFF] = True


def check_developed(scene: bpy.types.Scene) -> None:
    """Raise ``BadValueError`` where the scene has our node, and no view to show its codes."""
    if node_of(scene) is not None:
        _check_view(scene)


def remove(
    scene: bpy.types.Scene, models: Iterable[bpy.types.Object], elsewhere: Iterable[bpy.types.Object] = ()
) -> None:
    """Take our node out of the scene's compositor, and give back what was set along with it.

    ``elsewhere``: models in the pictures of other scenes that are developed. Their own switches stay off, and
    are turned on again when the last of those scenes is developed no more.
    """
    tree: Any = scene.compositing_node_group
    node = node_of(scene)
    if node is None:
        return
    _give_back(scene, node)
    for each in {*models, *models_among(scene.objects)} - set(elsewhere):
        if each.library is None and each.pop(SWITCHED_OFF, None) and nodes.find_modifier(each) is not None:
            _switch(each, True)
    _forget_animation(tree, node)
    group, source = node.node_tree, _first_link(node.inputs)
    for link in list(node.outputs[0].links):
        if source is not None:
            tree.links.new(source.from_socket, link.to_socket)
        _shift(link.to_node, -ROOM)
    tree.nodes.remove(node)
    if group is not None and not group.users:
        bpy.data.node_groups.remove(group)
    _leave(scene, tree)


def _give_back(scene: bpy.types.Scene, node: Any) -> None:
    """The view as it was, as far as it is still as we set it, and the compositor's switch."""
    view, before = view_of(scene), node.get("view", {})
    for name in ("view_transform", *NEUTRAL):  # a look belongs to its transform
        if isinstance(NEUTRAL[name], str) and not _is_offered(view, name, before.get(name, "")):
            continue  # the configuration of colours is another by now
        if name in before and getattr(view, name) == NEUTRAL[name]:
            setattr(view, name, type(NEUTRAL[name])(before[name]))
    if node.get("compositing_was_off"):
        scene.render.use_compositing = False


def _leave(scene: bpy.types.Scene, tree: Any) -> None:
    """Take the tree away with our node, where it is ours or the shadow's and nothing is left in it."""
    ours = tree.get(MARK) == OWN_TREE
    if not ours and tree.get(cg_compositor.MARK) != cg_compositor.OWN_TREE:
        return
    others = [node for node in tree.nodes if node.type not in ("R_LAYERS", "GROUP_OUTPUT")]
    if not others and not any(cg_compositor.MARK in node for node in tree.nodes):
        scene.compositing_node_group = None
        if not tree.users:
            bpy.data.node_groups.remove(tree)
        return
    for node in [node for node in tree.nodes if node.get(MARK) == LAYER]:
        if not any(output.links for output in node.outputs):
            tree.nodes.remove(node)
    if ours:  # the shadow of *Put CG Here* stands in it, and takes it away when it goes
        del tree[MARK]
        tree[cg_compositor.MARK] = cg_compositor.OWN_TREE


def _new_node(scene: bpy.types.Scene) -> Any:
    """Our node, with neither group nor links yet, in the scene's compositor, made where there is none."""
    tree: Any = scene.compositing_node_group
    if tree is None:
        tree = bpy.data.node_groups.new("PhysHDR Compositing", "CompositorNodeTree")
        tree[MARK] = OWN_TREE
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        layer, output = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("NodeGroupOutput")
        layer.scene, layer[MARK] = scene, LAYER
        layer.layer = next((each.name for each in scene.view_layers if each.use), scene.view_layers[0].name)
        layer.location, output.location = (-350.0, 0.0), (0.0, 0.0)
        tree.links.new(layer.outputs["Image"], output.inputs[0])
        scene.compositing_node_group = tree
    node = tree.nodes.new("CompositorNodeGroup")
    node[MARK] = NODE
    node.name = LABEL
    return node


def _output(tree: Any) -> Any:
    """The socket that puts the picture out, with a link; raises ``BadValueError`` where there is none."""
    if tree.library is not None:
        text = f"the compositing nodes {tree.name!r} are linked from another file"
        raise BadValueError(text, "Make them local (right click, Make Local), or develop there.")
    output = next(
        (each for each in tree.nodes if each.type == "GROUP_OUTPUT" and each.is_active_output), None
    )
    if output is None or not len(output.inputs) or not output.inputs[0].links:
        text = f"the compositing nodes {tree.name!r} put no picture out"
        raise BadValueError(text, "Link a picture to their Group Output, or take them off the scene.")
    return output.inputs[0]


def _check_source(output: Any, node: Any) -> None:
    """Raise ``BadValueError`` where our node, if any, puts the picture out and takes none."""
    if node is None or output.links[0].from_node != node:
        return
    image = node.inputs.get(response_nodes.IMAGE)
    if image is None or not image.links:
        text = f"the node {node.label!r} takes no picture"
        raise BadValueError(text, "Link a picture to it, or remove it.")


def _insert(tree: Any, node: Any) -> None:
    """Put our node, which has its group, between the output and what it takes the picture from."""
    socket = _output(tree)
    source = socket.links[0].from_socket
    node.location = socket.node.location
    _shift(socket.node, ROOM)
    tree.links.new(source, node.inputs[response_nodes.IMAGE])
    tree.links.new(node.outputs[0], socket)


def _shift(node: Any, by: float) -> None:
    if node.type == "GROUP_OUTPUT":
        node.location.x += by


def _is_linked(node: Any) -> bool:
    return _first_link(node.inputs) is not None and _first_link(node.outputs) is not None


def _first_link(sockets: Any) -> Any:
    links = sockets[0].links if len(sockets) else ()
    return links[0] if links else None


def _forget_animation(tree: Any, node: Any) -> None:
    """Remove keyframes and drivers of our node's inputs, which would lead nowhere."""
    data = tree.animation_data
    if data is None:
        return
    ours = f'nodes["{bpy.utils.escape_identifier(node.name)}"].'
    for driver in [each for each in data.drivers if each.data_path.startswith(ours)]:
        data.drivers.remove(driver)
    for curve in [each for each in curves_of(data) if each.data_path.startswith(ours)]:
        _bag_of(data, curve).fcurves.remove(curve)
    if not data.drivers and not curves_of(data) and not data.nla_tracks:
        tree.animation_data_clear()


def _bag_of(data: Any, curve: bpy.types.FCurve) -> Any:
    """What holds a curve of an animation."""
    strips = (strip for layer in data.action.layers for strip in layer.strips)
    bags = (bag for strip in strips for bag in strip.channelbags)
    return next(bag for bag in bags if any(each == curve for each in bag.fcurves))


# ---- what would spoil it -----------------------------------------------------------------------------------


def view_of(scene: bpy.types.Scene) -> Any:
    """The scene's view settings; which transforms and looks there are says the configuration of colours."""
    return scene.view_settings


def _is_offered(view: Any, name: str, value: str) -> bool:
    """Whether the configuration of colours (OCIO) has such a transform or look: Blender takes no other."""
    return bool(bpy.types.UILayout.enum_item_name(view, name, value))


def _check_view(scene: bpy.types.Scene) -> None:
    """Raise ``BadValueError`` where the configuration of colours has no view that shows codes as they are."""
    wanted = NEUTRAL["view_transform"]
    if not _is_offered(view_of(scene), "view_transform", wanted):
        text = (
            f"the configuration of colours (OCIO) has no view transform {wanted!r}, which shows the response"
        )
        raise BadValueError(text, "Start Blender with its own configuration: without the variable OCIO.")


def toned(models: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Those of the models whose *Learned tone mapper* is on."""
    found = []
    for each in models:
        modifier = nodes.find_modifier(each)
        if modifier is None or not nodes.has_input(modifier, nodes.TONE_MAPPER):
            continue
        if nodes.get_input(modifier, nodes.TONE_MAPPER):
            found.append(each)
    return found


def can_switch(target: bpy.types.Object) -> bool:
    """Whether a model's *Learned tone mapper* can be set: it is of this file, and nothing animates it."""
    modifier = nodes.find_modifier(target)
    if modifier is None or target.library is not None:
        return False
    return curve_of(target, nodes.input_data_path(modifier, nodes.TONE_MAPPER)) is None


def _switch(target: bpy.types.Object, on: bool) -> None:
    modifier = nodes.find_modifier(target)
    if modifier is not None and nodes.has_input(modifier, nodes.TONE_MAPPER):
        nodes.set_input(modifier, nodes.TONE_MAPPER, on)


def faults_of_view(scene: bpy.types.Scene) -> list[str]:
    """What of the scene's view changes a developed picture: ``view transform AgX``."""
    view = view_of(scene)
    found = []
    for name, value in NEUTRAL.items():
        current = getattr(view, name)
        if current != value:
            text = name.removeprefix("use_").replace("_", " ")
            number = f"{current:g}" if isinstance(value, float) else current
            found.append(text if isinstance(value, bool) else f"{text} {number}")
    return found


def is_off(scene: bpy.types.Scene) -> bool:
    """Whether the scene has our node, and its picture is not developed because something is switched off."""
    node = node_of(scene)
    return node is not None and (node.mute or not scene.render.use_compositing)


def is_apart(scene: bpy.types.Scene) -> bool:
    """Whether the scene has our node, and it has lost its links."""
    node = node_of(scene)
    return node is not None and not _is_linked(node)
