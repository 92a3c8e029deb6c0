# SPDX-License-Identifier: GPL-3.0-or-later
"""Several built-in scenes by one command: each a data set in a folder of its own, one progress for all."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..bridge.data_set import passes_files
from . import floors
from .dataset import make
from .errors import OptionError
from .options import Options
from .progress import Report


def make_all(out: Path, scenes: Sequence[str], options: Options, report: Report) -> dict[str, Any]:
    """``dataset.make`` for each scene, in ``out`` itself if there is one, else in ``out/<scene>``.

    Returns:
        What ``make`` returns; of several scenes ``folder`` and ``scenes`` with the results by name.

    Raises:
        SynthError: of the first scene that fails; what is made until then is kept.
    """
    if len(scenes) == 1 or options.from_file:
        if len(scenes) > 1:
            raise OptionError("--scene names several built-in scenes, and --from-file asks for your own")
        return make(out, replace(options, scene=scenes[0]), report)
    for name, value in (("--test-truth", options.test_truth), ("--renders-of", options.renders_of)):
        if value is not None:
            raise OptionError(f"{name} is of one scene, and --scene names several: give one at a time")
    for scene in scenes:  # all, before hours are spent on the first
        replace(options, scene=scene).check()
    rendered = sum(len(passes_files(out / scene)) for scene in scenes)
    parts = options.part[1] if options.part else 1
    pieces = options.views + options.lit_views + options.validation_views + floors.count(options)
    report.begin_all((len(scenes) * pieces - rendered) // parts)
    results = {}
    for scene in scenes:
        report.enter(scene)
        results[scene] = make(out / scene, replace(options, scene=scene), report)
    return {"folder": str(out.absolute()), "scenes": results}
