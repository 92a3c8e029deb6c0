# SPDX-License-Identifier: GPL-3.0-or-later
"""The dialog of a data set of the open scene, and what the panel shows of it."""

import textwrap
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import bpy

from ...bridge.errors import PhysHDRError
from ...synth.light_names import GROUP
from .. import outside
from ..capture import originals
from ..model.look import is_model
from ..runtime import session
from . import dataset_command, dataset_folder, denoiser, render_time, time_trial, unsaved
from .dataset_settings import PHYSHDR_DatasetSettings, chosen, settings_of

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import IconItems

#: Pixels of the dialog, and characters of a line of it.
WIDTH, COLUMNS = 460, 72
#: Characters of a line beside a small button.
TEXT_BESIDE = 52


def draw(context: bpy.types.Context, layout: bpy.types.UILayout) -> None:
    """What every data set needs, the rest folded, what is wrong with it, and about how long it takes."""
    scene = context.scene
    settings, values = settings_of(scene), chosen(scene)
    layout.use_property_split = True
    layout.use_property_decorate = False
    row = layout.row(align=True)
    row.prop(settings, "out")
    row.popover("PHYSHDR_PT_dataset_presets", text="", icon="PRESET")
    column = layout.column(align=True)
    for name in ("rig", "views", "resolution_x"):
        _prop(column, settings, name)
    _draw_lights(layout, settings)
    # No ``layout.panel``: a dialog with one that opens again, below an error, crashes Blender 5.2.2.
    row = layout.row()
    row.use_property_split, row.alignment = False, "LEFT"
    icon = "DOWNARROW_HLT" if settings.show_advanced else "RIGHTARROW"
    row.prop(settings, "show_advanced", icon=icon, emboss=False)
    if settings.show_advanced:
        _draw_advanced(layout, settings)
    needed = dataset_command.combinations(values)
    if 0 < settings.lit_views < needed:
        text = f"These levels combine in {needed} ways: better {needed} views under other light"
        _write(layout, text, "INFO")
    models = [item.name for item in scene.objects if is_model(item) and not item.hide_render]
    if models:
        text = f"Trained models are left out of what is photographed: {', '.join(models)}"
        _write(layout, textwrap.shorten(text, 3 * COLUMNS, placeholder=" …"), "INFO")
    if originals.are_hidden(scene):
        _write(layout, "The hidden originals are photographed, too", "INFO")
    if named := outside.not_chosen(settings):
        box = layout.box()
        _write(box, outside.QUESTION, "INFO")
        outside.draw(box, named)
        return
    problem, folder = _judged(values, scene)
    if problem is None:
        _write(layout, folder, "FILE_FOLDER")
        _draw_time(layout, values, scene)
    else:
        box = layout.box()
        box.alert = True
        _write(box, problem.message, "ERROR")
        if problem.hint:
            _write(box, problem.hint, "BLANK1")


def time_in_words(values: SimpleNamespace, scene: bpy.types.Scene) -> str:
    """``48 pictures to render: about 12 min, as the last data set of this scene went``."""
    out = None
    if values.out:
        out = dataset_folder.chosen_folder(values.out)
    seconds, by = render_time.estimate(values, scene, session().home, out)
    pictures = f"{dataset_command.pictures(values)} pictures to render"
    return f"{pictures}. {by}" if seconds < 0.0 else f"{pictures}: about {about(seconds)}, {by}"


def about(seconds: float) -> str:
    """As exact as it is known: ``40 s``, ``12 min``, ``3.5 h``."""
    if seconds < 90.0:
        return f"{max(10, 10 * round(seconds / 10.0))} s"
    if seconds < 90.0 * 60.0:
        return f"{round(seconds / 60.0)} min"
    return f"{round(seconds / 1800.0) / 2:g} h"


def _judged(values: SimpleNamespace, scene: bpy.types.Scene) -> tuple[PhysHDRError | None, str]:
    """What is wrong, else what becomes of the folder."""
    try:
        dataset_command.of(values, scene)
        unsaved.require_saved()
        return None, dataset_folder.check(Path(dataset_folder.chosen_folder(values.out)))
    except PhysHDRError as error:
        return error, ""


def _draw_time(layout: bpy.types.UILayout, values: SimpleNamespace, scene: bpy.types.Scene) -> None:
    trial = time_trial.in_words()
    text = trial or time_in_words(values, scene)
    known = settings_of(scene).rate > 0.0 and settings_of(scene).rate_device == values.device
    if known or time_trial.trial().is_running:
        _write(layout, text, "SORTTIME")
        return
    row = layout.split(factor=0.8)
    _write(row, text, "SORTTIME", TEXT_BESIDE)
    row.operator("physhdr.dataset_time", icon="FILE_REFRESH")


def _draw_advanced(layout: bpy.types.UILayout, settings: PHYSHDR_DatasetSettings) -> None:
    """What has good values by itself: of the rig, the camera, the lights' levels and Cycles."""
    of_rig = {
        "GRID": ("rig_distance", "rig_width", "rig_height"),
        "ORBIT": ("rig_distance", "rig_arc"),
        "HEMISPHERE": ("rig_distance", "rig_arc"),
        "PATH": (),
    }
    file = ("response_file",) if settings.response == "file" else ()
    layout.prop(settings, "show_cameras")
    for names in (
        of_rig[settings.rig],
        ("resolution_y", "exposures", "response", *file),
        ("lit_views", "lit_levels", "relit_views", "ambient_levels"),
    ):
        column = layout.column(align=True)
        for name in names:
            _prop(column, settings, name)
    _draw_cycles(layout.column(align=True), settings)


def _draw_cycles(column: bpy.types.UILayout, settings: PHYSHDR_DatasetSettings) -> None:
    column.prop(settings, "samples")
    row = column.row()
    row.enabled = denoiser.can_denoise()
    row.prop(settings, "denoise")
    if not row.enabled:
        _write(column, denoiser.REASON, "INFO")
    for name in ("seed", "device"):
        column.prop(settings, name)


def _draw_lights(layout: bpy.types.UILayout, settings: PHYSHDR_DatasetSettings) -> None:
    column = layout.column(heading="Lights That Vary")
    column.prop(settings, "vary_ambient", text="Ambient: the world and suns")
    for light in settings.lights:
        kind = "light group" if light.kind == GROUP else "collection"
        column.prop(light, "vary", text=f"{light.name} ({kind}): {light.words}")


def _prop(layout: bpy.types.UILayout, settings: PHYSHDR_DatasetSettings, name: str) -> None:
    layout.prop(settings, name, text=dataset_command.label(name, getattr(settings, name)))


def _write(layout: bpy.types.UILayout, text: str, icon: "IconItems", columns: int = COLUMNS) -> None:
    column = layout.column(align=True)
    column.scale_y = 0.8
    for index, line in enumerate(textwrap.wrap(text, columns)):
        column.label(text=line, icon=icon if index == 0 else "BLANK1")
