# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes frames as a video for all players (H.264, 4:2:0), an animated WebP for web pages, or PNG files."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Protocol

import numpy as np
from PIL import Image

from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError, OutputError
from ...bridge.regular import read_json_object
from ..optional import needed
from ..scene.pictures import write_png

CONTAINERS = (".mp4", ".mov", ".mkv")
#: An animated image, which needs no package but Pillow.
ANIMATION = ".webp"
#: x264's constant rate factor: 18 is considered visually lossless, 0 is lossless, 51 the worst.
QUALITY = 16
#: Codes of ITU-T H.273: primaries BT.709, transfer sRGB (IEC 61966-2-1), matrix BT.709, limited range.
PRIMARIES, TRANSFER, MATRIX, LIMITED_RANGE = 1, 13, 1, 1
#: libwebp's quality, 0 to 100, and effort, 0 to 6.
WEBP_QUALITY, WEBP_EFFORT = 80, 6
#: The format's longest side, pixels.
WEBP_SIDE = 16383
#: Maximum bytes of an animation's frames, which Pillow takes all at once.
WEBP_BYTES = 2**30
#: Stores, next to numbered frames, how many of them are ours.
FRAMES_FILE = "video.frames.json"
FRAMES_FORMAT, FRAMES_VERSION = "physhdr-video-frames", 1


class FrameSink(Protocol):
    """Takes frames ``[H, W, 3]`` uint8, all of one size."""

    def __call__(self, frame: np.ndarray) -> None: ...


def require_suffix(path: Path) -> None:
    """Raise ``BadValueError`` unless the suffix is that of a video that can be written."""
    if path.suffix.lower() not in (*CONTAINERS, ANIMATION):
        raise BadValueError(
            f"a video must end in {', '.join(CONTAINERS)} or {ANIMATION}, got {path.name}",
            f"Use .mp4 for players, {ANIMATION} for a web page, or a folder (of numbered PNG files) for "
            "other programs; .exr or .png for one picture.",
        )


@contextmanager
def video_writer(path: Path, fps: int | Fraction) -> Iterator[FrameSink]:
    """A sink that encodes frames into ``path``, which exists once the block has ended without an error.

    The suffix sets the format: one of ``CONTAINERS`` is H.264, tagged as sRGB; an odd last row or column is
    repeated once, because 4:2:0 needs even sizes. ``ANIMATION`` is a WebP that loops forever (sRGB by the
    format's definition). Raises ``BadValueError`` for another suffix, frames of another size or too many for
    a WebP, ``PackageMissingError`` without PyAV (not for a WebP), ``OutputError`` if it cannot be written.
    """
    path = Path(path)
    require_suffix(path)
    writer = _webp_writer if path.suffix.lower() == ANIMATION else _h264_writer
    with writer(path, Fraction(fps)) as sink:
        yield sink


@contextmanager
def _h264_writer(path: Path, fps: Fraction) -> Iterator[FrameSink]:
    av = needed("av", "av", "writing a video")
    with atomic_path(path) as temporary:
        try:
            with av.open(str(temporary), "w", options={"movflags": "faststart"}) as container:
                encoder = _Encoder(av, container, fps)
                yield encoder
                encoder.finish()
        except av.FFmpegError as error:
            raise OutputError(
                f"cannot encode {path}: {error}",
                "Check the disk's space, or write numbered pictures instead (--out FOLDER).",
            ) from error


@contextmanager
def _webp_writer(path: Path, fps: Fraction) -> Iterator[FrameSink]:
    with atomic_path(path) as temporary:
        frames: list[Image.Image] = []

        def hold(frame: np.ndarray) -> None:
            _require_alike(
                frame, len(frames), (frames[0].height, frames[0].width) if frames else frame.shape[:2]
            )
            if max(frame.shape[:2]) > WEBP_SIDE:
                raise BadValueError(
                    f"a WebP's sides are at most {WEBP_SIDE} pixels, got {frame.shape[1]}×{frame.shape[0]}",
                    "Choose a smaller --width, or write an .mp4.",
                )
            if (len(frames) + 1) * frame.size > WEBP_BYTES:
                raise BadValueError(
                    f"{path.name}: an animated WebP may take {WEBP_BYTES >> 30} GiB, which {len(frames)} "
                    "frames fill",
                    "Lower --seconds, --fps or --width, or write an .mp4.",
                )
            frames.append(Image.fromarray(frame))

        yield hold
        if not frames:
            raise BadValueError("a video needs at least one frame")
        # Integer milliseconds whose sum does not drift.
        ends = [round(1000 * number / fps) for number in range(len(frames) + 1)]
        frames[0].save(
            temporary,
            "WEBP",
            save_all=True,
            append_images=frames[1:],
            duration=[end - begin for begin, end in pairwise(ends)],
            loop=0,
            quality=WEBP_QUALITY,
            method=WEBP_EFFORT,
        )


def _require_alike(frame: np.ndarray, number: int, shape: tuple[int, ...]) -> None:
    if frame.shape != (*shape, 3) or frame.dtype != np.uint8:
        raise BadValueError(
            f"frame {number} is {frame.shape} {frame.dtype}, the video [{shape[0]}, {shape[1]}, 3] uint8"
        )


class _Encoder:
    """The stream, created with the size of the first frame."""

    def __init__(self, av, container, fps: Fraction) -> None:
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
            context.time_base = 1 / self._fps
        _require_alike(frame, self._count, self._shape)
        even = np.pad(frame, ((0, self._shape[0] % 2), (0, self._shape[1] % 2), (0, 0)), mode="edge")
        picture = self._av.VideoFrame.from_ndarray(even, format="rgb24").reformat(
            format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
        )
        picture.pts, picture.time_base = self._count, 1 / self._fps
        picture.color_primaries, picture.color_trc = PRIMARIES, TRANSFER
        self._container.mux(self._stream.encode(picture))
        self._count += 1

    def finish(self) -> None:
        """Flush the encoder."""
        if self._stream is None:
            raise BadValueError("a video needs at least one frame")
        self._container.mux(self._stream.encode(None))


def frame_name(number: int) -> str:
    """``frame_0000.png`` and so on."""
    return f"frame_{number:04d}.png"


@contextmanager
def frames_writer(folder: Path, count: int) -> Iterator[FrameSink]:
    """A sink that writes ``count`` frames, ``frame_0000.png`` …, into ``folder``.

    ``FRAMES_FILE`` next to them stores how many pictures of these names are a video's; others stay untouched.
    Further frames of an earlier, longer video are removed at the end, if the block ends without an error.
    Raises ``OutputError`` if another picture has a frame's name, before anything is written, or if the folder
    cannot be written; ``FileDamagedError`` if ``FRAMES_FILE`` cannot be read.
    """
    folder = Path(folder)
    ours = _own_frames(folder)
    for number in range(ours, count):
        path = folder / frame_name(number)
        if os.path.lexists(path):
            raise OutputError(
                f"{path} exists, and may not be a video's frame",
                "Choose another folder for the frames, or move that picture away.",
            )
    # Before the first frame, so that an interrupted video's frames count as ours, too.
    _store_count(folder, max(ours, count))
    done = 0

    def write(frame: np.ndarray) -> None:
        nonlocal done
        write_png(folder / frame_name(done), frame)
        done += 1

    yield write
    for path in folder.glob("frame_*.png"):
        digits = path.stem.removeprefix("frame_")
        if digits.isdecimal() and count <= int(digits) < ours and path.name == frame_name(int(digits)):
            try:
                path.unlink()
            except OSError as error:
                raise OutputError(f"cannot remove {path}: {error.strerror}", "Remove it by hand.") from error
    _store_count(folder, count)


def _own_frames(folder: Path) -> int:
    """How many of the folder's numbered pictures, from ``frame_0000.png`` on, are a video's."""
    path = folder / FRAMES_FILE
    if not path.exists():
        return 0
    remedy = "Choose another folder for the frames, or move that file away."
    content = read_json_object(path, remedy)
    count = content.get("frames")
    if content.get("format") != FRAMES_FORMAT or type(count) is not int or count < 0:
        raise OutputError(f"{path} is not a {FRAMES_FORMAT} file", remedy)
    return count


def _store_count(folder: Path, count: int) -> None:
    with atomic_path(folder / FRAMES_FILE) as temporary:
        content = {"format": FRAMES_FORMAT, "version": FRAMES_VERSION, "frames": count}
        temporary.write_text(json.dumps(content) + "\n", encoding="utf-8")
