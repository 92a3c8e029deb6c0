# SPDX-License-Identifier: GPL-3.0-or-later
"""The data set: chosen, made of photos, or rendered."""

import bpy

from ..dataset import rig_preview
from ..operators.base import choices
from ..session.state import PHOTOS, Photos, Prepared, State
from ..session.tasks import duration
from ..settings import PHYSHDR_Settings
from .parts import BOX, button, first_line, reasons, shortened, write


def draw(context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
    """The folder, what it holds, and the two ways to make one."""
    layout.prop(context.scene.physhdr, "data", text="")
    if state.dataset.folder and state.dataset.folder == choices(context).data:
        draw_report(context, layout, state)
    photos = choices(context).photos
    if photos:
        draw_photos(context, layout.box(), state, photos)
    column = layout.column(align=True)
    text = "Prepare Other Photos…" if photos else "Prepare Photos…"
    if state.backend.ready:
        button(context, column, state, "look", "physhdr.photos_look", text, "CAMERA_DATA")
    text = "Render from This Scene…"
    button(context, column, state, "render", "physhdr.dataset_render", text, "RENDER_STILL")
    if rig_preview.pinned():
        column.operator("physhdr.rig_show", text="Hide Cameras", icon="OUTLINER_DATA_CAMERA", depress=True)


def draw_photos(context: bpy.types.Context, layout: bpy.types.UILayout, state: State, folder: str) -> None:
    """What was understood of the photos, what can be chosen, and the button for the long work."""
    row = layout.row(align=True)
    row.label(text=shortened(folder, context), icon="FILE_FOLDER")
    row.operator("physhdr.photos_forget", text="", icon="X")
    found = state.photos if state.photos.folder == folder else Photos()
    column = layout.column(align=True)
    for line in found.lines:
        write(context, column, line, beside=BOX)
    for warning in found.warnings:
        write(context, column, warning, "ERROR", beside=BOX)
    if found.problem:
        write(context, column, f"{found.problem.message}. {found.problem.hint}", "ERROR", beside=BOX)
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = False
    settings = context.scene.physhdr
    for name in ("photos_out", "photos_width", "photos_handheld"):
        column.prop(settings, name)
    draw_lights(layout, settings)
    head, more = layout.panel("physhdr_photos_more", default_closed=True)
    head.label(text="If It Is Misunderstood")
    if more is not None:
        more.use_property_split = True
        more.use_property_decorate = False
        for name in ("bracket", "exposures", "lens"):
            more.prop(settings, f"photos_{name}")
        more.use_property_split = False  # for the longest name there is only so room beside its box
        for name in ("same_exposure", "borrow_poses", "partial", "named_lights"):
            more.prop(settings, f"photos_{name}")
    if found.seconds >= 0.0:
        write(context, layout, f"Preparing takes about {duration(found.seconds)}", "SORTTIME", beside=BOX)
    button(context, layout, state, "photos", "physhdr.photos_prepare", "Prepare", "PLAY")
    if not state.task(PHOTOS):
        reasons(context, layout, state, "photos", BOX)


def draw_lights(layout: bpy.types.UILayout, settings: PHYSHDR_Settings) -> None:
    """The folders of photos under other light, and a button for one more."""
    for number, each in enumerate(settings.photos_lights):
        column = layout.column(align=True)
        row = column.row(align=True)
        row.prop(each, "light", text="", icon="LIGHT", placeholder="Light")
        row.prop(each, "word", text="")
        if each.word == "factor":
            row.prop(each, "factor", text="")
        row.operator("physhdr.photos_light_remove", text="", icon="X").number = number
        column.prop(each, "folder", text="")
    layout.operator("physhdr.photos_light_add", text="Other Light…", icon="ADD")


def draw_report(context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
    """What the data set holds, folded; what is wrong with it is always seen."""
    dataset, made = state.dataset, state.prepared
    made = made if made.folder == dataset.folder else Prepared()
    if dataset.problem:
        write(context, layout, f"{dataset.problem.message}. {dataset.problem.hint}", "ERROR")
        return
    if not dataset.lines:
        layout.label(text="Looking at it", icon="SORTTIME")
        return
    warnings = dict.fromkeys((*dataset.warnings, *made.warnings))
    # Two folds, so that each remembers for itself whether it is open.
    fold = "physhdr_report_warned" if warnings else "physhdr_report"
    head, body = layout.panel(fold, default_closed=not warnings)
    head.label(text=first_line(context, dataset.lines[0].split(", ")[0]))
    if body is None:
        if warnings:
            many = f"{len(warnings)} warnings" if len(warnings) > 1 else "A warning"
            head.label(text=many, icon="ERROR")
        return
    column = body.column(align=True)
    for line in (*dataset.lines, made.found):
        if line:
            write(context, column, line)
    for warning in warnings:
        write(context, column, warning, "ERROR")
