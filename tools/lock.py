#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Renew the lock files, locks/*.txt, from pyproject.toml, and say what changed. Needs the network.

    python3 tools/lock.py            the newest version of everything that pyproject.toml allows
    python3 tools/lock.py --keep     what is pinned stays; only what pyproject.toml asks anew is added

A lock names one version of each package, and the SHA-256 of every file of it (all platforms, Python 3.11 and
newer), so that ``pip install --require-hashes`` takes what was locked or nothing. uv resolves, in a scratch
environment, itself locked by its hash.

    backend.txt     the trainer and the extra prepare, without torch
    develop.txt     the extras test and develop, on top of it
    torch.txt       torch itself; torch-cuda.txt: the libraries that its CUDA build for Linux asks for
    warp.txt        the extra warp
    torch-cuda12.txt, warp12.txt: instead of torch-cuda.txt and warp.txt where a driver or card is too old for
                    CUDA 13: what torch's build for CUDA 12 asks for, and the last Warp on PyPI for it
    bpy.txt         the bpy wheel and what it asks for; blender.txt: what our side of Blender needs beside it
    uv.txt          uv

torch is published by PyPI and, built for the processor alone and for other versions of CUDA, by PyTorch's own
index: its lock has the hashes of both. What the build for CUDA 12 asks for stands nowhere but in that index.
The index is asked when it can be reached; where it cannot be, its rows for the same version stay.

It could not be when they were first written. They are what public records of the index say: each is in two
or more, but for ten (cpu: Windows with Python 3.14; cu130: aarch64; cu126: aarch64 with 3.11, 3.13 and 3.14,
Windows with 3.13 and 3.14), which are in one. Cpu for Linux x86-64 with 3.11 was at hand and is as recorded;
macOS's are those of PyPI. What cu126 asks for is what PyTorch's build declares, and what others' locks found
in it. A row that is wrong refuses a file that is right; it cannot bring one that the index does not serve.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import tomllib
import urllib.error
import urllib.parse
import urllib.request
import venv
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LOCKS = ROOT / "locks"
PYPROJECT = ROOT / "pyproject.toml"
#: What the extension bundles is pinned by hand, with the manifest that names the files.
BUNDLED = ROOT / "tools" / "wheels.txt"
#: The pages of torch in PyTorch's own index, of the builds that addon/scripts/install_backend.py offers.
CUDA12_PAGE = "https://download.pytorch.org/whl/cu126/torch/"
PYTORCH_PAGES = (
    "https://download.pytorch.org/whl/cpu/torch/",
    "https://download.pytorch.org/whl/cu130/torch/",
    CUDA12_PAGE,
)
#: The last Warp whose wheels on PyPI are for CUDA 12, within what pyproject.toml allows.
WARP_OF_CUDA12 = "warp-lang>=1.17,<1.18"
#: Which of their files are locked: what PyPI's torch is built for.
PYTORCH_FILES = re.compile(
    r"-cp3(?:1[1-4])-cp3(?:1[1-4])-(?:manylinux.*_(?:x86_64|aarch64)|win_amd64|macosx.*)\.whl$"
)
PAGE_SECONDS = 20
#: Packages that torch's CUDA builds for Linux ask for and its other builds do not.
OF_CUDA = re.compile(r"nvidia-|cuda-|triton\b")
OLDEST, BLENDER = "3.11", "3.13"

HEADERS = {
    "backend.txt": "The trainer's packages (the extras backend and prepare) without torch.",
    "develop.txt": "The extras test and develop; goes with backend.txt.",
    "torch-cuda.txt": "What torch's CUDA build for Linux asks for, as PyPI has it.",
    "warp.txt": "The extra warp; goes with backend.txt.",
    "torch-cuda12.txt": "What torch's build for CUDA 12 for Linux asks for, as PyPI has it.",
    "warp12.txt": "The extra warp for CUDA 12; goes with backend.txt, in place of warp.txt.",
    "bpy.txt": "Blender as a Python module, for Python 3.13.",
    "blender.txt": "What our side of Blender needs beside bpy or a blender binary (the extra blender).",
    "uv.txt": "What tools/lock.py resolves with.",
    "torch.txt": "torch: the files that PyPI has, and those of PyTorch's own index that are named here.",
}
WRITTEN = "# Written by tools/lock.py (make lock); not by hand.\n"


class LockError(Exception):
    """What could not be locked, and why."""


@dataclass(frozen=True)
class Pin:
    """One version of a package on some platforms: ``requirement`` as pip takes it, and its files' SHA-256."""

    requirement: str
    hashes: tuple[str, ...]

    @property
    def name(self) -> str:
        return re.split(r"==", self.requirement)[0].strip()

    @property
    def version(self) -> str:
        return re.split(r"==|;", self.requirement)[1].strip()

    def __str__(self) -> str:
        return " \\\n".join([self.requirement, *(f"    --hash=sha256:{each}" for each in self.hashes)]) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--keep", action="store_true", help="pins that still fit stay as they are")
    keep = parser.parse_args().keep
    former = {path.name: path.read_text(encoding="utf-8") for path in sorted(LOCKS.glob("*.txt"))}
    try:
        with tempfile.TemporaryDirectory() as scratch:
            files = lock(Path(scratch), former, keep)
    except (LockError, OSError) as error:
        print(f"error: {error}\n  Nothing was changed.", file=sys.stderr)
        return 1
    LOCKS.mkdir(exist_ok=True)
    for name, text in files.items():
        (LOCKS / name).write_text(text, encoding="utf-8")
    changed = [line for name in files for line in changes(name, former.get(name, ""), files[name])]
    print("\n".join(changed) or "nothing changed")
    return 0


def lock(scratch: Path, former: dict[str, str], keep: bool) -> dict[str, str]:
    """The new text of every lock file; raises ``LockError``."""
    resolver = Resolver(scratch, "\n".join(former.values()) if keep else "", former.get("uv.txt", ""))
    (scratch / "build.in").write_text("\n".join(project()["build-system"]["requires"]), encoding="utf-8")
    # Everything together first, so that what one part caps holds for all; then the parts, at those versions.
    everything = resolver.pins(OLDEST, ["backend", "prepare", "warp", "test", "develop"])
    limits = scratch / "everything.txt"
    limits.write_text("\n".join(pin.requirement for pin in everything), encoding="utf-8")
    backend = resolver.pins(OLDEST, ["backend", "prepare"], limits)
    develop = resolver.pins(OLDEST, ["backend", "prepare", "test", "develop"], limits)
    warp = resolver.pins(OLDEST, ["backend", "prepare", "warp"], limits)
    blender = resolver.pins(BLENDER, ["blender"])
    (scratch / "bpy.in").write_text("\n".join(p.requirement for p in blender if p.name == "bpy"))
    limits.write_text("\n".join(pin.requirement for pin in blender), encoding="utf-8")
    bpy = resolver.pins(BLENDER, [], limits, [scratch / "bpy.in"])
    (scratch / "uv.in").write_text("uv\n")
    [torch] = [pin for pin in backend if pin.name == "torch"]
    asked = asked_by_cuda12(torch.version, former.get("torch-cuda12.txt", ""))
    common = [pin for pin in backend if not OF_CUDA.match(pin.name)]
    limits.write_text("\n".join(pin.requirement for pin in common), encoding="utf-8")
    (scratch / "cuda12.in").write_text("\n".join(asked), encoding="utf-8")
    cuda12 = resolver.pins(OLDEST, [], limits, [scratch / "cuda12.in"])
    (scratch / "warp12.in").write_text(WARP_OF_CUDA12, encoding="utf-8")
    warp12 = resolver.pins(OLDEST, [], limits, [scratch / "warp12.in"])
    parts = {
        "backend.txt": without(common, [torch]),
        "torch-cuda.txt": [p for p in backend if OF_CUDA.match(p.name)],
        "develop.txt": without(develop, backend),
        "warp.txt": without(warp, backend),
        "warp12.txt": without(warp12, common),
        "bpy.txt": bpy,
        "blender.txt": without(blender, bpy),
        "uv.txt": resolver.pins(OLDEST, [], None, [scratch / "uv.in"]),
    }
    files = {name: written(name, pins) for name, pins in parts.items()}
    files["torch.txt"] = torch_lock(torch, former.get("torch.txt", ""))
    rows = "".join(f"# torch {torch.version}+cu126 asks for {each}\n" for each in asked)
    files["torch-cuda12.txt"] = written("torch-cuda12.txt", without(cuda12, common), rows)
    return files


def project() -> dict:
    return tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))


def without(pins: list[Pin], others: list[Pin]) -> list[Pin]:
    return [pin for pin in pins if pin.name not in {other.name for other in others}]


def written(name: str, pins: list[Pin], rows: str = "") -> str:
    return WRITTEN + f"# {HEADERS[name]}\n" + rows + "".join(map(str, pins))


class Resolver:
    """uv in an environment of its own. ``former``: pins that are preferred; ``lock``: uv's own, if any."""

    def __init__(self, scratch: Path, former: str, lock: str) -> None:
        self.scratch, self.former = scratch, former
        folder = scratch / "uv"
        venv.EnvBuilder(with_pip=True).create(folder)
        binaries = folder / ("Scripts" if os.name == "nt" else "bin")
        self.uv = str(binaries / "uv")
        wanted = ["uv"]
        if lock:
            (scratch / "uv.txt").write_text(lock, encoding="utf-8")
            wanted = ["--require-hashes", "-r", str(scratch / "uv.txt")]
        pip = [str(binaries / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        call([*pip, "--only-binary=:all:", *wanted])

    def pins(
        self, python: str, extras: list[str], limits: Path | None = None, more: list[Path] | None = None
    ) -> list[Pin]:
        """What pip must install for the project with ``extras`` (none: for ``more`` alone)."""
        out = self.scratch / "out.txt"
        out.write_text(self.former, encoding="utf-8")
        sources = [PYPROJECT, self.scratch / "build.in"] if extras else []
        command = [self.uv, "pip", "compile", "--quiet", "--universal", "--python-version", python]
        command += ["--generate-hashes", "--only-binary", ":all:", "--no-config", "--no-header"]
        command += ["--no-annotate", "--no-emit-index-url", "--no-emit-find-links", "--output-file", out]
        for extra in extras:
            command += ["--extra", extra]
        for each in (BUNDLED, limits):
            command += ["--constraints", each] if each else []
        call([*command, *sources, *(more or [])], UV_PYTHON_DOWNLOADS="never")
        return parse(out.read_text(encoding="utf-8"))


def call(command: list, **environment: str) -> None:
    words = [str(part) for part in command]
    done = subprocess.run(words, capture_output=True, text=True, env={**os.environ, **environment})
    if done.returncode:
        raise LockError(f"{Path(words[0]).name} failed:\n{(done.stderr or done.stdout).strip()}")


def parse(text: str) -> list[Pin]:
    """The pins of a lock file; comments are left out. Raises ``LockError`` at a line that is none."""
    pins = []
    plain = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#"))
    for entry in filter(None, map(str.strip, plain.replace("\\\n", " ").splitlines())):
        requirement, *hashes = re.split(r"\s+--hash=sha256:", entry)
        if not re.fullmatch(r"[\w.\-]+==[^;\s]+(\s*;.*)?", requirement):
            raise LockError(f"'{requirement}' pins no version")
        pins.append(Pin(requirement.strip(), tuple(each.strip() for each in hashes)))
    return pins


def torch_lock(pin: Pin, former: str) -> str:
    """The lock of torch: PyPI's files (``pin``) and PyTorch's own, whose rows are kept as comments."""
    kept = re.findall(r"^# ([0-9a-f]{64})  (\S+)$", former, re.MULTILINE)
    rows = {name: digest for digest, name in kept if belongs(name, pin.version)}
    for page in PYTORCH_PAGES:
        try:
            rows |= published(fetched(page), pin.version)
        except (OSError, urllib.error.URLError) as error:
            print(f"{page} cannot be read ({error}): its rows stay as they were", file=sys.stderr)
    if not rows:
        print(f"PyTorch's own files of torch {pin.version} are not in the lock", file=sys.stderr)
    comments = "".join(f"# {digest}  {name}\n" for name, digest in sorted(rows.items()))
    hashes = tuple(sorted({*pin.hashes, *rows.values()}))
    return written("torch.txt", [Pin(f"torch=={pin.version}", hashes)], comments)


def asked_by_cuda12(version: str, former: str) -> list[str]:
    """What torch's build for CUDA 12 asks for on Linux: by its wheel's metadata, or by rows in ``former``.

    Raises ``LockError`` where neither has ``version``: PyTorch builds no torch for CUDA 12 after 2.14.
    """
    kept = re.findall(r"^# torch (\S+)\+cu126 asks for (.+)$", former, re.MULTILINE)
    rows = [asked for of, asked in kept if of == version]
    try:
        links = re.findall(r'href="([^"#]+x86_64\.whl)#', fetched(CUDA12_PAGE))
        ours = [link for link in links if belongs(urllib.parse.unquote(link).rpartition("/")[2], version)]
        if ours:
            metadata = fetched(urllib.parse.urljoin(CUDA12_PAGE, ours[0]) + ".metadata")
            found = re.findall(r"^Requires-Dist: (\S.*)$", metadata, re.MULTILINE)
            rows = [each.strip() for each in found if OF_CUDA.match(each)]
    except (OSError, urllib.error.URLError) as error:
        print(f"{CUDA12_PAGE} cannot be read ({error}): what torch asks for stays", file=sys.stderr)
    if not rows:
        raise LockError(f"{CUDA12_PAGE} lists no torch {version}, or not what it requires")
    return rows


def fetched(address: str) -> str:
    with urllib.request.urlopen(address, timeout=PAGE_SECONDS) as answer:
        return answer.read().decode("utf-8")


def published(page: str, version: str) -> dict[str, str]:
    """File → SHA-256 of ``version`` as a page of the index lists them; files without a hash are left out."""
    links = re.findall(r'href="([^"#]+)#sha256=([0-9a-f]{64})"', page)
    named = [(urllib.parse.unquote(link).rpartition("/")[2], digest) for link, digest in links]
    return {name: digest for name, digest in named if belongs(name, version)}


def belongs(name: str, version: str) -> bool:
    found = re.match(r"torch-([^-+]+)", name)
    return found is not None and found[1] == version and PYTORCH_FILES.search(name) is not None


def changes(name: str, before: str, after: str) -> list[str]:
    """What a user must know of a new lock file, one line for each package that changed."""
    old, new = described(before), described(after)
    changed = [f"{name}: {each} {old[each][0]} is gone" for each in sorted(old.keys() - new.keys())]
    for each in sorted(new):
        (versions, files), (had, former) = new[each], old.get(each, ("", set()))
        if not had:
            changed.append(f"{name}: {each} {versions} is new")
        elif versions != had:
            changed.append(f"{name}: {each} {had} → {versions}")
        elif files != former:
            changed.append(
                f"{name}: {each} {versions}: {len(files - former)} files more, {len(former - files)} fewer"
            )
    return changed


def described(text: str) -> dict[str, tuple[str, set[str]]]:
    """Package → its versions in words, and the hashes of its files."""
    found: dict[str, tuple[list[str], set[str]]] = {}
    for pin in parse(text):
        versions, hashes = found.setdefault(pin.name, ([], set()))
        versions.append(pin.requirement.partition("==")[2])
        hashes.update(pin.hashes)
    return {name: (", ".join(versions), hashes) for name, (versions, hashes) in found.items()}


if __name__ == "__main__":
    sys.exit(main())
