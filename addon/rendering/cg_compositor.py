# SPDX-License-Identifier: GPL-3.0-or-later
"""The compositor's part of ``cg``: picture = F + S (C − F), put where the scene's picture was taken from.

A user's own nodes stay: what they took from the layer's *Image* they take from our group instead, and
``disconnect`` gives it back to them. Blender draws *Render Layers* nodes only at the top of a tree, so ours
stand there, beside the group that adds up.
"""

from typing import Any

import bpy

#: Custom property of the nodes and trees that are ours, and what they are.
MARK = "physhdr_cg"
NODE, GROUP, OWN_TREE = "node", "group", "tree"
_RECIPE = 1


def connect(scene: bpy.types.Scene, beauty: str, shadow: str, front: str) -> None:
    """Let the scene's picture of the layer ``beauty`` have its shadow; where it has one, renew that."""
    disconnect(scene)
    tree: Any = scene.compositing_node_group
    if tree is None:
        tree = bpy.data.node_groups.new("PhysHDR Compositing", "CompositorNodeTree")
        tree[MARK] = OWN_TREE
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        scene.compositing_node_group = tree
        output = tree.nodes.new("NodeGroupOutput")
        output.location = (500.0, 0.0)
        taken = [output.inputs[0]]
    else:
        sources = [node for node in tree.nodes if _renders(node, scene, beauty)]
        taken = [link.to_socket for node in sources for link in node.outputs["Image"].links]
    scene.render.use_compositing = True
    left = min((node.location.x for node in tree.nodes if node.type != "FRAME"), default=0.0) - 500.0
    group = tree.nodes.new("CompositorNodeGroup")
    group.node_tree, group.label, group[MARK] = _formula(), "Shadow on the Capture", NODE
    group.location = (left + 300.0, 0.0)
    for index, (layer, output, name) in enumerate(
        ((beauty, "Image", "Image"), (front, "Image", "Front"), (shadow, "Shadow Catcher", "Shadow"))
    ):
        node = tree.nodes.new("CompositorNodeRLayers")
        node.scene, node.layer, node[MARK] = scene, layer, NODE
        node.location = (left, 300.0 - 350.0 * index)
        if output in node.outputs:  # EEVEE has no shadow catcher: the group's own value stands, no shadow
            tree.links.new(node.outputs[output], group.inputs[name])
    for socket in taken:
        tree.links.new(group.outputs["Image"], socket)


def disconnect(scene: bpy.types.Scene) -> None:
    """Take our nodes out of the scene's tree; what hung on them hangs on the layer's picture again."""
    tree: Any = scene.compositing_node_group
    if tree is None:
        return
    ours = [node for node in tree.nodes if MARK in node]
    if tree.get(MARK) == OWN_TREE and all(MARK in node or node.type == "GROUP_OUTPUT" for node in tree.nodes):
        scene.compositing_node_group = None
        if not tree.users:
            bpy.data.node_groups.remove(tree)
    else:
        for group in [node for node in ours if node.type == "GROUP"]:
            source = _picture(tree, group)
            for link in list(group.outputs["Image"].links):
                if source is not None:
                    tree.links.new(source, link.to_socket)
        for node in ours:
            if node.type != "R_LAYERS" or not any(output.links for output in _other_links(tree, node, ours)):
                tree.nodes.remove(node)
            else:
                del node[MARK]
    for formula in [each for each in bpy.data.node_groups if each.get(MARK) == GROUP]:
        if not formula.users:
            bpy.data.node_groups.remove(formula)


def is_connected(scene: bpy.types.Scene) -> bool:
    """Whether the scene's compositor draws the shadow."""
    tree: Any = scene.compositing_node_group
    if tree is None or not scene.render.use_compositing:
        return False
    groups = [node for node in tree.nodes if MARK in node and node.type == "GROUP"]
    return any(node.outputs["Image"].links and not node.mute for node in groups)


def _renders(node: Any, scene: bpy.types.Scene, layer: str) -> bool:
    return node.type == "R_LAYERS" and node.scene == scene and node.layer == layer


def _picture(tree: Any, group: Any) -> Any:
    """The picture that a user's nodes get back: of a node of theirs of that layer, else of ours."""
    links = group.inputs["Image"].links
    if not links:
        return None
    own = links[0].from_node
    others = [node for node in tree.nodes if MARK not in node and _renders(node, own.scene, own.layer)]
    return (others[0] if others else own).outputs["Image"]


def _other_links(tree: Any, node: Any, ours: list[Any]) -> list[Any]:
    """Outputs of a node that others than ours take from."""
    return [out for out in node.outputs if any(link.to_node not in ours for link in out.links)]


def _formula() -> bpy.types.NodeTree:
    """The group F + S (C − F), made when it is not there; alpha is the picture's own."""
    for tree in bpy.data.node_groups:
        if tree.get(MARK) == GROUP and tree.get("recipe") == _RECIPE and tree.library is None:
            return tree
    tree: Any = bpy.data.node_groups.new("PhysHDR Shadow on the Capture", "CompositorNodeTree")
    tree[MARK], tree["recipe"] = GROUP, _RECIPE
    sockets = (
        ("Image", (0.0, 0.0, 0.0, 0.0), "Splats and CG together"),
        ("Front", (0.0, 0.0, 0.0, 0.0), "What of it is in front of the ground"),
        ("Shadow", (1.0, 1.0, 1.0, 1.0), "Light on the ground with the CG, over that without it"),
    )
    for name, value, description in sockets:
        socket = tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketColor")
        socket.default_value, socket.description = value, description
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    given, output = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")

    def blend(kind: str, first: Any, second: Any, label: str) -> Any:
        node = tree.nodes.new("ShaderNodeMix")
        node.data_type, node.blend_type, node.clamp_result, node.clamp_factor = "RGBA", kind, False, False
        node.label = label
        colours = [socket for socket in node.inputs if socket.type == "RGBA"]
        node.inputs[0].default_value = 1.0  # all of it; alpha stays the first one's
        tree.links.new(first, colours[0])
        tree.links.new(second, colours[1])
        return next(socket for socket in node.outputs if socket.type == "RGBA")

    ground = blend("SUBTRACT", given.outputs["Image"], given.outputs["Front"], "C − F: on the ground")
    shaded = blend("MULTIPLY", ground, given.outputs["Shadow"], "S (C − F)")
    whole = blend("ADD", shaded, given.outputs["Front"], "F + S (C − F)")
    tree.links.new(whole, output.inputs[0])
    for index, node in enumerate([given, *(each for each in tree.nodes if each.type == "MIX"), output]):
        node.location = (220.0 * index, 0.0)
    return tree
