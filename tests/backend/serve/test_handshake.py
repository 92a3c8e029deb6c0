# SPDX-License-Identifier: GPL-3.0-or-later
"""Who is let in, and what happens to those who do not keep to the protocol: nobody brings it down."""

import json
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from websockets.client import ClientProtocol
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.uri import parse_uri

from physhdr.backend.cli.serve import PRESET_NAMES
from physhdr.backend.serve.admission import STRANGERS_MAX
from physhdr.backend.train.presets import PRESETS
from physhdr.bridge.messages import (
    PROTOCOL_VERSION,
    TEXT_BYTES_MAX,
    ControlTake,
    Done,
    Envelope,
    Hello,
    HistoryGet,
    ModelExport,
    PreviewCamera,
    PreviewRequest,
    RunOpen,
    StatusGet,
    TrainResume,
    TrainStart,
    encode,
    type_name,
)
from physhdr.bridge.presets import IN_PANEL

HELLO = encode(Envelope("request", 1, Hello(protocol=PROTOCOL_VERSION, client="raw")))


@pytest.mark.parametrize(
    ("options", "status"),
    [
        ({"token": "0" * 64}, 401),
        ({"token": ""}, 401),
        ({"token": "ü"}, 401),
        ({"headers": {"Origin": "http://127.0.0.1"}}, 403),
        ({"headers": {"Origin": "null"}}, 403),
        ({"path": "/elsewhere"}, 404),
    ],
)
def test_strangers_are_refused(backend, enter, options, status):
    with pytest.raises(InvalidStatus) as refused:
        enter(backend, **options)
    assert refused.value.response.status_code == status


def closing(peer, timeout=10.0):
    """(code, reason) with which the backend closes."""
    with pytest.raises(ConnectionClosed) as closed:
        peer.until(lambda: False, timeout)
    return closed.value.rcvd.code, closed.value.rcvd.reason


@pytest.mark.parametrize(
    ("first", "code", "words"),
    [
        ("nonsense", 1007, "JSON"),
        ("[1, 2]", 1008, "object"),
        ('{"kind": "request", "id": 1, "id": 2, "type": "hello", "body": {}}', 1007, "JSON"),
        ("[" * 100_000, 1007, "JSON"),
        (b"\0\1\2", 1003, "text"),
        ("x" * (TEXT_BYTES_MAX + 1), 1009, ""),
        ('{"kind": "request", "id": 1, "type": "status_get", "body": {}}', 1008, "hello"),
        ('{"kind": "request", "id": 1, "type": "hello", "body": {"protocol": 1}}', 1008, "client"),
    ],
)
def test_a_wrong_first_frame_ends_the_connection(backend, enter, first, code, words):
    peer = enter(backend, say_hello=False)
    peer.socket.send(first)
    got, reason = closing(peer)
    assert got == code and words in reason


@pytest.mark.parametrize("version", [PROTOCOL_VERSION - 1, PROTOCOL_VERSION + 1, "2", None])
def test_another_version_is_told_so(backend, enter, version):
    peer = enter(backend, say_hello=False)
    body = {"protocol": version, "client": "a newer one", "a field of theirs": 1}
    peer.socket.send(json.dumps({"kind": "request", "id": 7, "type": "hello", "body": body}))
    code, reason = closing(peer)
    assert code == 1002 and f"version {PROTOCOL_VERSION}" in reason
    assert peer.answers[7].code == "wrong_protocol" and "same version" in peer.answers[7].failure.hint


def test_wrong_requests_are_answered_and_bounded(backend, enter):
    peer = enter(backend)
    wrong = [
        {"kind": "request", "id": 50, "type": "no_such_thing", "body": {}},
        {"kind": "request", "id": 51, "type": "run_open", "body": {}},
        {"kind": "request", "id": 52, "type": "run_open", "body": {"run": 7}},
        {"kind": "request", "id": 53, "type": "train_start", "body": {"data": "/x", "out": "/y", "more": 1}},
        {"kind": "reply", "id": 54, "type": "done", "body": {}},
        {"kind": "request", "id": 55, "type": "hello", "body": {"protocol": 1, "client": "again"}},
    ]
    for frame in wrong:
        peer.socket.send(json.dumps(frame))
        peer.until(lambda frame=frame: frame["id"] in peer.answers)
        assert peer.answers[frame["id"]].code == "protocol"
    assert peer.ask(StatusGet()).in_control  # it is still listened to
    for _ in range(3):
        peer.socket.send(json.dumps(wrong[0]))
    code, reason = closing(peer)
    assert code == 1008 and "too many invalid frames" in reason


@pytest.mark.parametrize(
    ("frame", "code"),
    [("{", 1007), ("7", 1008), ('{"id": -1}', 1008), (b"\0", 1003), ("x" * (TEXT_BYTES_MAX + 1), 1009)],
)
def test_frames_without_an_id_end_the_connection(backend, enter, frame, code):
    peer = enter(backend)
    peer.socket.send(frame)
    assert closing(peer)[0] == code
    assert enter(backend).welcome.pid == backend.process.pid


def test_what_is_no_websocket_at_all_is_dropped(backend, enter):
    for garbage in (b"\0" * 4096, b"GET / HTTP/1.1\r\n\r\n", b"POST / HTTP/1.1\r\nContent-Length: 9\r\n\r\n"):
        with socket.create_connection(("127.0.0.1", backend.connection.port), timeout=10) as raw:
            raw.sendall(garbage)
            raw.shutdown(socket.SHUT_WR)
            while raw.recv(4096):
                pass
    assert enter(backend).welcome.pid == backend.process.pid


@pytest.mark.long
@pytest.mark.parametrize("says", [b"", pytest.param(b"GET / HTTP/1.1\r\n", marks=pytest.mark.long)])
def test_a_crowd_of_strangers_is_kept_small(start, enter, says):
    """Connections that anybody on the machine can make use up neither the open files nor the log."""
    backend = start()
    peer = enter(backend)
    peer.wait_for("idle")
    files = Path(f"/proc/{backend.process.pid}/fd")
    before, crowd = len(list(files.iterdir())), []
    for _ in range(300):
        crowd.append(socket.create_connection(("127.0.0.1", backend.connection.port), timeout=10))
        with suppress(OSError):  # it has been dropped already
            crowd[-1].sendall(says)
    assert peer.ask(StatusGet()).in_control
    deadline = time.monotonic() + 2.5  # well before the first of them is given up for saying nothing
    while len(list(files.iterdir())) - before > STRANGERS_MAX + 6:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert enter(backend).welcome.pid == backend.process.pid  # whoever has the token comes through the crowd
    for stranger in crowd:
        stranger.close()
    for _ in range(50):
        with pytest.raises(InvalidStatus):
            enter(backend, token="0" * 64)
    assert backend.log.read_text().count("refused") == 1
    assert peer.ask(StatusGet()).in_control


#: Connects up to 4,000 times a second and says nothing; on a busy machine less often, without bursts.
STORM = """
import socket, sys, time
kept = []
for number in range(60 * 4000):
    if number % 40 == 0:
        time.sleep(0.01)
    each = socket.socket()
    each.setblocking(False)
    each.connect_ex(("127.0.0.1", int(sys.argv[1])))
    kept.append(each)
    if len(kept) > 400:
        kept.pop(0).close()
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="others take in who says nothing, and may be too slow")
def test_in_a_storm_of_strangers_every_client_is_let_in(start, enter):
    backend = start()
    enter(backend).wait_for("idle")
    storm = subprocess.Popen([sys.executable, "-c", STORM, str(backend.connection.port)])
    try:
        time.sleep(0.5)
        for _ in range(5):
            assert enter(backend).ask(StatusGet()).state == "idle"
        assert storm.poll() is None  # it went on until now
    finally:
        storm.kill()
        storm.wait()


def test_values_out_of_range_are_refused_with_a_reason(backend, enter, refusal, tmp_path):
    peer = enter(backend)
    peer.wait_for("idle")
    good = {"data": str(tmp_path), "out": str(tmp_path / "out")}
    for change in (
        {"data": "relative/path"},
        {"data": "/with\0nul"},
        {"data": "/with\ud800surrogate"},
        {"out": ""},
        {"preset": "nonsense"},
        {"iterations": 0},
        {"iterations": 10**300},
        {"threads": 10**6},
        {"seed": -1},
    ):
        failure = refusal(peer, TrainStart(**{**good, **change}))
        assert failure.code == "bad_value" and failure.hint, change
    assert refusal(peer, TrainStart(**{**good, "data": "/no/such/folder"})).code == "file_missing"
    assert refusal(peer, RunOpen(run=str(tmp_path))).code == "file_missing"
    assert peer.ask(StatusGet()).state == "idle"


#: Every path that a client may name.
PATHS = {
    "train_start.data": lambda path: TrainStart(data=path, out="/nowhere/run"),
    "train_start.out": lambda path: TrainStart(data="/", out=path),
    "train_resume.run": lambda path: TrainResume(run=path),
    "train_resume.data": lambda path: TrainResume(run="/nowhere/run", data=path),
    "run_open.run": lambda path: RunOpen(run=path),
    "run_open.data": lambda path: RunOpen(run="/nowhere/run", data=path),
    "model_export.path": lambda path: ModelExport(path=path),
}


@pytest.mark.parametrize("field", PATHS)
def test_paths_that_the_system_refuses_are_told_with_a_remedy(backend, enter, refusal, tmp_path, field):
    """No fault of PhysHDR's, whatever the client names: what is wrong with which path, and what to do."""
    peer = enter(backend)
    peer.wait_for("idle")
    circle = tmp_path / "circle"
    circle.symlink_to(circle)
    for path, words, remedy in (
        (tmp_path / ("n" * 300 + ".safetensors"), "File name too long", "shorter path"),
        (tmp_path / "/".join(["folder"] * 700) / "x.safetensors", "File name too long", "shorter path"),
        (circle / "x.safetensors", "symbolic links", "links lead in a circle"),
    ):
        failure = refusal(peer, PATHS[field](str(path)))
        assert failure.code == "path" and f"{path}: " in failure.message and words in failure.message
        assert remedy in failure.hint
    for path in ("relative.safetensors", "/with\0nul.safetensors", "/half\ud800.safetensors", ""):
        if path or field not in ("train_resume.data", "run_open.data"):  # empty there: as before
            failure = refusal(peer, PATHS[field](path))
            assert failure.code == "bad_value" and "absolute path" in failure.message and failure.hint
    assert peer.ask(StatusGet()).state == "idle"


def test_a_model_is_written_to_a_name_of_its_own_alone(backend, enter, refusal, tmp_path):
    peer = enter(backend)
    for name in ("notes.txt", "model", ".safetensors", "model.safetensors.bak", "model.SafeTensors"):
        failure = refusal(peer, ModelExport(path=str(tmp_path / name)))
        assert failure.code == "bad_value" and name in failure.message and ".safetensors" in failure.hint


def test_the_panel_offers_presets_that_there_are():
    offered = [preset.name for preset in IN_PANEL]
    assert set(offered) < set(PRESET_NAMES) and offered[:4] == ["fast", "default", "high", "paper"]


def test_the_welcome_says_what_is_there(backend, enter):
    import torch

    welcome = enter(backend, "Blender").welcome
    assert welcome.protocol == PROTOCOL_VERSION and welcome.torch == torch.__version__
    assert welcome.log == str(backend.log) and welcome.pid == backend.process.pid
    # A method without splats has nothing that Blender could show.
    shown = [name for name, config in PRESETS.items() if config.method.traits.splats]
    assert welcome.presets == PRESET_NAMES and sorted(PRESET_NAMES) == sorted(shown)
    peer = enter(backend)
    peer.wait_for("idle")
    assert peer.status.device.startswith("cuda" if torch.cuda.is_available() else "cpu")


def raw_client(backend):
    """A socket on which the handshake and hello were said by hand, so that nothing reads it by itself."""
    protocol = ClientProtocol(parse_uri(backend.connection.address), max_size=None)
    request = protocol.connect()
    request.headers["Authorization"] = f"Bearer {backend.connection.token}"
    protocol.send_request(request)
    raw = socket.create_connection(("127.0.0.1", backend.connection.port), timeout=10)
    raw.sendall(b"".join(protocol.data_to_send()))
    while not protocol.events_received():
        protocol.receive_data(raw.recv(65536))
    protocol.send_text(HELLO.encode())
    raw.sendall(b"".join(protocol.data_to_send()))
    return protocol, raw


def test_who_does_not_read_or_speak_is_dropped(backend, enter):
    """One connection says nothing, one asks without ever reading: both end, memory stays, others go on."""
    begun = time.monotonic()
    silent = enter(backend, say_hello=False)
    protocol, stalled = raw_client(backend)
    observer = enter(backend, "observer")
    assert not observer.welcome.in_control and observer.status.controller == "raw"
    before = backend.memory_mb()
    request = encode(Envelope("request", 2, HistoryGet())).encode()
    camera = PreviewCamera(pose=(0.0,) * 16, width=2000, height=2000, fx=1.0, fy=1.0, cx=0.0, cy=0.0)
    picture = encode(Envelope("request", 3, PreviewRequest(sequence=1, camera=camera))).encode()
    stalled.settimeout(0.5)
    try:
        while time.monotonic() - begun < 4.0:
            for text in [request, picture] * 200:
                protocol.send_text(text)
            stalled.sendall(b"".join(protocol.data_to_send()))
    except TimeoutError:
        pass  # the backend does not read on either
    observer.until(lambda: observer.status.in_control, 10.0)
    assert time.monotonic() - begun < 12.0
    assert backend.memory_mb() - before < 100.0
    assert observer.ask(HistoryGet()).iterations == ()
    stalled.close()
    code, reason = closing(silent)
    assert code == 1008 and "no hello" in reason


def test_one_steers_and_the_others_watch(backend, enter, refusal, tmp_path):
    first, second = enter(backend, "Blender one"), enter(backend, "Blender\n two")
    assert first.welcome.in_control and not second.welcome.in_control
    for request in (RunOpen(run=str(tmp_path)), ModelExport(path=str(tmp_path / "m.safetensors"))):
        failure = refusal(second, request)
        assert failure.code == "not_in_control" and "Blender one" in failure.hint
        assert "Blender one controls" in failure.message and type_name(type(request)) in failure.message
    assert second.ask(StatusGet()).controller == "Blender one"
    assert second.ask(StatusGet()).in_control is False
    assert second.ask(ControlTake()) == Done()
    first.until(lambda: first.status.controller == "Blender two")
    assert not first.status.in_control
    assert refusal(first, RunOpen(run=str(tmp_path))).code == "not_in_control"
    assert refusal(second, RunOpen(run=str(tmp_path))).code == "file_missing"  # it may, but there is none
    second.socket.close()
    first.until(lambda: first.status.in_control)


@pytest.mark.long
def test_a_flood_of_requests_is_answered_one_by_one(backend, enter, tmp_path):
    """More than the engine takes at once: every one has an answer, those beyond the bound ``busy``."""
    peer = enter(backend)
    numbers = [peer.send(RunOpen(run=str(tmp_path))) for _ in range(80)]
    peer.until(lambda: all(number in peer.answers for number in numbers))
    assert {peer.answers[number].code for number in numbers} <= {"file_missing", "busy"}
