# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender and the backend say to each other: typed messages, their JSON and binary frames.

docs/protocol.md describes the conversation. A text frame is one JSON object, an envelope:

* ``{"kind": "request", "id": 7, "type": "train_start", "body": {…}}`` from Blender, answered by
* ``{"kind": "reply", "id": 7, "type": "done", "body": {…}}`` or
* ``{"kind": "error", "id": 7, "code": "busy", "message": "…", "hint": "…"}``; and unasked
* ``{"kind": "event", "type": "job_status", "body": {…}}``, of which only the latest counts.

A binary frame carries a picture: the length of a JSON header (4 bytes, little endian), the header, and the
raw arrays, each at the offset that follows from their order. Nothing is ever unpickled or executed.
"""

import dataclasses
import functools
import json
import math
import re
import types
import typing
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

import numpy as np

from .errors import PhysHDRError
from .regular import unique_names

#: Both sides must speak the same version; it changes whenever a message does.
PROTOCOL_VERSION = 1
#: Text frames larger than this are refused: requests are small.
TEXT_BYTES_MAX = 1 << 20
#: Pixels of a preview along a side, and in all. A view may have more: it is asked for on fewer.
PREVIEW_SIDE_MAX = 4096
PREVIEW_PIXELS_MAX = 4096 * 2160
#: Four halves and the depth, a float.
PREVIEW_PIXEL_BYTES = 12
#: The largest picture, and its header.
BINARY_BYTES_MAX = PREVIEW_PIXELS_MAX * PREVIEW_PIXEL_BYTES + (1 << 16)
#: Seconds between heartbeats, and how long one may stay unanswered: a dead peer is noticed within 5 s.
HEARTBEAT_SECONDS = 1.0
HEARTBEAT_TIMEOUT_SECONDS = 3.0


class ProtocolError(PhysHDRError):
    """A frame is not what the protocol says: malformed, too large, an unknown type or a wrong field."""


# ---- requests ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Hello:
    """The first request of every connection. ``client`` names the peer in messages to people."""

    protocol: int
    client: str
    version: str = ""


@dataclass(frozen=True, kw_only=True)
class TrainStart:
    """Train on the data set in folder ``data``, writing to the run's folder ``out``; absolute paths.

    ``iterations``: ``None`` for as many as the preset has for data of this size. ``overwrite``: replace a
    run that is in ``out``. ``threads``: 0 for as many as the backend was started with. Answered by
    ``Done`` when it is taken on; what goes wrong afterwards (damaged data, say) is a ``JobStatus`` with
    the state ``failed``.
    """

    data: str
    out: str
    preset: str = "default"
    iterations: int | None = None
    exposure_mode: Literal["exp1", "exp3"] = "exp3"
    device: Literal["auto", "cpu", "cuda"] = "auto"
    threads: int = 0
    seed: int = 0
    overwrite: bool = False


@dataclass(frozen=True, kw_only=True)
class TrainResume:
    """Go on with the run in folder ``run`` from its checkpoint; answered as ``TrainStart`` is.

    ``data``: the data set, where it has moved since.
    """

    run: str
    device: Literal["auto", "cpu", "cuda"] = "auto"
    threads: int = 0
    data: str = ""


@dataclass(frozen=True, kw_only=True)
class TrainPause:
    """Halt after the present iteration, or the first one of a training being prepared; previews continue."""


@dataclass(frozen=True, kw_only=True)
class TrainContinue:
    """Go on after a pause."""


@dataclass(frozen=True, kw_only=True)
class TrainStop:
    """Save a checkpoint and end the training; the model stays open for previews.

    Answered by ``Done`` at once; it is saved when ``JobStatus`` says ``stopped``.
    """


@dataclass(frozen=True, kw_only=True)
class RunOpen:
    """Open a trained run for previews and export, with no training; ``Done`` when it is open.

    Where it cannot be opened, what was open before stays. ``data``: the data set, where it has moved; without
    it a run whose data set is not there opens by what it keeps of that.
    """

    run: str
    device: Literal["auto", "cpu", "cuda"] = "auto"
    data: str = ""


@dataclass(frozen=True, kw_only=True)
class ModelExport:
    """Write the open model as it is now to the model file ``path``, for import; answered by ``Exported``.

    ``path`` ends in ``.safetensors`` and lies in a folder that is there. What is at ``path`` already is
    replaced only if it is a model file. Writing is for the connection in control, as all that steers.
    """

    path: str


@dataclass(frozen=True, kw_only=True)
class PreviewCamera:
    """A pinhole camera: ``pose`` camera-to-world, 16 numbers row by row, Blender's axes; the rest pixels.

    The rotation may be out of true by a hundredth and is then corrected. The centre of the top left pixel is
    at (0.5, 0.5); (``cx``, ``cy``) is where the axis meets the picture, so that a lens shift offsets it.
    """

    pose: tuple[float, ...]
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True, kw_only=True)
class PreviewRequest:
    """Render the open model; answered by a binary frame with ``sequence``, or by an error.

    A newer request replaces one that is not begun, which is then answered by the error ``superseded``.
    ``tone``: scene-linear radiance times 2^``exposure_ev``, or (``learned``) the picture that the camera
    would have taken with 2^``exposure_ev`` seconds, decoded from sRGB to scene-linear so that Blender's
    *Standard* view shows its very codes. Where Gaussians cover a pixel only by a share alpha, the rest of it
    has the camera's black taken off: an uncovered pixel is 0, a covered one is the camera's own.
    ``lighting_levels`` ≥ 0: one for each of the model's lights in the order of ``JobStatus.lights``; those at
    the end that are not given are at 1, and more than there are is an error. |``exposure_ev``| ≤ 30.
    """

    sequence: int
    camera: PreviewCamera
    lighting_levels: tuple[float, ...] = ()
    exposure_ev: float = 0.0
    tone: Literal["linear", "learned"] = "linear"


@dataclass(frozen=True, kw_only=True)
class HistoryGet:
    """The curves of the present job; answered by ``History``."""


@dataclass(frozen=True, kw_only=True)
class StatusGet:
    """Answered by ``JobStatus``."""


@dataclass(frozen=True, kw_only=True)
class ControlTake:
    """Steer the backend from this connection, whoever did before (an event informs them)."""


@dataclass(frozen=True, kw_only=True)
class WhenClosed:
    """What becomes of a training when the connection in control closes, by intent or by a crash.

    ``keep``: it continues, and whoever connects next may steer it (so it is until this is sent). ``stop``:
    it saves and stops, unless a connection takes control within a few seconds.
    """

    training: Literal["keep", "stop"]


@dataclass(frozen=True, kw_only=True)
class Shutdown:
    """Save, end the training if there is one, and end the backend."""


# ---- replies and events ------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Welcome:
    """The answer to ``Hello``, at once: torch may still be loading, ``JobStatus`` says so.

    ``torch``: its version as installed, empty if it is not. ``device``: where ``auto`` computes, empty until
    torch is loaded (``JobStatus.device`` then says). ``in_control``: whether this connection may steer.
    """

    protocol: int
    version: str
    pid: int
    log: str
    device: str
    torch: str
    presets: tuple[str, ...]
    in_control: bool


@dataclass(frozen=True, kw_only=True)
class Done:
    """A request was carried out, or taken on where it takes long (``JobStatus`` then tells how it goes)."""


@dataclass(frozen=True, kw_only=True)
class Exported:
    """A model file is on disk."""

    path: str
    gaussians: int
    iteration: int


@dataclass(frozen=True, kw_only=True)
class Failure:
    """An error as data: ``code`` for programs, ``message`` and ``hint`` for people."""

    code: str
    message: str
    hint: str = ""


JobState = Literal[
    "idle", "preparing", "training", "paused", "stopping", "stopped", "finished", "failed", "open"
]


@dataclass(frozen=True, kw_only=True)
class JobStatus:
    """All there is to know of the present job, in one event: a newer one replaces an older one.

    ``state``: ``preparing`` reads data and compiles kernels (``message`` says what; with an empty ``run``
    the backend itself is starting); ``stopped`` can be resumed; ``open`` is a run opened without
    training. ``device``: ``cpu``, or ``cuda (name of the card)``: of the job, and before there is one,
    where ``auto`` computes. ``iterations``: found from the data where nobody has set it, and known for
    sure while it trains. ``seconds_left``: by what later iterations cost, where that was timed before the
    training (then from its beginning on), else by how fast iterations go just now. ``losses``: weighted
    terms; ``monitor``: measured on a fixed held-out view, ``PSNR``. ``saved_iteration``: of the newest
    checkpoint, 0 if there is none. ``can_relight`` and ``has_model``: what previews may ask for.
    ``lights``: names of the lights that the model has levels for, empty where there is no model, and
    ``standard_levels`` of each, at which its photographs were taken.
    ``photographed_ev``: the EV at which previews of photographs look as these do (0: of renders).
    ``controller``: the name of the client that steers.
    """

    state: JobState = "idle"
    run: str = ""
    data: str = ""
    preset: str = ""
    device: str = ""
    message: str = ""
    iteration: int = 0
    iterations: int = 0
    gaussians: int = 0
    iterations_per_second: float = 0.0
    seconds_left: float = 0.0
    losses: dict[str, float] = field(default_factory=dict)
    monitor: dict[str, float] = field(default_factory=dict)
    saved_iteration: int = 0
    has_model: bool = False
    can_relight: bool = False
    lights: tuple[str, ...] = ()
    standard_levels: tuple[float, ...] = ()
    photographed_ev: float = 0.0
    failure: Failure | None = None
    controller: str = ""
    in_control: bool = False


@dataclass(frozen=True, kw_only=True)
class History:
    """Curves of the present job: at each of ``iterations`` the total loss; PSNR (dB) where measured.

    Thinned out where they would be long; a resumed or opened run has them from its beginning.
    """

    iterations: tuple[int, ...] = ()
    losses: tuple[float, ...] = ()
    psnr_iterations: tuple[int, ...] = ()
    psnr: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class PreviewHeader:
    """What a preview frame says of itself: what was asked, and at which iteration it was rendered.

    ``milliseconds``: how long the rendering took, without the wait and the way.
    """

    request: PreviewRequest
    iteration: int
    milliseconds: float


Request = (
    Hello
    | TrainStart
    | TrainResume
    | TrainPause
    | TrainContinue
    | TrainStop
    | RunOpen
    | ModelExport
    | PreviewRequest
    | HistoryGet
    | StatusGet
    | ControlTake
    | WhenClosed
    | Shutdown
)
Reply = Welcome | Done | Exported | History | JobStatus
#: Requests that change something, in the backend or on the disk: for the connection in control alone.
STEERING: tuple[type, ...] = (
    TrainStart,
    TrainResume,
    TrainPause,
    TrainContinue,
    TrainStop,
    RunOpen,
    ModelExport,
    WhenClosed,
    Shutdown,
)


def type_name(cls: type) -> str:
    """``TrainStart`` → ``train_start``: what the envelope's ``type`` says."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()


REQUESTS: dict[str, type] = {type_name(cls): cls for cls in typing.get_args(Request)}
REPLIES: dict[str, type] = {type_name(cls): cls for cls in typing.get_args(Reply)}


# ---- text frames -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Envelope:
    """One text frame. ``id`` is 0 for events; ``message`` is a ``Failure`` where ``kind`` is ``error``."""

    kind: Literal["request", "reply", "error", "event"]
    id: int
    message: Any


def encode(envelope: Envelope) -> str:
    """The text frame of an envelope."""
    body = dataclasses.asdict(envelope.message)
    if envelope.kind == "error":
        return json.dumps({"kind": "error", "id": envelope.id, **body})
    content = {"kind": envelope.kind, "id": envelope.id, "type": type_name(type(envelope.message))}
    return json.dumps({**content, "body": body}, allow_nan=False)


def decode(text: str | bytes) -> Envelope:
    """The envelope in a text frame, every field checked; raises ``ProtocolError``."""
    content = _json_object(text)
    kind, number = content.get("kind"), content.get("id", 0)
    if type(number) is not int or number < 0:
        raise ProtocolError(f"the frame's id is {number!r:.80}, not a whole number")
    if kind == "error":
        return Envelope("error", number, _build(Failure, {k: content.get(k) for k in _fields(Failure)}))
    if kind not in ("request", "reply", "event"):
        raise ProtocolError(f"the frame's kind is {kind!r:.80}; it must be request, reply, error or event")
    known = REQUESTS if kind == "request" else REPLIES
    name = content.get("type")
    if not isinstance(name, str) or name not in known:
        raise ProtocolError(f"there is no {kind} of type {name!r:.80}", "One side may be of another version.")
    return Envelope(kind, number, _build(known[name], content.get("body", {})))


# ---- binary frames -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PreviewFrame:
    """A rendered preview, top row first.

    ``rgba``: ``[H, W, 4]`` float16, scene-linear, premultiplied by alpha. ``depth``: ``[H, W]`` float32,
    distance along the camera's axis in metres, 0 where nothing is.
    """

    header: PreviewHeader
    rgba: np.ndarray
    depth: np.ndarray


def encode_frame(frame: PreviewFrame) -> list[bytes | memoryview]:
    """The parts of a binary frame, to be sent as one message."""
    header = json.dumps(dataclasses.asdict(frame.header), allow_nan=False).encode()
    rgba = np.ascontiguousarray(frame.rgba, "<f2")
    depth = np.ascontiguousarray(frame.depth, "<f4")
    return [len(header).to_bytes(4, "little") + header, depth.data.cast("B"), rgba.data.cast("B")]


def decode_frame(data: bytes) -> PreviewFrame:
    """The preview in a binary frame; its arrays are views of ``data``. Raises ``ProtocolError``."""
    if len(data) < 4:
        raise ProtocolError(f"a picture's frame has only {len(data)} bytes")
    start = 4 + int.from_bytes(data[:4], "little")
    if start > len(data):
        raise ProtocolError("a picture's frame ends inside its header")
    header = _build(PreviewHeader, _json_object(data[4:start]))
    width, height = header.request.camera.width, header.request.camera.height
    if not (0 < width <= PREVIEW_SIDE_MAX and 0 < height <= PREVIEW_SIDE_MAX):
        raise ProtocolError(f"a picture's sides are {(width, height)!r:.80}, not 1 to {PREVIEW_SIDE_MAX}")
    pixels = width * height
    if len(data) - start != pixels * PREVIEW_PIXEL_BYTES:
        raise ProtocolError(f"a picture of {width}×{height} cannot be {len(data) - start} bytes")
    depth = np.frombuffer(data[start : start + 4 * pixels], "<f4").reshape(height, width)
    rgba = np.frombuffer(data[start + 4 * pixels :], "<f2").reshape(height, width, 4)
    return PreviewFrame(header, rgba, depth)


# ---- checking ----------------------------------------------------------------------------------------------

Message = TypeVar("Message")


def _json_object(text: str | bytes) -> dict[str, Any]:
    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is not a number")

    try:
        content = json.loads(text, parse_constant=refuse, object_pairs_hook=unique_names)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"a frame is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise ProtocolError(f"a frame holds a {type(content).__name__}, not an object")
    return content


@functools.cache
def _fields(cls: Any) -> dict[str, Any]:
    return typing.get_type_hints(cls)


def _build(cls: type[Message], body: Any) -> Message:
    """``cls`` from JSON: no field missing, none unknown, each of its type. Raises ``ProtocolError``."""
    name = type_name(cls)
    if not isinstance(body, dict):
        raise ProtocolError(f"the body of {name} is a {type(body).__name__}, not an object")
    hints = _fields(cls)
    unknown = sorted(set(body) - set(hints))
    if unknown:
        raise ProtocolError(f"{name} has no field {unknown[0]!r:.80}", "One side may be of another version.")
    values = {key: _convert(hints[key], value, f"{name}.{key}") for key, value in body.items()}
    try:
        return cls(**values)
    except TypeError as error:  # a required field is missing
        raise ProtocolError(f"{name}: {error}") from error


def _convert(hint: Any, value: Any, where: str) -> Any:
    """``value`` as the annotation ``hint`` wants it."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        if value in arguments and type(value) is str:
            return value
    elif origin in (types.UnionType, typing.Union):  # only X | None is used
        return None if value is None else _convert(arguments[0], value, where)
    elif origin is tuple:
        if isinstance(value, list):
            return tuple(_convert(arguments[0], item, where) for item in value)
    elif origin is dict:
        if isinstance(value, dict):
            return {key: _convert(arguments[1], item, where) for key, item in value.items()}
    elif dataclasses.is_dataclass(hint):
        return _build(typing.cast(type, hint), value)
    elif hint is float:
        with suppress(OverflowError):  # a whole number of four hundred digits
            if type(value) in (int, float) and math.isfinite(value):
                return float(value)
    elif type(value) is hint:
        return value
    wanted = " or ".join(map(repr, arguments)) if origin is Literal else getattr(hint, "__name__", str(hint))
    raise ProtocolError(f"{where} is {value!r:.80}; it must be {wanted}")
