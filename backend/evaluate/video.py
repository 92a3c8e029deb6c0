# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures one after the other into a video that every player shows (H.264, 4:2:0), or into PNG files."""

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Protocol

import numpy as np

from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError, OutputError
from ..scene.pictures import write_png
from .optional import needed

CONTAINERS = (".mp4", ".mov", ".mkv")
#: x264's constant rate factor: 18 is taken for visually lossless, 0 is lossless, 51 the worst.
QUALITY = 16
#: Codes of ITU-T H.273: primaries BT.709, transfer sRGB (IEC 61966-2-1), matrix BT.709, limited range.
PRIMARIES, TRANSFER, MATRIX, LIMITED_RANGE = 1, 13, 1, 1


class FrameSink(Protocol):
    """Where frames go: ``[H, W, 3]`` uint8, all of one size."""

    def __call__(self, frame: np.ndarray) -> None: ...


@contextmanager
def video_writer(path: Path, fps: int) -> Iterator[FrameSink]:
    """A sink that encodes frames into ``path``, which is there once the block has ended without an error.

    Pixels are sRGB codes and are tagged so; an odd last row or column is repeated once, for 4:2:0 has none.
    Raises ``PackageMissingError`` without PyAV, ``BadValueError`` for another container or frames of another
    size, ``OutputError`` where it cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in CONTAINERS:
        raise BadValueError(f"a video must end in {', '.join(CONTAINERS)}, got {path.name}")
    av = needed("av", "av", "video", "writing a video")
    with atomic_path(path) as temporary:
        try:
            with av.open(str(temporary), "w", options={"movflags": "faststart"}) as container:
                encoder = _Encoder(av, container, fps)
                yield encoder
                encoder.finish()
        except av.FFmpegError as error:
            raise OutputError(
                f"cannot encode {path}: {error}", "Check the disk's space, or write --frames instead."
            ) from error


class _Encoder:
    """The stream, made when the first frame tells its size."""

    def __init__(self, av, container, fps: int) -> None:
        self._av, self._container, self._fps = av, container, fps
        self._stream, self._shape, self._count = None, (0, 0), 0

    def __call__(self, frame: np.ndarray) -> None:
        if self._stream is None:
            self._shape = frame.shape[:2]
            self._stream = self._container.add_stream("libx264", rate=self._fps)
            self._stream.height, self._stream.width = (side + side % 2 for side in self._shape)
            self._stream.pix_fmt = "yuv420p"
            self._stream.options = {"crf": str(QUALITY), "preset": "medium"}
            context = self._stream.codec_context
            context.color_primaries, context.color_trc = PRIMARIES, TRANSFER
            context.colorspace, context.color_range = MATRIX, LIMITED_RANGE
            context.time_base = Fraction(1, self._fps)
        if frame.shape != (*self._shape, 3) or frame.dtype != np.uint8:
            raise BadValueError(
                f"frame {self._count} is {frame.shape} {frame.dtype}, the video [{self._shape[0]}, "
                f"{self._shape[1]}, 3] uint8"
            )
        even = np.pad(frame, ((0, self._shape[0] % 2), (0, self._shape[1] % 2), (0, 0)), mode="edge")
        picture = self._av.VideoFrame.from_ndarray(even, format="rgb24").reformat(
            format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
        )
        picture.pts, picture.time_base = self._count, Fraction(1, self._fps)
        picture.color_primaries, picture.color_trc = PRIMARIES, TRANSFER
        self._container.mux(self._stream.encode(picture))
        self._count += 1

    def finish(self) -> None:
        """Write out what the encoder still holds."""
        if self._stream is None:
            raise BadValueError("a video needs at least one frame")
        self._container.mux(self._stream.encode(None))


def frame_name(number: int) -> str:
    """``frame_0000.png`` and so on."""
    return f"frame_{number:04d}.png"


@contextmanager
def frames_writer(folder: Path) -> Iterator[FrameSink]:
    """A sink that writes ``frame_0000.png`` … into ``folder``; raises ``OutputError``.

    Frames of a longer video that was there before are removed at the end, if the block ends without an error.
    """
    count = 0

    def write(frame: np.ndarray) -> None:
        nonlocal count
        write_png(Path(folder) / frame_name(count), frame)
        count += 1

    yield write
    for path in Path(folder).glob("frame_*.png"):
        digits = path.stem.removeprefix("frame_")
        if digits.isdecimal() and int(digits) >= count and path.name == frame_name(int(digits)):
            try:
                path.unlink()
            except OSError as error:
                raise OutputError(f"cannot remove {path}: {error.strerror}", "Remove it by hand.") from error
