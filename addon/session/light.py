# SPDX-License-Identifier: GPL-3.0-or-later
"""The backend's work for *Light From Here*: panoramas of a model, drawn in a process of its own. Pure."""

from collections.abc import Sequence

#: The task's name.
LIGHT = "light"


def panorama_command(
    source: str, width: int, places: Sequence[tuple[tuple[float, float, float], str]]
) -> list[str]:
    """The arguments of the backend's command that draws panoramas of a model file, or a run.

    ``places``: each in the model's own space, metres, and the folder for what is seen from there.
    """
    command = ["render", source, "--width", str(width), "--json"]
    for place, folder in places:
        command += ["--at", *(f"{value:.9g}" for value in place), "--out", folder]
    return command
