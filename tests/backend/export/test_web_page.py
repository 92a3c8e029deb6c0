# SPDX-License-Identifier: GPL-3.0-or-later
"""The files of a web page: what they hold, what is refused, what is never overwritten."""

import base64
import hashlib
import json
import os
import re
import shutil
import subprocess
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from physhdr.backend.cli import main, web
from physhdr.backend.export import web_page
from physhdr.backend.export.quantised import quantised
from physhdr.backend.export.web_page import WebPage, WebView, write_web_page
from physhdr.backend.scene import READERS, Scene
from physhdr.backend.scene.camera import Camera
from physhdr.bridge.errors import BadValueError, OutputError
from physhdr.bridge.gaussian_ply import write_standard_ply
from physhdr.bridge.model_file import Model, write_model
from physhdr.tests.backend.export.test_quantised import some_model


def facts_of(html: str) -> dict:
    """What the page's script is told."""
    return json.loads(re.search(r"window\.MODEL_FACTS = (.*);\n</script>", html).group(1))


def data_of(scripts: str) -> bytes:
    """What the parts in some scripts unpack to."""
    parts = re.findall(r'MODEL_PART\((\d+),"([A-Za-z0-9+/=]*)"\);', scripts)
    assert [int(index) for index, _ in parts] == list(range(len(parts)))
    return zlib.decompress(b"".join(base64.b64decode(text) for _, text in parts))


def pose(rotation: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, (1.0, 2.0, 3.0)
    return matrix


@pytest.mark.parametrize("single", [False, True])
def test_the_page_holds_the_model(tmp_path, monkeypatch, single):
    monkeypatch.setattr(web_page, "PART_BYTES", 3000)  # several parts
    model, seen = some_model(), []
    out = tmp_path / ("scene.html" if single else "scene")
    written = write_web_page(out, model, WebPage("A scene"), single, seen.append)
    html = written.page.read_text()
    facts = facts_of(html)
    files = [entry["file"] for entry in facts["parts"]]
    assert len(files) > 3
    if single:
        assert files == [""] * len(files) and [p.name for p in tmp_path.iterdir()] == ["scene.html"]
        scripts = html
    else:
        (viewer,) = re.findall(r'<script src="(.*?)"', html)
        assert {p.name for p in out.iterdir()} == {"index.html", viewer, *files}
        # Each name says what is in the file: sha256, as any program has it.
        for name in (viewer, *files):
            digest = hashlib.sha256((out / name).read_bytes()).hexdigest()
            assert re.fullmatch(rf"(viewer|model-\d\d\d)-{digest[:12]}\.js", name)
        scripts = "".join((out / name).read_text() for name in files)
    assert data_of(scripts) == quantised(model).raw()
    assert facts["bytes"] == len(quantised(model).raw())
    assert written.gaussians == facts["count"] == model.count
    assert written.page_bytes == sum(p.stat().st_size for p in tmp_path.rglob("*") if p.is_file())
    assert seen == sorted(seen) and seen[-1] == 1.0
    # Nothing that a browser refuses from disk, and nothing from elsewhere.
    assert 'type="module"' not in html and "fetch(" not in html + web_page.viewer()
    assert not re.search(r"(src|href)=\"(https?:)?//", html)


def test_names_cannot_become_markup(tmp_path):
    name = '</script><script>alert(1)</script> & "@CSS@" <!--'
    model = some_model(count=4, lights=1)
    model = Model(**{**vars(model), "lights": (name,)})
    html = write_web_page(tmp_path / "x", model, WebPage(name, notes=(name,))).page.read_text()
    assert facts_of(html)["title"] == name and facts_of(html)["lights"] == [name]
    assert html.count("<script") == 2 and "alert(1)</script>" not in html
    assert "<title>&lt;/script&gt;&lt;script&gt;alert(1)&lt;/script&gt; &amp; &quot;@CSS@&quot;" in html


def test_cameras_are_told_as_they_are():
    rng = np.random.default_rng(1)
    for _ in range(50):
        rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        rotation *= np.linalg.det(rotation)
        camera = Camera(pose(rotation), 640, 480, 500.0, 510.0, 300.0, 250.0)
        facts = web_page.page_facts(*facts_input([WebView("test/0", camera)]))
        (row,) = facts["cameras"]
        w, x, y, z = row["turn"]
        back = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        np.testing.assert_allclose(back, rotation, atol=1e-6)
        assert row["lens"] == [500 / 640, 510 / 480, 300 / 640, 250 / 480, 640 / 480]


def facts_input(views: list[WebView]) -> tuple:
    model = some_model(count=3)
    return model, WebPage("x", views), quantised(model)


def test_up_is_z_unless_the_cameras_say_otherwise():
    level = Camera.from_field_of_view(pose(np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)), 10, 10, 1.0)
    y_up = Camera.from_field_of_view(pose(np.eye(3)), 10, 10, 1.0)
    upside = Camera.from_field_of_view(pose(np.diag([-1.0, -1.0, 1.0])), 10, 10, 1.0)
    up = lambda *cameras: web_page.page_facts(*facts_input([WebView("", c) for c in cameras]))["up"]  # noqa: E731
    assert up(level) == [0.0, 0.0, 1.0]
    assert up(y_up) == [0.0, 1.0, 0.0]
    assert up(y_up, upside) == [0.0, 0.0, 1.0]  # they agree on nothing


def test_up_is_z_where_that_is_known():
    """Cameras that all look down by 35°, on an arc before a thing, have a mean up that leans away from it."""
    arc = []
    for angle in np.radians(np.linspace(-60.0, 60.0, 9)):
        down = np.radians(35.0)
        backward = np.array([np.sin(angle) * np.cos(down), -np.cos(angle) * np.cos(down), np.sin(down)])
        right = np.array([np.cos(angle), np.sin(angle), 0.0])
        rotation = np.stack([right, np.cross(backward, right), backward], axis=1)
        arc.append(WebView("", Camera.from_field_of_view(pose(rotation), 10, 10, 1.0)))
    model, page, packed = facts_input(arc)
    assert web_page.page_facts(model, page, packed)["up"][2] < np.cos(np.radians(20.0))
    assert web_page.page_facts(model, replace(page, is_upright=True), packed)["up"] == [0.0, 0.0, 1.0]
    # Without cameras the page has one of its own, in Blender's world.
    assert web_page.page_facts(*facts_input([]))["up"] == [0.0, 0.0, 1.0]


def test_worlds_of_structure_from_motion_stand_as_their_cameras_do(tmp_path):
    scene = Scene(tmp_path, "x", [], [], [])
    known = {layout: web.is_upright(replace(scene, layout=layout)) for layout in READERS}
    assert [layout for layout, upright in known.items() if upright] == ["HDR-NeRF-Syn", "NeRF-Synthetic"]
    ours = replace(scene, layout="COLMAP", info={"generator": {}})
    assert web.is_upright(ours) and web.is_upright(replace(scene, layout="PhysHDR"))
    (tmp_path / "prepare.json").write_text("{}")  # which turns its world so that +Z is up
    assert web.is_upright(replace(scene, layout="COLMAP"))


def test_another_programs_ply_stands_upright_and_its_notes_are_told(tmp_path, monkeypatch, capsys):
    """A pole along COLMAP's up, −Y, which is Z on the page; one of its Gaussians is damaged."""
    position = np.zeros((20, 3), np.float32)
    position[:, 1] = np.linspace(-10.0, 0.0, 20)
    rotation, scale = np.tile(np.float32([1, 0, 0, 0]), (20, 1)), np.full((20, 3), 0.1, np.float32)
    colour_sh = np.zeros((20, 1, 3), np.float32)
    opacity = np.full(20, 0.9, np.float32)
    write_standard_ply(tmp_path / "a.ply", position, rotation, scale, opacity, colour_sh, up="colmap")
    spoiled = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(spoiled[:-4] + np.float32(np.nan).tobytes())
    pages = []
    monkeypatch.setattr(web, "write_web_page", lambda *given: pages.append(given) or write_web_page(*given))
    assert main(["export", str(tmp_path / "a.ply"), str(tmp_path / "site"), "--web"]) == 0
    _, model, page, *_ = pages[0]
    expected = np.zeros((19, 3))
    expected[:, 2] = np.linspace(10.0, 0.0, 20)[:-1]
    np.testing.assert_allclose(model.position, expected, atol=1e-5)
    told = " ".join(capsys.readouterr().out.split())
    for note in ("1 Gaussian", "linearised as sRGB"):
        assert any(note in line for line in page.notes) and note in told


def test_the_learned_response_is_told_as_it_is():
    x = np.array([-3.0, -1.0, 0.0, 2.0], np.float32)
    y = np.array([[0.0, 0.1, 0.0], [0.2, 0.2, 0.1], [0.5, 0.6, 0.7], [1.0, 0.9, 1.0]], np.float32)
    model = some_model(count=3)
    model = Model(
        **{**vars(model), "tone_curve_log_exposure": x, "tone_curve": y, "exposures": (0.5, 2.0, 8.0)}
    )
    facts = web_page.page_facts(model, WebPage("x"), quantised(model))
    rows = np.array(facts["curve"]["rows"])
    even = np.linspace(-3.0, 2.0, len(rows))
    for channel in range(3):
        np.testing.assert_allclose(rows[:, channel], np.interp(even, x, y[:, channel]), atol=1e-6)
    assert facts["exposure"] == {"start": 1.0, "range": [-5.0, 7.0]}  # 2 s; 1/32 to 128 s


def test_another_page_is_not_replaced_and_ours_is(tmp_path):
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "index.html").write_text("<h1>My home</h1>")
    with pytest.raises(OutputError, match="did not write it"):
        write_web_page(folder, some_model(count=4), WebPage("x"))
    assert [p.name for p in folder.iterdir()] == ["index.html"]


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_files_beside_the_page_that_are_not_ours_stay(tmp_path):
    theirs = {name: f"my own {name}" for name in ("viewer.js", "model-000.js", "model-001.js", "notes.txt")}
    for name, text in theirs.items():
        (tmp_path / name).write_text(text)
    for count in (4, 5, 6):
        write_web_page(tmp_path, some_model(count=count), WebPage("x"))
        assert contents(tmp_path).items() >= theirs.items()
    assert facts_of((tmp_path / "index.html").read_text())["count"] == 6
    # Of the two pages before nothing is left: a page, its viewer and its one part are there.
    assert len(contents(tmp_path)) == len(theirs) + 3


def as_before(folder: Path) -> None:
    """Give the files of a page the names that they had at first, which said nothing of what is in them."""
    html = (folder / "index.html").read_text()
    for path in sorted(folder.glob("*.js")):
        old = re.sub(r"-[0-9a-f]{12}\.js$", ".js", path.name)
        html = html.replace(path.name, old)
        path.rename(folder / old)
    (folder / "index.html").write_text(html)


def test_a_page_of_an_earlier_version_is_replaced(tmp_path, monkeypatch):
    monkeypatch.setattr(web_page, "PART_BYTES", 3000)
    write_web_page(tmp_path, some_model(), WebPage("x"))
    as_before(tmp_path)
    assert {"viewer.js", "model-000.js", "model-001.js"} <= contents(tmp_path).keys()
    monkeypatch.setattr(web_page, "PART_BYTES", 3_000_000)
    for name in ("model-099.js", "viewer-mine.js"):
        (tmp_path / name).write_text("mine")
    write_web_page(tmp_path, some_model(count=4), WebPage("y"))
    files = [entry["file"] for entry in facts_of((tmp_path / "index.html").read_text())["parts"]]
    assert len(files) == 1
    assert {name for name in contents(tmp_path) if not name.startswith("viewer-")} == {
        "index.html",
        *files,
        "model-099.js",
    }
    assert len(list(tmp_path.glob("viewer*.js"))) == 2 and (tmp_path / "viewer-mine.js").exists()


def test_what_a_page_says_of_others_files_removes_none(tmp_path):
    """An index.html of ours that somebody edited."""
    folder = tmp_path / "site"
    write_web_page(folder, some_model(count=4), WebPage("x"))
    html = (folder / "index.html").read_text()
    (name,) = [entry["file"] for entry in facts_of(html)["parts"]]
    theirs = tmp_path / "model-000.js"
    for path in (theirs, folder / "mine.js"):
        path.write_text("mine")
    for edited in (
        html.replace(name, "../model-000.js").replace(
            "<script src", '<script src="mine.js"></script><script src'
        ),
        html.replace('"parts":[', '"parts":[7,'),
        html.replace("window.MODEL_FACTS = {", "window.MODEL_FACTS = {,"),
    ):
        (folder / "index.html").write_text(edited)
        write_web_page(folder, some_model(count=5), WebPage("x"))
        assert theirs.exists() and (folder / "mine.js").exists()


@pytest.mark.parametrize("at", [0, 2, "index.html"])
def test_an_export_that_ends_early_leaves_the_page_before_whole(tmp_path, monkeypatch, at):
    monkeypatch.setattr(web_page, "PART_BYTES", 3000)
    write_web_page(tmp_path, some_model(), WebPage("x"))
    before, write, written = contents(tmp_path), web_page._write, []

    def full(path: Path, *others) -> int:
        if path.name == at or len(written) == at:
            raise OutputError("no space left", "Make room.")
        written.append(path.name)
        return write(path, *others)

    monkeypatch.setattr(web_page, "_write", full)
    with pytest.raises(OutputError, match="no space"):
        write_web_page(tmp_path, some_model(count=300, seed=9), WebPage("y"))
    assert contents(tmp_path) == before


def test_a_page_that_appears_meanwhile_is_not_replaced(tmp_path):
    def somebody(done: float) -> None:
        tmp_path.joinpath("index.html").write_text("<h1>My home</h1>")

    with pytest.raises(OutputError, match="did not write it"):
        write_web_page(tmp_path, some_model(count=4), WebPage("x"), report=somebody)
    assert contents(tmp_path) == {"index.html": "<h1>My home</h1>"}


@pytest.mark.parametrize("kind", ["link", "folder", "pipe"])
def test_what_is_no_file_is_not_replaced(tmp_path, never_waits, kind):
    target = tmp_path / "page.html"
    ours = write_web_page(tmp_path / "ours.html", some_model(count=4), WebPage("x"), True).page
    {"link": lambda: target.symlink_to(ours), "folder": target.mkdir, "pipe": lambda: os.mkfifo(target)}[
        kind
    ]()
    before = ours.read_bytes()
    with pytest.raises(OutputError, match="did not write it"):
        write_web_page(target, some_model(count=5), WebPage("x"), True)
    assert ours.read_bytes() == before and target.is_symlink() == (kind == "link")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--web",), "--web needs an output"),
        ((), "no output was given"),
        (("out.html", "--exposure-ev", "2"), "--exposure-ev has no effect on a web page"),
        (("out", "--web", "--lighting-levels", "ambient=2"), "--lighting-levels"),
        (("out", "--web", "--data", "x"), "--data"),
    ],
)
def test_what_does_not_fit_together_is_refused(tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    write_model(Path("m.safetensors"), some_model(count=4))
    assert main(["export", "m.safetensors", *words]) == 1
    assert message in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["m.safetensors"]


def test_damaged_models_are_refused(tmp_path, capsys):
    file = tmp_path / "m.safetensors"
    write_model(file, some_model(count=4))
    content = bytearray(file.read_bytes())
    content[-4:] = np.float32("nan").tobytes()
    file.write_bytes(content)
    assert main(["export", str(file), str(tmp_path / "out"), "--web"]) == 1
    assert "NaN" in capsys.readouterr().err
    with pytest.raises(BadValueError, match="no Gaussians"):
        some_model(count=0)
    assert not (tmp_path / "out").exists()


def test_a_program_is_told_json(tmp_path, capsys):
    file = tmp_path / "m.safetensors"
    write_model(file, some_model(count=4))
    assert main(["export", str(file), str(tmp_path / "out"), "--web", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[-1]["result"]["out"] == str(tmp_path / "out" / "index.html")
    assert lines[-2]["progress"] == 1.0
    assert main(["export", str(tmp_path / "no.safetensors"), str(tmp_path / "out"), "--web", "--json"]) == 1
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["error"]["code"] == "file_missing"


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node, to read JavaScript")
def test_the_script_is_one_classic_script(tmp_path):
    script = tmp_path / "viewer.js"
    script.write_text(web_page.viewer())
    subprocess.run(["node", "--check", script], check=True)


#: Reads a page's facts and its parts' scripts from standard input, and writes how loading it ended.
LOADING = """
const [facts, scripts] = JSON.parse(require("fs").readFileSync(0, "utf8"));
globalThis.window = globalThis;
globalThis.document = { readyState: "complete" };
process.on("unhandledRejection", (error) => { console.log("unhandled", error.message); process.exit(1); });
const waited = setTimeout(() => { console.log("still loading"); process.exit(1); }, 10_000);
const told = (text) => { console.log(text); clearTimeout(waited); };
const run = (0, eval)(`(() => { ${process.argv[1]}; return { loadPlanes, PageError }; })()`);
(0, eval)(scripts);
run.loadPlanes(facts, () => {}).then(
  (planes) => told(`planes ${Object.keys(planes)}`),
  (error) => told(`${error instanceof run.PageError} ${error.message}`));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node, to run JavaScript")
@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda facts, data: data, "planes all"),
        # The facts of a smaller page: unpacked it is more than there is room for, and far from its end.
        (lambda facts, data: facts.update(bytes=1000) or data, "true .* damaged: there are too many"),
        (lambda facts, data: facts.update(bytes=facts["bytes"] + 1) or data, "true .* not whole"),
        (lambda facts, data: data[: len(data) // 2], "true .* damaged"),
        (lambda facts, data: bytes(len(data)), "true .* damaged"),
    ],
)
def test_data_that_do_not_fit_the_page_are_told(spoil, told):
    raw = np.random.default_rng(0).bytes(1_000_000)
    facts = {"bytes": len(raw), "planes": [["all", len(raw)]]}
    data = spoil(facts, zlib.compress(raw))
    pieces = [data[at : at + 50_000] for at in range(0, len(data), 50_000)]
    facts["parts"] = [{"file": "", "size": len(piece)} for piece in pieces]
    scripts = "".join(web_page._script_of_part(index, piece) for index, piece in enumerate(pieces))
    source = (web_page.ASSETS / "data.js").read_text()
    ran = subprocess.run(
        ["node", "-e", LOADING, source], input=json.dumps([facts, scripts]), capture_output=True, text=True
    )
    assert re.match(told, ran.stdout), ran.stdout + ran.stderr
    assert ran.returncode == 0
