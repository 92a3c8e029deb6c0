# SPDX-License-Identifier: GPL-3.0-or-later
"""Messages go over the wire and come back the same; what is not a message is refused with a reason."""

import dataclasses
import json
import types
import typing

import numpy as np
import pytest

from physhdr.bridge.errors import PhysHDRError
from physhdr.bridge.messages import (
    BINARY_BYTES_MAX,
    PREVIEW_SIDE_MAX,
    REPLIES,
    REQUESTS,
    STEERING,
    Done,
    Envelope,
    Failure,
    JobStatus,
    PreviewCamera,
    PreviewFrame,
    PreviewHeader,
    PreviewRequest,
    ProtocolError,
    TrainStart,
    decode,
    decode_frame,
    encode,
    encode_frame,
    type_name,
)


def example(hint, seed=1):
    """A value of an annotated type, none of it a default."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Literal:
        return arguments[-1]
    if origin in (types.UnionType, typing.Union):
        return example(arguments[0], seed)
    if origin is tuple:
        return tuple(example(arguments[0], seed + i) for i in range(3))
    if origin is dict:
        return {"größe": example(arguments[1], seed)}
    if dataclasses.is_dataclass(hint):
        hints = typing.get_type_hints(hint)
        return hint(**{name: example(each, seed + i) for i, (name, each) in enumerate(hints.items())})
    return {int: 7 * seed, float: seed / 3.0, str: f'"größe {seed}"\n', bool: True}[hint]


@pytest.mark.parametrize(
    ("kind", "cls"),
    [("request", cls) for cls in REQUESTS.values()] + [("reply", cls) for cls in REPLIES.values()],
)
def test_every_message_comes_back_the_same(kind, cls):
    message = example(cls)
    text = encode(Envelope(kind, 12, message))
    assert decode(text) == Envelope(kind, 12, message)
    assert json.loads(text)["type"] == type_name(cls)
    assert decode(text.encode()) == decode(text)


def test_defaults_may_be_left_out_and_types_have_names():
    text = '{"kind": "request", "id": 3, "type": "train_start", "body": {"data": "/d", "out": "/o"}}'
    assert decode(text).message == TrainStart(data="/d", out="/o")
    assert decode('{"kind": "reply", "id": 3, "type": "done"}') == Envelope("reply", 3, Done())
    assert set(STEERING) < set(REQUESTS.values())
    assert REQUESTS["preview_request"] is PreviewRequest and "welcome" in REPLIES


def test_errors_are_data():
    failure = Failure(code="busy", message="x", hint="y")
    text = encode(Envelope("error", 4, failure))
    assert json.loads(text) == {"kind": "error", "id": 4, "code": "busy", "message": "x", "hint": "y"}
    assert decode(text) == Envelope("error", 4, failure)
    event = Envelope("event", 0, JobStatus(state="failed", failure=failure))
    assert decode(encode(event)) == event


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not JSON"),
        ("{", "not JSON"),
        ("[" * 200_000, "not JSON"),
        ("[]", "list"),
        ("{}", "kind is None"),
        ('{"kind": "request", "id": -1, "type": "status_get", "body": {}}', "id is -1"),
        ('{"kind": "request", "id": true, "type": "status_get", "body": {}}', "id is True"),
        ('{"kind": "request", "id": 1.0, "type": "status_get", "body": {}}', "id is 1.0"),
        ('{"kind": "request", "id": 1, "type": "done", "body": {}}', "no request of type 'done'"),
        ('{"kind": "request", "id": 1, "type": ["status_get"], "body": {}}', "no request of type"),
        ('{"kind": "request", "id": 1, "type": "status_get", "body": []}', "is a list"),
        ('{"kind": "request", "id": 1, "type": "status_get", "body": {"x": 1}}', "no field 'x'"),
        ('{"kind": "request", "id": 1, "type": "run_open", "body": {}}', "run"),
        ('{"kind": "request", "id": 1, "type": "run_open", "body": {"run": null}}', "run_open.run"),
        ('{"kind": "error", "id": 1, "code": 5, "message": "", "hint": ""}', "failure.code"),
        ('{"kind": "error", "id": 1}', "failure.code"),
        ('{"kind": "request", "id": 1, "type": "stop", "type": "status_get", "body": {}}', "stands twice"),
        ('{"kind": "reply", "id": 1, "type": "history", "body": {"losses": [1, NaN]}}', "NaN"),
        ('{"kind": "reply", "id": 1, "type": "history", "body": {"losses": [1e999]}}', "history.losses"),
        ('{"kind": "reply", "id": 1, "type": "history", "body": {"losses": [true]}}', "history.losses"),
        (
            '{"kind": "reply", "id": 1, "type": "history", "body": {"losses": [1%s]}}' % ("0" * 400),
            "history.losses",
        ),
        ('{"kind": "reply", "id": 1, "type": "history", "body": {"iterations": [1.5]}}', "it must be int"),
        ('{"kind": "reply", "id": 1, "type": "history", "body": {"iterations": 1%s}}' % ("0" * 5000), "JSON"),
        ('{"kind": "event", "id": 0, "type": "job_status", "body": {"state": "asleep"}}', "'idle' or"),
        ('{"kind": "event", "id": 0, "type": "job_status", "body": {"state": ["idle"]}}', "'idle' or"),
        ('{"kind": "event", "id": 0, "type": "job_status", "body": {"failure": 3}}', "failure is a int"),
    ],
)
def test_what_is_no_message_is_refused(text, words):
    with pytest.raises(ProtocolError) as refused:
        decode(text)
    assert words in refused.value.message and refused.value.code == "protocol"


@pytest.mark.parametrize(
    "envelope",
    [
        {"kind": "x" * 5000, "id": 1},
        {"kind": ["x"] * 5000, "id": 1},
        {"kind": "request", "id": "x" * 5000},
        {"kind": "request", "id": 1, "type": "x" * 5000},
        {"kind": "request", "id": 1, "type": "status_get", "body": {"x" * 5000: 1}},
        {"kind": "request", "id": 1, "type": "run_open", "body": {"run": ["\ud800" * 5000]}},
    ],
)
def test_what_is_refused_is_not_repeated_at_length(envelope):
    with pytest.raises(ProtocolError) as refused:
        decode(json.dumps(envelope))
    assert len(refused.value.message) < 250
    refused.value.message.encode("utf-8")


def test_numbers_that_json_cannot_say_are_not_sent():
    with pytest.raises(ValueError, match="JSON compliant"):
        encode(Envelope("event", 0, JobStatus(seconds_left=float("inf"))))


def frame(width=5, height=3):
    camera = PreviewCamera(
        pose=tuple(map(float, range(16))), width=width, height=height, fx=1.5, fy=2.5, cx=0.5, cy=0.25
    )
    request = PreviewRequest(sequence=9, camera=camera, lighting_levels=(0.3, 2.0), tone="learned")
    rng = np.random.default_rng(0)
    rgba = rng.uniform(0, 6e4, (height, width, 4)).astype(np.float16)
    depth = rng.uniform(0, 9, (height, width)).astype(np.float32)
    return PreviewFrame(PreviewHeader(request=request, iteration=5, milliseconds=1.5), rgba, depth)


def test_a_picture_comes_back_to_the_bit():
    sent = frame()
    data = b"".join(encode_frame(sent))
    got = decode_frame(data)
    assert got.header == sent.header
    np.testing.assert_array_equal(got.rgba, sent.rgba)
    np.testing.assert_array_equal(got.depth, sent.depth)
    # As docs/protocol.md has it, read by hand.
    length = int.from_bytes(data[:4], "little")
    header = json.loads(data[4 : 4 + length])
    assert header["request"]["lighting_levels"] == [0.3, 2.0]
    assert header["request"]["sequence"] == 9 and header["iteration"] == 5
    assert len(data) == 4 + length + 5 * 3 * (4 + 8)
    assert np.frombuffer(data[4 + length :][:4], "<f4")[0] == sent.depth[0, 0]
    assert np.frombuffer(data[-2:], "<f2")[0] == sent.rgba[-1, -1, 3]
    # Planes first in memory, as torch has them: the same bytes.
    planes = np.ascontiguousarray(sent.rgba.transpose(2, 0, 1)).transpose(1, 2, 0)
    assert b"".join(encode_frame(dataclasses.replace(sent, rgba=planes))) == data


def test_damaged_pictures_are_refused():
    data = b"".join(encode_frame(frame()))
    for damaged in (b"", data[:3], data[:20], data[:-1], data + b"\0", b"\xff\xff\xff\xff" + data[4:]):
        with pytest.raises(ProtocolError):
            decode_frame(damaged)
    with pytest.raises(ProtocolError):
        decode_frame(data[:4] + b"?" + data[5:])


@pytest.mark.parametrize(
    ("width", "height"),
    [(0, -5), (-1, -1), (0, 3), (3, 0), (PREVIEW_SIDE_MAX + 1, 1), (1, PREVIEW_SIDE_MAX + 1), (10**400, 0)],
)
def test_sides_that_no_request_may_have_are_refused(width, height):
    """Also where the arrays' bytes would agree with them."""
    sent = frame(1, 1)
    camera = dataclasses.replace(sent.header.request.camera, width=width, height=height)
    request = dataclasses.replace(sent.header.request, camera=camera)
    header = dataclasses.replace(sent.header, request=request)
    text = json.dumps(dataclasses.asdict(header)).encode()
    with pytest.raises(ProtocolError, match="a picture's sides are") as refused:
        decode_frame(len(text).to_bytes(4, "little") + text + bytes(12 * width * height))
    assert len(refused.value.message) < 200


def test_a_large_viewport_fits_a_frame():
    assert PREVIEW_SIDE_MAX * 2160 * 12 < BINARY_BYTES_MAX


def test_the_code_of_an_error_is_its_class():
    class VeryOwnTroubleError(PhysHDRError):
        pass

    assert VeryOwnTroubleError("x").code == "very_own_trouble"
