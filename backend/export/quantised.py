# SPDX-License-Identifier: GPL-3.0-or-later
"""A model in few bytes, for web pages: how each number is stored, and its error.

``quantised`` gives planes of bytes, which deflate packs well, and a header that says how to read them. The
page reads them in ``web/data.js``; ``restored`` does the same here, which tests compare with the model. The
most that each number is off, which tests/backend/export/test_quantised.py measures:

==============  ====================================================  ====================================
position        16 bits an axis of its chunk's box                    half of 1/65535 of the box
scale           8 bits of its logarithm in its chunk's range          half a step: its factor is in the chunk
rotation        the three smallest components, 10 bits each           0.0007 each
opacity         8 bits                                                1/510; confidence, too
mean radiance   16 bits: steps of 0.01 of the SH coefficient          0.14 % of the radiance
other SH, gain  8 bits: steps of 0.03, or more where values need it   half a step
share of light  8 bits of the angle whose sine squared it is          0.0031
==============  ====================================================  ====================================
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ...bridge.errors import BadValueError
from ...bridge.model_file import Model
from ...bridge.splatting import ALPHA_MIN
from ..model.morton import morton_order

#: Gaussians that are neighbours in space share the range of their positions and scales.
CHUNK = 256
#: A Gaussian is a runaway that is more than so many times as far out as this percentage of all are.
RUNAWAY, NEAR_PERCENT = 10.0, 99.9
#: Steps of the SH coefficient of degree 0, in 16 bits: 655 in all, and ln radiance reaches ±74 / 0.28.
BASE_STEP = 0.01
#: The least step of all other coefficients: 127 of them reach ±3.8. A chunk that needs more has a step that
#: is 2^(code / 4) times as large. 0.03 is one percent of radiance, root mean square over directions.
REST_STEP = 0.03
STEP_CODES = 4
#: The thinnest axis that is kept, of the Gaussian's own longest one: what is thinner looks the same.
THINNEST = 1e-3
#: Lengths below this are one: a Gaussian of no size at all has no logarithm.
SMALLEST = 1e-9
#: Of a chunk whose values are all one: no denormal number, which processors take for 0.
LEAST_EXTENT = np.float32(1e-30)
ROTATION_BITS = 10
_ROTATION_SCALE = ((1 << ROTATION_BITS) - 1) * math.sqrt(0.5)
#: Lights, or baked levels, that a page can draw: layers of a texture, and numbers that a shader is given.
MOST_LIGHTS = 64


@dataclass(frozen=True)
class Quantised:
    """``planes``: named arrays of bytes, in the order in which they stand in the file.

    ``header``: what a reader must know beside them; plain JSON. ``omitted``: Gaussians that are never
    rendered and so are missing. Its ``count`` is that of places, a few of which may be fillers of opacity 0.
    """

    header: dict[str, Any]
    planes: dict[str, np.ndarray]
    omitted: int

    def raw(self) -> bytes:
        """All planes, one after the other."""
        return b"".join(plane.tobytes() for plane in self.planes.values())


def quantised(model: Model) -> Quantised:
    """The model in bytes, in Morton order; runaways last, in chunks of their own.

    Raises ``BadValueError`` where no Gaussian could be seen, or where there are too many lights.
    """
    if len(model.lights) > MOST_LIGHTS or len(model.levels) > MOST_LIGHTS:
        raise BadValueError(
            f"a web page can render {MOST_LIGHTS} lights, this model has {len(model.lights)}",
            "Train with fewer lights: leave some out of the data set's lit_lights.",
        )
    seen = np.flatnonzero(model.opacity >= ALPHA_MIN)
    if not len(seen):
        raise BadValueError("no Gaussian of the model is opaque enough to be seen", "Train longer.")
    places, is_drawn = _in_order(model.position[seen])
    order = seen[places]
    chunks = -(-len(order) // CHUNK)

    position, bounds = _in_boxes(model.position[order], chunks, 65535)
    largest = model.scale[order].max(axis=1, keepdims=True)
    log_scale = np.log(np.maximum(np.maximum(model.scale[order], THINNEST * largest), SMALLEST))
    scale, log_bounds = _in_boxes(log_scale, chunks, 255)
    base = np.rint(model.log_radiance_sh[order, 0].astype(np.float64) / BASE_STEP).astype(np.int64) + (
        1 << 15
    )
    rest, steps = _in_steps(model.log_radiance_sh[order, 1:].transpose(1, 2, 0), chunks)
    planes = {
        "bounds": np.concatenate([bounds, log_bounds], axis=1).astype("<f4").view(np.uint8),
        "position": _two_bytes(position.T),
        "scale": scale.T.astype(np.uint8),
        "rotation": _rotations(model.rotation[order]),
        "opacity": np.rint(255.0 * model.opacity[order] * is_drawn).astype(np.uint8),
        "base": _two_bytes(base.T),
        "rest_steps": steps,
        "rest": rest.view(np.uint8),
    }
    if model.light_share is not None:
        share = model.light_share[order].transpose(1, 2, 0)
        planes["share"] = np.rint(np.arcsin(np.sqrt(share.clip(0.0, 1.0))) * (510.0 / np.pi)).astype(np.uint8)
    else:
        assert model.level_log_gain is not None  # checked when the model was made
        gain, gain_steps = _in_steps(model.level_log_gain[:, order].transpose(0, 2, 1), chunks)
        planes |= {"gain_steps": gain_steps, "gain": gain.view(np.uint8)}
    if model.confidence is not None:
        planes["confidence"] = np.rint(255.0 * model.confidence[order]).astype(np.uint8)
    header = {
        "count": len(order),
        "chunk": CHUNK,
        "degree": model.sh_degree,
        "lights": list(model.lights),
        "levels": list(model.levels),
        "standard": list(model.standard_levels),
        "base_step": BASE_STEP,
        "rest_step": REST_STEP,
        "step_codes": STEP_CODES,
        "planes": [[name, plane.size] for name, plane in planes.items()],
    }
    return Quantised(header, planes, model.count - len(seen))


def restored(packed: Quantised) -> Model:
    """The model that a page draws, as ``web/data.js`` reads it: Gaussians in the order of the planes."""
    header, planes = packed.header, packed.planes
    count, chunks = header["count"], -(-header["count"] // CHUNK)
    bounds = planes["bounds"].reshape(-1).view("<f4").reshape(chunks, 4, 3)[np.arange(count) // CHUNK]
    position = bounds[:, 0] + _of_two(planes["position"]).T * (bounds[:, 1] / np.float32(65535.0))
    scale = np.exp(bounds[:, 2] + planes["scale"].reshape(3, count).T * (bounds[:, 3] / np.float32(255.0)))
    base = (_of_two(planes["base"]).T.astype(np.float64) - (1 << 15)) * BASE_STEP
    rest = _of_steps(planes["rest"], planes["rest_steps"], count)
    sh = np.concatenate([base[:, None], rest.transpose(2, 0, 1)], axis=1)
    share = gain = None
    if "share" in planes:
        share = np.sin(planes["share"].reshape(-1, 3, count).transpose(2, 0, 1) * (np.pi / 510.0)) ** 2
        # Rounded shares may add up to more than 1; the page's shader leaves no negative rest either.
        share = (share / np.maximum(share.sum(axis=1, keepdims=True), 1.0)).astype(np.float32)
    else:
        gain = _of_steps(planes["gain"], planes["gain_steps"], count).transpose(0, 2, 1)
    return Model(
        position=position.astype(np.float32),
        rotation=_of_rotations(planes["rotation"].reshape(4, count)),
        scale=scale.astype(np.float32),
        opacity=planes["opacity"].astype(np.float32) / np.float32(255.0),
        log_radiance_sh=sh.astype(np.float32),
        light_share=share,
        lights=tuple(header["lights"]),
        level_log_gain=None if gain is None else np.ascontiguousarray(gain, np.float32),
        levels=tuple(header["levels"]),
        confidence=planes["confidence"] / np.float32(255.0) if "confidence" in planes else None,
    )


def _in_order(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``[M]``: the Gaussian of ``[N, 3]`` that stands at each place, and whether it is drawn there.

    One that is far beyond all others would widen its chunk's box until its neighbours are displaced. So these
    stand last, and what the chunk before them lacks is filled by a Gaussian that is not drawn.
    """
    distance = np.abs(position - np.median(position, axis=0)).max(axis=1)
    far = distance > RUNAWAY * np.percentile(distance, NEAR_PERCENT, method="lower")
    near, runaways = np.flatnonzero(~far), np.flatnonzero(far)
    order = near[morton_order(torch.from_numpy(position[near])).numpy()]
    runaways = runaways[np.argsort(distance[runaways], kind="stable")]
    lacking = -len(order) % CHUNK if len(runaways) else 0
    is_drawn = np.ones(len(position) + lacking, bool)
    is_drawn[len(order) : len(order) + lacking] = False
    return np.concatenate([order, np.repeat(order[-1:], lacking), runaways]), is_drawn


def _padded(values: np.ndarray, chunks: int) -> np.ndarray:
    """``[chunks, CHUNK, …]`` of ``[N, …]``: the last chunk is filled by its last row: no range changes."""
    missing = chunks * CHUNK - len(values)
    return np.concatenate([values, np.repeat(values[-1:], missing, axis=0)]).reshape(
        chunks, CHUNK, *values.shape[1:]
    )


def _in_boxes(values: np.ndarray, chunks: int, most: int) -> tuple[np.ndarray, np.ndarray]:
    """``[N, 3]`` numbers up to ``most``, and ``[chunks, 2, 3]`` float32: each chunk's least and extent."""
    boxes = _padded(values.astype(np.float64), chunks)
    low = boxes.min(axis=1).astype(np.float32)
    extent = np.nextafter((boxes.max(axis=1) - low).astype(np.float32), np.float32(np.inf)).clip(LEAST_EXTENT)
    codes = (boxes - low[:, None]) / extent[:, None].astype(np.float64) * most
    codes = np.rint(codes).clip(0, most).astype(np.int64).reshape(-1, 3)[: len(values)]
    return codes, np.stack([low, extent], axis=1)


def _in_steps(values: np.ndarray, chunks: int) -> tuple[np.ndarray, np.ndarray]:
    """Of ``[K, 3, N]`` the signed bytes ``[K, 3, N]``, and the code of each step ``[K, chunks]``."""
    layers, _, count = values.shape
    if not layers:
        return np.zeros((0, 3, count), np.int8), np.zeros((0, chunks), np.uint8)
    reach = _padded(np.abs(values).max(axis=1).T, chunks).max(axis=1).T.astype(np.float64)  # [K, chunks]
    codes = np.ceil(STEP_CODES * np.log2(np.maximum(reach / (127.0 * REST_STEP), 1.0)) - 1e-9)
    steps = REST_STEP * 2.0 ** (codes / STEP_CODES)
    each = np.repeat(steps, CHUNK, axis=1)[:, None, :count]
    return np.rint(values / each).clip(-127, 127).astype(np.int8), codes.astype(np.uint8)


def _of_steps(planes: np.ndarray, codes: np.ndarray, count: int) -> np.ndarray:
    """``[K, 3, N]`` values of the signed bytes and the codes of their steps."""
    chunks = -(-count // CHUNK)
    steps = REST_STEP * 2.0 ** (codes.reshape(-1, chunks).astype(np.float64) / STEP_CODES)
    return planes.view(np.int8).reshape(-1, 3, count) * np.repeat(steps, CHUNK, axis=1)[:, None, :count]


def _two_bytes(values: np.ndarray) -> np.ndarray:
    """Of ``[A, N]`` numbers below 65536 the high bytes and the low bytes ``[A, 2, N]``."""
    return np.stack([values >> 8, values & 255], axis=1).astype(np.uint8)


def _of_two(planes: np.ndarray) -> np.ndarray:
    """``[A, N]`` numbers of their ``[A, 2, N]`` bytes."""
    high, low = planes.reshape(3, 2, -1).astype(np.int64).transpose(1, 0, 2)
    return high << 8 | low


def _rotations(quaternions: np.ndarray) -> np.ndarray:
    """``[4, N]`` bytes of ``[N, 4]`` quaternions: which component is the largest, and the three others.

    The largest is made positive, which is the same rotation, so that the reader knows it by the others.
    """
    q = quaternions.astype(np.float64)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    largest = np.abs(q).argmax(axis=1)
    rows = np.arange(len(q))
    q *= np.where(q[rows, largest] < 0.0, -1.0, 1.0)[:, None]
    others = np.stack([q[rows, (largest + step) % 4] for step in (1, 2, 3)])
    half = 1 << (ROTATION_BITS - 1)
    codes = np.rint(others * _ROTATION_SCALE).astype(np.int64).clip(-half, half - 1) + half
    words = largest | codes[0] << 2 | codes[1] << 12 | codes[2] << 22
    return np.stack([words >> shift & 255 for shift in (0, 8, 16, 24)]).astype(np.uint8)


def _of_rotations(planes: np.ndarray) -> np.ndarray:
    """``[N, 4]`` float32 unit quaternions of their bytes."""
    words = sum(plane.astype(np.int64) << 8 * index for index, plane in enumerate(planes))
    mask, half = (1 << ROTATION_BITS) - 1, 1 << (ROTATION_BITS - 1)
    others = np.stack([((words >> shift & mask) - half) / _ROTATION_SCALE for shift in (2, 12, 22)])
    largest, rows = words & 3, np.arange(planes.shape[1])
    q = np.empty((planes.shape[1], 4))
    q[rows, largest] = np.sqrt(np.maximum(1.0 - np.square(others).sum(axis=0), 0.0))
    for step in (1, 2, 3):
        q[rows, (largest + step) % 4] = others[step - 1]
    return q.astype(np.float32)
