# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr export``: chooses the kind of output. Each kind has its own module, loaded when needed: importing
torch takes seconds, and only exports of a run need it.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

import tyro

from ...bridge.errors import BadValueError
from .convert import Convert, FormatOptions
from .exporting import PAGE, BakedLook, Exporting
from .options import build_kind, is_folder
from .output import run_and_report

if TYPE_CHECKING:
    from .run_files import RunFiles
    from .web import WebPageOf


@dataclass(frozen=True, kw_only=True)
class Export(Exporting):
    """Write a run for Blender and other programs, or Gaussians in another program's format.

    RUN alone, or RUN FOLDER: writes model.safetensors (for Blender), cameras.json, a standard 3DGS PLY and,
    for Gaussians, the lossless PLY. With a file name: writes one file of the type its suffix says: .html
    (a web page), .ply, .spz, .glb, .gltf, .usdc, .usda, .usd, .usdz or .safetensors. Reads a run's folder,
    .safetensors, .ply (also compressed), .spz, .splat, .ksplat, .sog (or its meta.json), .glb, .gltf and USD.
    """

    #: Write a folder with a web page, which opens from disk or from any server. docs/other-programs.md
    web: bool = False
    look: Annotated[BakedLook, tyro.conf.OmitArgPrefixes] = field(default_factory=BakedLook)
    format: Annotated[FormatOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=FormatOptions)

    def run(self) -> int:
        return run_and_report(lambda: self.kind().work(), self.json)

    def kind(self) -> "Convert | RunFiles | WebPageOf":
        """The requested kind; raises ``BadValueError`` for an option that it does not read."""
        if self.web or (self.out is not None and self.out.suffix.lower() in PAGE):
            from .web import WebPageOf

            return build_kind(WebPageOf, self, "a web page, which has sliders for its light", "web")
        if self.out is not None and not is_folder(self.out):
            return build_kind(Convert, self, "a file of Gaussians")
        if self.source.is_file():
            raise BadValueError(
                f"{self.source} is a file, and no output was given",
                "Give a file to write, such as OUT.spz, or a folder and --web.",
            )
        from .run_files import RunFiles

        return build_kind(RunFiles, self, "the files of a run")
