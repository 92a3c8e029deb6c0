# SPDX-License-Identifier: GPL-3.0-or-later
"""What a lossless PLY says of its ``phys_…`` columns: how they make radiance, lights, exposures, response.

It is said twice. As comment lines: ``phys_form COMPOSER MODULATOR``, ``phys_lights NAMES`` (a JSON list, only
where there are others than the ambient light), ``phys_exposures SECONDS`` (a JSON list: those of the training
pictures), ``phys_curve NAME SHAPE PART BASE64`` (the sampled response) and ``phys_network …`` of the same
form (the networks, which need torch). And, because programs that rewrite a PLY keep its columns and drop its
comments, as columns whose *names* say it:

- ``phys_form__COMPOSER__MODULATOR``, ``phys_lights__NAME__NAME…`` and ``phys_exposures__SECONDS__SECONDS…``
  hold zeros. A word's letters and digits stand for themselves, every other byte of its UTF-8 is ``_`` and two
  hexadecimal digits.
- ``phys_curve__M__x``, ``__r``, ``__g``, ``__b``: every Gaussian carries one of the response's M samples, ln
  exposure and the three channels. Sorted by x they are it, whatever order the Gaussians are in; as long as
  each sample has one Gaussian left, none is lost.

The networks have no columns.
"""

import base64
import contextlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

#: What the comment lines begin with, and with ``__`` the columns.
FORM, LIGHTS, EXPOSURES = "phys_form", "phys_lights", "phys_exposures"
CURVE, NETWORK = "phys_curve", "phys_network"
#: Tensors of the response, as ``Model`` and the comment lines call them.
CURVE_TENSORS = ("tone_curve_log_exposure", "tone_curve")
#: Tensors are stored as base64 in comment lines of at most this many characters.
COMMENT_WIDTH = 400
#: Between the words of a column's name; an encoded word never has it.
SEPARATOR = "__"
#: Columns of the response: ln exposure, and its value in each channel.
CURVE_PARTS = ("x", "r", "g", "b")


def form_columns(comments: Sequence[str], count: int) -> dict[str, np.ndarray]:
    """The columns ``[count]`` that say what the comment lines say."""
    columns: dict[str, np.ndarray] = {}
    zeros = np.zeros(count, np.float32)
    form, lights = form_of(comments, ()), lights_of(comments, ())
    if form is not None:
        columns[name_of(FORM, form)] = zeros
    if isinstance(lights, list) and all(isinstance(name, str) and name for name in lights):
        columns[name_of(LIGHTS, lights)] = zeros
    exposures = exposures_of(comments, ())
    if isinstance(exposures, list) and exposures:
        columns[name_of(EXPOSURES, map(str, exposures))] = zeros
    curve = curve_of(comments, {})
    if curve and curve[CURVE_TENSORS[1]].shape == (len(curve[CURVE_TENSORS[0]]), 3):
        samples = np.column_stack([curve[name] for name in CURVE_TENSORS])
        which = np.arange(count) % len(samples)
        for part, sample in zip(CURVE_PARTS, samples.T, strict=True):
            columns[name_of(CURVE, (str(len(samples)), part))] = sample[which]
    return columns


def form_of(comments: Sequence[str], columns: Iterable[str]) -> tuple[str, str] | None:
    """Composer and modulator, by the comment lines or else a column's name; ``None`` where none says it."""
    for line in comments:
        words = line.split()
        if len(words) == 3 and words[0] == FORM:
            return words[1], words[2]
    words = words_of(FORM, columns)
    return (words[0], words[1]) if words is not None and len(words) == 2 else None


def lights_of(comments: Sequence[str], columns: Iterable[str]) -> object:
    """What stands for the names of the lights, to be checked: by the comment lines, or else a column's name.

    ``None`` where nothing says it, the text itself where the line is no JSON.
    """
    return _listed(LIGHTS, comments, columns)


def exposures_of(comments: Sequence[str], columns: Iterable[str]) -> object:
    """What stands for the exposures, in seconds, as ``lights_of``: numbers, or their digits as text."""
    return _listed(EXPOSURES, comments, columns)


def _listed(kind: str, comments: Sequence[str], columns: Iterable[str]) -> object:
    for line in comments:
        if line.startswith(kind + " "):
            text = line.removeprefix(kind + " ")
            try:
                return json.loads(text)
            except (ValueError, RecursionError):
                return text
    return words_of(kind, columns)


def curve_of(comments: Sequence[str], columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The sampled response by ``Model``'s names, from the comment lines or else the columns.

    Empty where there is none, and where it is not whole: a sample's Gaussians are all gone, or something has
    mixed Gaussians.
    """
    curve = tensors_from_comments(CURVE, comments)
    if set(curve) == set(CURVE_TENSORS):
        return curve
    parts = [words_of(CURVE, columns, part) for part in CURVE_PARTS]
    lengths = {words[0] for words in parts if words is not None and len(words) == 2}
    if None in parts or len(lengths) != 1 or not (length := lengths.pop()).isdecimal():
        return {}
    x, *rgb = (columns[name_of(CURVE, (length, part))] for part in CURVE_PARTS)
    samples, first, which = np.unique(x, return_index=True, return_inverse=True)
    values = np.column_stack(rgb)
    same = np.array_equal(values[first][which], values) and bool(np.isfinite(values).all())
    if str(len(samples)) != length or not np.isfinite(samples).all() or not same:
        return {}
    return dict(zip(CURVE_TENSORS, (samples, values[first]), strict=True))


def says_curve(columns: Iterable[str]) -> bool:
    """Whether a column's name says that there was a response."""
    return words_of(CURVE, columns) is not None


def name_of(kind: str, words: Iterable[str]) -> str:
    """A column's name that says ``words``, in ASCII letters, digits and underscores."""
    return SEPARATOR.join([kind, *map(_encoded, words)])


def words_of(kind: str, columns: Iterable[str], last: str = "") -> list[str] | None:
    """What the first column of ``kind`` says (whose last word is ``last``); ``None`` where there is none, or
    its words are no text."""
    for name in columns:
        if name.startswith(kind + SEPARATOR):
            words = name.removeprefix(kind + SEPARATOR).split(SEPARATOR)
            if not last or words[-1] == last:
                with contextlib.suppress(UnicodeDecodeError):
                    return [_decoded(word) for word in words]
    return None


def tensor_comments(kind: str, tensors: Mapping[str, np.ndarray]) -> list[str]:
    """Tensors as comment lines: ``KIND NAME SHAPE PART BASE64`` (float32, little endian)."""
    lines = []
    for name, tensor in tensors.items():
        text = base64.b64encode(np.ascontiguousarray(tensor, "<f4").tobytes()).decode()
        shape = json.dumps(list(tensor.shape), separators=(",", ":"))
        for part, start in enumerate(range(0, max(len(text), 1), COMMENT_WIDTH)):
            lines.append(f"{kind} {name} {shape} {part} {text[start : start + COMMENT_WIDTH]}")
    return lines


def tensors_from_comments(kind: str, comments: Sequence[str]) -> dict[str, np.ndarray]:
    """The tensors that ``tensor_comments`` wrote, by their names; those that cannot be read are left out."""
    texts: dict[str, list[str]] = {}
    shapes: dict[str, str] = {}
    for line in comments:
        words = line.split(" ")
        if len(words) == 5 and words[0] == kind:
            texts.setdefault(words[1], []).append(words[4])
            shapes[words[1]] = words[2]
    tensors = {}
    for name, parts in texts.items():
        try:
            values = np.frombuffer(base64.b64decode("".join(parts), validate=True), "<f4")
            tensors[name] = values.reshape(json.loads(shapes[name])).copy()
        except (ValueError, TypeError, RecursionError, OverflowError):
            continue
    return tensors


def _encoded(word: str) -> str:
    return "".join(
        chr(byte) if chr(byte).isascii() and chr(byte).isalnum() else f"_{byte:02x}" for byte in word.encode()
    )


def _decoded(word: str) -> str:
    raw = re.sub(rb"_([0-9a-f]{2})", lambda match: bytes.fromhex(match[1].decode()), word.encode())
    return raw.decode()
