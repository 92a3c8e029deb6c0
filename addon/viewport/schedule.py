# SPDX-License-Identifier: GPL-3.0-or-later
"""When to ask for a picture and how large: pure decisions, no bpy, no clock of their own.

While the view moves pictures are small enough to keep up; when it rests they sharpen. At most one request
is outstanding, so that a slow backend never has a queue: the newest view is asked for when it answers.
Times are seconds of any clock that only goes forward.
"""

import math
from collections.abc import Hashable
from dataclasses import dataclass

from ...bridge.messages import PREVIEW_PIXELS_MAX, PREVIEW_SIDE_MAX
from .camera import ViewCamera

#: A picture must be there within this to give 15 a second, with a fifth to spare for drawing it.
FRAME_SECONDS = 0.8 / 15
#: A view that did not change for as long rests.
REST_SECONDS = 0.2
#: Where a reply takes longer, a view that has changed meanwhile is asked for without it.
TIMEOUT_SECONDS = 5.0
#: A view that holds waits for its picture as long: large ones take a processor many seconds.
PATIENCE_SECONDS = 60.0
#: After a lost reply or an error: how long until the next try.
RETRY_SECONDS = 0.5
#: Training continues: how often a resting view asks for the newest model's picture.
REFRESH_SECONDS = 0.5
#: One step of the ladder halves the number of pixels.
STEP = math.sqrt(0.5)
#: The lowest step: a quarter of the width, 1/16 of the pixels. Below it the time hardly falls (half of it is
#: for each Gaussian, not for each pixel), and nothing can be recognised.
LOWEST_STEP = 4


class ResolutionLadder:
    """How many pixels a view gets: down at once when too slow, up one step when clearly faster."""

    def __init__(self, frame_seconds: float = FRAME_SECONDS, step: int = 2) -> None:
        self.frame_seconds = frame_seconds
        self.step = step
        self._is_measured = False

    @property
    def scale(self) -> float:
        """Pixels of a picture along a side per pixel of a full one, at most 1."""
        return STEP**self.step

    def measured(self, seconds: float, step: int) -> None:
        """A picture of ladder step ``step`` (0: full size) took ``seconds``."""
        if step == 0 and self._is_measured and self.step > 0:
            return  # small pictures know better: part of the time does not depend on the size
        self._is_measured |= step > 0
        if seconds > self.frame_seconds:
            self.step = min(LOWEST_STEP, step + math.ceil(math.log2(seconds / self.frame_seconds)))
        elif seconds < 0.4 * self.frame_seconds:
            # Twice the pixels take at most twice the time.
            self.step = max(0, step - 1)


@dataclass(frozen=True)
class View:
    """What is looked at. ``camera``: the region's, at its full size.

    ``look``: whatever else the person changes and waits for (lighting level, exposure, tone mapping, which
    model). ``revision``: what changes by itself, such as the iteration of a running training.
    """

    camera: ViewCamera
    look: Hashable = None
    revision: Hashable = None

    @property
    def held(self) -> Hashable:
        """What must stay the same for the view to rest."""
        return self.camera.key, self.look


@dataclass(frozen=True)
class Request:
    """Ask for this. ``camera`` is resized; ``number`` comes back with the reply."""

    number: int
    camera: ViewCamera
    look: Hashable
    revision: Hashable
    #: The picture of a resting view: nothing better will follow.
    is_sharp: bool
    #: Step of the ladder.
    step: int


class PreviewSchedule:
    """Decides for one region. Call ``wants`` at every tick and redraw, the others as events come."""

    def __init__(
        self,
        *,
        sharpness: float = 1.0,
        frame_seconds: float = FRAME_SECONDS,
        rest_seconds: float = REST_SECONDS,
        timeout_seconds: float = TIMEOUT_SECONDS,
        refresh_seconds: float = REFRESH_SECONDS,
    ) -> None:
        """``sharpness``: pixels of a resting picture per pixel of the region, along a side."""
        self.sharpness = sharpness
        self.rest_seconds = rest_seconds
        self.timeout_seconds = timeout_seconds
        self.refresh_seconds = refresh_seconds
        self.ladder = ResolutionLadder(frame_seconds)
        #: A resting view gets as many pixels as are rendered before its picture may be given up.
        self.resting_ladder = ResolutionLadder(timeout_seconds, step=0)
        self._held: Hashable = None
        self._changed_at = -math.inf
        self._outstanding: tuple[Request, float] | None = None
        self._last: tuple[Request, float] | None = None
        self._last_held: Hashable = None
        #: What was given up and may come yet: the request, when it was sent, and the view that it is of.
        self._late: dict[int, tuple[Request, float, Hashable]] = {}
        self._number = 0
        self._failed = False
        self._retry_at = -math.inf

    def wants(self, now: float, view: View) -> Request | None:
        """The request to send now, or ``None``. A returned request counts as sent.

        An orthographic view wants nothing (the backend cannot draw it).
        """
        if view.held != self._held:
            # The first view there is has not moved: it may be sharp at once.
            self._changed_at = now if self._held is not None else -math.inf
            self._held = view.held
        if self._outstanding is not None:
            late, sent_at = self._outstanding
            patience = PATIENCE_SECONDS if view.held == self._last_held else self.timeout_seconds
            if now - sent_at < patience:
                return None
            self.lost()
            self._late[late.number] = late, sent_at, self._last_held
        if self._failed:
            self._failed, self._retry_at = False, now + RETRY_SECONDS
        if now < self._retry_at:
            return None
        if view.camera.is_orthographic or not self._is_stale(now, view):
            return None
        resting = self._rests(now)
        ladder = self.resting_ladder if resting else self.ladder
        camera = view.camera.scaled(self.sharpness * ladder.scale)
        camera = camera.within(PREVIEW_SIDE_MAX, PREVIEW_PIXELS_MAX)
        request = Request(self._number, camera, view.look, view.revision, resting, ladder.step)
        self._number += 1
        self._outstanding = self._last = (request, now)
        self._last_held = view.held
        return request

    def received(self, now: float, number: int, rendering: float | None = None) -> bool:
        """The reply to request ``number`` is here. ``False``: it is not to be shown, for it had been given up
        and the view is another one by now, or has its picture.

        ``rendering``: seconds that the backend worked on it, where it says. The rest of the time is spent on
        waits, redraws and training, which fewer pixels do not shorten.
        """
        late = self._late.pop(number, None)
        if late is not None:
            request, sent_at, held = late
        elif self._outstanding is not None and self._outstanding[0].number == number:
            request, sent_at = self._outstanding
            held = self._last_held
        else:
            return False
        self._measured(now - sent_at if rendering is None else rendering, request)
        if late is not None:
            if held != self._held:
                return False
            self._last, self._last_held = (request, sent_at), held
        self._outstanding = None
        self._late.clear()
        self._failed, self._retry_at = False, -math.inf
        return True

    def lost(self, number: int | None = None) -> None:
        """Request ``number``, or the outstanding one, was not or will not be answered (an error, a closed
        connection).

        ``wants`` asks again ``RETRY_SECONDS`` after it is next called, so that a failing backend is not
        asked at every tick.
        """
        if number is not None and (self._outstanding is None or self._outstanding[0].number != number):
            self._late.pop(number, None)
            return  # the view has asked for another one since
        self._outstanding = self._last = None
        self._failed = True

    def _measured(self, seconds: float, request: Request) -> None:
        if request.is_sharp:
            self.resting_ladder.measured(seconds, request.step)
        # However large a resting picture is, it is no small one.
        self.ladder.measured(seconds, 0 if request.is_sharp else request.step)

    def _rests(self, now: float) -> bool:
        return now - self._changed_at >= self.rest_seconds

    def _is_stale(self, now: float, view: View) -> bool:
        """Whether the last request's picture is not the one that this view should have."""
        if self._last is None or view.held != self._last_held:
            return True
        request, sent_at = self._last
        if not request.is_sharp:
            return self._rests(now)
        return view.revision != request.revision and now - sent_at >= self.refresh_seconds
