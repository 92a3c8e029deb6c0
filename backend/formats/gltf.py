# SPDX-License-Identifier: GPL-3.0-or-later
"""glTF 2.0 with ``KHR_gaussian_splatting``: Gaussians as the attributes of a primitive of points.

As in the extension that Khronos ratified in 2026: ``POSITION``; ``KHR_gaussian_splatting:ROTATION``
(xyzw), ``:SCALE`` (linear standard deviations), ``:OPACITY`` (0…1) and ``:SH_DEGREE_l_COEF_n``, whose colour
is SH_C0·sh_0 + ½ + higher toward the direction from the camera, display-referred. ``colorSpace`` says whether
colours are blended as sRGB codes, or as linear values that are encoded after blending. Y is up. For programs
that do not know the extension ``COLOR_0`` has the plain colour, linear as glTF wants it.
"""

import base64
import binascii
import json
import struct
import urllib.parse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import numpy as np

from ...bridge import srgb
from ...bridge.affine import matrices_of
from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError, FileDamagedError
from ...bridge.gaussian_ply import SH_C0
from ...bridge.limits import is_number
from ...bridge.regular import parse_json, read_bytes, read_json_object, regular_file
from ...bridge.spherical_harmonics import degree_of
from ...bridge.splat_files import SplatCloud
from .placed import FREE, MOST_TIMES, joined, moved

EXTENSION = "KHR_gaussian_splatting"
Space = Literal["srgb_rec709_display", "lin_rec709_display"]
SPACES: tuple[Space, ...] = ("srgb_rec709_display", "lin_rec709_display")
MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"
#: Bytes of a GLB, whose header counts them in 32 bits, and of the JSON in it.
LARGEST, LARGEST_JSON = (1 << 32) - 1, 1 << 27
#: Component type → number type, and by what its integers are divided where they are normalised.
COMPONENTS = {
    5120: (np.dtype("i1"), 127.0),
    5121: (np.dtype("u1"), 255.0),
    5122: (np.dtype("<i2"), 32767.0),
    5123: (np.dtype("<u2"), 65535.0),
    5125: (np.dtype("<u4"), 1.0),
    5126: (np.dtype("<f4"), 1.0),
}
FLOAT, USHORT = 5126, 5123
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
POINTS, ARRAY_BUFFER = 0, 34962
#: How deep nodes may be nested.
DEEPEST = 64
REMEDY = "Export it again: it may be cut off, or use a part of glTF that is not read here."


@dataclass(frozen=True, eq=False)
class GltfSplats:
    """All Gaussians of a file's scene, in glTF's axes; ``color_space`` is what ``colour_sh`` describes."""

    cloud: SplatCloud
    color_space: Space


# -- writing -------------------------------------------------------------------------------------------------


def write_gltf(
    path: Path, cloud: SplatCloud, color_space: Space = "srgb_rec709_display", generator: str = ""
):
    """Write ``cloud``, which has Y up, as ``.glb``, or as ``.gltf`` with its data in it; atomically.

    ``color_space``: what its colours are. Raises ``BadValueError`` (too many for a GLB) and ``OutputError``.
    """
    parts: list[bytes] = []
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []

    def accessor(kind: str, values: np.ndarray, component: int, **more: Any) -> int:
        raw = np.ascontiguousarray(values, COMPONENTS[component][0]).tobytes()
        views.append({"buffer": 0, "byteOffset": sum(map(len, parts)), "byteLength": len(raw)})
        views[-1]["target"] = ARRAY_BUFFER
        parts.append(raw + bytes(-len(raw) % 4))
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": cloud.count})
        accessors[-1] |= {"type": kind, **more}
        return len(accessors) - 1

    position = cloud.position
    bounds = {"min": position.min(axis=0).tolist(), "max": position.max(axis=0).tolist()}
    names = {
        "POSITION": accessor("VEC3", position, FLOAT, **bounds),
        "COLOR_0": accessor("VEC4", _plain_colours(cloud, color_space), USHORT, normalized=True),
        f"{EXTENSION}:ROTATION": accessor("VEC4", cloud.rotation[:, [1, 2, 3, 0]], FLOAT),
        f"{EXTENSION}:SCALE": accessor("VEC3", cloud.scale, FLOAT),
        f"{EXTENSION}:OPACITY": accessor("SCALAR", cloud.opacity, FLOAT),
    }
    for name, index in coefficient_names(degree_of(cloud.colour_sh.shape[1])):
        names[name] = accessor("VEC3", cloud.colour_sh[:, index], FLOAT)
    extension = {"kernel": "ellipse", "colorSpace": color_space}
    extension |= {"projection": "perspective", "sortingMethod": "cameraDistance"}
    primitive = {"attributes": names, "mode": POINTS, "extensions": {EXTENSION: extension}}
    buffer = b"".join(parts)
    content: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": generator} if generator else {"version": "2.0"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": path.stem}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": len(buffer)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    if path.suffix.lower() == ".gltf":
        data = base64.b64encode(buffer).decode()
        content["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{data}"
        written = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
    else:
        written = _glb(content, buffer)
    with atomic_path(path) as temporary:
        temporary.write_bytes(written)


def coefficient_names(degree: int) -> Iterator[tuple[str, int]]:
    """Each attribute of SH up to ``degree``, and which coefficient it holds."""
    for band in range(degree + 1):
        for order in range(2 * band + 1):
            yield f"{EXTENSION}:SH_DEGREE_{band}_COEF_{order}", band * band + order


def _plain_colours(cloud: SplatCloud, space: Space) -> np.ndarray:
    """``[N, 4]`` uint16: linear colour and opacity of a point."""
    colour = (SH_C0 * cloud.colour_sh[:, 0].astype(np.float64) + 0.5).clip(0.0, 1.0)
    if space == "srgb_rec709_display":
        colour = srgb.to_linear(colour)
    both = np.concatenate([colour, cloud.opacity[:, None]], axis=1)
    return np.rint(65535.0 * both).astype(np.uint16)


def _glb(content: dict[str, Any], buffer: bytes) -> bytes:
    text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(buffer)
    if total > LARGEST:
        raise BadValueError(
            f"a GLB holds 4 GiB, and this would have {total} bytes", "Convert it to SPZ or USD, or split it."
        )
    head = MAGIC + struct.pack("<II", 2, total)
    json_head = struct.pack("<I", len(text)) + JSON_CHUNK
    return b"".join([head, json_head, text, struct.pack("<I", len(buffer)), BINARY_CHUNK, buffer])


# -- reading -------------------------------------------------------------------------------------------------


def read_gltf(path: Path) -> GltfSplats:
    """Read every Gaussian of the scene of a ``.glb`` or ``.gltf``, each primitive where its nodes put it.

    Attributes are floats, or integers as the extension allows. Raises ``FileMissingError``,
    ``FileDamagedError``, and ``BadValueError`` where it has no Gaussians, or compressed ones.
    """
    path = Path(path)
    regular_file(path, "Check the path, or choose another file.")
    return _Gltf(path).splats()


class _Gltf:
    def __init__(self, path: Path) -> None:
        self.path = path
        with open(path, "rb") as file:
            is_binary = file.read(4) == MAGIC
        self.content, self.binary = (
            self._parsed() if is_binary else (read_json_object(path, REMEDY, LARGEST), None)
        )
        asset = self.content.get("asset")
        if not isinstance(asset, dict) or not str(asset.get("version", "")).startswith("2."):
            raise self.damaged("it is not of version 2")
        self.buffers: dict[int, bytes] = {}

    def splats(self) -> GltfSplats:
        stored: set[int] = set()
        clouds: list[SplatCloud] = []
        spaces: set[Space] = set()
        total = in_file = 0
        for primitive, extension, matrix in self._splats():
            if total > max(FREE, MOST_TIMES * in_file):
                break  # joined() says why
            cloud, space = self._gaussians(primitive, extension)
            total += cloud.count
            if id(primitive) not in stored:
                in_file += cloud.count
                stored.add(id(primitive))
            clouds.append(moved(self.path, cloud, matrix))
            spaces.add(space)
        if not clouds:
            raise BadValueError(
                f"{self.path} has no Gaussians ({EXTENSION})",
                "For a mesh use Blender's own File > Import > glTF 2.0.",
            )
        if len(spaces) > 1:
            raise BadValueError(f"{self.path}: its Gaussians have two colour spaces", "Export each alone.")
        return GltfSplats(joined(self.path, clouds, in_file), spaces.pop())

    def damaged(self, what: str) -> FileDamagedError:
        return FileDamagedError(f"{self.path} is not a readable glTF: {what}", REMEDY)

    # -- the container ---------------------------------------------------------------------------------------

    def _parsed(self) -> tuple[dict[str, Any], bytes]:
        raw = read_bytes(self.path, REMEDY, LARGEST)
        if len(raw) < 20:
            raise self.damaged("it ends in its header")
        version, total = struct.unpack_from("<II", raw, 4)
        length = struct.unpack_from("<I", raw, 12)[0]
        if version != 2 or raw[16:20] != JSON_CHUNK or length > LARGEST_JSON:
            raise self.damaged("it does not begin with its JSON")
        if total > len(raw) or 20 + length > len(raw):
            raise self.damaged(f"it claims {total} bytes and has {len(raw)}")
        try:
            content = parse_json(raw[20 : 20 + length].decode("utf-8"))
        except (ValueError, RecursionError) as error:
            raise self.damaged(f"its JSON cannot be read ({error!s:.100})") from error
        if not isinstance(content, dict):
            raise self.damaged("its JSON is not an object")
        at = 20 + length
        if at + 8 > len(raw) or raw[at + 4 : at + 8] != BINARY_CHUNK:
            return content, b""
        size = struct.unpack_from("<I", raw, at)[0]
        if at + 8 + size > len(raw):
            raise self.damaged(f"its data are cut off: {size} bytes, {len(raw) - at - 8} are there")
        return content, raw[at + 8 : at + 8 + size]

    def _item(self, kind: str, index: Any) -> dict[str, Any]:
        items = self.content.get(kind)
        if isinstance(items, list) and type(index) is int and 0 <= index < len(items):
            item = items[index]
            if isinstance(item, dict):
                return item
        raise self.damaged(f"there is no {kind}[{index!r:.40}]")

    def _whole(self, holder: dict[str, Any], key: str, default: int | None = None) -> int:
        value = holder.get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 40:
            raise self.damaged(f"{key} is {value!r:.40}")
        return value

    def _buffer(self, index: int) -> bytes:
        if index not in self.buffers:
            self.buffers[index] = self._loaded(index)
        return self.buffers[index]

    def _loaded(self, index: int) -> bytes:
        uri = self._item("buffers", index).get("uri")
        if uri is None:
            if index != 0 or self.binary is None:
                raise self.damaged(f"buffers[{index}] is nowhere")
            return self.binary
        if not isinstance(uri, str):
            raise self.damaged(f"buffers[{index}].uri is {uri!r:.40}")
        if uri.startswith("data:"):
            head, _, data = uri.partition(",")
            try:
                return base64.b64decode(data, validate=True) if head.endswith(";base64") else b""
            except binascii.Error as error:
                raise self.damaged(f"buffers[{index}] is not base64 ({error})") from error
        name = urllib.parse.unquote(uri)
        if PurePosixPath(name).name != name or "\\" in name or ":" in name or name in ("", ".", ".."):
            raise self.damaged(f"buffers[{index}].uri {uri!r:.80} is not a file beside it")
        return read_bytes(self.path.parent / name, REMEDY, LARGEST)

    # -- nodes -----------------------------------------------------------------------------------------------

    def _splats(self) -> Iterator[tuple[dict[str, Any], Any, np.ndarray]]:
        """Each primitive of Gaussians in the scene with its extension, and the matrix of where it stands."""
        for mesh, matrix in self._placed():
            for primitive, extension in _splat_primitives(mesh):
                yield primitive, extension, matrix

    def _placed(self) -> Iterator[tuple[dict[str, Any], np.ndarray]]:
        """Each mesh of the scene, and the matrix ``[4, 4]`` of where it stands."""
        if "scenes" not in self.content:  # no scene: every mesh where it is
            meshes = self.content.get("meshes")
            for index in range(len(meshes) if isinstance(meshes, list) else 0):
                yield self._item("meshes", index), np.eye(4)
            return
        roots = self._item("scenes", self.content.get("scene", 0)).get("nodes", [])
        waiting = [(index, np.eye(4), 0) for index in roots] if isinstance(roots, list) else []
        seen: set[Any] = set()
        while waiting:
            index, above, depth = waiting.pop()
            node = self._item("nodes", index)
            if depth > DEEPEST or index in seen:
                raise self.damaged(f"nodes[{index}] is in itself, in two others or too deep")
            seen.add(index)
            matrix = above @ self._matrix(node)
            if "mesh" in node:
                yield self._item("meshes", node["mesh"]), matrix
            children = node.get("children", [])
            waiting += (
                [(child, matrix, depth + 1) for child in children] if isinstance(children, list) else []
            )

    def _matrix(self, node: dict[str, Any]) -> np.ndarray:
        def numbers(key: str, default: list[float]) -> np.ndarray:
            values = node.get(key, default)
            if not isinstance(values, list) or len(values) != len(default) or not all(map(is_number, values)):
                raise self.damaged(f"a node's {key} is {values!r:.80}")
            return np.array(values, np.float64)

        if "matrix" in node:
            return numbers("matrix", np.eye(4).ravel().tolist()).reshape(4, 4).T
        matrix = np.eye(4)
        x, y, z, w = numbers("rotation", [0.0, 0.0, 0.0, 1.0])
        matrix[:3, :3] = matrices_of(np.array([[w, x, y, z]]))[0] * numbers("scale", [1.0, 1.0, 1.0])
        matrix[:3, 3] = numbers("translation", [0.0, 0.0, 0.0])
        return matrix

    # -- Gaussians -------------------------------------------------------------------------------------------

    def _gaussians(self, primitive: dict[str, Any], extension: Any) -> tuple[SplatCloud, Space]:
        if not isinstance(extension, dict):
            raise self.damaged(f"{EXTENSION} is not an object")
        space, kernel = extension.get("colorSpace", SPACES[0]), extension.get("kernel", "ellipse")
        if extension.get("extensions"):
            raise BadValueError(
                f"{self.path}: its Gaussians are compressed or changed by {_names(extension['extensions'])}",
                "Export it without compression.",
            )
        if space not in SPACES or kernel != "ellipse":
            raise BadValueError(
                f"{self.path}: colour space {space!r:.40}, kernel {kernel!r:.40}",
                f"Supported are {' and '.join(SPACES)}, ellipse.",
            )
        names = primitive.get("attributes")
        if not isinstance(names, dict):
            raise self.damaged("a primitive has no attributes")
        position = self._values(names, "POSITION", 3)
        sh = []
        degree = max((d for d in (1, 2, 3) if f"{EXTENSION}:SH_DEGREE_{d}_COEF_0" in names), default=0)
        for name, _ in coefficient_names(degree):
            sh.append(self._values(names, name, 3))
        cloud = SplatCloud(
            position=position,
            rotation=self._values(names, f"{EXTENSION}:ROTATION", 4)[:, [3, 0, 1, 2]],
            scale=self._values(names, f"{EXTENSION}:SCALE", 3),
            opacity=self._values(names, f"{EXTENSION}:OPACITY", 1)[:, 0],
            colour_sh=np.stack(sh, axis=1),
            up="y",
        )
        return cloud, space

    def _values(self, names: dict[str, Any], name: str, width: int) -> np.ndarray:
        """An attribute ``[N, width]`` float32."""
        if name not in names:
            raise self.damaged(f"its Gaussians have no {name}")
        accessor = self._item("accessors", names[name])
        kind, component = accessor.get("type"), accessor.get("componentType")
        known = COMPONENTS.get(component) if type(component) is int else None
        if WIDTHS.get(str(kind)) != width or known is None or "sparse" in accessor:
            raise self.damaged(f"{name} is {kind!r:.40} of type {component!r:.40}, or sparse")
        count = self._whole(accessor, "count")
        view = self._item("bufferViews", accessor.get("bufferView"))
        if view.get("extensions"):
            raise BadValueError(
                f"{self.path}: {name} is compressed ({_names(view['extensions'])})",
                "Export it without compression.",
            )
        dtype, whole = known
        size = dtype.itemsize * width
        stride = self._whole(view, "byteStride", size)
        start, length = self._whole(view, "byteOffset", 0), self._whole(view, "byteLength")
        offset = self._whole(accessor, "byteOffset", 0)
        buffer = self._buffer(self._whole(view, "buffer"))
        last = offset + (count - 1) * stride + size
        if start + length > len(buffer) or count < 1 or stride < size or last > length:
            raise self.damaged(f"{name} claims {count} values, which are not there")
        raw = np.ndarray(
            (count, width), dtype, buffer, offset=start + offset, strides=(stride, dtype.itemsize)
        )
        values = raw.astype(np.float32)
        if accessor.get("normalized") and dtype.kind in "iu":
            values = np.maximum(values / np.float32(whole), -1.0)
        return values


def _names(extensions: Any) -> str:
    """Extensions for a message; their names are the file's and may be anything."""
    return f"{', '.join(map(ascii, extensions)) if isinstance(extensions, dict) else ascii(extensions):.200}"


def _splat_primitives(mesh: dict[str, Any]) -> Iterator[tuple[dict[str, Any], Any]]:
    """Each primitive of Gaussians, and what the extension says of it."""
    primitives = mesh.get("primitives")
    for primitive in primitives if isinstance(primitives, list) else []:
        extensions = primitive.get("extensions") if isinstance(primitive, dict) else None
        if isinstance(extensions, dict) and EXTENSION in extensions:
            yield primitive, extensions[EXTENSION]
