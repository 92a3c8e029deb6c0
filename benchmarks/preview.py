# SPDX-License-Identifier: GPL-3.0-or-later
"""Previews end to end: a real backend process, a real socket, and a client that unpacks what it gets."""

import dataclasses
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import torch
from measure import Row
from processes import START_SIZE, write_data
from synthetic import STANDSTILL, gaussians
from websockets.sync.client import connect

from physhdr.backend.scene import read_scene
from physhdr.backend.train.begin import begin
from physhdr.backend.train.config import write_config
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.saver import save
from physhdr.backend.train.trainer import step
from physhdr.bridge.connection import Connection, read_connection
from physhdr.bridge.errors import PhysHDRError
from physhdr.bridge.messages import (
    BINARY_BYTES_MAX,
    PROTOCOL_VERSION,
    Envelope,
    Hello,
    JobStatus,
    PreviewCamera,
    PreviewFrame,
    PreviewRequest,
    Request,
    RunOpen,
    TrainResume,
    decode,
    decode_frame,
    encode,
)

COUNT = 50_000
#: What is to be reached: frames per second at 400×400.
AT_LEAST = 15.0
SECONDS = 6.0


def write_run(data: Path, folder: Path) -> PreviewCamera:
    """A run of 50,000 Gaussians in the middle of its training, and a camera that sees them all."""
    scene = read_scene(data)
    preset = PRESETS["default"]
    config = dataclasses.replace(
        preset,
        iterations=1_000_000,
        optimiser=STANDSTILL,
        initial_points="random",
        random_points=COUNT,
        backbone=dataclasses.replace(preset.backbone, stop=0.0),
    )
    camera = scene.train[0].camera
    state = begin(scene, config)
    (means, quaternions, scales, opacities, _), _ = gaussians(COUNT, 3, camera.width)
    pose = torch.tensor(camera.camera_to_world, dtype=torch.float32)
    parameters = state.method.gaussians.parameters
    with torch.no_grad():
        parameters["means"].copy_(means @ pose[:3, :3].T + pose[:3, 3])
        parameters["quaternions"].copy_(quaternions)
        parameters["log_scales"].copy_(scales.log())
        parameters["opacity_logits"].copy_(opacities.logit())
    step(state)  # so that the optimiser has a state
    state.iteration = config.iterations // 2
    folder.mkdir()
    save(state, folder)
    write_config(folder / "config.json", config, data, "default")
    return PreviewCamera(
        pose=tuple(float(x) for x in camera.camera_to_world.reshape(-1)),
        width=camera.width,
        height=camera.height,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
    )


class Watcher:
    """A client that asks for one preview after the other."""

    def __init__(self, connection: Connection) -> None:
        self._socket = connect(
            connection.address,
            additional_headers={"Authorization": f"Bearer {connection.token}"},
            max_size=BINARY_BYTES_MAX,
            compression=None,
            proxy=None,
        ).__enter__()
        self.status = JobStatus()
        self._ask(Hello(protocol=PROTOCOL_VERSION, client="benchmark"))

    def _ask(self, request: Request) -> None:
        self._socket.send(encode(Envelope("request", 1, request)))

    def _next(self) -> PreviewFrame | None:
        data = self._socket.recv(timeout=60)
        if isinstance(data, bytes):
            return decode_frame(data)
        envelope = decode(data)
        if envelope.kind == "error":
            raise RuntimeError(envelope.message.message)
        if isinstance(envelope.message, JobStatus):
            self.status = envelope.message
        return None

    def begin(self, request: Request, state: str) -> None:
        """Send the request and wait for the state."""
        self._ask(request)
        while self.status.state != state:
            self._next()

    def watch(self, camera: PreviewCamera, tone: str, seconds: float) -> tuple[float, float, float]:
        """Frames per second, milliseconds of a rendering, training iterations per second meanwhile."""
        frames, rendering = 0, 0.0
        begun, first, last = 0.0, 0, 0
        while not begun or time.perf_counter() - begun < seconds:
            self._ask(PreviewRequest(sequence=frames, camera=camera, exposure_ev=1.0, tone=tone))
            while (frame := self._next()) is None:
                pass
            last = frame.header.iteration
            if not begun:  # the first one warms up and does not count
                begun, first = time.perf_counter(), last
                continue
            frames, rendering = frames + 1, rendering + frame.header.milliseconds
        took = time.perf_counter() - begun
        return frames / took, rendering / frames, (last - first) / took

    def pace(self, seconds: float) -> float:
        """Training iterations per second while nobody looks."""
        until = time.perf_counter() + seconds
        begun, first = 0.0, 0
        while time.perf_counter() < until:
            self._next()
            if not begun:
                begun, first = time.perf_counter(), self.status.iteration
        return (self.status.iteration - first) / (time.perf_counter() - begun)


def preview_rows(quick: bool) -> Iterator[Row]:
    """Frames per second, idle and while training, of a request answered, unpacked, and asked for anew."""
    seconds = SECONDS / 3 if quick else SECONDS
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_data(folder / "data")
        camera = write_run(folder / "data", folder / "run")
        command = [sys.executable, "-c", "import sys; from physhdr.backend.cli import main; sys.exit(main())"]
        command += ["serve", "--home", str(folder / "home"), "--threads", str(torch.get_num_threads())]
        with open(folder / "log", "w") as log:
            process = subprocess.Popen(command, stdout=log, stderr=log)
        try:
            watcher = Watcher(_connection(folder / "home"))
            watcher.begin(RunOpen(run=str(folder / "run")), "open")
            for tone in ("linear", "learned"):
                rate, rendering, _ = watcher.watch(camera, tone, seconds)
                note = f"rendering {rendering:.1f} ms of {1e3 / rate:.1f}"
                work = f"preview, {tone}, {COUNT // 1000} k, {START_SIZE}²"
                yield Row(work=work, value=rate, unit="/s", at_least=AT_LEAST, note=note)
            watcher.begin(TrainResume(run=str(folder / "run")), "training")
            watcher.watch(camera, "linear", 1.0)
            alone = watcher.pace(seconds)
            rate, _, pace = watcher.watch(camera, "linear", seconds)
            note = f"{pace:.1f} iterations/s meanwhile, {alone:.1f} unwatched"
            yield Row(work="… while training", value=rate, unit="/s", note=note)
        finally:
            process.kill()
            process.wait()


def _connection(home: Path) -> Connection:
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        try:
            return read_connection(home)
        except PhysHDRError:
            time.sleep(0.05)
    raise RuntimeError("the backend did not come up")
