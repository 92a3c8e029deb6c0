# SPDX-License-Identifier: GPL-3.0-or-later
"""The lights of a user's scene as they are named: on the command line, in files, and as sliders."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from ..bridge.lights import AMBIENT
from .errors import OptionError
from .passes import RESERVED

GROUP, COLLECTION = "group", "collection"
KINDS = {GROUP: "light group of this view layer", COLLECTION: "collection of this file"}
#: The light that what nobody chose is, lamps and glowing things.
LAMPS = "lamps"


@dataclass(frozen=True)
class LightChoice:
    """A light of the data set: its name there, and the light group or collection that it is."""

    name: str
    kind: str
    what: str

    def __str__(self) -> str:
        return f"{self.name}={self.kind}:{self.what}"

    def check(self) -> None:
        """Raise ``OptionError`` where a folder, a layer of an EXR or a slider could not have its name."""
        if self.kind not in KINDS or not self.what:
            raise OptionError(f"--light '{self}': write NAME={GROUP}:… or NAME={COLLECTION}:…")
        if layer_name(self.name, {AMBIENT, LAMPS}) != self.name:
            raise OptionError(
                f"--light '{self}': '{self.name}' cannot be a light's name",
                "small letters, digits and _, and none of " + ", ".join(sorted({AMBIENT, LAMPS, *RESERVED})),
            )


def layer_name(name: str, taken: set[str] | Mapping[str, str]) -> str:
    """A name for layers of EXR files, folders and sliders: ``Key Light`` → ``key_light``."""
    plain = re.sub(r"\W+", "_", name.lower()).strip("_") or "light"
    made, count = plain, 2
    while made in taken or made in RESERVED:
        made, count = f"{plain}_{count}", count + 1
    return made
