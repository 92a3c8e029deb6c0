# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the backend's own environment: run by the Python that is to be its base, standard library only.

    python install_backend.py --target FOLDER --launcher EXTENSION/backend/launch.py --torch cpu

The environment is made under a name that says what is in it, and is complete or not used at all; others are
removed when it is, and has passed the backend's check. Where another version's is there, of the same Python
and the same build of torch, the new one begins as its copy, by hard links: only what it lacks is downloaded,
and the old one serves until then. Says how far it is as one JSON object a line (addon/session/task.py).

What is installed is what the extension's locks name, file by file (EXTENSION/locks, tools/lock.py): pip
refuses whatever has another SHA-256, and builds nothing. From where, is the user's own setting of pip, but
for torch: that comes from PyTorch's own index (or a folder that pip's find-links name), and nothing else
does. With ``--torch pip`` it is the user's own build of the locked version, wherever pip finds it, and this
one file is not compared with a hash.

With ``--torch cuda`` it is the build that the card and its driver can run: for CUDA 13, else for CUDA 12,
with the Warp of the same. Where they can run neither, it is the processor's, and the result says why.
"""

import argparse
import contextlib
import hashlib
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import venv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

MINIMUM = (3, 11)
STAMP = "physhdr-complete.json"
#: What an environment is called: the beginning, digits of what is in it, and the end of the other name. On
#: Windows as short as may be, for whole paths are limited there.
PREFIX, DIGITS, OTHER = ("env-", 8, "-2") if os.name == "nt" else ("environment-", 12, "-anew")
OURS = re.compile(f"{PREFIX}([0-9a-f]{{{DIGITS}}})({OTHER})?")
#: Characters of the longest path within the packages' folder: a licence in torch 2.13.0+cu130.
LONGEST_PATH = 173
#: Characters of the longest path on Windows, unless LongPathsEnabled is set in its registry.
WINDOWS_PATH = 259
#: In the place of a Python of Microsoft's Store (addon/session/pythons.py).
STORE = "PythonSoftwareFoundation.Python"
#: Bytes that an environment needs, unpacking included: measured 1.8 GB with torch for the CPU.
SPACE = {"cpu": 3 << 30, "cuda": 12 << 30, "cuda12": 12 << 30, "pip": 3 << 30}
#: Bytes for what is added to a copy.
SPACE_ADDED = 1 << 30
#: What a user chooses among; which of the builds for CUDA it is, the card and its driver say (``build_for``).
CHOICES = ("cpu", "cuda", "pip")
#: The index that torch alone is taken from; none for the user's own. The locked hashes are of these builds.
TORCH_INDEX = {
    "cpu": "https://download.pytorch.org/whl/cpu",
    "cuda": "https://download.pytorch.org/whl/cu130",
    "cuda12": "https://download.pytorch.org/whl/cu126",
    "pip": "",
}
#: The locks that each build needs beside torch's, in the folder ``locks`` beside the launcher's.
LOCKS = {
    "cpu": ("backend.txt",),
    "cuda": ("backend.txt", "torch-cuda.txt", "warp.txt"),
    "cuda12": ("backend.txt", "torch-cuda12.txt", "warp12.txt"),
    "pip": ("backend.txt",),
}
#: Where drivers leave their program that tells of cards, where it is not on the path (Windows, WSL).
SMI = (
    r"%SystemRoot%\System32\nvidia-smi.exe",
    r"%ProgramFiles%\NVIDIA Corporation\NVSMI\nvidia-smi.exe",
    "/usr/lib/wsl/lib/nvidia-smi",
)
TORCH_LOCK, CUDA_LOCKS = "torch.txt", ("torch-cuda.txt", "torch-cuda12.txt")
#: A lock is all that is needed, torch apart: pip adds nothing, and runs no code of what it installs.
LOCKED = ("--no-deps", "--only-binary=:all:")
#: Where in the whole the downloads, and torch's among them, end.
PACKAGES_DONE, TORCH_DONE, COMPLETE = 0.35, 0.7, 0.8
#: What pip writes, and what the user reads: message ({}: the package) and hint. The first that fits.
CAUSES = (
    (
        "DO NOT MATCH THE HASHES",
        "{} is not the file that was locked; it was not installed",
        "Somebody may have exchanged it on its way: see the log for its name and from where it came, and the "
        "index that pip is set up with. If it is pip's own cache, 'pip cache purge' helps. Else report it.",
    ),
    (
        "No space left on device",
        "the disk is full",
        "Free some space (on the disk of temporary files too), or set another folder in the preferences.",
    ),
    (
        "connection broken by|Max retries exceeded|Could not fetch URL|Network is unreachable|timed out",
        "pip cannot reach the index that it takes packages from",
        "Check the network, and pip's settings if a proxy is needed (pip config list); then install again.",
    ),
    (
        "No matching distribution found",
        "there is no build of a package for this Python or system, or its index cannot be reached",
        "Check the network; else choose another Python: 3.11 to 3.14, 64 bit.",
    ),
)


class InstallError(Exception):
    """Something the user can fix: a message and a hint."""

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.message, self.hint = message, hint


@dataclass(frozen=True)
class Build:
    """What a build of torch for CUDA, and the Warp beside it, run on.

    ``torch``: its key in ``TORCH_INDEX``; ``driver``: the oldest of NVIDIA's; ``oldest`` and ``newest``: the
    compute capabilities of cards, (major, minor). Capabilities that begin with the same number run each
    other's code upwards, so what is newer within ``newest``'s is served.
    """

    torch: str
    name: str
    driver: tuple[int, ...]
    oldest: tuple[int, int]
    newest: tuple[int, int]


def builds() -> tuple[Build, Build]:
    """What this system's builds for CUDA run on, the one to be preferred first; sources: docs/performance.md.

    A program made with any CUDA 12 runs on drivers from CUDA 12.0's on, whose numbers differ between systems.
    torch has code for cards of 5.0 to 9.0, on Windows of 6.1 to 9.0; Warp 1.17 of 5.2 on, on ARM of 7.5 on.
    """
    windows = os.name == "nt"
    oldest = (6, 1) if windows else (7, 5) if platform.machine() == "aarch64" else (5, 2)
    return (
        Build("cuda", "CUDA 13", (580,), (7, 5), (99, 0)),
        Build("cuda12", "CUDA 12", (528, 33) if windows else (525, 60), oldest, (9, 0)),
    )


def say(**content: object) -> None:
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


class Lines:
    """The lines that a program writes, as it writes them; then its exit ``status``."""

    def __init__(self, command: list[str], environment: dict[str, str] | None = None) -> None:
        self.command, self.environment, self.status = command, environment or {}, 0

    def __iter__(self) -> Iterator[str]:
        process = subprocess.Popen(
            self.command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            encoding="utf-8",
            errors="replace",
            env={**os.environ, **self.environment},
        )
        assert process.stdout is not None
        yield from process.stdout
        self.status = process.wait()


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--target", type=Path, required=True)
    parser.add_argument("--launcher", type=Path, required=True)
    parser.add_argument("--torch", choices=CHOICES, default="cpu")
    parser.add_argument("--fresh", action="store_true", help="make it anew even if it is complete")
    parser.add_argument("--extend", action="store_true", help="add what the environment that is there lacks")
    options = parser.parse_args()
    try:
        torch, why_not_card = options.torch, ""
        if options.extend:
            torch = torch_there(options.target)
        elif torch == "cuda":
            torch, why_not_card = build_for(cards_here())
        if why_not_card:
            say(progress=0.0, message=why_not_card)
        folder = install(options.target, options.launcher, torch, options.fresh)
        status = check(interpreter_of(folder), options.launcher, [why_not_card] if why_not_card else [])
        if status == 0:  # until then Blender uses the former one, and keeps it
            remove_others(folder)
        return status
    except InstallError as error:
        say(error={"code": "install_failed", "message": error.message, "hint": error.hint})
        return 1
    except OSError as error:
        where = f": {error.filename}" if error.filename else ""
        say(error={"code": "install_failed", "message": f"{error.strerror}{where}", "hint": "See the log."})
        return 1
    except KeyboardInterrupt:
        return 130


def install(target: Path, launcher: Path, torch: str, fresh: bool) -> Path:
    """The folder of a complete environment in ``target``, made where there is none."""
    if sys.version_info < MINIMUM:
        raise InstallError(
            f"Python {sys.version.split()[0]} is too old for the backend", "Choose Python 3.11 or newer."
        )
    locks = launcher.parent.parent / "locks"
    contents = "".join(read_lock(locks / name) for name in (*LOCKS[torch], TORCH_LOCK, *CUDA_LOCKS))
    locked = hashlib.sha256(contents.encode()).hexdigest()
    identity = json.dumps([locked, torch, sys.version, sys.base_prefix])
    named = target / (PREFIX + hashlib.sha256(identity.encode()).hexdigest()[:DIGITS])
    # What is made anew has the other of two names: the one that is there serves until then, and if it fails.
    other = named.with_name(named.name + OTHER)
    # Of both the older one is in use: the newer has not passed its check, or the older would be gone.
    both = [folder for folder in (named, other) if (folder / STAMP).exists()]
    there = min(both, key=lambda folder: (folder / STAMP).stat().st_mtime, default=None)
    if there and not fresh:
        say(progress=COMPLETE, message="the environment is there already")
        return there
    folder = other if there == named else named
    python = interpreter_of(folder)
    target.mkdir(parents=True, exist_ok=True)
    if os.name == "nt":
        refuse_what_windows_cannot(folder, sys.base_prefix)
    former = None if fresh else extensible(target, torch)
    free, needed = shutil.disk_usage(target).free, SPACE_ADDED if former else SPACE[torch]
    if free < needed:
        raise InstallError(
            f"{target} has {free / 1e9:.1f} GB free; the backend needs {needed / 1e9:.0f} GB",
            "Free some space, or set another folder in the extension's preferences.",
        )
    try:
        if former:
            say(progress=0.01, message="taking over the environment that is there")
            take_over(former, folder)
        else:
            say(progress=0.01, message=f"making an environment with {sys.executable}")
            make_environment(folder)
        pip_install(python, [locks / name for name in LOCKS[torch]], 0.03, PACKAGES_DONE)
        torch_install(python, locks / TORCH_LOCK, TORCH_INDEX[torch])
        complete(python, [locks / name for name in CUDA_LOCKS])
        (folder / STAMP).write_text(identity, encoding="utf-8")
    except BaseException:
        remove(folder)
        raise
    return folder


def make_environment(folder: Path) -> None:
    """An environment of this Python with pip; raises ``InstallError`` where it can make none."""
    try:
        venv.EnvBuilder(with_pip=True, clear=True, symlinks=os.name != "nt").create(folder)
    except subprocess.CalledProcessError as error:  # the new Python does not start, or its pip is not there
        said = (error.output or b"").decode("utf-8", "replace").strip().splitlines()
        raise InstallError(
            f"{sys.executable} cannot make an environment" + (f": {said[-1]:.200}" if said else ""),
            "Choose another Python, such as one from python.org.",
        ) from error


def remove(folder: Path) -> None:
    """Remove an environment; where some of it is in use, which Windows keeps, it is complete no more."""
    with contextlib.suppress(OSError):
        (folder / STAMP).unlink(missing_ok=True)
    shutil.rmtree(folder, ignore_errors=True)


def remove_others(folder: Path) -> None:
    """Remove all environments of ours beside ``folder``."""
    for old in folder.parent.glob(PREFIX + "*"):
        if old != folder and made_here(old):
            remove(old)


def made_here(folder: Path) -> bool:
    """Whether an environment was made here: the user may have chosen a folder with others in it.

    One that was not completed has no stamp, and is known by its name; a name of decimal digits alone can be
    somebody's date, and wants the stamp.
    """
    found = OURS.fullmatch(folder.name)
    return found is not None and (not found[1].isdecimal() or (folder / STAMP).exists())


def refuse_what_windows_cannot(folder: Path, base: str) -> None:
    """Raises ``InstallError`` where no environment can be in ``folder``, or ``base``'s Python makes none."""
    if STORE in base:
        raise InstallError(
            "a Python of Microsoft's Store writes what it makes where Blender does not find it",
            "Choose another: Blender's own, or install one from python.org.",
        )
    longest = len(str(folder / "Lib" / "site-packages")) + 1 + LONGEST_PATH
    if longest > WINDOWS_PATH and not takes_long_paths(folder.parent):
        raise InstallError(
            f"files in {folder} would have paths of {longest} characters, and this Windows takes "
            f"{WINDOWS_PATH}",
            f"Set a folder in the extension's preferences that is {longest - WINDOWS_PATH} characters "
            "shorter, such as C:\\physhdr, or allow long paths (LongPathsEnabled in Windows' registry).",
        )


def takes_long_paths(folder: Path) -> bool:
    """Whether paths can be longer than ``WINDOWS_PATH``: by trying, for Python, too, must allow it."""
    probe = Path(tempfile.mkdtemp(prefix="long-paths-", dir=folder))  # a new one: it is removed again
    try:
        (probe / ("x" * 150) / ("x" * 150)).mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    finally:
        shutil.rmtree(probe, ignore_errors=True)
    return True


def interpreter_of(environment: Path) -> Path:
    return environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def cards_here() -> list[tuple[str, str, str]]:
    """Name, driver's version and compute capability of this machine's NVIDIA cards, as their driver says.

    Empty where it says nothing: there is no driver, or none that can be asked. Drivers before about R510 know
    of no capability, and refuse the whole question: it is "" then.
    """
    found = shutil.which("nvidia-smi")
    places = [found, *map(os.path.expandvars, SMI)] if found else list(map(os.path.expandvars, SMI))
    for program in places:
        try:
            rows = ask_driver(program, "name", "driver_version", "compute_cap")
            if rows is None:
                rows = [[*row, ""] for row in ask_driver(program, "name", "driver_version") or []]
        except (OSError, subprocess.TimeoutExpired):
            continue
        return [(row[0], row[1], row[2]) for row in rows]
    return []


def ask_driver(program: str, *fields: str) -> list[list[str]] | None:
    """The fields of each card, as the driver's program tells them; None where it fails.

    Raises ``OSError`` or ``TimeoutExpired`` where it cannot be run.
    """
    command = [program, f"--query-gpu={','.join(fields)}", "--format=csv,noheader"]
    done = subprocess.run(
        command, capture_output=True, encoding="utf-8", errors="replace", timeout=30, check=False
    )
    if done.returncode:
        return None
    rows = [[field.strip() for field in line.split(",")] for line in done.stdout.splitlines()]
    return [row for row in rows if len(row) == len(fields)]


def build_for(cards: list[tuple[str, str, str]]) -> tuple[str, str]:
    """The build of torch, as ``TORCH_INDEX`` has it, that one of ``cards`` can run, and "".

    ``cpu`` and the reason with its remedy where none can run any, before gigabytes are fetched. What the
    driver does not tell in numbers is not judged: the check at the end will find it out.
    """
    refusals: list[str] = []
    for build in builds():
        refusals = [refusal(build, *card) for card in cards]
        if not cards or not all(refusals):
            return build.torch, ""
    # Of the build that asks for least: what it says would help.
    return "cpu", f"the card is not used: {refusals[0]}"


def refusal(build: Build, name: str, driver: str, capability: str) -> str:
    """Why a card of that driver and compute capability cannot run a build, and what helps; "" if it can."""
    version, card = numbers(driver), numbers(capability)
    if card and card < build.oldest:
        least = ".".join(map(str, build.oldest))
        return f"{name} is older than {build.name} builds know (capability {capability}; {least} is needed)"
    if card and card[0] > build.newest[0]:
        first = builds()[0]
        return (
            f"{name} needs the build for {first.name}, and that the driver {first.driver[0]} or newer; it is "
            f"{driver}. Install a newer driver from NVIDIA, then install again"
        )
    if version and version < build.driver:
        needed = ".".join(map(str, build.driver))
        return (
            f"the driver of {name} is {driver}; builds for {build.name} need {needed} or newer. "
            "Install a newer driver from NVIDIA, then install again"
        )
    return ""


def numbers(text: str) -> tuple[int, ...]:
    """``"581.29"`` as (581, 29); empty for what is not numbers."""
    parts = text.split(".")
    return tuple(map(int, parts)) if all(part.isdecimal() for part in parts) else ()


def stamp_of(folder: Path) -> list[str]:
    """What a complete environment says of itself: its locks, build of torch, Python and that one's place."""
    try:
        stamp = json.loads((folder / STAMP).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return stamp if isinstance(stamp, list) and len(stamp) == 4 else []


def extensible(target: Path, torch: str) -> Path | None:
    """A complete environment of this Python with that build of torch, of whatever locks: the newest."""
    like = [torch, sys.version, sys.base_prefix]
    found = [folder for folder in target.glob(PREFIX + "*") if stamp_of(folder)[1:] == like]
    return max(found, key=lambda folder: (folder / STAMP).stat().st_mtime, default=None)


def torch_there(target: Path) -> str:
    """The build of torch of the complete environment that this Python made; raises ``InstallError``."""
    for torch in TORCH_INDEX:
        if extensible(target, torch):
            return torch
    raise InstallError(
        f"there is no complete environment of Python {sys.version.split()[0]} in {target}",
        "Install the backend again.",
    )


def take_over(former: Path, folder: Path) -> None:
    """Make ``folder`` a copy of an environment: its files by hard links, for none is ever changed in place.

    pip replaces files, and so does what is written anew here: the stamp, which comes when all is there, and
    the scripts that name the former's place.
    """
    shutil.rmtree(folder, ignore_errors=True)
    leave_out = shutil.ignore_patterns(STAMP)
    try:
        shutil.copytree(former, folder, symlinks=True, ignore=leave_out, copy_function=link_or_copy)
    except shutil.Error as error:  # of all files that fail, a list
        *_, (source, _, reason) = error.args[0]
        raise InstallError(
            f"{source} cannot be copied: {reason}",
            "Free some space if the disk is full; else install the backend again, with Anew.",
        ) from error
    was, now = os.fsencode(former), os.fsencode(folder)
    for script in (folder / ("Scripts" if os.name == "nt" else "bin")).iterdir():
        if script.is_symlink() or not script.is_file() or script.suffix == ".exe":
            continue
        content = script.read_bytes()
        if was in content:
            mode = script.stat().st_mode
            script.unlink()
            script.write_bytes(content.replace(was, now))
            script.chmod(mode)


def link_or_copy(source: str, target: str) -> None:
    """A hard link; a copy on a disk that knows none."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def read_lock(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise InstallError(f"{path} cannot be read: {error.strerror}", "Reinstall the extension.") from error


def pins(text: str) -> list[str]:
    """The requirements of a lock, without hashes and comments: ``numpy==2.4.6 ; python_version < "3.12"``."""
    lines = [line for line in text.splitlines() if line[:1].isalnum()]
    return [re.split(r"\s*(?:--hash|\\)", line)[0] for line in lines]


def pip_install(python: Path, locks: list[Path], begin: float, end: float) -> None:
    """Exactly what ``locks`` name, from wherever the user's pip takes packages; raises ``InstallError``."""
    arguments = [*LOCKED, "--require-hashes"]
    for lock in locks:
        arguments += ["-r", str(lock)]
    run_pip(python, arguments, sum(len(pins(read_lock(lock))) for lock in locks), begin, end)


def torch_install(python: Path, lock: Path, index: str) -> None:
    """torch alone: from ``index`` and no other, or where there is none, as the user's pip finds it."""
    if not index:
        run_pip(python, [*LOCKED, *pins(read_lock(lock))], 1, PACKAGES_DONE, TORCH_DONE)
        return
    arguments = [*LOCKED, "--require-hashes", "--index-url", index, "-r", str(lock)]
    # pip's settings may name more indexes, and any of them may offer a torch: this one takes their place.
    run_pip(python, arguments, 1, PACKAGES_DONE, TORCH_DONE, {"PIP_EXTRA_INDEX_URL": index})


def complete(python: Path, cuda: list[Path]) -> None:
    """Nothing that a package asks for is missing; a user's own torch with CUDA gets its libraries.

    They are of the first of the locks ``cuda`` that has all that is missing.
    """
    missing = missing_packages(python)
    for lock in cuda:
        if missing and missing <= {pin.partition("==")[0] for pin in pins(read_lock(lock))}:
            pip_install(python, [lock], TORCH_DONE, COMPLETE)
            missing = missing_packages(python)
    if missing:
        raise InstallError(
            f"this build of torch asks for packages that were not tested: {', '.join(sorted(missing))}",
            "Choose another build of torch, or make an environment yourself and choose its Python.",
        )


def missing_packages(python: Path) -> set[str]:
    """What installed packages ask for and is not there."""
    command = [str(python), "-m", "pip", "check", "--disable-pip-version-check"]
    lines = Lines(command)
    found = re.findall(r" requires (\S+), which is not installed", "".join(lines))
    return {re.sub(r"[-_.]+", "-", name).lower() for name in found}


def run_pip(
    python: Path,
    arguments: list[str],
    packages: int,
    begin: float,
    end: float,
    environment: dict | None = None,
) -> None:
    """``pip install`` with a line of progress for each package; raises ``InstallError`` with the cause."""
    command = [str(python), "-m", "pip", "install", "--disable-pip-version-check", "--no-input"]
    command += ["--progress-bar", "off", *arguments]
    collected, output = 0, []
    # Where the user's settings say "user", pip would refuse to install into an environment.
    lines = Lines(command, {"PIP_USER": "0", **(environment or {})})
    for line in lines:
        sys.stdout.write(line)
        output.append(line.strip())
        share = begin + (end - begin) * min(collected / packages, 1.0) * 0.9
        if line.startswith("Collecting "):
            collected += 1
            say(progress=share, message=f"fetching {line.split()[1]}")
        elif line.lstrip().startswith("Downloading "):
            say(progress=share, message=line.strip()[:80].lower())
        elif line.startswith("Installing collected"):
            say(progress=begin + (end - begin) * 0.9, message="unpacking: a minute or two")
    if lines.status:
        raise failure(output)


def failure(output: list[str]) -> InstallError:
    """What went wrong, from pip's lines."""
    text = "\n".join(output)
    errors = [line for line in output if line.startswith("ERROR")] or [line for line in output if line][-1:]
    last = errors[-1] if errors else "it said nothing"
    refused = re.search(r"DO NOT MATCH THE HASHES.*\n+(\S+)", text)
    for pattern, message, hint in CAUSES:
        if re.search(pattern, text):
            named = message.format(refused[1]) if refused else f"{message} ({last})"
            return InstallError(named, hint)
    return InstallError(
        f"pip could not install the backend's packages: {last}",
        "Check the network and the disk, then install again; the log has all of pip's lines.",
    )


def check(python: Path, launcher: Path, warnings: list[str]) -> int:
    """Run the backend's own check and pass its lines on, in the last fifth of the progress bar.

    ``warnings`` come before those that it finds.
    """
    lines = Lines([str(python), str(launcher), "check", "--json"])
    for line in lines:
        try:
            content = json.loads(line) if line.startswith("{") else {}
        except ValueError:
            content = {}
        if "progress" in content:
            say(**{**content, "progress": round(COMPLETE + (1.0 - COMPLETE) * content["progress"], 4)})
        elif "result" in content:
            added = {"warnings": [*warnings, *content["result"].get("warnings", [])]}
            say(result={**content["result"], **added, "environment": str(python)})
        else:
            sys.stdout.write(line)
            sys.stdout.flush()
    return lines.status


if __name__ == "__main__":
    sys.exit(main())
