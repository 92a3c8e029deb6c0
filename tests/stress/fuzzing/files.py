# SPDX-License-Identifier: GPL-3.0-or-later
"""Single files: pictures, point clouds, model files, and the small ones that commands leave behind."""

import gzip
import json
import math
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from physhdr.bridge.errors import PhysHDRError

from .cases import InsaneError, Target
from .mutate import tests_module

HEIGHT, WIDTH = 20, 24
#: Gaussians as other programs write them.
_SPLAT_FILES = Path(__file__).resolve().parents[2] / "fixtures" / "splat_files.zip"


def require(right: bool, what: str) -> None:
    if not right:
        raise InsaneError(f"accepted though wrong is {what}")


def _finite(array: Any, what: str) -> None:
    require(bool(np.isfinite(np.asarray(array)).all()), f"{what}, which is not finite")


# ---- pictures ----------------------------------------------------------------------------------------------


def write_pngs(folder: Path) -> None:
    from PIL import Image, PngImagePlugin

    folder.mkdir(parents=True)
    rgb = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    smooth = np.broadcast_to(np.arange(WIDTH, dtype=np.uint8)[None, :, None], (HEIGHT, WIDTH, 3)).copy()
    info = PngImagePlugin.PngInfo()
    info.add_text("Software", "Blender", zip=True)
    info.add_itxt("Title", "küche")
    for mode, source in (("RGB", rgb), ("RGBA", rgb), ("P", rgb), ("L", smooth), ("LA", smooth), ("1", rgb)):
        folder_in(folder, f"png-{mode}")
        Image.fromarray(source).convert(mode).save(folder / f"png-{mode}" / "picture.png", pnginfo=info)


def write_jpegs(folder: Path) -> None:
    from PIL import Image

    layouts = tests_module("backend/scene/layouts.py")
    rgb = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    kinds: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("baseline", "RGB", {"quality": 90}),
        ("progressive", "RGB", {"progressive": True, "quality": 60}),
        ("grey", "L", {}),
        ("optimised", "RGB", {"optimize": True, "subsampling": 2}),
    )
    for name, mode, options in kinds:
        Image.fromarray(rgb).convert(mode).save(folder_in(folder, name) / "picture.jpg", **options)
    layouts.save(folder / "exif" / "picture.jpg", rgb, exif=layouts.camera_exif(0.125))


def write_exrs(folder: Path) -> None:
    """Scan lines in every compression, tiles, half floats; not files with several pictures."""
    import OpenEXR

    rgb = np.random.default_rng(0).uniform(0.0, 4.0, (HEIGHT, WIDTH, 3)).astype(np.float32)
    names = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB")
    for name in names:
        header = {
            "compression": getattr(OpenEXR, f"{name}_COMPRESSION"),
            "type": OpenEXR.scanlineimage,
            "note": "a text of the header",
        }
        pixels = rgb if name in ("NO", "ZIP") else rgb.astype(np.float16)
        OpenEXR.File(header, {"RGB": pixels}).write(str(folder_in(folder, name) / "picture.exr"))
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.tiledimage,
        "tiles": _tiles("ONE_LEVEL"),
    }
    OpenEXR.File(header, {"RGB": rgb}).write(str(folder_in(folder, "tiles") / "picture.exr"))


def _tiles(mode: str) -> Any:
    import OpenEXR

    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = 8
    tiles.mode = getattr(OpenEXR, mode)
    return tiles


def write_odd_exrs(folder: Path) -> None:
    """Several parts and deep pixels: none of our readers need accept them, none may fail on them."""
    import OpenEXR

    rgb = np.random.default_rng(0).uniform(0.0, 4.0, (HEIGHT, WIDTH, 3)).astype(np.float32)
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage}, {"RGB": rgb}, name) for name in "ab"]
    OpenEXR.File(parts).write(str(folder_in(folder, "parts") / "picture.exr"))
    deep = np.empty((HEIGHT, WIDTH), dtype=object)
    for row, column in np.ndindex(deep.shape):
        deep[row, column] = np.array([row, column], np.float32)
    channels = {name: deep for name in "RGB"}
    header = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.deepscanline}
    OpenEXR.File(header, channels).write(str(folder_in(folder, "deep") / "picture.exr"))
    header = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.deeptile, "tiles": _tiles("ONE_LEVEL")}
    OpenEXR.File(header, channels).write(str(folder_in(folder, "deep-tiles") / "picture.exr"))
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.tiledimage,
        "tiles": _tiles("MIPMAP_LEVELS"),
    }
    OpenEXR.File(header, {"RGB": rgb}).write(str(folder_in(folder, "levels") / "picture.exr"))


def write_deep(folder: Path) -> None:
    """PNG and TIFF of 16 bits, TIFF of floats and .hdr, by OpenImageIO: what Pillow does not read for us."""
    import OpenImageIO

    rng = np.random.default_rng(0)
    deep = rng.integers(0, 65536, (HEIGHT, WIDTH, 4), dtype=np.uint16)
    light = rng.uniform(0.01, 9.0, (HEIGHT, WIDTH, 3)).astype(np.float32)
    kinds = (
        ("png", deep, ""),
        ("tif", deep, "none"),
        ("tif", deep, "lzw"),
        ("tif", light, "zip"),
        ("hdr", light, ""),
    )
    for suffix, pixels, compression in kinds:
        place = folder_in(folder, f"{suffix}-{pixels.dtype}-{compression}") / f"picture.{suffix}"
        spec = OpenImageIO.ImageSpec(
            WIDTH, HEIGHT, pixels.shape[2], pixels.dtype.name.replace("float32", "float")
        )
        if compression:
            spec.attribute("compression", compression)
        writer = OpenImageIO.ImageOutput.create(str(place))
        assert writer is not None, f"OpenImageIO writes no .{suffix}"
        require(writer.open(str(place), spec) and writer.write_image(pixels), "a picture that is written")
        writer.close()


def write_layers(folder: Path) -> None:
    """As ``synth`` writes passes."""
    from physhdr.synth import exr

    rng = np.random.default_rng(0)
    names = ("ambient.R", "ambient.G", "ambient.B", "R", "G", "B", "depth.V", "index.V")
    planes = {name: rng.uniform(0.0, 4.0, (HEIGHT, WIDTH)).astype(np.float32) for name in names}
    content = exr.encode(planes, {"physhdr": json.dumps({"samples": 16})})
    (folder_in(folder, "layers") / "picture.exr").write_bytes(content)
    (folder_in(folder, "long") / "picture.exr").write_bytes(
        exr.encode(planes | {f"{'long' * 12}.R": planes["R"]})
    )


def read_picture(folder: Path, file: str, _: bytes) -> None:
    from physhdr.backend.scene.pictures import picture_size, read_codes

    size = picture_size(folder / file)
    picture, _alpha = read_codes(folder / file)
    require(
        picture.dtype in (np.uint8, np.uint16) and picture.shape == (size[1], size[0], 3), "a picture's size"
    )


def read_source(folder: Path, file: str, _: bytes) -> None:
    from physhdr.backend.scene.encoding import CAMERA, LogEncoding
    from physhdr.backend.scene.pictures import holds_radiance, picture_size
    from physhdr.backend.scene.source import PictureSource

    size = picture_size(folder / file)
    encoding = LogEncoding(4.0) if holds_radiance(folder / file) else CAMERA
    read = PictureSource(folder / file, encoding=encoding, alpha=True).read()
    require(read.codes.dtype in (np.uint8, np.uint16), "codes of 8 or 16 bits")
    require(read.codes.shape == (size[1], size[0], 3), "a picture's size")
    require(read.mask is None or read.mask.shape == read.codes.shape[:2], "a mask's size")


def read_exr(folder: Path, file: str, _: bytes) -> None:
    from physhdr.backend.scene.pictures import read_exr

    radiance = read_exr(folder / file)
    require(radiance.dtype == np.float32 and radiance.shape[2:] == (3,), "a picture's shape")
    _finite(radiance, "radiance")


def read_layers(folder: Path, file: str, _: bytes) -> None:
    from physhdr.backend.inspect.layers import read_layers

    planes = read_layers(folder / file)
    require(len({plane.shape for plane in planes.values()}) == 1, "layers of several sizes")
    require(all(plane.dtype == np.float32 for plane in planes.values()), "a layer's type")


def read_odd_exr(folder: Path, file: str, content: bytes) -> None:
    """Both readers; what the last one refuses is refused."""
    refused = None
    for read in (read_exr, read_layers):
        try:
            read(folder, file, content)
        except PhysHDRError as error:
            refused = error
    if refused:
        raise refused


def read_synth_exr(folder: Path, file: str, _: bytes) -> None:
    from physhdr.synth import exr

    radiance = exr.read(folder / file)
    _finite(radiance, "radiance")
    channels, texts = exr.read_channels(folder / file)
    require(all(plane.shape == radiance.shape[:2] for plane in channels.values()), "layers of several sizes")
    require(all(isinstance(text, str) for text in texts.values()), "the header's texts")


def write_synth_png(folder: Path) -> None:
    from physhdr.synth import png

    rgb = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    (folder_in(folder, "png") / "picture.png").write_bytes(png.encode(rgb))


def read_synth_png(folder: Path, file: str, _: bytes) -> None:
    from physhdr.synth import png

    picture = png.read(folder / file)
    require(picture.dtype == np.uint8 and picture.ndim == 3 and picture.shape[2] == 3, "a picture's shape")


def read_exif(folder: Path, file: str, _: bytes) -> None:
    """What a camera wrote: if it is damaged, it counts as missing."""
    from physhdr.backend.scene.exif import read_exif
    from physhdr.backend.scene.exposures import exposures_from_exif

    found = read_exif(folder / file)
    for value in (found.time, found.iso, found.f_number):
        require(value is None or (math.isfinite(value) and value > 0.0), "a number of EXIF")
    exposures = exposures_from_exif([folder / file])
    if exposures is not None:
        require(all(math.isfinite(x) and x > 0.0 for x in exposures[0]), "an exposure from EXIF")


def write_exif(folder: Path) -> None:
    layouts = tests_module("backend/scene/layouts.py")
    rgb = np.zeros((8, 8, 3), np.uint8)
    apex = {0x9201: 3.0, 0x9202: 6.0, 0x8827: 65535, 0x8832: 102400}
    for name, tags in (("times", layouts.camera_exif(0.125)), ("apex", apex)):
        layouts.save(folder / name / "picture.jpg", rgb, exif=tags)
    layouts.save(folder / "png" / "picture.png", rgb, exif=layouts.camera_exif(1.0))


def write_heics(folder: Path) -> None:
    """As phones and cameras do: 8 and 10 bits, tiles, turned, with a profile, code points, EXIF; and AVIF."""
    from PIL import Image, ImageCms

    heic = tests_module("backend/scene/capture/heic.py")
    layouts = tests_module("backend/scene/layouts.py")
    rgb = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    large = np.broadcast_to(np.arange(40, dtype=np.uint8)[:, None, None], (40, 40, 3)).copy()
    layouts.save(folder_in(folder, "plain") / "turned.jpg", rgb, exif=layouts.camera_exif(0.125))
    with Image.open(folder / "plain" / "turned.jpg") as picture:
        exif = picture.getexif()
        exif[0x0112] = 6
    (folder / "plain" / "turned.jpg").unlink()
    icc = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    heic.write_heic(folder / "plain" / "photo.heic", rgb, exif=exif.tobytes())
    heic.write_heic(folder_in(folder, "tiles") / "photo.heic", large, tile_size=16, icc_profile=icc)
    heic.write_heic(folder_in(folder, "deep") / "photo.hif", rgb * 4, 10, nclx=(9, 16))
    heic.write_heic(folder_in(folder, "several") / "photo.heic", rgb, others=[rgb], xmp=b"<x>GPano</x>")
    Image.fromarray(rgb).save(folder_in(folder, "avif") / "photo.avif", exif=exif)


def read_photo(folder: Path, file: str, _: bytes) -> None:
    from physhdr.backend.scene.capture.photos import find_photos

    for photo in find_photos(folder).photos:
        codes, _keep = photo.codes()
        require(codes.dtype == (np.uint16 if photo.deep else np.uint8), "codes of 8 or 16 bits")
        require(codes.shape == (photo.height, photo.width, 3), "a photo's size")
        for value in (photo.shutter, photo.iso, photo.f_number):
            require(value is None or (math.isfinite(value) and value > 0.0), "a number of EXIF")


# ---- Gaussians and points ----------------------------------------------------------------------------------


def write_plys(folder: Path) -> None:
    import plyfile

    from physhdr.bridge.gaussian_ply import standard_columns, write_lossless_ply, write_standard_ply
    from physhdr.bridge.lossless_form import tensor_comments

    plys = tests_module("bridge/test_ply_model.py")
    for name, coefficients in (("degree-0", 1), ("degree-1", 4)):
        write_standard_ply(folder_in(folder, name) / "splats.ply", **plys.gaussians(5, coefficients))
    for form, text, order in (("ascii", True, "="), ("big", False, ">")):
        ply = plyfile.PlyData.read(str(folder / "degree-0" / "splats.ply"))
        ply = plyfile.PlyData(ply.elements, text=text, byte_order=order, comments=["from elsewhere"])
        ply.write(str(folder_in(folder, form) / "splats.ply"))
    given = plys.gaussians(5, 4)
    rng = np.random.default_rng(0)
    names = [f"phys_reflectance_dc_{c}" for c in range(3)] + [f"phys_reflectance_rest_{i}" for i in range(9)]
    names += ["phys_log_illumination_0"]
    for name, logits, comments in (
        ("lossless", [f"phys_ambient_share_logits_{c}" for c in range(3)], []),
        ("lights", [f"phys_light_share_logits_{i}" for i in range(6)], ['phys_lights ["ambient", "lamp"]']),
    ):
        curve = {
            "tone_curve_log_exposure": np.linspace(-3, 3, 7, dtype=np.float32),
            "tone_curve": np.linspace(0, 1, 21, dtype=np.float32).reshape(7, 3),
        }
        form = "additive" if name == "lossless" else "additive-lights"
        lines = [f"phys_form product {form}", *comments, *tensor_comments("phys_curve", curve)]
        extra = {column: rng.normal(size=5).astype(np.float32) for column in (*names, *logits)}
        write_lossless_ply(folder_in(folder, name) / "splats.ply", standard_columns(**given), extra, lines)


def read_gaussians(folder: Path, file: str, _: bytes) -> None:
    from physhdr.bridge.gaussian_ply import read_ply

    ply = read_ply(folder / file)
    counts = {column.shape for column in ply.columns.values()}
    require(len(counts) == 1 and len(next(iter(counts))) == 1, "columns of several lengths")
    require(all(column.dtype == np.float32 for column in ply.columns.values()), "a column's type")


def read_ply_model(folder: Path, file: str, _: bytes) -> None:
    from physhdr.bridge.ply_model import read_ply_model

    found = read_ply_model(folder / file)
    check_model(found.model)
    printable(" ".join((*found.notes, *found.model.metadata, *found.model.metadata.values())))


def write_splat_files(folder: Path) -> None:
    """What other programs wrote: each in a folder of its own."""
    with zipfile.ZipFile(_SPLAT_FILES) as archive:
        for name in archive.namelist():
            if name not in ("made.txt", "source.ply"):
                (folder_in(folder, name) / name).write_bytes(archive.read(name))


def read_splat_files(folder: Path, file: str, _: bytes) -> None:
    from physhdr.bridge.gaussian_import import read_gaussians
    from physhdr.bridge.splat_files import read_splat_file

    found = read_gaussians(folder / file)
    check_model(found.model)
    printable(" ".join(found.notes))
    cloud = read_splat_file(folder / file)
    for name in ("position", "rotation", "scale", "opacity", "colour_sh"):
        _finite(getattr(cloud, name), name)


def write_unpacked_spz(folder: Path) -> None:
    """What an SPZ of version 2 or 3 unpacks to: damage to the file itself seldom gets past its checksum."""
    with zipfile.ZipFile(_SPLAT_FILES) as archive:
        for version in (2, 3):
            raw = gzip.decompress(archive.read(f"version-{version}.spz"))
            (folder_in(folder, f"version-{version}") / "unpacked.bin").write_bytes(raw)


def read_unpacked_spz(folder: Path, file: str, _: bytes) -> None:
    packed = folder / "packed.spz"
    raw = (folder / file).read_bytes() if (folder / file).is_file() else b""
    packed.write_bytes(gzip.compress(raw, 1))
    read_splat_files(folder, packed.name, b"")


def write_points(folder: Path) -> None:
    import plyfile

    small = tests_module("backend/scene/small_data_set.py")
    small.write_points(folder_in(folder, "binary") / "points.ply")
    for form, text, order in (("ascii", True, "="), ("big", False, ">")):
        ply = plyfile.PlyData.read(str(folder / "binary" / "points.ply"))
        plyfile.PlyData(ply.elements, text=text, byte_order=order).write(
            str(folder_in(folder, form) / "points.ply")
        )


def read_points(folder: Path, file: str, _: bytes) -> None:
    from physhdr.backend.scene.points import read_points

    points = read_points(folder / file)
    require(points.positions.shape == points.colours.shape and points.positions.shape[1:] == (3,), "shapes")
    _finite(points.positions, "a position")
    require(bool((points.colours >= 0.0).all() and (points.colours <= 1.0).all()), "a colour outside 0…1")


def write_models(folder: Path) -> None:
    from physhdr.bridge.model_file import write_model

    models = tests_module("bridge/test_model_file.py")
    for name, options in (
        ("additive", {}),
        ("baked", {"modulator": "baked-levels"}),
        ("lights", {"lights": ("ambient", "lamp")}),
    ):
        write_model(folder_in(folder, name) / "model.safetensors", models.make_model(count=4, **options))


def read_model(folder: Path, file: str, _: bytes) -> None:
    from physhdr.bridge.model_file import read_model, write_model

    model = read_model(folder / file)
    check_model(model)
    printable(" ".join((*model.metadata, *model.metadata.values(), *model.lights)))
    with tempfile.TemporaryDirectory(dir=folder) as again:
        path = Path(again) / "again.safetensors"
        write_model(path, model)
        second = read_model(path)
    for name, array in model.tensors().items():
        require(np.array_equal(array, second.tensors()[name]), f"{name}, written again")


def check_model(model: Any) -> None:
    """All values in their ranges, and the radiance that they give is one."""
    for name, array in model.tensors().items():
        _finite(array, name)
    require(bool((model.opacity >= 0.0).all() and (model.opacity <= 1.0).all()), "an opacity")
    require(bool((model.scale >= 0.0).all()), "a scale")
    directions = np.broadcast_to(np.array([0.6, 0.0, 0.8], np.float32), model.position.shape)
    with np.errstate(all="ignore"):
        _finite(model.radiance(directions), "radiance")
        _finite(model.log_gain(2.0), "a level's gain")


def printable(text: str) -> None:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise InsaneError(f"text that cannot be printed: {error}") from error


# ---- small files -------------------------------------------------------------------------------------------


def write_plan(folder: Path) -> None:
    from physhdr.lab.benchmark import plan

    lines = [line for line in (plan.__doc__ or "").splitlines() if "=" in line or line.startswith("[[")]
    text = "\n".join(lines).replace("../data/demo", "demo").replace("../data/bathroom", "bathroom")
    for name in ("demo", "bathroom"):
        folder_in(folder, f"plan/{name}")
        (folder / "plan" / name / "a.json").write_text("{}")
    (folder / "plan" / "plan.toml").write_text(text + "\n", encoding="utf-8")


def read_plan(folder: Path, file: str, _: bytes) -> None:
    from physhdr.lab.benchmark.plan import make_plan, read_plan, write_plan

    plan = make_plan(read_plan(folder / file), folder)
    with tempfile.TemporaryDirectory(dir=folder) as again:
        path = Path(again) / "plan.toml"
        write_plan(plan, path)
        require(make_plan(read_plan(path), path.parent) == plan, "a plan, written again")


def write_evaluation(folder: Path) -> None:
    means = {"psnr": 30.0, "ssim": 0.9, "lpips": 0.1, "lpips_01": 0.05}
    content = {
        "format": "physhdr-evaluation",
        "version": 1,
        "conditions": {"data_set": "", "views": 2},
        "means": {"LDR-OE": means, "LDR-NE": means, "HDR": means, "HDR, scale aligned": None},
        "scale_ratio": 1.01,
        "relit_means": {"all": {"ours": 30.0, "gain_over_scaled_truth": 3.0}},
    }
    (folder_in(folder, "evaluation") / "evaluation.json").write_text(json.dumps(content))


def read_evaluation(folder: Path, file: str, _: bytes) -> None:
    """Read, and shown in a table of every column."""
    from physhdr.backend.evaluate.comparison import METRICS, PARTS, ComparedRun, column, load_evaluation

    entry = ComparedRun("method", "scene", "exp3", 0, load_evaluation(folder / file))
    keys = [f"{part}.{metric}" for part in PARTS for metric in METRICS]
    for each in map(column, (*keys, "scale", "relit.psnr", "relit.gain")):
        value = each.value(entry)
        if value is not None:
            require(math.isfinite(value), "a number of a table")
            each.merit(value)
    printable(entry.data_set)


def write_log(folder: Path) -> None:
    lines = [{"event": "started", "iteration": 0}]
    for i in range(1, 6):
        losses, monitor = {"pixel": 1.0 / i, "ssim": 0.5}, {"PSNR": 20.0 + i}
        lines.append({"event": "progress", "iteration": i, "losses": losses, "monitor": monitor})
    (folder_in(folder, "log") / "log.jsonl").write_text("\n".join(map(json.dumps, lines)) + "\n")


def read_log(folder: Path, file: str, _: bytes) -> None:
    """Damaged lines are skipped; the rest can be sent."""
    from physhdr.backend.serve.curves import Curves
    from physhdr.bridge.messages import Envelope, decode, encode

    curves = Curves()
    curves.read(folder / file, 10**9)
    envelope = Envelope("reply", 1, curves.history())
    require(decode(encode(envelope)) == envelope, "a history, sent")


def write_connection(folder: Path) -> None:
    from physhdr.bridge.connection import Connection, new_token, write_connection

    write_connection(folder_in(folder, "home"), Connection(2, 40000, new_token(), 12345, "0.1", "/tmp/log"))


def read_connection(folder: Path, _: str, __: bytes) -> None:
    from physhdr.bridge.connection import read_connection

    found = read_connection(folder)
    require(0 < found.port < 1 << 16, "a port")
    require(found.pid > 0, "a process's number")
    require(found.token.isascii() and found.token.isprintable(), "a token that no header can carry")


def write_weights(folder: Path) -> None:
    """Of the right shapes, and all alike: a small file."""
    shapes = {"conv0": (64, 3, 11, 11), "conv3": (192, 64, 5, 5), "conv6": (384, 192, 3, 3)}
    shapes |= {"conv8": (256, 384, 3, 3), "conv10": (256, 256, 3, 3)}
    arrays: dict[str, np.ndarray] = {}
    for i, (name, shape) in enumerate(shapes.items()):
        arrays[f"{name}.weight"] = np.full(shape, 0.01, np.float32)
        arrays[f"{name}.bias"] = np.zeros(shape[0], np.float32)
        arrays[f"lin{i}"] = np.ones((1, shape[0], 1, 1), np.float32)
    np.savez_compressed(folder_in(folder, "weights") / "lpips.npz", **arrays)  # type: ignore[arg-type]


def read_weights(folder: Path, file: str, _: bytes) -> None:
    import torch

    from physhdr.backend.evaluate.lpips import Lpips

    distance = Lpips.from_file(folder / file)
    picture = torch.linspace(0.0, 1.0, 3 * 32 * 32).reshape(3, 32, 32)
    both = distance.both(picture, 1.0 - picture)
    require(all(map(math.isfinite, both)), "weights: the distance is not finite")


def write_response(folder: Path) -> None:
    (folder_in(folder, "json") / "curve.json").write_text("[[0.01, 0.1], [0.5, 0.6], [2.0, 0.95]]")
    (folder_in(folder, "text") / "curve.txt").write_text("# x code\n0.01 0.1\n0.5, 0.6\n2.0 0.95\n")


def read_response(folder: Path, file: str, _: bytes) -> None:
    from physhdr.synth.response import from_file

    codes = from_file(folder / file)(np.array([0.0, 0.1, 100.0]))
    require(bool((codes >= 0.0).all() and (codes <= 1.0).all()), "a code outside 0…1")


def write_state(folder: Path) -> None:
    from physhdr.bridge import data_set

    state = {"format": data_set.FORMAT, "version": data_set.VERSION, "generator": {"name": "physhdr"}}
    state |= {"options": {"seed": 0, "scene": "demo"}, "frames": {}}
    path = folder_in(folder, "out") / data_set.PARTIAL_FILE
    path.write_text(json.dumps(state))


def read_state(folder: Path, _: str, __: bytes) -> None:
    from physhdr.synth.folder import open_folder

    state = open_folder(folder, {"seed": 0, "scene": "demo"}, {"name": "physhdr"})
    require(isinstance(state, dict), "a state")


def folder_in(folder: Path, name: str) -> Path:
    (folder / name).mkdir(parents=True, exist_ok=True)
    return folder / name


def _synth_error() -> tuple[type[Exception], ...]:
    from physhdr.synth.errors import SynthError

    return (SynthError,)


TARGETS = (
    Target("picture: PNG", write_pngs, read_picture, 2000),
    Target("picture: JPEG", write_jpegs, read_picture, 1000),
    Target("picture: 16 bits, TIFF, .hdr", write_deep, read_source, 2000),
    Target("picture: EXR", write_exrs, read_exr, 2500),
    Target("picture: EXR, trained from", write_exrs, read_source, 1500),
    Target("picture: EXR, parts and deep", write_odd_exrs, read_odd_exr, 1000, whole_refused=True),
    Target("picture: EXR layers", write_layers, read_layers, 1000),
    Target("picture: EXR, synth", write_layers, read_synth_exr, 1500, refusals=_synth_error()),
    Target("picture: PNG, synth", write_synth_png, read_synth_png, 1500, refusals=_synth_error()),
    Target("picture: EXIF", write_exif, read_exif, 2000),
    Target("photo: HEIC, AVIF", write_heics, read_photo, 2000, needs="pillow_heif"),
    Target("PLY: Gaussians", write_plys, read_gaussians, 2000),
    Target("PLY: model", write_plys, read_ply_model, 2000),
    Target("Gaussians of other programs", write_splat_files, read_splat_files, 3000),
    Target("SPZ, unpacked", write_unpacked_spz, read_unpacked_spz, 1000, names_place=False),
    Target("PLY: first points", write_points, read_points, 1500),
    Target("model file", write_models, read_model, 3000),
    Target("benchmark plan", write_plan, read_plan, 1500, chosen=("plan.toml",), names_place=False),
    Target("evaluation.json", write_evaluation, read_evaluation, 1500),
    Target("log.jsonl", write_log, read_log, 1500),
    Target("connection.json", write_connection, read_connection, 1500),
    Target("LPIPS weights", write_weights, read_weights, 150),
    Target("response file, synth", write_response, read_response, 1000, refusals=_synth_error()),
    Target("dataset.json, synth", write_state, read_state, 1000, refusals=_synth_error()),
)
