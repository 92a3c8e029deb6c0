# SPDX-License-Identifier: GPL-3.0-or-later
"""The installer, with small packages and indexes on this machine: what is locked, from where it may come.

The real pip; no network.
"""

import errno
import hashlib
import http.server
import importlib.util
import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import threading
import venv
import zipfile
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parent.parent.parent / "addon" / "scripts" / "install_backend.py"
#: Instead of backend/launch.py: the check that ends an installation, which says what can be imported.
LAUNCHER = """
import importlib.metadata as m, json, sys
found = {d.metadata["Name"]: d.version for d in m.distributions()}
import torch
print(json.dumps({"result": {"versions": found, "torch": torch.FROM}}))
"""


def wheel(folder: Path, name: str, version: str, module: str = "", requires: tuple[str, ...] = ()) -> str:
    """A wheel of one module; returns its SHA-256."""
    info = f"{name.replace('-', '_')}-{version}.dist-info"
    metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
    files = {
        f"{name.replace('-', '_')}.py": module,
        f"{info}/METADATA": metadata + "".join(f"Requires-Dist: {each}\n" for each in requires),
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    files[f"{info}/RECORD"] = "".join(f"{each},,\n" for each in files) + f"{info}/RECORD,,\n"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name.replace('-', '_')}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for each, text in files.items():
            archive.writestr(zipfile.ZipInfo(each), text)  # of no date: the same bytes each time
    return hashlib.sha256(path.read_bytes()).hexdigest()


class Index:
    """A package index on this machine, which remembers whose page it was asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.asked = folder, set()
        index = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self):
                name = self.path.strip("/").split("/")[-1]
                body = index.answer(name)
                self.send_response(200 if body is not None else 404)
                self.send_header("Content-Type", "text/html" if body else "text/plain")
                self.end_headers()
                self.wfile.write(body or b"")

            def log_message(self, *_):
                pass

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        self.url = f"http://127.0.0.1:{self.server.server_port}/simple"

    def answer(self, name: str) -> bytes | None:
        if name.endswith(".whl"):
            return (self.folder / name).read_bytes()
        self.asked.add(name)
        files = sorted(self.folder.glob(f"{name.replace('-', '_')}-*.whl"))
        return "".join(f'<a href="/{file.name}">{file.name}</a>' for file in files).encode() or None


@pytest.fixture(scope="module")
def empty(tmp_path_factory):
    """An environment with nothing but pip, to be copied: making one takes seconds."""
    folder = tmp_path_factory.mktemp("empty") / "environment"
    venv.EnvBuilder(with_pip=True, symlinks=os.name != "nt").create(folder)
    return folder


@pytest.fixture(scope="module")
def ground(tmp_path_factory):
    """A folder, always the same, for environments know their place; and its indexes by name."""
    root = tmp_path_factory.mktemp("ground") / "place"
    indexes = {name: Index(root / name) for name in ("pytorch", "cu130", "cu126", "mine", "extra")}
    yield root, indexes
    for index in indexes.values():
        index.server.shutdown()


@pytest.fixture
def place(ground, empty):
    """An extension whose locks name small packages; PyTorch's index, the user's own and a second one."""

    class Place:
        root, indexes = ground
        extension, target = root / "extension", root / "environments"
        hashes: dict = {}  # noqa: RUF012

        def installed(self) -> Path:
            """The environment that a first installation makes: made once, then copied."""
            kept = self.root.parent / "installed"
            if not kept.exists():
                status, _, log = self.install()
                assert status == 0, log
                shutil.copytree(self.target, kept, symlinks=True)
            elif not self.target.exists():
                shutil.copytree(kept, self.target, symlinks=True)
            [made] = environments(self)
            return made

        def lock(self, name: str, **pins: str) -> None:
            """A lock of packages, each 1.0; of several files of one, the hashes are apart by blanks."""
            lines = []
            for each, digests in pins.items():
                hashes = [f"--hash=sha256:{digest}" for digest in digests.split()]
                lines.append(" ".join([f"{each.replace('_', '-')}==1.0", *hashes]) + "\n")
            (self.extension / "locks" / name).write_text("# a lock\n" + "".join(lines))

        def driver_says(self, *card: str) -> dict[str, str]:
            """The environment of a machine whose driver's program tells of that card."""
            smi = self.root / "bin" / "nvidia-smi"
            smi.parent.mkdir(exist_ok=True)
            smi.write_text(f"#!/bin/sh\necho '{', '.join(card)}'\n")
            smi.chmod(0o755)
            return {"PATH": f"{smi.parent}{os.pathsep}{os.environ['PATH']}"}

        def install(self, torch: str = "cpu", *more: str, **environment: str) -> tuple[int, list[dict], str]:
            """The status, the lines for the panel, and all that was written."""
            patched = (
                "import runpy, sys\n"
                f"sys.argv[0] = {str(SCRIPT)!r}\n"
                f"module = runpy.run_path({str(SCRIPT)!r})\n"
                f"module['TORCH_INDEX']['cpu'] = {self.indexes['pytorch'].url!r}\n"
                f"module['TORCH_INDEX']['cuda'] = {self.indexes['cu130'].url!r}\n"
                f"module['TORCH_INDEX']['cuda12'] = {self.indexes['cu126'].url!r}\n"
                "module['SPACE'].update(dict.fromkeys(module['SPACE'], 1))\n"
                "import shutil, venv\n"
                "def copy(self, folder):\n"
                "    shutil.rmtree(folder, ignore_errors=True)\n"
                "    shutil.copytree(self.empty, folder, symlinks=True)\n"
                f"venv.EnvBuilder.empty, venv.EnvBuilder.create = {str(empty)!r}, copy\n"
                "sys.exit(module['main']())\n"
            )
            clean = {k: v for k, v in os.environ.items() if not k.startswith("PIP_")}
            clean |= {
                "PIP_CONFIG_FILE": os.devnull,
                "PIP_INDEX_URL": self.indexes["mine"].url,
                "PIP_EXTRA_INDEX_URL": self.indexes["extra"].url,
                "PIP_NO_CACHE_DIR": "1",
            }
            launcher = str(self.extension / "backend" / "launch.py")
            command = [sys.executable, "-c", patched, "--target", str(self.target), "--launcher", launcher]
            done = subprocess.run(
                [*command, "--torch", torch, *more],
                capture_output=True,
                text=True,
                env={**clean, **environment},
            )
            said = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
            return done.returncode, said, done.stdout + done.stderr

    made = Place()
    shutil.rmtree(made.root, ignore_errors=True)
    for index in made.indexes.values():
        index.asked.clear()
    for name in ("locks", "backend"):
        (made.extension / name).mkdir(parents=True)
    (made.extension / "backend" / "launch.py").write_text(LAUNCHER)
    first = wheel(made.root / "mine", "first", "1.0", requires=("second",))
    second = wheel(made.root / "mine", "second", "1.0")
    torch = wheel(made.root / "pytorch", "torch", "1.0", "FROM = 'pytorch'", ("first",))
    made.hashes = {"first": first, "second": second, "torch": torch}
    wheel(made.root / "mine", "torch", "1.0", "FROM = 'mine'", ("first", "nvidia-thing"))
    wheel(made.root / "extra", "torch", "1.0", "FROM = 'extra'")
    for name in ("torch", "first", "second"):  # what somebody else offers under these names is newer
        wheel(made.root / "extra", name, "9.0", "FROM = 'extra'")
    made.lock("backend.txt", first=first, second=second)
    cu130 = wheel(made.root / "cu130", "torch", "1.0", "FROM = 'cu130'", ("first", "nvidia-thing"))
    cu126 = wheel(made.root / "cu126", "torch", "1.0", "FROM = 'cu126'", ("first", "nvidia-thing-cu12"))
    made.lock("torch.txt", torch=f"{torch} {cu130} {cu126}")
    made.lock("torch-cuda.txt", nvidia_thing=wheel(made.root / "mine", "nvidia-thing", "1.0"))
    made.lock("torch-cuda12.txt", nvidia_thing_cu12=wheel(made.root / "mine", "nvidia-thing-cu12", "1.0"))
    made.lock("warp.txt", warp_of_13=wheel(made.root / "mine", "warp-of-13", "1.0"))
    made.lock("warp12.txt", warp_of_12=wheel(made.root / "mine", "warp-of-12", "1.0"))
    return made


def head(path: Path) -> bytes:
    return path.read_bytes()[:4096]


def environments(place) -> list[Path]:
    return sorted(place.target.glob("environment-*"))


def test_torch_comes_from_pytorchs_index_alone_and_all_else_by_the_users_settings(place):
    status, said, log = place.install()
    assert status == 0, log
    result = said[-1]["result"]
    assert result["torch"] == "pytorch"
    assert {name: result["versions"][name] for name in place.hashes} == dict.fromkeys(place.hashes, "1.0")
    assert place.indexes["pytorch"].asked == {"torch"}  # for nothing else
    assert "torch" not in place.indexes["mine"].asked | place.indexes["extra"].asked
    assert Path(result["environment"]).is_relative_to(place.target)
    fractions = [line["progress"] for line in said if "progress" in line]
    assert fractions == sorted(fractions) and 0.6 < fractions[-1] <= 0.8
    assert any(line.get("message", "").startswith("fetching torch") for line in said)
    # A second time it is there; a lock that has changed makes another, and the former goes.
    [made] = environments(place)
    assert place.install()[0] == 0 and environments(place) == [made]
    with open(place.extension / "locks" / "backend.txt", "a") as file:
        file.write("# renewed\n")
    assert place.install()[0] == 0
    assert len(environments(place)) == 1 and environments(place) != [made]


@pytest.mark.long
def test_what_a_new_version_needs_is_added_and_torch_is_not_downloaded_again(place):
    """As an environment of before photos were prepared in Blender: pycolmap is new, the rest is there."""
    former = place.installed()
    kept = former / next(path.relative_to(former) for path in former.rglob("torch.py"))
    inode = kept.stat().st_ino
    new = wheel(place.root / "mine", "pycolmap", "1.0", requires=("first",))
    place.lock("backend.txt", **{k: v for k, v in place.hashes.items() if k != "torch"}, pycolmap=new)
    for index in place.indexes.values():
        index.asked.clear()
    # With everything but the new package gone from everywhere.
    for name in ("mine/first", "mine/second", "mine/torch", "pytorch/torch"):
        (place.root / f"{name}-1.0-py3-none-any.whl").unlink()
    status, said, log = place.install("cpu", "--extend")
    assert status == 0, log
    [extended] = environments(place)
    assert extended != former and said[-1]["result"]["versions"]["pycolmap"] == "1.0"
    assert said[-1]["result"]["torch"] == "pytorch"
    asked = set().union(*(index.asked for index in place.indexes.values()))
    assert asked == {"pycolmap"}
    assert (extended / kept.relative_to(former)).stat().st_ino == inode  # not even copied
    # It is whole by itself: scripts name its own place.
    scripts = extended / ("Scripts" if os.name == "nt" else "bin")
    assert not [path for path in scripts.glob("*") if path.is_file() and os.fsencode(former) in head(path)]
    assert subprocess.run([scripts / "pip", "--version"], capture_output=True).returncode == 0
    # Without --extend, too; and there is nothing left to do.
    assert place.install()[0] == 0 and environments(place) == [extended]


@pytest.mark.long
def test_packages_go_into_the_environment_where_pips_settings_say_for_the_user(place):
    settings = place.root / "pip.conf"
    settings.write_text("[install]\nuser = true\n")
    status, _, log = place.install(PIP_CONFIG_FILE=str(settings))
    assert status == 0, log
    [made] = environments(place)
    assert list(made.rglob("first.py")) and list(made.rglob("torch.py"))


@pytest.mark.long
def test_an_extension_that_fails_leaves_the_former_environment_as_it_was(place):
    former = place.installed()
    before = {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in former.rglob("*.py")}
    wheel(place.root / "mine", "pycolmap", "1.0")
    place.lock("backend.txt", first=place.hashes["first"], pycolmap="0" * 64)
    status, said, _ = place.install("cpu", "--extend", PIP_EXTRA_INDEX_URL="")
    assert status == 1 and "pycolmap" in said[-1]["error"]["message"]
    assert environments(place) == [former] and (former / "physhdr-complete.json").exists()
    assert before == {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in former.rglob("*.py")}


@pytest.mark.long
def test_an_installation_anew_that_fails_leaves_the_former_environment_as_it_was(place):
    """And one that succeeds takes its place, again and again."""
    former = place.installed()
    assert place.install("cpu", "--fresh", PIP_EXTRA_INDEX_URL="", PIP_INDEX_URL="file:///nowhere")[0] == 1
    assert environments(place) == [former] and (former / "physhdr-complete.json").exists()
    assert place.install()[1][-1]["result"]["environment"].startswith(str(former)), "it is still used"
    assert place.install("cpu", "--fresh")[0] == 0
    [anew] = environments(place)
    assert anew != former and place.install()[0] == 0 and environments(place) == [anew]
    assert place.install("cpu", "--fresh")[0] == 0 and environments(place) == [former]


@pytest.mark.long
def test_the_former_environment_serves_until_the_new_one_has_passed_its_check(place):
    """Blender goes on with it, whatever the check of another version's, or of the same anew, ends with."""
    former = place.installed()
    launcher = place.extension / "backend" / "launch.py"
    launcher.write_text("raise SystemExit(3)")
    for _ in range(2):
        assert place.install("cpu", "--fresh")[0] == 3
        assert former in environments(place) and (former / "physhdr-complete.json").exists()
        assert len(environments(place)) == 2
    with open(place.extension / "locks" / "backend.txt", "a") as file:
        file.write("# renewed\n")
    assert place.install()[0] == 3
    assert former in environments(place) and (former / "physhdr-complete.json").exists()
    launcher.write_text(LAUNCHER)
    status, said, _ = place.install()
    assert status == 0 and [Path(said[-1]["result"]["environment"]).parent.parent] == environments(place)
    assert former not in environments(place)


def test_a_disk_that_is_full_while_files_are_taken_over_is_named(tmp_path, monkeypatch):
    (tmp_path / "former" / "lib").mkdir(parents=True)
    (tmp_path / "former" / "lib" / "first.py").touch()
    script = runpy.run_path(str(SCRIPT))

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setitem(script["take_over"].__globals__, "link_or_copy", full)
    with pytest.raises(script["InstallError"], match=r"first\.py cannot be copied: .*No space left"):
        script["take_over"](tmp_path / "former", tmp_path / "new")


@pytest.mark.long
def test_an_environment_of_another_build_or_python_is_not_taken_over(place):
    former = place.installed()
    stamp = former / "physhdr-complete.json"
    content = json.loads(stamp.read_text())
    for index, other in ((2, "3.11.0 (another)"), (3, "/elsewhere")):
        stamp.write_text(json.dumps([*content[:index], other, *content[index + 1 :]]))
        status, said, _ = place.install("cpu", "--extend")
        assert status == 1 and "no complete environment" in said[-1]["error"]["message"]
    stamp.write_text(json.dumps([content[0], "cuda", *content[2:]]))
    with open(place.extension / "locks" / "backend.txt", "a") as file:
        file.write("# renewed\n")
    place.indexes["pytorch"].asked.clear()
    status, _, log = place.install()
    assert status == 0, log
    assert place.indexes["pytorch"].asked == {"torch"} and environments(place) != [former]


@pytest.mark.parametrize("name", ["second", pytest.param("torch", marks=pytest.mark.long)])
def test_a_file_with_another_hash_stops_the_installation_and_nothing_stays(place, name):
    wheel(place.root / ("pytorch" if name == "torch" else "mine"), name, "1.0", "EVIL = True")
    status, said, log = place.install(PIP_EXTRA_INDEX_URL="")
    error = said[-1]["error"]
    assert status == 1 and error["code"] == "install_failed"
    assert error["message"].startswith(f"{name}==1.0 is not the file that was locked")
    assert "pip cache purge" in error["hint"] and "THESE PACKAGES DO NOT MATCH" in log
    assert environments(place) == []


def test_a_pin_without_a_hash_is_refused(place):
    (place.extension / "locks" / "backend.txt").write_text("first==1.0\nsecond==1.0\n")
    status, said, _ = place.install()
    assert status == 1 and "error" in said[-1] and environments(place) == []


@pytest.mark.long
def test_the_users_own_torch_brings_its_libraries_by_the_lock(place):
    status, said, log = place.install("pip", PIP_EXTRA_INDEX_URL="")
    assert status == 0, log
    assert said[-1]["result"]["torch"] == "mine" and "nvidia-thing" in said[-1]["result"]["versions"]
    assert place.indexes["pytorch"].asked == set()


@pytest.mark.long
def test_the_users_own_torch_for_cuda_12_gets_the_libraries_of_that(place):
    wheel(place.root / "mine", "torch", "1.0", "FROM = 'mine'", ("first", "nvidia-thing-cu12"))
    status, said, log = place.install("pip", PIP_EXTRA_INDEX_URL="")
    assert status == 0, log
    versions = said[-1]["result"]["versions"]
    assert "nvidia-thing-cu12" in versions and "nvidia-thing" not in versions


@pytest.mark.long
def test_a_torch_that_asks_for_what_was_never_locked_is_named(place):
    place.lock("torch-cuda.txt")
    status, said, _ = place.install("pip", PIP_EXTRA_INDEX_URL="")
    assert status == 1 and "nvidia-thing" in said[-1]["error"]["message"] and environments(place) == []


@pytest.mark.long
def test_an_index_that_cannot_be_reached_is_said_to_be_so(place):
    status, said, _ = place.install(
        PIP_INDEX_URL="http://127.0.0.1:1/simple", PIP_EXTRA_INDEX_URL="", PIP_RETRIES="1"
    )
    assert status == 1 and "cannot reach" in said[-1]["error"]["message"]
    assert "network" in said[-1]["error"]["hint"] and environments(place) == []


def test_an_extension_without_its_locks_says_to_install_it_again(place):
    (place.extension / "locks" / "torch.txt").unlink()
    status, said, _ = place.install()
    assert status == 1 and "torch.txt" in said[-1]["error"]["message"]
    assert said[-1]["error"]["hint"] == "Reinstall the extension."


# ---- cards -----------------------------------------------------------------------------------------------

NEW, OLD_DRIVER, OLD_CARD = (
    ("NVIDIA GeForce RTX 4070", "581.29", "8.9"),
    ("NVIDIA GeForce RTX 3060", "535.183.01", "8.6"),
    ("NVIDIA GeForce GTX 1080", "580.82.07", "6.1"),
)
#: Its nvidia-smi knows no ``compute_cap``.
OLDEST_DRIVER = ("Tesla T4", "470.256.02")


@pytest.fixture
def installer(monkeypatch) -> dict:
    """The script's names. A machine without any of the drivers' programs, until a test puts one there."""
    module = runpy.run_path(str(SCRIPT))
    monkeypatch.setattr("shutil.which", lambda name: None)
    return module


@pytest.mark.parametrize(
    ("system", "driver", "capability", "build"),
    [
        # Linux, x86-64: Ampere, Pascal, Turing, Maxwell; the oldest drivers of CUDA 12 and of CUDA 13.
        ("linux", "535.183.01", "8.6", "cuda12"),
        ("linux", "580.82.07", "6.1", "cuda12"),
        ("linux", "580.65.06", "7.5", "cuda"),
        ("linux", "575.57.08", "7.5", "cuda12"),
        ("linux", "525.60.13", "7.0", "cuda12"),
        ("linux", "525.53", "7.0", "driver .* is 525.53; .*525.60 or newer.* Install a newer driver"),
        ("linux", "470.256.02", "", "driver .* is 470.256.02; .*525.60 or newer.* Install a newer driver"),
        ("linux", "580.82.07", "5.2", "cuda12"),
        ("linux", "580.82.07", "5.0", "older than CUDA 12 builds know .capability 5.0; 5.2 is needed"),
        ("linux", "470.256.02", "3.5", "older than CUDA 12 builds know .capability 3.5; 5.2 is needed"),
        # Blackwell: CUDA 12.6 knows no code for it.
        ("linux", "580.82.07", "12.0", "cuda"),
        ("linux", "570.86.15", "12.0", "build for CUDA 13, .*580 or newer; it is 570.86.15. Install a newer"),
        # Windows has other numbers, and a torch without code for the oldest cards.
        ("windows", "551.86", "8.6", "cuda12"),
        ("windows", "528.33", "8.6", "cuda12"),
        ("windows", "527.41", "8.6", "driver .* is 527.41; .*528.33 or newer"),
        ("windows", "581.29", "7.5", "cuda"),
        ("windows", "581.29", "6.1", "cuda12"),
        ("windows", "581.29", "6.0", "older than .*; 6.1 is needed"),
        # ARM: Warp has no code for cards before Turing.
        ("aarch64", "535.183.01", "9.0", "cuda12"),
        ("aarch64", "535.183.01", "7.0", "older than .*; 7.5 is needed"),
        ("linux", "[N/A]", "[N/A]", "cuda"),
    ],
)
def test_the_build_is_the_one_that_card_and_driver_can_run(
    installer, monkeypatch, system, driver, capability, build
):
    monkeypatch.setattr("platform.machine", lambda: "aarch64" if system == "aarch64" else "x86_64")
    with monkeypatch.context() as faked:
        faked.setattr("os.name", "nt" if system == "windows" else "posix")
        chosen, why = installer["build_for"]([("A card", driver, capability)])
    if " " in build:
        assert chosen == "cpu" and re.search(build, why), why
    else:
        assert (chosen, why) == (build, "")


@pytest.mark.parametrize(
    ("cards", "build"),
    [([], "cuda"), ([OLD_CARD, NEW], "cuda"), ([(*OLDEST_DRIVER, ""), OLD_DRIVER], "cuda12")],
)
def test_of_several_cards_the_best_one_decides_and_of_none_the_check_will(installer, cards, build):
    assert installer["build_for"](cards) == (build, "")


@pytest.mark.parametrize(
    ("platform", "place"),
    [
        ("Linux", "/usr/bin/nvidia-smi"),
        ("WSL", "/usr/lib/wsl/lib/nvidia-smi"),
        ("Windows", r"C:\Windows\System32\nvidia-smi.exe"),
        ("Windows, an old driver", r"C:\Program Files\NVIDIA Corporation\NVSMI\nvidia-smi.exe"),
    ],
)
def test_the_drivers_program_is_found_where_each_system_has_it(installer, monkeypatch, platform, place):
    """Whatever is not there cannot be started; Windows' own variables are set as Windows sets them."""
    windows = platform.startswith("Windows")
    variables = {"SystemRoot": r"C:\Windows", "ProgramFiles": r"C:\Program Files"} if windows else {}

    def expanded(path: str) -> str:
        for name, value in variables.items():
            path = path.replace(f"%{name}%", value)
        return path

    def run(command, **_):
        if command[0] != place:
            raise FileNotFoundError(errno.ENOENT, "not there", command[0])
        return subprocess.CompletedProcess(command, 0, "\n".join(map(", ".join, [NEW, OLD_CARD])) + "\n", "")

    if platform == "Linux":
        monkeypatch.setattr("shutil.which", lambda name: place)
    monkeypatch.setattr("os.path.expandvars", expanded)
    monkeypatch.setattr("subprocess.run", run)
    assert installer["cards_here"]() == [NEW, OLD_CARD]


def test_a_driver_that_knows_no_capability_is_asked_for_the_rest(installer, monkeypatch):
    """As nvidia-smi before R510: one unknown field, and it answers nothing else."""

    def run(command, **_):
        if "compute_cap" in command[1]:
            refusal = 'Field "compute_cap" is not a valid field to query.\n\n'
            return subprocess.CompletedProcess(command, 2, refusal, "")
        return subprocess.CompletedProcess(command, 0, ", ".join(OLDEST_DRIVER) + "\n", "")

    monkeypatch.setattr("subprocess.run", run)
    cards = installer["cards_here"]()
    assert cards == [(*OLDEST_DRIVER, "")]
    chosen, why = installer["build_for"](cards)
    assert chosen == "cpu" and "470.256.02" in why


@pytest.mark.parametrize(
    ("status", "said"), [(9, "NVIDIA-SMI has failed, because it could not communicate"), (0, "a, b")]
)
def test_a_driver_that_says_nothing_of_use_is_as_none(installer, monkeypatch, status, said):
    done = subprocess.CompletedProcess([], status, said, "")
    monkeypatch.setattr("subprocess.run", lambda command, **_: done)
    assert installer["cards_here"]() == []


@pytest.mark.long
@pytest.mark.parametrize(
    ("card", "index", "library", "warp"),
    [
        (NEW, "cu130", "nvidia-thing", "warp-of-13"),
        (OLD_DRIVER, "cu126", "nvidia-thing-cu12", "warp-of-12"),
    ],
)
def test_a_card_gets_torch_and_warp_of_the_cuda_that_it_can_run(place, card, index, library, warp):
    status, said, log = place.install("cuda", PIP_EXTRA_INDEX_URL="", **place.driver_says(*card))
    assert status == 0, log
    result = said[-1]["result"]
    assert result["torch"] == index and result["warnings"] == []
    brought = {name for name in result["versions"] if name.startswith(("nvidia", "warp"))}
    assert brought == {library, warp}
    # What is added later is of the same build, whatever the driver says by then.
    [former] = environments(place)
    with open(place.extension / "locks" / "backend.txt", "a") as file:
        file.write("# renewed\n")
    status, said, log = place.install("cpu", "--extend", PIP_EXTRA_INDEX_URL="")
    assert status == 0, log
    assert environments(place) != [former] and said[-1]["result"]["torch"] == index


@pytest.mark.long
def test_a_new_driver_makes_another_environment(place):
    status, said, _ = place.install("cuda", PIP_EXTRA_INDEX_URL="", **place.driver_says(*OLD_DRIVER))
    [former] = environments(place)
    renewed = place.driver_says(OLD_DRIVER[0], "580.82.07", OLD_DRIVER[2])
    status, said, log = place.install("cuda", PIP_EXTRA_INDEX_URL="", **renewed)
    assert status == 0 and said[-1]["result"]["torch"] == "cu130", log
    assert len(environments(place)) == 1 and environments(place) != [former]


@pytest.mark.long
def test_a_card_that_can_run_no_build_gets_the_processors_and_the_reason(place):
    card = place.driver_says(*OLDEST_DRIVER, "7.5")
    status, said, log = place.install("cuda", PIP_EXTRA_INDEX_URL="", **card)
    assert status == 0, log
    [warning] = said[-1]["result"]["warnings"]
    assert "470.256.02" in warning and "Install a newer driver" in warning
    assert said[0] == {"progress": 0.0, "message": warning}  # before anything is fetched
    assert said[-1]["result"]["torch"] == "pytorch"
    assert not place.indexes["cu130"].asked | place.indexes["cu126"].asked
    assert not any(name.startswith(("nvidia", "warp")) for name in said[-1]["result"]["versions"])


@pytest.fixture
def script():
    """The script as a module."""
    spec = importlib.util.spec_from_file_location("install_backend", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclass looks there
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def below(length: int, of: str) -> Path:
    """A folder whose path has so many characters, with what an environment's own name adds."""
    return Path("C:" + "/x" * ((length - 2 - len(of)) // 2) + "y" * (length % 2 != len(of) % 2) + of)


def test_where_windows_paths_would_be_too_long_the_remedy_comes_before_the_download(script, monkeypatch):
    """Windows takes 259 characters, and pip has fetched everything before it meets the first longer one."""
    refuse = script.refuse_what_windows_cannot
    # The deepest file of torch 2.13.0+cu130.
    deepest = (
        "torch-2.13.0+cu130.dist-info/licenses/third_party/kineto/libkineto/third_party/dynolog/third_party/"
        "prometheus-cpp/3rdparty/civetweb/src/third_party/duktape-1.8.0/LICENSE.txt"
    )
    assert len(deepest) == script.LONGEST_PATH
    environment, packages = "/env-01234567", "/Lib/site-packages/"
    fits = below(259 - len(packages) - len(deepest), environment)
    assert len(f"{fits}{packages}{deepest}") == 259
    monkeypatch.setattr(script, "takes_long_paths", lambda folder: False)
    refuse(fits, "C:/Python312")
    too_long = fits.with_name(fits.name + "8")
    with pytest.raises(script.InstallError, match="paths of 260 characters") as caught:
        refuse(too_long, "C:/Python312")
    assert "1 characters shorter" in caught.value.hint and "LongPathsEnabled" in caught.value.hint
    monkeypatch.setattr(script, "takes_long_paths", lambda folder: True)
    refuse(too_long, "C:/Python312")


def test_whether_paths_may_be_long_is_tried_and_nothing_stays(script, tmp_path, monkeypatch):
    assert script.takes_long_paths(tmp_path) and not list(tmp_path.iterdir())
    (tmp_path / "long-paths").mkdir()  # of the user's
    assert script.takes_long_paths(tmp_path) and [path.name for path in tmp_path.iterdir()] == ["long-paths"]
    (tmp_path / "long-paths").rmdir()
    mkdir = os.mkdir

    def short(path, *mode):
        if len(str(path)) > 247:  # where Windows' own limit for folders is
            raise FileNotFoundError(errno.ENOENT, "The system cannot find the path specified", str(path))
        mkdir(path, *mode)

    monkeypatch.setattr(os, "mkdir", short)
    assert not script.takes_long_paths(tmp_path) and not list(tmp_path.iterdir())


def test_a_python_of_the_store_is_refused(script, tmp_path):
    """What it writes below AppData lands in a folder of the Store's, where Blender does not look."""
    base = "C:/Program Files/WindowsApps/PythonSoftwareFoundation.Python.3.12_3.12.2800.0_x64__qbz5n2kfra8p0"
    with pytest.raises(script.InstallError, match="Microsoft's Store") as caught:
        script.refuse_what_windows_cannot(tmp_path / "env-01234567", base)
    assert "python.org" in caught.value.hint


def test_only_environments_that_were_made_here_are_removed(script, tmp_path):
    """The user may have chosen a folder in which others have theirs."""
    whole, other = script.PREFIX + "0f" * (script.DIGITS // 2), script.OTHER
    date = f"{script.PREFIX}{'20261127' * 2}"[: len(whole)]
    unfinished = script.PREFIX + "ab" * (script.DIGITS // 2)
    theirs = [f"{script.PREFIX}of-mine", f"{whole}.old", f"{whole}{other}{other}", whole[:-1], date]
    for name in (whole, f"{whole}{other}", unfinished, f"{date}{other}", *theirs):
        (tmp_path / name).mkdir()
        (tmp_path / name / "thesis.txt").write_text("")
    (tmp_path / f"{date}{other}" / script.STAMP).write_text("[]")
    script.remove_others(tmp_path / whole)
    assert {path.name for path in tmp_path.iterdir()} == {whole, *theirs}
    assert all((tmp_path / name / "thesis.txt").exists() for name in theirs)


def test_what_cannot_be_removed_whole_is_no_longer_complete(script, tmp_path, monkeypatch):
    """Windows keeps the libraries that a backend has loaded."""
    folder = tmp_path / "env-01234567"
    folder.mkdir()
    (folder / "torch.dll").write_text("")
    (folder / script.STAMP).write_text("[]")
    monkeypatch.setattr(script.shutil, "rmtree", lambda *words, **options: None)
    script.remove(folder)
    assert [path.name for path in folder.iterdir()] == ["torch.dll"]


def test_a_python_that_can_make_no_environment_says_so(script, tmp_path, monkeypatch):
    """One that another program brings along may lack what starts a new one."""

    def fail(self, folder):
        Path(folder).mkdir(parents=True)
        raise subprocess.CalledProcessError(1, ["python.exe"], b"No Python at 'C:/nowhere'\r\n")

    monkeypatch.setattr(script.venv.EnvBuilder, "create", fail)
    monkeypatch.setattr(script, "SPACE", {"cpu": 1})
    launcher = SCRIPT.parent.parent.parent / "backend" / "launch.py"
    with pytest.raises(script.InstallError, match="cannot make an environment: No Python at") as caught:
        script.install(tmp_path, launcher, "cpu", False)
    assert "python.org" in caught.value.hint and not list(tmp_path.iterdir())
