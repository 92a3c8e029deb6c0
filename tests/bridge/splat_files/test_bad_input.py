# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that are cut off, damaged, or claim more than they hold: one clear error, and little memory."""

import gzip
import importlib.util
import os
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from physhdr.bridge.errors import BadValueError, FileDamagedError, FileMissingError, PhysHDRError
from physhdr.bridge.gaussian_import import read_gaussians
from physhdr.bridge.gaussian_ply import standard_names
from physhdr.bridge.splat_files import SplatCloud, read_splat_file, spz
from physhdr.bridge.splat_files.usable import only_usable

HAS_ZSTD = sys.version_info >= (3, 14) or importlib.util.find_spec("zstandard") is not None
needs_zstd = pytest.mark.skipif(not HAS_ZSTD, reason="SPZ 4 needs the package zstandard, or Python 3.14")
NAMES = (
    "version-2.spz",
    "version-3.spz",
    pytest.param("version-4.spz", marks=needs_zstd),
    "chunks.compressed.ply",
    "gaussians.splat",
    "level-0.ksplat",
    "level-2.ksplat",
)
#: What reading may take, in bytes of address space.
MEMORY = 2 << 30


def check(cloud: SplatCloud) -> None:
    """What has been read can be drawn."""
    for name in ("position", "rotation", "scale", "opacity", "colour_sh"):
        assert np.isfinite(getattr(cloud, name)).all(), name
    assert (cloud.scale >= 0.0).all() and (cloud.opacity >= 0.0).all() and (cloud.opacity <= 1.0).all()
    np.testing.assert_allclose(np.linalg.norm(cloud.rotation, axis=1), 1.0, atol=1e-5)


def test_nan_alone_has_a_remedy_that_fits_any_program(files: Path) -> None:
    cloud = read_splat_file(files / "gaussians.splat")
    with pytest.raises(BadValueError, match="every Gaussian has NaN") as caught:
        only_usable(files / "gaussians.splat", replace(cloud, opacity=cloud.opacity * np.nan))
    assert caught.value.hint.startswith("Export or convert it again")


@pytest.mark.parametrize("name", NAMES)
def test_cut_off_anywhere(files: Path, tmp_path: Path, name: str) -> None:
    raw = (files / name).read_bytes()
    path = tmp_path / name
    for size in [0, 1, 3, 15, 31, *np.linspace(40, len(raw) - 1, 40).astype(int).tolist(), len(raw) - 1]:
        path.write_bytes(raw[:size])
        if name.endswith(".splat") and size and size % 32 == 0:
            continue  # which is a shorter .splat
        with pytest.raises(PhysHDRError) as caught:
            read_splat_file(path)
        assert name in caught.value.message, size
        assert caught.value.hint, caught.value.message


@pytest.mark.filterwarnings("error::RuntimeWarning")  # arithmetic that overflows
@pytest.mark.parametrize("name", NAMES)
def test_damaged_anywhere(files: Path, tmp_path: Path, fuzzing: ModuleType, name: str) -> None:
    path = tmp_path / name
    for case, damaged in enumerate(fuzzing.mutations((files / name).read_bytes(), 150, 22)):
        path.write_bytes(damaged)
        try:
            check(read_splat_file(path))
        except PhysHDRError as error:
            assert error.message, f"case {case}"


def test_damaged_inside_the_compression(files: Path, tmp_path: Path, fuzzing: ModuleType) -> None:
    path = tmp_path / "a.spz"
    raw = gzip.decompress((files / "version-3.spz").read_bytes())
    for damaged in fuzzing.mutations(raw, 150, 23):
        path.write_bytes(gzip.compress(damaged, 1))
        try:
            check(read_splat_file(path))
        except PhysHDRError as error:
            assert error.message


@pytest.mark.parametrize("name", ["a.spz", "a.ply", "a.ksplat", "a.splat", "a.compressed.ply"])
def test_a_picture_with_the_wrong_suffix(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(np.random.default_rng(0).bytes(5000)))
    with pytest.raises(FileDamagedError, match=name):
        read_splat_file(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "start", "called"),
    [
        ("a.sog", b"PK\3\4", "SOG"),
        ("meta.json", b"{}", "SOG"),
        ("a.glb", b"glTF\2\0\0\0", "glTF"),
        ("a.gltf", b"{}", "glTF"),
        ("a.usdc", b"PXR-USDC", "USD"),
        ("a.usdz", b"PK\3\4", "USD"),
    ],
)
def test_what_needs_the_backend_says_how(tmp_path: Path, name: str, start: bytes, called: str) -> None:
    (tmp_path / name).write_bytes(start)
    for read in (read_splat_file, read_gaussians):
        with pytest.raises(BadValueError, match=rf"{called} is not read here\n.*physhdr export IN OUT.ply"):
            read(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "words"), [("a.csv", "made of"), ("a.lcc", "splat-transform IN.lcc OUT.ply")]
)
def test_what_the_backend_does_not_read_either(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / name).write_text("x,y,z\n")
    with pytest.raises(BadValueError, match=rf"is not read here\n.*{words}"):
        read_splat_file(tmp_path / name)


def test_what_nobody_knows(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("hello")
    with pytest.raises(BadValueError, match=r"not a known kind of file of Gaussians\n.*\.spz"):
        read_splat_file(tmp_path / "a.txt")
    with pytest.raises(FileMissingError, match="is missing"):
        read_splat_file(tmp_path / "b.spz")
    with pytest.raises(FileMissingError, match="is a folder"):
        read_splat_file(tmp_path)


def test_version_4_without_zstd(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(spz.importlib, "import_module", missing)
    with pytest.raises(BadValueError, match=r"zstd, without which it cannot be read.*\n.*physhdr export"):
        read_splat_file(files / "version-4.spz")


@needs_zstd
def test_a_stream_of_zstd_that_goes_on(files: Path, tmp_path: Path) -> None:
    """Its table says what the header wants, and it unpacks to 256 MB."""
    raw = (files / "version-4.spz").read_bytes()
    bomb = spz._zstd("write").compress(bytes(1 << 28))
    table = 32
    sizes = list(struct.iter_unpack("<QQ", raw[table : table + 96]))
    begin = table + 96
    (tmp_path / "a.spz").write_bytes(
        raw[:table]
        + struct.pack("<QQ", len(bomb), sizes[0][1])
        + raw[table + 16 : begin]
        + bomb
        + raw[begin + sizes[0][0] :]
    )
    with pytest.raises(FileDamagedError, match=rf"a stream that is not {sizes[0][1]} bytes"):
        read_splat_file(tmp_path / "a.spz")


# ---- claims and bombs --------------------------------------------------------------------------------


def spz_header(count: int, degree: int = 3) -> bytes:
    return spz.HEADER.pack(spz.MAGIC, 3, count, degree, 12, 0, 0)


def ten_gigabytes(header: bytes) -> bytes:
    """A gzip stream of ``header`` and 10 GB of zeros, in 10 MB: one part of it, many times."""
    zeros = gzip.compress(bytes(1 << 26), 9)
    return gzip.compress(header) + zeros * 160


def claims(path: Path, what: str) -> Path:
    """A file that claims too much."""
    if what == "SPZ: 4 billion":
        path.write_bytes(gzip.compress(spz_header((1 << 32) - 1)))
    elif what == "SPZ 4: 4 billion":
        path.write_bytes(spz.HEADER_4.pack(spz.MAGIC, 4, (1 << 32) - 1, 0, 12, 0, 5, 32) + bytes(80))
    elif what == "SPZ 4: streams of 2^62":
        header = spz.HEADER_4.pack(spz.MAGIC, 4, 100, 0, 12, 0, 5, 32)
        path.write_bytes(header + struct.pack("<10Q", *[1 << 62] * 10) + bytes(500))
    elif what == "SPZ: 10 GB after it":
        path.write_bytes(ten_gigabytes(spz_header(1000)))
    elif what == "SPZ: 10 GB":
        path.write_bytes(ten_gigabytes(spz_header(160_000_000)))
    elif what == "KSPLAT: 4 billion":
        most = (1 << 32) - 1
        header = struct.pack("<BB2xIIIIH2x3fff", 0, 1, 1, 1, most, most, 0, 0, 0, 0, 0, 0).ljust(4096, b"\0")
        section = struct.pack("<IIIIfH2xIIIIH", most, most, 0, 0, 0.0, 0, 0, 0, 0, 0, 2).ljust(1024, b"\0")
        path.write_bytes(header + section + bytes(10_000))
    elif what == "KSPLAT: 4 billion sections":
        path.write_bytes(struct.pack("<BB2xI", 0, 1, (1 << 32) - 1).ljust(10_000, b"\0"))
    elif what == "PLY: 2^62 rows":
        columns = "".join(f"property float {name}\n" for name in standard_names(1))
        header = f"ply\nformat binary_little_endian 1.0\nelement vertex {1 << 62}\n{columns}end_header\n"
        path.write_bytes(header.encode() + bytes(10_000))
    elif what == "compressed PLY: 2^62 rows":
        words = "".join(
            f"property uint packed_{name}\n" for name in ("position", "rotation", "scale", "color")
        )
        header = f"ply\nformat binary_little_endian 1.0\nelement vertex {1 << 62}\n{words}end_header\n"
        path.write_bytes(header.encode() + bytes(10_000))
    elif what == "PLY: a million NaN":
        columns = "".join(f"property float {name}\n" for name in standard_names(4))
        header = f"ply\nformat binary_little_endian 1.0\nelement vertex 1000000\n{columns}end_header\n"
        path.write_bytes(header.encode() + np.full(26_000_000, np.nan, "<f4").tobytes())
    elif what == "splat: a million NaN":
        path.write_bytes(np.full(8_000_000, np.nan, "<f4").tobytes())
    return path


SUFFIX = {"PLY": ".ply", "compressed": ".ply", "splat": ".splat", "KSPLAT": ".ksplat", "SPZ": ".spz"}


CLAIMS = {
    "SPZ: 4 billion": "claims 4294967295 Gaussians",
    "SPZ 4: 4 billion": "claims 4294967295 Gaussians",
    "SPZ 4: streams of 2^62": "a stream of" if HAS_ZSTD else "zstandard",
    "SPZ: 10 GB after it": "has data after its 1000 Gaussians",
    "SPZ: 10 GB": "it is damaged, or a bomb",
    "KSPLAT: 4 billion": "whose sections need",
    "KSPLAT: 4 billion sections": "with 4294967295 sections",
    "PLY: 2^62 rows": "it claims",
    "compressed PLY: 2^62 rows": "it claims",
    "PLY: a million NaN": "every Gaussian has NaN",
    "splat: a million NaN": "most of its Gaussians are not numbers",
}


@pytest.mark.skipif(sys.platform != "linux", reason="limits a process's memory as Linux does")
def test_what_claims_too_much_takes_little_memory(tmp_path: Path) -> None:
    """Imported one after the other in a process of at most 2 GB."""
    code = (
        "import resource, sys; from pathlib import Path\n"
        "from physhdr.bridge.errors import PhysHDRError\n"
        "from physhdr.bridge.gaussian_import import read_gaussians\n"
        f"resource.setrlimit(resource.RLIMIT_AS, ({MEMORY}, {MEMORY}))\n"
        "for path in sys.argv[1:]:\n"
        "    try: print(read_gaussians(Path(path)).model.count)\n"
        "    except PhysHDRError as error: print(error.message)\n"
    )
    paths = []
    for index, what in enumerate(CLAIMS):
        suffix = SUFFIX[what.split(":")[0].split(" ")[0]]
        paths.append(claims(tmp_path / f"{index}{suffix}", what))
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", code, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
    assert done.returncode == 0, done.stderr
    for path, words, said in zip(paths, CLAIMS.values(), done.stdout.splitlines(), strict=True):
        assert words in said and path.name in said


def test_the_limit_is_felt_by_what_is_really_large(tmp_path: Path) -> None:
    """So that the test above can fail: Gaussians without end, were they read, need more than the limit."""
    code = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({MEMORY}, {MEMORY})); bytes({MEMORY})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "MemoryError" in done.stderr
