# SPDX-License-Identifier: GPL-3.0-or-later
"""The session of this Blender: made when first asked for, pumped by a timer, closed with the extension."""

import traceback

import bpy
from bpy.app.handlers import persistent

from . import changes, outside, paths, plot, settings
from .session.advice import why_not
from .session.session import Session
from .session.state import FileOpened
from .settings import photo_options
from .viewport.live import LivePreview, is_of_job

#: Seconds between looks at what has happened: while pictures come, while something is under way, else.
PICTURES, BUSY, QUIET = 0.015, 0.1, 1.0

_session: Session | None = None
_live = LivePreview()


def session() -> Session:
    """The one session; there is one Blender, one backend and one training."""
    global _session
    if _session is None:
        _session = Session(settings.home_folder(), paths.LAUNCHER, _name(), paths.version())
        _session.set_when_closed(settings.when_closed())
    return _session


def redraw() -> None:
    """Draw the 3D views again, whose panels show the state, and the status bar."""
    manager = bpy.context.window_manager
    for window in manager.windows if manager else ():
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
        # Nothing else draws the status bar again; the text is that of an operator, which none is at.
        if window.workspace and not window.modal_operators:
            window.workspace.status_text_set(None)


def renew() -> None:
    """Another session, of the folder that is chosen now; a training continues without this Blender."""
    global _session
    if _session is not None:
        _session.close()
        _session = None


def _tick() -> float:
    """The timer's call. Blender ends a timer that raises, and the panel would stand still without a word."""
    try:
        return _attend()
    except Exception:  # noqa: BLE001 (whatever it is, the next call may do better)
        traceback.print_exc()
        return QUIET


def _attend() -> float:
    """Take in what has happened, show it; returns the seconds until the next look."""
    current = session()
    _follow_scene(current)
    _follow_photos(current)
    before = current.state.history
    if current.pump():
        redraw()
    if current.state.history is not before:
        plot.update(current.state.history)
    _follow_model(current)
    if _live.tick(current):
        return PICTURES
    return BUSY if current.busy else QUIET


def _follow_scene(current: Session) -> None:
    """Look at the data set of the scene that is shown: another file or scene has another one."""
    folder = outside.chosen(bpy.context.scene.physhdr.data)
    if folder and folder != current.state.dataset.folder:
        current.choose_dataset(folder)


def _follow_photos(current: Session) -> None:
    """Look at the photos of the scene that is shown, anew where other options understand them otherwise."""
    settings = bpy.context.scene.physhdr
    folder = outside.chosen(settings.photos)
    others = [settings.photos_exposures, *(each.folder for each in settings.photos_lights)]
    if not folder or not all(map(outside.chosen, filter(None, others))) or why_not(current.state, "look"):
        return
    options = photo_options(settings).to_look
    if (folder, options) != (current.state.photos.folder, current.state.photos.options):
        current.look_at_photos(folder, options)


def _follow_model(current: Session) -> None:
    """Let the scenes that are shown have a slider for each light of the backend's model, and its exposure."""
    job = current.state.job
    for window in bpy.context.window_manager.windows:
        if window.scene.is_editable:  # not linked from another file
            settings.follow_lights(window.scene.physhdr, job.lights, job.standard_levels)
            if job.has_model:
                settings.follow_exposure(window.scene.physhdr, job.photographed_ev)


@persistent
def _file_opened(*_: object) -> None:
    """Another .blend, or a new one: the backend stays, what was said of the former file is past."""
    if _session is None:
        return
    current = session()
    current.name = _name()
    current.dispatch(FileOpened())
    job = current.state.job
    for scene in bpy.data.scenes:
        chosen = getattr(scene, settings.SETTINGS)
        if chosen.preview and scene.is_editable and not (job.has_model and is_of_job(chosen, job)):
            chosen.preview = False  # it would show another file's model
    redraw()


def _name() -> str:
    """Who this is to other Blenders."""
    file = f" ({bpy.path.basename(bpy.data.filepath)})" if bpy.data.filepath else ""
    return f"Blender {bpy.app.version_string}{file}"


def _when_closed_changed() -> None:
    session().set_when_closed(settings.when_closed())


def _dataset_chosen(folder: str) -> None:
    session().choose_dataset(folder)


def register() -> None:
    changes.home.follow(renew)
    changes.when_closed.follow(_when_closed_changed)
    changes.dataset.follow(_dataset_chosen)
    bpy.app.handlers.load_post.append(_file_opened)
    if not bpy.app.background:
        bpy.app.timers.register(_tick, first_interval=QUIET, persistent=True)


def unregister() -> None:
    changes.home.leave(renew)
    changes.when_closed.leave(_when_closed_changed)
    changes.dataset.leave(_dataset_chosen)
    bpy.app.handlers.load_post.remove(_file_opened)
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    _live.clear()
    renew()
