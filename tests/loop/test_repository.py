# SPDX-License-Identifier: GPL-3.0-or-later
"""The repository of extensions that `make extension` writes, served as by any static server, in Blender."""

import functools
import hashlib
import http.server
import importlib.util
import json
import re
import shutil
import subprocess
import sys
import threading
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
TOOL = ROOT / "tools" / "build_extension.py"
#: What edits sys.path, and why it may: neither runs inside a Blender that has the extension enabled.
OWN_PROCESSES = {"backend/launch.py", "synth/make_scene.py"}


def build_tool():
    spec = importlib.util.spec_from_file_location("build_extension", TOOL)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """What `make extension` puts into dist/."""
    out = tmp_path_factory.mktemp("repository")
    subprocess.run([sys.executable, TOOL, "--out", out], check=True, capture_output=True)
    return out


@pytest.fixture
def zipped(built) -> Path:
    [path] = built.glob("physhdr-*.zip")
    return path


def test_the_index_names_the_zip_by_a_relative_path_with_its_size_and_hash(built, zipped):
    index = json.loads((built / "index.json").read_text())
    [entry] = index["data"]
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text())
    assert entry["archive_url"] == f"./{zipped.name}"
    assert entry["archive_size"] == zipped.stat().st_size
    assert entry["archive_hash"] == f"sha256:{hashlib.sha256(zipped.read_bytes()).hexdigest()}"
    for name in ("id", "version", "website", "blender_version_min", "permissions"):
        assert entry[name] == manifest[name]
    assert "blender_version_max" not in entry  # 5.3 takes it as it is


def test_the_website_is_the_projects_address_or_the_papers_while_there_is_none():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text())
    urls = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"].get("urls", {})
    paper = re.findall(r'^\s+url: "(\S+)"', (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert manifest["website"] in (list(urls.values()) or paper)


def test_nothing_edits_the_path_of_modules_where_blender_loads_the_extension(zipped):
    with zipfile.ZipFile(zipped) as archive:
        edits = {
            name
            for name in archive.namelist()
            if name.endswith(".py") and re.search(rb"sys\.path\s*(\+=|\[|\.|=[^=])", archive.read(name))
        }
    assert edits == OWN_PROCESSES
    # One is the trainer's, in a Python that has no Blender; the other edits it only where it is the script.
    script = (ROOT / "synth" / "make_scene.py").read_text()
    body = script.split("def _load_package")[1].split("\n\n\n")[0]
    assert "sys.path" in body and "sys.path" not in script.replace(body, "")
    assert 'if not globals().get("__package__")' in script and script.count("_load_package()") == 2


@pytest.fixture
def served(built, tmp_path):
    """An address at which a copy of ``built`` is served, and its folder."""
    folder = tmp_path / "served"
    shutil.copytree(built, folder)

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format, *args):
            """Nothing."""

    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Handler, directory=str(folder))
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}/index.json", folder
    server.shutdown()
    server.server_close()


def newer_version(zipped: Path, folder: Path) -> str:
    """The same extension as a newer one, with its index, in ``folder``; its version."""
    folder.mkdir()
    with zipfile.ZipFile(zipped) as old:
        manifest = old.read("blender_manifest.toml").decode()
        version = tomllib.loads(manifest)["version"]
        major, minor, patch = version.split(".")
        newer = f"{major}.{minor}.{int(patch) + 1}"
        raised = manifest.replace(f'version = "{version}"', f'version = "{newer}"', 1)
        assert tomllib.loads(raised)["version"] == newer
        with zipfile.ZipFile(folder / f"physhdr-{newer}.zip", "w", zipfile.ZIP_DEFLATED) as new:
            for name in old.namelist():
                new.writestr(name, raised if name == "blender_manifest.toml" else old.read(name))
    tool = build_tool()
    assert tool.write_index(tool.extension_tool(), folder) == 0
    return newer


@pytest.mark.long
def test_blender_installs_from_it_is_offered_a_newer_version_and_updates(
    served, built, zipped, in_blender, tmp_path
):
    url, folder = served
    version = tomllib.loads((ROOT / "blender_manifest.toml").read_text())["version"]
    newer = newer_version(zipped, tmp_path / "newer")
    arguments = ["--url", url, "--served", folder, "--newer", tmp_path / "newer"]
    in_blender(
        "tests/loop/use_repository.py",
        *arguments,
        "--out",
        tmp_path / "seen.json",
        BLENDER_USER_RESOURCES=str(tmp_path / "blender"),
        HOME=str(tmp_path),
    )
    seen = json.loads((tmp_path / "seen.json").read_text())
    assert seen["listed"] == {"physhdr": version} and seen["installed"] == version
    assert seen["outdated"] == 0 and "model_import" in seen["operators"]
    assert seen["module"] == "bl_ext.ours.physhdr"
    assert set(seen["new_paths"]) <= {seen["site_packages"]}  # Blender's own, for the wheels
    assert seen["outdated_later"] == 1
    assert seen["updated"] == newer and seen["outdated_after"] == 0 and seen["enabled"]
