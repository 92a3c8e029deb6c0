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
    """An output socket with arithmetic: ``+ − * /`` make math nodes (vector math with a vector)."""

    def __init__(self, builder: "NodeBuilder", socket: bpy.types.NodeSocket) -> None:
        self.builder = builder
        self.socket = socket

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
            self.tree.links.new(value.socket, socket)
        elif value is None:
            return
        elif socket.type == "VECTOR" and isinstance(value, int | float):
            socket.default_value = (value, value, value)
        else:
            socket.default_value = value

    def arrange(self) -> None:
        """Place frames from left to right in the order of their making, and inside each the nodes in
        columns by their distance from the frame's inputs."""
        groups: dict[Any, list[bpy.types.Node]] = {}
        for node in self.tree.nodes:
            if node.type != "FRAME":
                groups.setdefault(node.parent, []).append(node)
        left = 0.0
        for nodes in groups.values():
            columns = self._columns(nodes)
            for index, column in enumerate(columns):
                top = 0.0
                for node in column:
                    node.location = (left + index * COLUMN_WIDTH, top)
                    sockets = sum(socket.enabled for socket in [*node.inputs, *node.outputs])
                    top -= HEADER_HEIGHT + SOCKET_HEIGHT * sockets + ROW_GAP
            left += len(columns) * COLUMN_WIDTH + FRAME_GAP

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


class GeometryBuilder(NodeBuilder):
    """Adds geometry nodes to a tree."""

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
