# SPDX-License-Identifier: GPL-3.0-or-later
"""The live preview: the backend's pictures of each 3D view's own camera, asked for and shown as they come.

Nothing here waits: ``tick`` is called often (by the session's timer), looks whether a picture has come, and
asks for the next one. One is asked for at a time, for all views together: the backend has two cores as well.
"""

import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import bpy

from ...bridge.messages import PreviewCamera, PreviewFrame, PreviewRequest
from ..attributes import FILE
from ..blender import cloud_of
from ..look import is_model
from ..session.session import Session
from ..settings import preview_levels
from . import overlay, splats
from .camera import ViewCamera, of_region
from .schedule import TIMEOUT_SECONDS, PreviewSchedule, Request, View
from .splat_data import identity

#: Pixels of a resting picture per pixel of the view, along a side.
SHARPNESS = 1.0
#: Seconds between looks for imported copies of the model that is shown.
LOOK_SECONDS = 0.5


#: What ``_regions`` puts into a view's ``look``: exposure, a level for each light, tone mapping.
_Look = tuple[float, tuple[float, ...], Literal["linear", "learned"]]


@dataclass(frozen=True, eq=False)
class _Asked:
    """The request that is under way: for which region, and how the schedule knows it."""

    key: int
    request: Request
    sequence: int
    at: float


class LivePreview:
    """Pictures for every 3D view of the windows whose scene has its preview on."""

    def __init__(self) -> None:
        self._schedules: dict[int, PreviewSchedule] = {}
        self._asked: _Asked | None = None
        self._sequences = itertools.count(1)
        self._last_key = 0
        self._hidden: set[str] = set()
        self._looked = 0.0

    def tick(self, session: Session) -> bool:
        """Show what has come, ask for what is wanted; returns whether any view has the preview on."""
        now = time.perf_counter()
        self._take(session, now)
        job = session.state.job
        regions = dict(_regions(job.lights)) if job.has_model else {}
        for key in self._schedules.keys() - regions.keys():
            del self._schedules[key]
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
        run = Path(session.state.job.run)
        hidden = set()
        for target in bpy.data.objects if is_on else ():
            if is_model(target) and Path(cloud_of(target).get(FILE, "")).parent == run:
                hidden.add(identity(cloud_of(target)))
        if hidden != self._hidden:
            self._hidden = hidden
            splats.set_hidden(hidden)

    def _take(self, session: Session, now: float) -> None:
        answer = session.take_preview()
        asked = self._asked
        if asked and (now - asked.at > TIMEOUT_SECONDS or session.state.link.status != "connected"):
            self._asked = None  # its schedule will give it up as well
            return
        if answer is None or asked is None:
            return
        frame = answer if isinstance(answer, PreviewFrame) else None
        request = answer.header.request if isinstance(answer, PreviewFrame) else answer.request
        if request.sequence != asked.sequence:
            return
        self._asked = None
        schedule = self._schedules.get(asked.key)
        if schedule is None:
            return  # its view is gone, or does not show the preview any more
        if frame is None:
            schedule.lost()
        elif schedule.received(now, asked.request.number, 1e-3 * frame.header.milliseconds):
            overlay.set_picture(
                asked.key, overlay.RenderedView(frame.rgba, frame.depth, asked.request.camera)
            )

    def _ask(self, session: Session, regions: "dict[int, View]", now: float) -> None:
        # The view after the one that was served last comes first.
        order = sorted(regions, key=lambda key: (key <= self._last_key, key))
        for key in order:
            view = regions[key]
            if session.state.job.state == "training":
                view = View(view.camera, view.look, session.state.job.iteration)
            wanted = self._schedules[key].wants(now, view)
            if wanted is None:
                continue
            sequence = next(self._sequences)
            if session.request_preview(_message(sequence, wanted)):
                self._asked, self._last_key = _Asked(key, wanted, sequence, now), key
            else:
                self._schedules[key].lost()
            return


def _message(sequence: int, wanted: Request) -> PreviewRequest:
    camera: ViewCamera = wanted.camera
    exposure_ev, lighting_levels, tone = cast(_Look, wanted.look)
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


def _regions(lights: Sequence[str]) -> Iterator[tuple[int, View]]:
    """The regions that want pictures of a model with these lights, each with its view."""
    for window in bpy.context.window_manager.windows:
        settings = window.scene.physhdr
        if not settings.preview:
            continue
        look = (settings.exposure_ev, preview_levels(settings, lights), settings.tone)
        for area in window.screen.areas:
            if area.type != "VIEW_3D":
                continue
            for region in area.regions:
                if region.type == "WINDOW" and region.data is not None and region.width > 1:
                    yield overlay.region_key(region), View(of_region(region, region.data), look)
