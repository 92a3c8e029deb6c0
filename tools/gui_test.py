#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension in a real Blender window: Debian sid's Blender under Xvfb. Skips, with the reason, elsewhere.

    make gui-test                           all of tests/gui; screenshots in runs/gui
    python tools/gui_test.py panel          one of them
    python tools/gui_test.py --keep         then put the guide's pictures into docs/images/guide

Every test has a Blender, a home, a /tmp and processes of its own, which all end with it; one that leaves any
running fails. What is compiled (kernels, shaders) is kept in runs/gui from run to run, and the backend is
checked once for all.

Debian sid has a Blender that is new enough, and opens its window without a graphics card. debootstrap makes a
root folder of 1.7 GB, once, in PHYSHDR_BLENDER_ROOT (default: /var/cache/physhdr/blender), of what the
system's own apt is set up to take Debian from, or PHYSHDR_DEBIAN_MIRROR. Mounts are made in a namespace of
their own and are gone with it.
"""

import argparse
import contextlib
import hashlib
import os
import platform
import re
import resource
import shlex
import shutil
import subprocess
import sys
import time
import urllib.request
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CHROOT = Path(os.environ.get("PHYSHDR_BLENDER_ROOT", "/var/cache/physhdr/blender"))
OUT = ROOT / "runs" / "gui"
TESTS = ROOT / "tests" / "gui"
PYTHON = ROOT / ".venvs" / "backend" / "bin" / "python"
APT = Path("/etc/apt")
PACKAGES = (
    "blender xvfb xauth xdotool libgl1-mesa-dri libegl1 libgl1 x11-utils imagemagick "
    "python3-numpy python3-requests python3-cattr python3-zstandard"
)
#: Of the screen, in pixels: of most tests, and of those whose subject it is.
SIZE, SIZES = (1280, 800), {"newcomer": (1600, 900)}
#: Seconds for one test on an idle machine, more on a busy one; software rendering on two cores is slow.
PATIENCE = 900
#: Inside: the artist's home, as pictures show it, and where in it the backend looks for compiled kernels.
HOME = Path("/home/artist")
KERNELS = Path("blender/extensions/.user/user_default/physhdr/backend/cache")
#: A variable that all processes of a test inherit: which run of this program began them.
ROOM_MARK = "PHYSHDR_GUI_TEST"
#: Of the demo's run: what tests open, import and evaluate.
OF_RUN = ("config.json", "views.json", "checkpoint.safetensors", "model.safetensors", "log.jsonl")
#: Seconds for the first answer of the mirror.
PAGE_SECONDS = 20

#: Screenshots that docs/guide.md shows: name there, and test and name of the screenshot.
KEPT = {
    "no_backend": "panel/1_no_backend",
    "photos": "photos/1_understood",
    "ready": "panel/3_ready",
    "training": "panel/4_training",
    "failed": "panel/6_failed",
    "imported": "panel/8_imported",
    "found": "search/1_found",
    "first_look": "newcomer/scene_6_first_look",
    "relit": "newcomer/scene_7_relit",
    "rendered": "newcomer/scene_8_rendered",
    "level_0.25": "live_preview/level_0.25",
    "level_1": "live_preview/level_1",
    "level_4": "live_preview/level_4",
    "splats": "splats/free_view",
    "dialog": "render_dialog/1_dialog",
    "results": "results/3_evaluated",
    "render_warns": "first_try/2_render_warns",
    "lit": "first_try/4_lit",
    "selected": "edit_mode/box_selected",
}
GUIDE = ROOT / "docs" / "images" / "guide"
#: What else is in tests/gui.
NO_TESTS = ("driver", "prepare", "__init__")


class Skip(Exception):  # noqa: N818 (not an error)
    """Why there can be no window here."""


def mirror(apt: Path = APT) -> str:
    """The address of Debian's archive, as the system's apt is set up to use it; raises ``Skip``."""
    if named := os.environ.get("PHYSHDR_DEBIAN_MIRROR"):
        return named
    if shutil.which("apt-get") is None:
        raise Skip("there is no apt that knows where Debian is to be had; PHYSHDR_DEBIAN_MIRROR may say it")
    system = platform.freedesktop_os_release()
    releases = {"stable", "testing", "unstable", "sid", system.get("VERSION_CODENAME", "sid")}
    for address, suite, components in sources(apt) if system.get("ID") == "debian" else ():
        if suite in releases and "main" in components and re.match("https?://|file:/", address):
            return address.rstrip("/")
    raise Skip(f"apt's settings in {apt} name no archive of Debian; PHYSHDR_DEBIAN_MIRROR may say one")


def sources(apt: Path) -> Iterator[tuple[str, str, list[str]]]:
    """Address, suite and components of each source of packages in apt's settings, in both of their forms."""
    for path in [apt / "sources.list", *sorted((apt / "sources.list.d").glob("*.list"))]:
        for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
            words = re.sub(r"\[.*?\]|#.*", " ", line).split()
            if len(words) > 2 and words[0] == "deb":
                yield words[1], words[2], words[3:]
    for path in sorted((apt / "sources.list.d").glob("*.sources")):
        lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
        for paragraph in re.split(r"\n\s*\n", "\n".join(lines)):
            fields = dict(re.findall(r"^([\w-]+):(.*(?:\n[ \t].*)*)", paragraph, re.MULTILINE))
            named = {name.lower(): value.split() for name, value in fields.items()}
            if "deb" in named.get("types", ()) and named.get("enabled") != ["no"]:
                for address in named.get("uris", ()):
                    for suite in named.get("suites", ()):
                        yield address, suite, named.get("components", [])


def require_answer(address: str) -> None:
    """Raises ``Skip`` where the archive at ``address`` cannot be reached, or has no Debian sid."""
    try:
        with urllib.request.urlopen(f"{address}/dists/sid/Release", timeout=PAGE_SECONDS):
            pass
    except (OSError, ValueError) as error:
        raise Skip(f"{address} cannot be reached, or has no Debian sid: {error}") from error


def make_blender() -> None:
    """Debian sid with Blender in ``CHROOT``, unless it is there; raises ``Skip``."""
    if os.name != "posix" or os.geteuid() != 0:
        raise Skip("a chroot needs root")
    for program in ("debootstrap", "unshare", "setpriv"):
        if shutil.which(program) is None:
            raise Skip(f"there is no {program} (apt-get install debootstrap util-linux)")
    if (CHROOT / "usr" / "bin" / "xdotool").exists() and (CHROOT / "usr" / "bin" / "blender").exists():
        return
    address = mirror()
    require_answer(address)
    print(f"installing Debian sid's Blender from {address} in {CHROOT}: 2 to 4 minutes, once", flush=True)
    CHROOT.mkdir(parents=True, exist_ok=True)
    log = ROOT / "runs" / "gui" / "install.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    with open(log, "w") as output:
        made = (CHROOT / "usr" / "bin" / "apt-get").exists() or not subprocess.call(
            ["debootstrap", "--variant=minbase", "sid", str(CHROOT), address], stdout=output, stderr=output
        )
        install = f"apt-get install -y --no-install-recommends {PACKAGES}"
        if not made or enter(install, [], output):
            raise Skip(f"Debian sid's Blender could not be installed; see {log}")


def enter(command: str, folders: list[Path], output=None) -> int:
    """Run a shell command inside, with ``folders`` at the same places; returns its status."""
    mounts = [f"mount --rbind /{name} {CHROOT}/{name}" for name in ("proc", "dev", "sys")]
    mounts += [bind(folder, folder) for folder in folders]
    script = " && ".join([*mounts, f"exec chroot {CHROOT} /bin/sh -c {shlex.quote(command)}"])
    unshare = ["unshare", "--mount", "--propagation", "private", "/bin/sh", "-c", script]
    return subprocess.call(unshare, stdout=output, stderr=output)


def bind(folder: Path, place: Path) -> str:
    """The commands that let a folder be found at ``place`` inside."""
    inside = shlex.quote(f"{CHROOT}{place}")
    return f"mkdir -p {inside} && mount --bind {shlex.quote(str(folder))} {inside}"


@dataclass(frozen=True)
class Room:
    """Where the tests live: an artist's home, the same path for each, so that what is compiled stays valid.

    ``base``: the Python's own folder, beside its environment. ``kernels``, ``shaders``: what is compiled, and
    outlives a run. ``template``: what is copied for each test.
    """

    zip: Path
    base: Path
    kernels: Path
    shaders: Path
    template: Path

    def run(self, out: Path, command: str, seconds: float) -> list[str]:
        """A command with ``out/home`` as its home; what it has left running, one line each.

        It has processes of its own (a PID namespace): whatever becomes of it, or of this program, they end.
        """
        (out / "home" / KERNELS).mkdir(parents=True, exist_ok=True)
        (out / "home" / ".cache").mkdir(exist_ok=True)
        home = {
            out / "home": HOME,
            self.kernels: HOME / KERNELS,
            self.shaders: HOME / ".cache",
            ROOT / "data" / "demo": HOME / "room",
            ROOT / ".venvs" / "backend": HOME / "torch",
        }
        mounts = [f"mount -t proc proc {CHROOT}/proc", f"mount -t tmpfs tmpfs {CHROOT}/tmp"]
        mounts += [f"mount --rbind /{name} {CHROOT}/{name}" for name in ("dev", "sys")]
        mounts += [bind(folder, folder) for folder in (ROOT, self.base)]
        mounts += [bind(folder, place) for folder, place in home.items()]
        left = out / "left.txt"
        inside = f"/usr/bin/python3 {ROOT / 'tools' / 'gui_inside.py'} {seconds} {left}"
        line = f"cd {HOME} && exec {inside} /bin/sh -c {shlex.quote(command)}"
        script = " && ".join([*mounts, f"exec chroot {CHROOT} /bin/sh -c {shlex.quote(line)}"])
        # Where this program is killed so is unshare, and with it all of the room.
        unshare = ["setpriv", "--pdeathsig", "KILL", "unshare", "--mount", "--propagation", "private"]
        unshare += ["--pid", "--fork", "--kill-child", "/bin/sh", "-c", script]
        with open(out / "blender.log", "w") as log:
            environment = {**os.environ, ROOM_MARK: str(os.getpid())}
            subprocess.call(unshare, stdout=log, stderr=log, env=environment)
        return left.read_text().splitlines() if left.exists() else ["(it was not looked at)"]

    def blender(self, script: Path, out: Path, options: str) -> str:
        """The command of a Blender that runs a script of tests/gui; ``options``: Blender's own."""
        args = {"out": out, "zip": self.zip, "python": HOME / "torch" / "bin" / "python"}
        args |= {"data": HOME / "room", "model": HOME / "room_run" / "model.safetensors"}
        arguments = " ".join(f"--{name} {shlex.quote(str(path))}" for name, path in args.items())
        variables = f"BLENDER_USER_RESOURCES={HOME}/blender HOME={HOME} LIBGL_ALWAYS_SOFTWARE=1"
        return f"{variables} blender --factory-startup {options} -P {script} -- {arguments}"


def furnish(extension: Path | None = None) -> Room:
    """What the tests use: the extension, a Python with torch, a data set and a trained model; or ``Skip``.

    The extension is installed and its backend checked once, into a home that each test begins with a copy of.
    """
    if extension is None and subprocess.call([str(PYTHON), str(ROOT / "tools" / "build_extension.py")]):
        raise SystemExit(1)
    data, run = ROOT / "data" / "demo", ROOT / "runs" / "demo"
    if not (run / "model.safetensors").exists() or not (data / "dataset.json").exists():
        raise Skip("there are no demo data and run; make demo makes them")
    newest = extension or max((ROOT / "dist").glob("physhdr-*.zip"), key=lambda path: path.stat().st_mtime)
    base = subprocess.check_output([str(PYTHON), "-c", "import sys; print(sys.base_prefix)"], text=True)
    site = sorted(
        path.name for path in (PYTHON.parent.parent / "lib").glob("python*/site-packages/*.dist-info")
    )
    with zipfile.ZipFile(newest) as archive:
        code = {name: archive.read(name) for name in sorted(archive.namelist()) if not name.endswith("/")}
    version = (CHROOT / "var" / "lib" / "dpkg" / "status").read_text(encoding="utf-8")
    blender = re.search(r"^Package: blender\n(?:.+\n)*?Version: (.+)$", version, re.MULTILINE)
    scripts = {name: (TESTS / name).read_bytes() for name in ("prepare.py",)}
    key = digest([blender[1] if blender else "", *site], [*code, *scripts], code | scripts)
    room = Room(newest, Path(base.strip()), OUT / ".kernels", OUT / ".shaders", OUT / ".template")
    for folder in (room.kernels, room.shaders):
        folder.mkdir(parents=True, exist_ok=True)
    known = room.template / "key.txt"
    if not known.exists() or known.read_text() != key:
        prepare(room)
        known.write_text(key)
    return room


def digest(words: list[str], names: list[str], contents: dict[str, bytes]) -> str:
    found = hashlib.sha256("\n".join(words).encode())
    for name in names:
        found.update(name.encode() + hashlib.sha256(contents[name]).digest())
    return found.hexdigest()[:16]


def prepare(room: Room) -> None:
    """Make the home that tests begin with; ends the program where that fails."""
    shutil.rmtree(room.template, ignore_errors=True)
    room.template.mkdir(parents=True)
    begun = time.perf_counter()
    command = room.blender(TESTS / "prepare.py", room.template, "-b --python-exit-code 1")
    left = room.run(room.template, command, PATIENCE)
    check = room.template / "check.json"
    if not check.exists() or left:
        print(f"error: the extension could not be installed and checked: {' '.join(left)}")
        print((room.template / "blender.log").read_text())
        raise SystemExit(1)
    seconds = time.perf_counter() - begun
    print(f"installed and checked in {seconds:.0f} s; the check: {check.read_text()}", flush=True)


def run_test(room: Room, script: Path) -> bool:
    out = OUT / script.stem
    shutil.rmtree(out, ignore_errors=True)
    # A home of its own: neither the user's preferences nor an earlier test's.
    shutil.copytree(room.template / "home", out / "home", symlinks=True)
    run = out / "home" / "room_run"
    run.mkdir()
    for name in OF_RUN:
        shutil.copy(ROOT / "runs" / "demo" / name, run)
    width, height = SIZES.get(script.stem, SIZE)
    options = f"--python-exit-code 1 --window-geometry 0 0 {width} {height}"
    blender = room.blender(script, out, options)
    screen = f"-screen 0 {width}x{height}x24 +extension GLX"
    # A display's number is the whole machine's, whatever the room's /tmp says.
    xvfb = f"xvfb-run -a -n {100 + os.getpid() % 10_000} -s {shlex.quote(screen)}"
    begun, before = time.perf_counter(), cpu_seconds()
    left = room.run(out, f"{xvfb} /usr/bin/env {blender}", PATIENCE)
    result = out / "result.txt"
    verdict = result.read_text().strip() if result.exists() else "Blender did not start the test"
    if left:
        verdict = f"{verdict}\nleft running: " + "\n  ".join(left)
    seconds, used = time.perf_counter() - begun, cpu_seconds() - before
    passed = "passed" if verdict == "passed" else "FAILED"
    print(
        f"{script.stem}: {passed} in {seconds:.0f} s ({used:.0f} s of processors); pictures in {out}",
        flush=True,
    )
    if verdict != "passed":
        print(f"{verdict}\n  Blender's log is {out / 'blender.log'}", flush=True)
    return verdict == "passed"


def cpu_seconds() -> float:
    """What all ended children of this process have used."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def inmates() -> list[int]:
    """The processes of this machine that this program's tests have begun."""
    mark, found = f"{ROOM_MARK}={os.getpid()}".encode(), []
    for folder in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            if folder.name.isdigit() and mark in (folder / "environ").read_bytes().split(b"\0"):
                found.append(int(folder.name))
    return found


def keep() -> None:
    """The guide's pictures, as JPEG: a third of a PNG's size."""
    from PIL import Image

    GUIDE.mkdir(parents=True, exist_ok=True)
    for name, shot in KEPT.items():
        source = OUT / f"{shot}.png"
        if source.exists():
            picture = Image.open(source).convert("RGB")
            picture.save(GUIDE / f"{name}.jpg", quality=80, optimize=True, progressive=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("names", nargs="*", help="tests of tests/gui; all by default")
    parser.add_argument("--keep", action="store_true", help="put the guide's pictures into docs/images/guide")
    parser.add_argument("--extension", type=Path, help="the zip of an extension; by default it is built")
    args = parser.parse_args()
    names = args.names
    try:
        make_blender()
        room = furnish(args.extension and args.extension.resolve())
    except Skip as reason:
        print(f"gui-test skipped: {reason}")
        return 0
    scripts = [path for path in sorted(TESTS.glob("*.py")) if path.stem not in NO_TESTS]
    chosen = [path for path in scripts if not names or path.stem in names]
    if not chosen:
        print(f"error: there is no GUI test {names}\n  Choose from: {', '.join(p.stem for p in scripts)}")
        return 1
    passed = all([run_test(room, path) for path in chosen])
    if left := inmates():
        print(f"error: processes of the tests still run: {left}")
        passed = False
    if passed and args.keep:
        keep()
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
