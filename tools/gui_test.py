#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension in a real Blender window: Debian sid's Blender under Xvfb. Skips, with the reason, elsewhere.

    make gui-test                           all of tests/gui; screenshots in runs/gui
    python tools/gui_test.py panel          one of them
    python tools/gui_test.py --keep         then put the guide's pictures into docs/images/guide

Debian sid has a Blender that is new enough, and opens its window without a graphics card. debootstrap makes a
root folder of 1.7 GB, once, in PHYSHDR_BLENDER_ROOT (default: /var/cache/physhdr/blender), of what the
system's own apt is set up to take Debian from, or PHYSHDR_DEBIAN_MIRROR. Mounts are made in a namespace of
their own and are gone with it.
"""

import argparse
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CHROOT = Path(os.environ.get("PHYSHDR_BLENDER_ROOT", "/var/cache/physhdr/blender"))
OUT = ROOT / "runs" / "gui"
PYTHON = ROOT / ".venvs" / "backend" / "bin" / "python"
APT = Path("/etc/apt")
PACKAGES = (
    "blender xvfb xauth xdotool libgl1-mesa-dri libegl1 libgl1 x11-utils imagemagick "
    "python3-numpy python3-requests python3-cattr python3-zstandard"
)
SCREEN = "-screen 0 1280x800x24 +extension GLX"
#: Seconds for one test; software rendering on two cores is slow.
PATIENCE = 900
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
    "level_0.25": "live_preview/level_0.25",
    "level_1": "live_preview/level_1",
    "level_4": "live_preview/level_4",
    "splats": "splats/free_view",
}
GUIDE = ROOT / "docs" / "images" / "guide"


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
    for program in ("debootstrap", "unshare"):
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
    for folder in folders:
        inside = shlex.quote(f"{CHROOT}{folder}")
        mounts.append(f"mkdir -p {inside} && mount --bind {shlex.quote(str(folder))} {inside}")
    script = " && ".join([*mounts, f"exec chroot {CHROOT} /bin/sh -c {shlex.quote(command)}"])
    unshare = ["unshare", "--mount", "--propagation", "private", "/bin/sh", "-c", script]
    return subprocess.call(unshare, stdout=output, stderr=output)


def materials() -> dict[str, Path]:
    """What the tests use: the extension, a Python with torch, a data set and a trained model."""
    if subprocess.call([str(PYTHON), str(ROOT / "tools" / "build_extension.py")]):
        raise SystemExit(1)
    data, run = ROOT / "data" / "demo", ROOT / "runs" / "demo"
    if not (run / "model.safetensors").exists() or not (data / "dataset.json").exists():
        raise Skip("there are no demo data and run; make demo makes them")
    newest = max((ROOT / "dist").glob("physhdr-*.zip"), key=lambda path: path.stat().st_mtime)
    return {"zip": newest, "python": PYTHON, "data": data, "model": run / "model.safetensors"}


def run_test(script: Path, options: dict[str, Path]) -> bool:
    out = OUT / script.stem
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    arguments = " ".join(f"--{name} {shlex.quote(str(path))}" for name, path in options.items())
    # A home of its own: neither the user's preferences nor an earlier test's.
    variables = f"BLENDER_USER_RESOURCES={out}/blender HOME={out} LIBGL_ALWAYS_SOFTWARE=1"
    blender = f"blender --factory-startup --window-geometry 0 0 1280 800 -P {script}"
    command = f"{variables} timeout {PATIENCE} xvfb-run -a -s {shlex.quote(SCREEN)}"
    command += f" {blender} -- --out {out} {arguments}"
    base = subprocess.check_output([str(PYTHON), "-c", "import sys; print(sys.base_prefix)"], text=True)
    begun = time.perf_counter()
    with open(out / "blender.log", "w") as log:
        enter(command, [ROOT, Path(base.strip())], log)
    result = out / "result.txt"
    told = result.read_text().strip() if result.exists() else "Blender did not start the test"
    seconds = time.perf_counter() - begun
    print(f"{script.stem}: {told if told == 'passed' else 'FAILED'} in {seconds:.0f} s; pictures in {out}")
    if told != "passed":
        print(f"{told}\n  Blender's log is {out / 'blender.log'}")
    return told == "passed"


def keep() -> None:
    """The guide's pictures, as JPEG: a third of a PNG's size."""
    from PIL import Image

    GUIDE.mkdir(parents=True, exist_ok=True)
    for name, shot in KEPT.items():
        source = OUT / f"{shot}.png"
        if source.exists():
            Image.open(source).convert("RGB").save(GUIDE / f"{name}.jpg", quality=88, optimize=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("names", nargs="*", help="tests of tests/gui; all by default")
    parser.add_argument("--keep", action="store_true", help="put the guide's pictures into docs/images/guide")
    given = parser.parse_args()
    names = given.names
    try:
        make_blender()
        options = materials()
    except Skip as reason:
        print(f"gui-test skipped: {reason}")
        return 0
    scripts = sorted((ROOT / "tests" / "gui").glob("*.py"))
    scripts = [path for path in scripts if path.stem not in ("driver", "__init__")]
    chosen = [path for path in scripts if not names or path.stem in names]
    if not chosen:
        print(f"error: there is no GUI test {names}\n  Choose from: {', '.join(p.stem for p in scripts)}")
        return 1
    passed = all([run_test(path, options) for path in chosen])
    if passed and given.keep:
        keep()
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
