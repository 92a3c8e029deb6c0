#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""What each format and program makes of a model: the table in lab/viewers.md. What is missing is skipped.

    python lab/tools/formats_table.py                       the demo's run, into lab/viewers.md
    python lab/tools/formats_table.py --run RUN --out -     another run, printed

Nothing is downloaded. Programs of npm (@playcanvas/splat-transform, gltf-validator, @sparkjsdev/spark with
three, playcanvas, @mkkellogg/gaussian-splats-3d) are those of the folder node_modules that
PHYSHDR_NODE_MODULES names; gsply, usd-core and Playwright those of this Python; Chromium is found on the PATH
or by CHROMIUM.
"""

import argparse
import functools
import http.server
import importlib
import importlib.util
import io
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from physhdr.backend.cli import main as physhdr
from physhdr.backend.cli.convert import read_source
from physhdr.backend.rasterize import rasterize
from physhdr.backend.runs.run import Run, open_run
from physhdr.backend.scene.camera import Camera
from physhdr.bridge import srgb
from physhdr.bridge.axes import Up, turn_of_up
from physhdr.bridge.gaussian_ply import write_standard_ply
from physhdr.bridge.spherical_harmonics import basis, degree_of
from physhdr.bridge.splat_files import SplatCloud, turned
from physhdr.bridge.splat_files.usable import taken

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "lab" / "viewers.md"
BEGIN, END = "<!-- formats: begin -->", "<!-- formats: end -->"
MODULES = os.environ.get("PHYSHDR_NODE_MODULES")
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
#: EV and width of the pictures; splats of which SOG is made, whose palette takes splat-transform long.
EV, SIDE, EVERY = 1.0, 200, 10
PATIENCE = 60_000
#: What splat-transform makes of our PLY, in its axes.
FROM_OURS = ("few.sog", "theirs.compressed.ply", "theirs.spz")


class MissingError(Exception):
    """Why something is skipped."""


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    format: str
    program: str
    what: str
    found: str


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--run", type=Path, default=ROOT / "runs" / "demo")
    parser.add_argument("--out", default=str(PAGE), help="the page to write into, or - to print")
    parser.add_argument("--views", type=int, default=3, help="test views that are drawn")
    arguments = parser.parse_args()
    if not arguments.run.is_dir():
        print(f"skipped: there is no run in {arguments.run} (make demo trains one)")
        return 0
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        table = Table(arguments.run, Path(folder), arguments.views)
        for part in (table.ours, table.splat_transform, table.validators, table.gsply, table.viewers):
            part()
    text = table.text()
    if arguments.out == "-":
        print(text)
        return 0
    page = Path(arguments.out)
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    page.write_text(f"{before}{BEGIN}\n{text}\n{END}{rest.partition(END)[2]}", encoding="utf-8")
    return 0


class Table:
    """The rows, as they are found."""

    def __init__(self, folder: Path, scratch: Path, views: int) -> None:
        self.folder, self.scratch = folder, scratch
        self.run: Run = open_run(folder, pictures=False)
        width = min(SIDE, (self.run.scene.test or self.run.scene.train)[0].camera.width)
        self.cameras = [
            v.camera.resized(width) for v in (self.run.scene.test or self.run.scene.train)[:views]
        ]
        self.rows: list[Row] = []
        self.skipped: list[str] = []
        self.baked = self.converted(folder, "baked.ply")
        self.source = cloud_in(self.baked)
        self.pictures = [drawn(self.source, camera) for camera in self.cameras]

    # -- parts -----------------------------------------------------------------------------------------------

    def ours(self) -> None:
        with torch.no_grad():
            own = [pixels_of(self.run.method.ldr(camera, 2.0**EV)) for camera in self.cameras]
            radiance = [self.run.method.hdr(camera).cpu().numpy() for camera in self.cameras]
        self.row("PLY", "ours", "our rasteriser of the file, against the method's own picture", self.db(own))
        quick = cloud_in(self.converted(self.folder, "quick.ply", "--quick"))
        self.row("PLY (`--quick`)", "ours", "the same", self.db(own, quick))
        for name, title, *options in (
            ("again.ply", "PLY"),
            ("v3.spz", "SPZ 3"),
            ("v4.spz", "SPZ 4", "--spz-version", "4"),
            ("a.glb", "glTF"),
        ):
            self.compare(title, "ours", self.converted(self.baked, name, *options), "written and read")
        through_srgb = [pixels_of(srgb.to_srgb(np.clip(2.0**EV * each, 0.0, 1.0))) for each in radiance]
        words = "our rasteriser of the radiance, then sRGB, against the method's radiance through sRGB"
        linear = cloud_in(self.converted(self.folder, "linear.glb", "--blend-linear"))
        found = [pixels_of(srgb.to_srgb(blended(linear, camera).clip(0, 1))) for camera in self.cameras]
        self.row("glTF (`--blend-linear`)", "ours", words, db_of(found, through_srgb))
        try:
            path = self.converted(self.folder, "a.usdc")
            field = cloud_in(path)
            found = [
                pixels_of(srgb.to_srgb((2.0**EV * blended(field, camera)).clip(0, 1)))
                for camera in self.cameras
            ]
            self.row("USD", "ours", words, db_of(found, through_srgb))
        except MissingError as error:
            self.skip("USD", str(error))

    def splat_transform(self) -> None:
        try:
            program = module("@playcanvas/splat-transform", "bin/cli.mjs")
        except MissingError as error:
            return self.skip("splat-transform", str(error))
        name = f"splat-transform {version_of('@playcanvas/splat-transform')}"

        def run(*words: object) -> None:
            call([node(), program, "-q", "-w", "-g", "cpu", *words])

        for title, file in (("PLY", "again.ply"), ("SPZ 3", "v3.spz"), ("SPZ 4", "v4.spz")):
            out = self.scratch / f"theirs-{file}.ply"
            run(self.scratch / file, out)
            up: Up = "y" if file.endswith(".spz") else "z"
            self.compare(title, name, out, "reads ours, writes PLY", up)
        for title, file in (("compressed PLY", "theirs.compressed.ply"), ("SPZ 4", "theirs.spz")):
            run(self.baked, self.scratch / file)
            self.judge(title, name, "writes it of our PLY, we read", self.cloud(self.scratch / file))
        run(self.baked, self.scratch / "theirs.glb")
        # It takes a PLY's axes for 3DGS's and turns half a turn about Z into glTF's.
        cloud = turned(cloud_in(self.scratch / "theirs.glb"), np.diag([-1.0, -1.0, 1.0]))
        self.judge("glTF", name, "writes it of our PLY, we read", replace(cloud, up="z"))
        few = taken(self.source, np.arange(0, self.source.count, EVERY))
        arrays = (few.position, few.rotation, few.scale, few.opacity, few.colour_sh)
        write_standard_ply(self.scratch / "few.ply", *arrays)
        run(self.scratch / "few.ply", self.scratch / "few.sog")
        pictures = [drawn(few, camera) for camera in self.cameras]
        read = self.cloud(self.scratch / "few.sog")
        words = f"writes it of every {EVERY}th Gaussian, we read"
        self.row("SOG", name, words, self.db(pictures, read))

    def validators(self) -> None:
        try:
            script = (
                "const v = require(process.argv[1]); v.validateBytes(new Uint8Array(require('fs')"
                ".readFileSync(process.argv[2])), {maxIssues: 200}).then(r => console.log(JSON.stringify(r)))"
            )
            where = module("gltf-validator", "index.js")
            issues = json.loads(call([node(), "-e", script, where, self.scratch / "a.glb"]))["issues"]
            errors = [each for each in issues["messages"] if each["severity"] == 0]
            names = [each for each in errors if "KHR_gaussian_splatting:" in each.get("pointer", "")]
            result = (
                f"{len(errors) - len(names)} errors ({len(names)} names of attributes that it does not know)"
            )
            self.row("glTF", f"gltf-validator {version_of('gltf-validator')}", "judges ours", result)
        except MissingError as error:
            self.skip("gltf-validator", str(error))
        try:
            wanted("pxr", "usd-core")
            Usd, UsdValidation = (importlib.import_module(f"pxr.{name}") for name in ("Usd", "UsdValidation"))
            context = UsdValidation.ValidationContext(
                UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
            )
            errors = context.Validate(Usd.Stage.Open(str(self.scratch / "a.usdc")))
            version = ".".join(map(str, Usd.GetVersion()[1:]))
            self.row("USD", f"pxr.UsdValidation {version}", "judges ours", f"{len(errors)} errors")
        except MissingError as error:
            self.skip("pxr.UsdValidation", str(error))

    def gsply(self) -> None:
        try:
            wanted("gsply", "gsply")
        except MissingError as error:
            return self.skip("gsply", str(error))
        gsply = importlib.import_module("gsply")
        data = gsply.plyread(str(self.baked))
        sh = np.concatenate([data.sh0.reshape(-1, 1, 3), data.shN.reshape(len(data.sh0), -1, 3)], axis=1)
        different = {
            "position": np.abs(data.means - self.source.position).max(),
            "colour": np.abs(sh - self.source.colour_sh).max(),
            "scale": np.abs(np.exp(data.scales) - self.source.scale).max(),
        }
        result = "largest difference " + ", ".join(f"{name} {value:.1g}" for name, value in different.items())
        self.row("PLY", f"gsply {gsply.__version__}", "reads ours", result)

    def viewers(self) -> None:
        try:
            with browser() as page:
                for viewer in VIEWERS:
                    self.view(page, viewer)
        except MissingError as error:
            self.skip("viewers", str(error))

    def view(self, page: Any, viewer: "Viewer") -> None:
        try:
            for package in viewer.packages:
                module(package, "package.json")
        except MissingError as error:
            return self.skip(viewer.title, str(error))
        name = f"{viewer.title} {version_of(viewer.packages[0])}"
        for title, file in viewer.files.items():
            cloud = self.cloud(self.scratch / file)
            try:
                with served(self.scratch, viewer.page) as address:
                    shots = [shot(page, address, file, camera, cloud.up) for camera in self.cameras]
            except MissingError as error:
                self.skip(f"{name}, {title}", str(error))
                continue
            own = [drawn(cloud, camera) for camera in self.cameras]
            self.row(title, name, viewer.settings, db_of(shots, own))

    # -- help ------------------------------------------------------------------------------------------------

    def cloud(self, path: Path) -> SplatCloud:
        """What a file holds; splat-transform leaves the axes of our PLY as they are, whatever the format."""
        cloud = cloud_in(path)
        return replace(cloud, up="z") if path.name in FROM_OURS else cloud

    def converted(self, source: Path, name: str, *options: str) -> Path:
        out = self.scratch / name
        if out.suffix == ".usdc":
            wanted("pxr", "usd-core")
        if physhdr(["export", str(source), str(out), *options]):
            raise SystemExit(f"physhdr export {source} {out} failed")
        return out

    def compare(self, title: str, program: str, path: Path, what: str, up: Up | None = None) -> None:
        cloud = cloud_in(path)
        self.judge(title, program, what, replace(cloud, up=up) if up else cloud)

    def judge(self, title: str, program: str, what: str, cloud: SplatCloud) -> None:
        lost = self.source.count - cloud.count
        result = self.db(self.pictures, cloud)
        self.row(title, program, what, f"{result}{f', {lost} Gaussians fewer' if lost else ''}")

    def db(self, wanted: list[np.ndarray], cloud: SplatCloud | None = None) -> str:
        cloud = cloud or self.source
        return db_of([drawn(cloud, camera) for camera in self.cameras], wanted)

    def row(self, *words: str) -> None:
        self.rows.append(Row(*words))
        print(" | ".join(words), flush=True)

    def skip(self, what: str, why: str) -> None:
        self.skipped.append(f"{what}: {why}")
        print(f"skipped {what}: {why}", flush=True)

    def text(self) -> str:
        scene = f"{self.run.scene.name}, {self.source.count:,} Gaussians"
        lines = [
            f"{scene}, {len(self.cameras)} test views of {self.cameras[0].width} pixels, EV {EV:g}. dB: mean "
            "PSNR of 8-bit pictures, 100 where all pixels are equal; unless stated otherwise, of our "
            "rasteriser's pictures of what was read and of the PLY that it was made of. Viewers: against our "
            "rasteriser of the same file.",
            "",
            "| format | program | what | found |",
            "|---|---|---|---|",
            *(f"| {r.format} | {r.program} | {r.what} | {r.found} |" for r in self.rows),
        ]
        if self.skipped:
            lines += ["", "Skipped: " + "; ".join(self.skipped) + "."]
        return "\n".join(lines)


# -- pictures ------------------------------------------------------------------------------------------------


def cloud_in(path: Path) -> SplatCloud:
    source = read_source(path)
    assert source.cloud is not None
    return replace(source.cloud, up=source.up)


def blended(cloud: SplatCloud, camera: Camera) -> np.ndarray:
    """``[3, H, W]``: what our rasteriser makes of a file, whatever its axes."""
    cloud = turned(cloud, turn_of_up(cloud.up, "z")) if cloud.up != "z" else cloud
    directions = cloud.position - camera.position.astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    Y = basis(directions, degree_of(cloud.colour_sh.shape[1]))
    colours = np.maximum(np.einsum("nk,nkc->nc", Y, cloud.colour_sh) + 0.5, 0.0)
    arrays = (cloud.position, cloud.rotation, cloud.scale, cloud.opacity, colours)
    tensors = [torch.from_numpy(np.array(array, np.float32)) for array in arrays]
    return rasterize(*tensors, camera).image.numpy()


def drawn(cloud: SplatCloud, camera: Camera) -> np.ndarray:
    return pixels_of(blended(cloud, camera))


def pixels_of(image: Any) -> np.ndarray:
    """``[H, W, 3]`` uint8 of ``[3, H, W]``, 0…1."""
    image = image.cpu().numpy() if isinstance(image, torch.Tensor) else image
    return np.rint(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8).transpose(1, 2, 0)


def db_of(found: list[np.ndarray], wanted: list[np.ndarray]) -> str:
    figures = []
    for one, other in zip(found, wanted, strict=True):
        error = np.mean((one.astype(np.float64) - other) ** 2) / 255.0**2
        figures.append(100.0 if error == 0.0 else min(100.0, -10.0 * math.log10(error)))
    return f"{np.mean(figures):.1f} dB"


# -- other programs ------------------------------------------------------------------------------------------


def node() -> str:
    found = shutil.which("node")
    if found is None:
        raise MissingError("there is no node")
    return found


def module(name: str, file: str) -> Path:
    """A file of a package in ``PHYSHDR_NODE_MODULES``."""
    if MODULES is None:
        raise MissingError("PHYSHDR_NODE_MODULES is not set")
    path = Path(MODULES) / name / file
    if not path.is_file():
        raise MissingError(f"npm install {name}")
    return path


def version_of(name: str) -> str:
    return json.loads(module(name, "package.json").read_text(encoding="utf-8"))["version"]


def wanted(name: str, package: str) -> None:
    if importlib.util.find_spec(name) is None:
        raise MissingError(f"pip install {package}")


def call(words: list[Any]) -> str:
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, encoding="utf-8")
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, words))} failed: {(done.stderr or done.stdout)[-800:]}")
    return done.stdout


# -- viewers -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Viewer:
    """A page that shows ``?file=…&view=[16 numbers]&angle=…`` on black; then ``window.done`` is true."""

    title: str
    packages: tuple[str, ...]
    settings: str
    files: dict[str, str]
    page: str


_HEAD = """<!doctype html><html><body style="margin:0;background:#000;overflow:hidden">
<script type="importmap">
{"imports": {"three": "/node_modules/three/build/three.module.js",
"three/addons/": "/node_modules/three/examples/jsm/",
"@sparkjsdev/spark": "/node_modules/@sparkjsdev/spark/dist/spark.module.js",
"playcanvas": "/node_modules/playcanvas/build/playcanvas.mjs",
"gs3d": "/node_modules/@mkkellogg/gaussian-splats-3d/build/gaussian-splats-3d.module.js"}}</script>
<script type="module">
const Q = new URLSearchParams(location.search), file = '/scratch/' + Q.get('file');
const N = innerWidth, M = innerHeight;
const pose = JSON.parse(Q.get('view')), angle = +Q.get('angle');  // degrees of height; pose row by row
const rest = ms => new Promise(go => setTimeout(go, ms));
"""
_THREE = """import * as THREE from 'three';
const renderer = new THREE.WebGLRenderer({antialias: false}); renderer.setPixelRatio(1);
renderer.setSize(N, M); document.body.appendChild(renderer.domElement);
const camera = new THREE.PerspectiveCamera(angle, N / M, 0.01, 1000), m = new THREE.Matrix4(); m.set(...pose);
m.decompose(camera.position, camera.quaternion, camera.scale); camera.updateMatrixWorld(true);
"""
_SPARK = (
    _HEAD
    + _THREE
    + """import {SplatMesh, SparkRenderer} from '@sparkjsdev/spark';
const scene = new THREE.Scene(); scene.add(new SparkRenderer({renderer, OPTIONS}));
const mesh = new SplatMesh({url: file, PRECISION}); scene.add(mesh); await mesh.initialized;
for (let i = 0; i < 8; i++) { renderer.render(scene, camera); await rest(250); }
window.done = true;
</script></body></html>"""
)
_PLAYCANVAS = (
    _HEAD
    + """import * as pc from 'playcanvas';
const canvas = document.createElement('canvas'); canvas.width = N; canvas.height = M;
document.body.appendChild(canvas);
const device = await pc.createGraphicsDevice(canvas, {deviceTypes: ['webgl2'], antialias: false});
device.maxPixelRatio = 1;
const app = new pc.Application(canvas, {graphicsDevice: device}); app.start();
app.setCanvasFillMode(pc.FILLMODE_NONE, N, M); app.setCanvasResolution(pc.RESOLUTION_FIXED, N, M);
const eye = new pc.Entity();
eye.addComponent('camera', {clearColor: new pc.Color(0, 0, 0), fov: angle, nearClip: 0.01, farClip: 1000,
  toneMapping: pc.TONEMAP_NONE});
const matrix = new pc.Mat4(); matrix.data.set(pose.map((_, i) => pose[(i % 4) * 4 + (i >> 2)]));
eye.setPosition(matrix.getTranslation()); eye.setRotation(new pc.Quat().setFromMat4(matrix));
app.root.addChild(eye);
const isScene = file.endsWith('.glb');
const asset = new pc.Asset('splats', isScene ? 'container' : 'gsplat', {url: file}); app.assets.add(asset);
await new Promise((go, no) => { asset.on('load', go); asset.on('error', no); app.assets.load(asset); });
let splats = new pc.Entity();
if (isScene) splats = asset.resource.instantiateRenderEntity(); else splats.addComponent('gsplat', {asset});
app.root.addChild(splats);
await rest(4000); window.done = true;
</script></body></html>"""
)
_GS3D = (
    _HEAD
    + _THREE
    + """import * as GS from 'gs3d';
const viewer = new GS.Viewer({renderer, camera, selfDrivenMode: false, useBuiltInControls: false,
  sharedMemoryForWorkers: false, gpuAcceleratedSort: false, sphericalHarmonicsDegree: 2,
  sceneRevealMode: GS.SceneRevealMode.Instant});
await viewer.addSplatScene(file, {showLoadingUI: false, splatAlphaRemovalThreshold: 1});
for (let i = 0; i < 16; i++) { viewer.update(); viewer.render(); await rest(250); }
window.done = true;
</script></body></html>"""
)
_TOLD = "preBlurAmount: 0.3, blurAmount: 0, minAlpha: 1 / 255, maxStdDev: 3.33, accumExtSplats: true"
_ALL = {"PLY": "baked.ply", "SPZ 3": "v3.spz"}
VIEWERS = (
    Viewer(
        "Spark",
        ("@sparkjsdev/spark", "three"),
        "set to our convention, and not to pack (`extSplats`)",
        _ALL | {"SPZ 4": "v4.spz", "SOG": "few.sog"},
        _SPARK.replace("OPTIONS", _TOLD).replace("PRECISION", "extSplats: true"),
    ),
    Viewer(
        "Spark",
        ("@sparkjsdev/spark", "three"),
        "as it comes",
        {"PLY": "baked.ply"},
        _SPARK.replace(", OPTIONS", "").replace(", PRECISION", ""),
    ),
    Viewer(
        "PlayCanvas",
        ("playcanvas",),
        "as it comes, no tone mapping",
        {"PLY": "baked.ply", "glTF": "a.glb", "SOG": "few.sog", "compressed PLY": "theirs.compressed.ply"},
        _PLAYCANVAS,
    ),
    Viewer(
        "GaussianSplats3D",
        ("@mkkellogg/gaussian-splats-3d", "three"),
        "SH degree 2, which is its most",
        _ALL,
        _GS3D,
    ),
)


@contextmanager
def browser() -> Iterator[Any]:
    """An empty page of a headless Chromium, drawn by the processor."""
    wanted("playwright", "playwright")
    found = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        raise MissingError("there is no Chromium (apt install chromium, or set CHROMIUM)")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        arguments = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
        running = playwright.chromium.launch(executable_path=found, args=arguments)
        yield running.new_page()
        running.close()


@contextmanager
def served(scratch: Path, page: str) -> Iterator[str]:
    """The page, the files and the packages from this machine; the address."""

    class Handler(http.server.SimpleHTTPRequestHandler):
        def translate_path(self, path: str) -> str:
            path = path.partition("?")[0]
            for begin, folder in (("/node_modules/", str(MODULES)), ("/scratch/", str(scratch))):
                if path.startswith(begin):
                    return str(Path(folder) / path.removeprefix(begin))
            return str(scratch / "page.html")

        def log_message(self, format: str, *args: Any) -> None:
            """Nobody reads it."""

    Handler.extensions_map = {**Handler.extensions_map, ".mjs": "text/javascript", ".js": "text/javascript"}
    (scratch / "page.html").write_text(page, encoding="utf-8")
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()


def shot(page: Any, address: str, file: str, camera: Camera, up: Up) -> np.ndarray:
    """``[H, W, 3]`` uint8: what the viewer shows from a camera, which is turned into the file's axes."""
    pose = np.eye(4)
    pose[:3] = turn_of_up("z", up) @ camera.camera_to_world[:3]
    angle = math.degrees(2.0 * math.atan(0.5 * camera.height / camera.fy))
    page.set_viewport_size({"width": camera.width, "height": camera.height})
    from playwright.sync_api import Error as PlaywrightError

    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    view = json.dumps(pose.ravel().tolist())
    page.goto(f"{address}?file={file}&angle={angle}&view={view}")
    try:
        page.wait_for_function("window.done === true", timeout=20_000 if errors else PATIENCE)
    except PlaywrightError as error:
        raise MissingError(f"it did not show it ({' '.join((errors or [str(error)])[:1]):.120})") from error
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))


if __name__ == "__main__":
    sys.exit(main())
