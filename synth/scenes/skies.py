# SPDX-License-Identifier: GPL-3.0-or-later
"""Skies: a gradient from the horizon up, with clouds before it."""

from collections.abc import Callable, Sequence

from .shading import Colour, Graph, Socket

#: From a world's graph and the direction (unit vector, Z up) to the sky's colour, for ``Lighting.sky``.
Sky = Callable[[Graph, Socket], Socket]


def clouded(
    clear: Sequence[tuple[float, Colour]],
    clouds: Colour,
    cover: tuple[float, float],
    scale: float,
    *,
    flat: float = 1.0,
    detail: float = 3.0,
    distortion: float = 0.3,
) -> Sky:
    """A gradient with clouds.

    ``clear``: (sine of the height above the horizon, colour); ``clouds``: their colour, brighter than white
    where the sun is in them; ``cover``: the noise's value where clouds begin and where they are thick;
    ``scale``: how many there are; ``flat``: how much wider than high they are.
    """

    def colour(graph: Graph, direction: Socket) -> Socket:
        height = graph.add("ShaderNodeSeparateXYZ", {"Vector": direction}).outputs["Z"]
        blue = graph.ramp(height, clear)
        if flat != 1.0:
            inputs = {"Vector": direction, "Scale": (1.0, 1.0, flat)}
            direction = graph.add("ShaderNodeMapping", inputs).outputs[0]
        noise = graph.noise(direction, scale, detail, distortion)
        thick = graph.ramp(noise, [(cover[0], (0.0,) * 3), (cover[1], (1.0,) * 3)])
        return graph.mix(thick, blue, clouds)

    return colour
