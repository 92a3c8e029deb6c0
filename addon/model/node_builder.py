# SPDX-License-Identifier: GPL-3.0-or-later
"""Write node trees as formulas: sockets with operators, frames with titles, a layout people can read."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Union

import bpy

from .attributes import Attribute, AttributeType

#: Grid of the layout, in node editor units: a column is wide enough for a 140 wide node and its links.
COLUMN_WIDTH = 190
FRAME_GAP = 90
HEADER_HEIGHT = 60
SOCKET_HEIGHT = 24
ROW_GAP = 30

Operand = Union["Field", float, tuple[float, float, float]]


class Field:
    """An output socket with arithmetic: ``+ − * /`` make math nodes (vector math with a vector).

    ``name``: what a node group calls it that it goes into or comes out of; empty: as its node or its socket.
    """

    def __init__(self, builder: "NodeBuilder", socket: bpy.types.NodeSocket, name: str = "") -> None:
        self.builder = builder
        self.socket = socket
        self.name = name

    def called(self, name: str) -> "Field":
        """The same, with a name for node groups."""
        return Field(self.builder, self.socket, name)

    @property
    def is_vector(self) -> bool:
        return self.socket.type in {"VECTOR", "RGBA"}

    def __add__(self, other: Operand) -> "Field":
        return self.builder.arithmetic("ADD", self, other)

    def __sub__(self, other: Operand) -> "Field":
        return self.builder.arithmetic("SUBTRACT", self, other)

    def __mul__(self, other: Operand) -> "Field":
        return self.builder.arithmetic("MULTIPLY", self, other)

    def __truediv__(self, other: Operand) -> "Field":
        return self.builder.arithmetic("DIVIDE", self, other)

    def __rsub__(self, other: Operand) -> "Field":
        return self.builder.arithmetic("SUBTRACT", other, self)

    def __rtruediv__(self, other: Operand) -> "Field":
        return self.builder.arithmetic("DIVIDE", other, self)

    __radd__ = __add__
    __rmul__ = __mul__


class NodeBuilder:
    """Adds nodes to a tree (geometry or shader). Call ``arrange`` at the end."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree
        self._frame: bpy.types.Node | None = None

    @contextmanager
    def frame(self, label: str) -> Iterator[None]:
        """Nodes added inside belong to a frame with that title; frames are laid out in this order."""
        frame = self.tree.nodes.new("NodeFrame")
        frame.label = label
        outer, self._frame = self._frame, frame
        yield
        self._frame = outer

    def node(self, kind: str, *inputs: Any, label: str = "", **properties: Any) -> bpy.types.Node:
        """A node of type ``kind`` with ``properties``; ``inputs`` are linked or set in the sockets' order.

        Sockets that the node's mode hides are not counted; ``None`` leaves a socket as it is.
        """
        node = self.tree.nodes.new(kind)
        node.parent = self._frame
        node.label = label
        for name, value in properties.items():
            # Blender works through the whole tree even where what is set was so before.
            if getattr(node, name) != value:
                setattr(node, name, value)
        sockets = [socket for socket in node.inputs if socket.enabled]
        for socket, value in zip(sockets, inputs, strict=False):
            self._connect(value, socket)
        return node

    def field(self, kind: str, *inputs: Any, output: str | int = 0, **properties: Any) -> Field:
        """As ``node``, giving one output: by name, or by its place among those that the mode shows."""
        node = self.node(kind, *inputs, **properties)
        if isinstance(output, str):
            return self.output(node, output)
        return Field(self, [socket for socket in node.outputs if socket.enabled][output])

    def output(self, node: bpy.types.Node, name: str) -> Field:
        """The output of that name which the node's mode shows."""
        return Field(self, next(socket for socket in node.outputs if socket.name == name and socket.enabled))

    def math(self, operation: str, *operands: Operand, label: str = "") -> Field:
        return self.field("ShaderNodeMath", *operands, operation=operation, label=label)

    def vector(self, operation: str, *operands: Operand, label: str = "") -> Field:
        """A vector math node; gives its number where the operation has one (DOT_PRODUCT, LENGTH)."""
        return self.field("ShaderNodeVectorMath", *operands, operation=operation, label=label)

    def arithmetic(self, operation: str, left: Operand, right: Operand) -> Field:
        vector = any(isinstance(x, tuple) or (isinstance(x, Field) and x.is_vector) for x in (left, right))
        return self.vector(operation, left, right) if vector else self.math(operation, left, right)

    def dot(self, left: Operand, right: Operand) -> Field:
        return self.vector("DOT_PRODUCT", left, right)

    def _connect(self, value: Any, socket: Any) -> None:
        # Any: a socket's ``default_value`` is of its own class, what sockets have in common has none.
        if isinstance(value, Field):
            self.tree.links.new(self._here(value).socket, socket)
        elif value is None:
            return
        elif socket.type == "VECTOR" and isinstance(value, int | float):
            socket.default_value = (value, value, value)
        else:
            socket.default_value = value

    def _here(self, field: Field) -> Field:
        """The field as a socket of the tree that nodes are added to."""
        return field

    def arrange(self) -> None:
        """Place frames from left to right in the order of their making, and inside each the nodes in
        columns by their distance from the frame's inputs."""
        groups: dict[Any, list[bpy.types.Node]] = {}
        for node in self.tree.nodes:
            if node.type != "FRAME":
                groups.setdefault(node.parent, []).append(node)
        left = 0.0
        places = {node.name: (node.location[0], node.location[1]) for node in self.tree.nodes}
        for nodes in groups.values():
            columns = self._columns(nodes)
            for index, column in enumerate(columns):
                top = 0.0
                for node in column:
                    places[node.name] = (left + index * COLUMN_WIDTH, top)
                    sockets = sum(socket.enabled for socket in [*node.inputs, *node.outputs])
                    top -= HEADER_HEIGHT + SOCKET_HEIGHT * sockets + ROW_GAP
            left += len(columns) * COLUMN_WIDTH + FRAME_GAP
        # All at once: after each that is set alone Blender works through the whole tree.
        flat = [x for node in self.tree.nodes for x in places[node.name]]
        self.tree.nodes.foreach_set("location", flat)

    def _columns(self, nodes: list[bpy.types.Node]) -> list[list[bpy.types.Node]]:
        sources: dict[str, list[str]] = {node.name: [] for node in nodes}
        for link in self.tree.links:
            source, target = link.from_node, link.to_node
            if source and target and source.name in sources and target.name in sources:
                sources[target.name].append(source.name)
        depths: dict[str, int] = {}
        for node in nodes:  # made in order, so every source is placed before what uses it
            depths[node.name] = 1 + max((depths[name] for name in sources[node.name]), default=-1)
        columns: list[list[bpy.types.Node]] = [[] for _ in range(1 + max(depths.values()))]
        for node in nodes:
            columns[depths[node.name]].append(node)
        return columns


#: Types of sockets whose classes are called otherwise.
_KINDS = {"VALUE": "Float", "RGBA": "Color", "BOOLEAN": "Bool"}


def socket_of(sockets: Any, identifier: str) -> bpy.types.NodeSocket:
    """The one of a node's inputs or outputs with that identifier."""
    return next(socket for socket in sockets if socket.identifier == identifier)


class _Group:
    """A node group of ``outside``. Its sockets are made for the fields that go in and come out."""

    def __init__(self, name: str, outside: bpy.types.NodeTree) -> None:
        self.outside = outside
        self.tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
        #: The node in ``outside``, and the one inside that puts out, once all else is inside.
        self.node: Any = None
        self._put_out: Any = None
        #: What goes in, by the identifier of the node's socket.
        self.wanted: dict[str, Field] = {}
        self._given = self.tree.nodes.new("NodeGroupInput")
        self._known: dict[tuple[str, str, str], Field] = {}

    def inside(self, field: Field) -> Field:
        """What ``field``, of the tree outside, is inside."""
        if (key := self._key(field)) not in self._known:
            identifier = self._declare(field, "INPUT")
            self.wanted[identifier] = field
            self._known[key] = self._as(field, self._given.outputs, identifier)
        return self._known[key]

    def close(self, node: bpy.types.Node) -> None:
        """All but what comes out is inside, and laid out; ``node`` is the group outside."""
        right = max(each.location_absolute.x for each in self.tree.nodes)
        self._put_out = self.tree.nodes.new("NodeGroupOutput")
        self._put_out.location = (right + COLUMN_WIDTH + FRAME_GAP, 0.0)
        self.node = node

    def output(self, field: Field) -> Field:
        """What ``field``, of the group, is outside."""
        if (key := self._key(field)) not in self._known:
            identifier = self._declare(field, "OUTPUT")
            self.tree.links.new(field.socket, socket_of(self._put_out.inputs, identifier))
            self._known[key] = self._as(field, self.node.outputs, identifier)
        return self._known[key]

    def _key(self, field: Field) -> tuple[str, str, str]:
        tree, node = field.socket.id_data, field.socket.node
        assert tree is not None and node is not None  # of a socket that has none there is no field
        return tree.name, node.name, field.socket.identifier

    def _declare(self, field: Field, in_out: str) -> str:
        interface: Any = self.tree.interface  # which types a socket may have is known only to Blender
        socket: Any = field.socket
        name = field.name or socket.node.label or socket.name
        name = name[:1].upper() + name[1:]
        kind = _KINDS.get(socket.type, socket.type.title())
        return interface.new_socket(name, in_out=in_out, socket_type=f"NodeSocket{kind}").identifier

    def _as(self, field: Field, sockets: Any, identifier: str) -> Field:
        return Field(field.builder, socket_of(sockets, identifier), field.name)


class GeometryBuilder(NodeBuilder):
    """Adds geometry nodes to a tree, and groups of them."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        super().__init__(tree)
        self._groups: dict[str, _Group] = {}
        self._open: list[_Group] = []

    @contextmanager
    def group(self, name: str) -> Iterator[None]:
        """Nodes added inside belong to a node group of that name. Its fields are used outside as they are.

        For whoever reads the tree, and for Blender, which works through a whole tree after each node and each
        link that it is given.
        """
        group = _Group(name, self.tree)
        self._groups[group.tree.name] = group
        frame, self._frame = self._frame, None
        self._open.append(group)
        self.tree = group.tree
        yield
        self.arrange()
        self._open.pop()
        self.tree, self._frame = group.outside, frame
        group.close(self.node("GeometryNodeGroup", node_tree=group.tree))
        for identifier, field in group.wanted.items():
            self._connect(field, socket_of(group.node.inputs, identifier))

    def discard(self) -> None:
        """Remove the groups: what they are of could not be built."""
        bpy.data.batch_remove([group.tree for group in self._groups.values()])

    def _here(self, field: Field) -> Field:
        around = [group.tree for group in self._open]
        tree: Any = field.socket.id_data
        while tree.name in self._groups and tree not in around:
            field, tree = self._groups[tree.name].output(field), self._groups[tree.name].outside
        for group in self._open[around.index(tree) + 1 if tree in around else 0 :]:
            field = group.inside(field)
        return field

    def named(self, attribute: Attribute, as_type: AttributeType | None = None) -> Field:
        """The attribute of each point; ``as_type`` where nodes know its own type under another name."""
        kind = as_type or attribute.type
        return self.field(
            "GeometryNodeInputNamedAttribute", attribute.name, data_type=kind, label=attribute.name
        )

    def store(self, geometry: Field, attribute: Attribute, value: Field) -> Field:
        """The geometry with the attribute set to ``value``."""
        name, kind = attribute.name, attribute.type
        return self.field(
            "GeometryNodeStoreNamedAttribute", geometry, None, name, value, data_type=kind, label=name
        )

    def switch(self, condition: Field, off: Any, on: Any, kind: str = "FLOAT") -> Field:
        return self.field("GeometryNodeSwitch", condition, off, on, input_type=kind)
