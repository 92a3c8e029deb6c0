# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr export``: which files are asked for; each kind has a module of its own, loaded when it is needed:
torch takes seconds, and only what is of a run needs it.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

import tyro

from ...bridge.errors import BadValueError
from .convert import Convert, FormatOptions
from .exporting import PAGE, BakedLook, Exporting
from .given import is_folder, of_kind
from .told import answered

if TYPE_CHECKING:
    from .run_files import RunFiles
    from .web import WebPageOf


@dataclass(frozen=True, kw_only=True)
class Export(Exporting):
    """Write a run for Blender and other programs, or Gaussians in the format of another program.

    RUN alone, or RUN FOLDER: model.safetensors (for Blender), cameras.json, a standard 3DGS PLY and, of
    Gaussians, the lossless PLY. With a file's name one file, whose suffix decides: .html (a web page), .ply,
    .spz, .glb, .gltf, .usdc, .usda, .usd, .usdz or .safetensors. Reads a run's folder, .safetensors, .ply
    (compressed too), .spz, .splat, .ksplat, .sog (or its meta.json), .glb, .gltf and USD.
    """

    #: A folder with a web page, which opens from disk or from any server. docs/other-programs.md
    web: bool = False
    look: Annotated[BakedLook, tyro.conf.OmitArgPrefixes] = field(default_factory=BakedLook)
    format: Annotated[FormatOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=FormatOptions)

    def run(self) -> int:
        return answered(lambda: self.kind().work(), self.json)

    def kind(self) -> "Convert | RunFiles | WebPageOf":
        """What is asked for; raises ``BadValueError`` for an option that it does not read."""
        if self.web or (self.out is not None and self.out.suffix.lower() in PAGE):
            from .web import WebPageOf

            return of_kind(WebPageOf, self, "a web page, which has sliders for its light", "web")
        if self.out is not None and not is_folder(self.out):
            return of_kind(Convert, self, "a file of Gaussians")
        if self.source.is_file():
            raise BadValueError(
                f"{self.source} is a file: nothing says what to make of it",
                "Name a file to write, such as OUT.spz, or a folder and --web.",
            )
        from .run_files import RunFiles

        return of_kind(RunFiles, self, "the files of a run")
