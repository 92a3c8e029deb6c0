# SPDX-License-Identifier: GPL-3.0-or-later
"""Messages as they come off the wire: text frames and previews."""

import dataclasses
import json
import types
import typing
from pathlib import Path
from typing import Any, Literal

import numpy as np

from physhdr.bridge.messages import (
    PREVIEW_SIDE_MAX,
    REPLIES,
    REQUESTS,
    Envelope,
    Failure,
    PreviewCamera,
    PreviewFrame,
    PreviewHeader,
    PreviewRequest,
    decode,
    decode_frame,
    encode,
    encode_frame,
)

from .cases import InsaneError, Target

CAMERA = PreviewCamera(
    pose=tuple(np.eye(4).ravel().tolist()), width=3, height=2, fx=3.0, fy=3.0, cx=1.5, cy=1.0
)


def sample(hint: Any) -> Any:
    """A value of a field's type."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        return arguments[-1]
    if origin in (types.UnionType, typing.Union):
        return sample(arguments[0])
    if origin is tuple:
        return (sample(arguments[0]), sample(arguments[0]))
    if origin is dict:
        return {"PSNR": sample(arguments[1])}
    if hint is PreviewCamera:
        return CAMERA
    if dataclasses.is_dataclass(hint):
        hints = typing.get_type_hints(hint)
        return typing.cast(Any, hint)(**{name: sample(kind) for name, kind in hints.items()})
    return {int: 7, float: 0.5, str: "küche", bool: True}[hint]


def write_texts(folder: Path) -> None:
    """One frame of every message."""
    (folder / "texts").mkdir(parents=True)
    for kind, known in (
        ("request", REQUESTS),
        ("reply", REPLIES),
        ("event", {"job_status": REPLIES["job_status"]}),
    ):
        for name, cls in known.items():
            envelope = Envelope(typing.cast(Any, kind), 0 if kind == "event" else 7, sample(cls))
            (folder / "texts" / f"{kind}-{name}.json").write_bytes(encode(envelope).encode())
    failure = Failure(code="busy", message="it is busy", hint="Wait.")
    (folder / "texts" / "error.json").write_bytes(encode(Envelope("error", 7, failure)).encode())


def read_text(_: Path, __: str, content: bytes) -> None:
    """What is accepted says the same when it is sent again."""
    envelope = decode(content.decode("utf-8", "replace"))
    again = decode(encode(envelope))
    if again != envelope:
        raise InsaneError(f"a message says something else when it is sent again: {envelope}")


def write_frames(folder: Path) -> None:
    (folder / "frames").mkdir(parents=True)
    rng = np.random.default_rng(0)
    for name, levels in (("one", (0.5,)), ("two", (0.5, 2.0))):
        request = PreviewRequest(sequence=3, camera=CAMERA, lighting_levels=levels)
        frame = PreviewFrame(
            PreviewHeader(request=request, iteration=100, milliseconds=12.5),
            rng.uniform(size=(2, 3, 4)).astype("<f2"),
            rng.uniform(size=(2, 3)).astype("<f4"),
        )
        (folder / "frames" / f"{name}.frame").write_bytes(b"".join(encode_frame(frame)))


def read_frame(_: Path, __: str, content: bytes) -> None:
    frame = decode_frame(content)
    camera = frame.header.request.camera
    if not (0 < camera.width <= PREVIEW_SIDE_MAX and 0 < camera.height <= PREVIEW_SIDE_MAX):
        raise InsaneError("a preview's size that no request may have")
    if frame.depth.shape != (camera.height, camera.width) or frame.rgba.shape != (*frame.depth.shape, 4):
        raise InsaneError("a preview's arrays are of another size")
    header = content[4 : 4 + int.from_bytes(content[:4], "little")]
    again = decode_frame(b"".join(encode_frame(frame)))
    if again.header != frame.header or again.rgba.tobytes() != frame.rgba.tobytes() or not json.loads(header):
        raise InsaneError("a preview says something else when it is sent again")


TARGETS = (
    Target("messages: text frames", write_texts, read_text, 80_000, in_memory=True, names_place=False),
    Target("messages: previews", write_frames, read_frame, 40_000, in_memory=True, names_place=False),
)
