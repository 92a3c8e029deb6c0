# SPDX-License-Identifier: GPL-3.0-or-later
"""The live preview: the backend's pictures of each 3D view's own camera, asked for and shown as they come.

Nothing here waits: ``tick`` is called often (by the session's timer), looks whether a picture has come, and
asks for the next one. One is asked for at a time, for all views together: the backend has two cores as well.
"""

import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import cast

import bpy
import numpy as np

from ...bridge.messages import JobStatus, PreviewCamera, PreviewFrame, PreviewRequest
from ...bridge.run_folder import same_spelling
from .. import similarity
from ..blender import cloud_of
from ..capture import placement
from ..chosen_run import run_of
from ..model import origin
from ..model.look import is_of_run, was_same_folder
from ..model.preview_look import PreviewLook, preview_look
from ..paths import absolute
from ..session.session import Session
from ..settings import PHYSHDR_Settings
from . import overlay, splats
from .camera import ViewCamera, of_region
from .schedule import TIMEOUT_SECONDS, PreviewSchedule, Request, View
from .splat_data import identity

#: Pixels of a resting picture per pixel of the view, along a side.
SHARPNESS = 1.0
#: Seconds between looks for imported copies of the model that is shown.
LOOK_SECONDS = 0.5


@dataclass(frozen=True, eq=False)
class _Asked:
    """The request that is under way: for which region, and how the schedule knows it.

    ``to_world``: ``[4, 4]``, where the capture stood: the request's camera is in the capture's own world.
    """

    key: int
    request: Request
    sequence: int
    at: float
    to_world: np.ndarray


class LivePreview:
    """Pictures for every 3D view of the windows whose scene has its preview on."""

    def __init__(self) -> None:
        self._schedules: dict[int, PreviewSchedule] = {}
        self._asked: _Asked | None = None
        #: What takes long and may come yet, by its sequence.
        self._late: dict[int, _Asked] = {}
        self._sequences = itertools.count(1)
        self._last_key = 0
        self._hidden: set[str] = set()
        self._looked = 0.0

    def tick(self, session: Session) -> bool:
        """Show what has come, ask for what is wanted; returns whether any view has the preview on."""
        now = time.perf_counter()
        self._take(session, now)
        job = session.state.job
        regions = {region.key: region for region in _regions(job)} if job.has_model else {}
        for key in self._schedules.keys() - regions.keys():
            del self._schedules[key]
            if self._asked and self._asked.key == key:
                self._asked = None  # the numbers of a schedule that comes later begin anew
            self._late = {sequence: late for sequence, late in self._late.items() if late.key != key}
            overlay.set_picture(key, None)
        for key in regions.keys() - self._schedules.keys():
            self._schedules[key] = PreviewSchedule(sharpness=SHARPNESS)
        self._hide_what_is_shown(session, bool(regions), now)
        if self._asked is None or self._asked.key not in regions:
            self._ask(session, regions, now)
        return bool(regions)

    def clear(self) -> None:
        """Show nothing any more."""
        for key in self._schedules:
            overlay.set_picture(key, None)
        if self._hidden:
            splats.set_hidden(())
        self.__init__()

    def _hide_what_is_shown(self, session: Session, is_on: bool, now: float) -> None:
        """Imported copies of the model that the preview shows: two pictures of it would cover each other."""
        if now < self._looked + LOOK_SECONDS:
            return
        self._looked = now
        run = session.state.job.run
        models = (each for each in bpy.data.objects if is_on and is_of_run(each, run))
        hidden = {identity(cloud_of(target)) for target in models}
        if hidden != self._hidden:
            self._hidden = hidden
            splats.set_hidden(hidden)

    def _take(self, session: Session, now: float) -> None:
        answer = session.take_preview()
        if session.state.link.status != "connected":
            self._asked = None  # its schedule will give it up as well
            self._late.clear()
            return
        if self._asked and now - self._asked.at > TIMEOUT_SECONDS:
            self._late[self._asked.sequence] = self._asked
            self._asked = None  # other views have their turn; its schedule gives it up where it has changed
        if answer is None:
            return
        frame = answer if isinstance(answer, PreviewFrame) else None
        request = answer.header.request if isinstance(answer, PreviewFrame) else answer.request
        asked = self._late.pop(request.sequence, None)
        if self._asked and self._asked.sequence == request.sequence:
            asked, self._asked = self._asked, None
        if asked is None:
            return
        if frame is not None:
            self._forget_before(request.sequence)
        schedule = self._schedules.get(asked.key)
        if schedule is None:
            return  # its view is gone, or does not show the preview any more
        if frame is None:
            schedule.lost(asked.request.number)
        elif schedule.received(now, asked.request.number, 1e-3 * frame.header.milliseconds):
            overlay.set_picture(asked.key, in_world(frame, asked.request.camera, asked.to_world))

    def _forget_before(self, sequence: int) -> None:
        """What was asked before a picture that is here will not come: a newer request has replaced it."""
        for older in [each for each in self._late if each < sequence]:
            late = self._late.pop(older)
            if late.key in self._schedules:
                self._schedules[late.key].lost(late.request.number)

    def _ask(self, session: Session, regions: "dict[int, _Region]", now: float) -> None:
        # The view after the one that was served last comes first.
        order = sorted(regions, key=lambda key: (key <= self._last_key, key))
        for key in order:
            view, to_world = regions[key].view, regions[key].to_world
            if session.state.job.state == "training":
                view = View(view.camera, view.look, session.state.job.iteration)
            wanted = self._schedules[key].wants(now, view)
            if wanted is None:
                continue
            sequence = next(self._sequences)
            if session.request_preview(_message(sequence, wanted)):
                self._asked, self._last_key = _Asked(key, wanted, sequence, now, to_world), key
            else:
                self._schedules[key].lost()
            return


def _message(sequence: int, wanted: Request) -> PreviewRequest:
    camera: ViewCamera = wanted.camera
    exposure_ev, lighting_levels, tone = cast(PreviewLook, wanted.look)  # as _regions puts it there
    return PreviewRequest(
        sequence=sequence,
        camera=PreviewCamera(
            pose=tuple(float(number) for number in camera.camera_to_world.reshape(-1)),
            width=camera.width,
            height=camera.height,
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
        ),
        lighting_levels=lighting_levels,
        exposure_ev=exposure_ev,
        tone=tone,
    )


def in_world(frame: PreviewFrame, camera: ViewCamera, to_world: np.ndarray) -> overlay.RenderedView:
    """The backend's picture for a ``camera`` in the capture's world, as it belongs into the scene's."""
    pose = similarity.out_of_capture(to_world, camera.camera_to_world)
    depth = frame.depth * np.float32(similarity.scale_of(to_world))
    return overlay.RenderedView(frame.rgba, depth, replace(camera, camera_to_world=pose))


@dataclass(frozen=True, eq=False)
class _Region:
    """A region that wants pictures: its view in the capture's own world, and where that stands."""

    key: int
    view: View
    to_world: np.ndarray


def is_of_job(chosen: PHYSHDR_Settings, job: JobStatus) -> bool:
    """Whether the job is of the run that a scene has chosen, or that is proposed for it."""
    if chosen.out and same_spelling(job.run, absolute(chosen.out)):
        return True  # known without a look at the disk, where this file may not lead
    out = absolute(run_of(chosen))
    return bool(out) and was_same_folder(job.run, out)


def _regions(job: JobStatus) -> Iterator[_Region]:
    """The regions that want pictures of the job's model: of scenes whose run it is."""
    for window in bpy.context.window_manager.windows:
        settings = window.scene.physhdr
        if not settings.preview or not is_of_job(settings, job):
            continue
        look = preview_look(window.scene, window.view_layer, job)
        to_world = placement.matrix_of(window.scene, origin.key_of(job.data))
        for area in window.screen.areas:
            if area.type != "VIEW_3D":
                continue
            for region in area.regions:
                if region.type == "WINDOW" and region.data is not None and region.width > 1:
                    camera = of_region(region, region.data)
                    pose = similarity.into_capture(to_world, camera.camera_to_world)
                    view = View(replace(camera, camera_to_world=pose), look)
                    yield _Region(overlay.region_key(region), view, to_world)
