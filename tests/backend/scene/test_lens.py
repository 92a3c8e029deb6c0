# SPDX-License-Identifier: GPL-3.0-or-later
"""Lenses taken out of pictures, against OpenCV's forward models and closed forms of the others.

Three points of the world are drawn where a lens puts them by a formula that is not pycolmap's; in the picture
without distortion they must be where the view's pinhole camera has them.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest

from physhdr.backend.scene import Scene, read_scene
from physhdr.backend.scene.lens import RealCamera, lenses_by_size, make_lens
from physhdr.bridge.errors import BadValueError, FileMissingError

#: Pixels by which a spot may be off: 8 bits, JPEG, and that a spot is bent, too.
HIT = 0.1

#: Directions ``[N, 2]`` on the plane z = 1 → where they are seen, in focal lengths from the principal point.
Model = Callable[[np.ndarray], np.ndarray]


def opencv(*distortion: float) -> Model:
    """OpenCV's k1, k2, p1, p2, k3, k4, k5, k6."""
    return lambda rays: cv2.projectPoints(with_depth(rays), *NOWHERE, np.eye(3), np.array(distortion))[0][
        :, 0
    ]


def fisheye(*k: float) -> Model:
    """OpenCV's k1 to k4 of the angle from the axis."""
    coefficients = np.array([*k, 0.0, 0.0, 0.0, 0.0][:4])
    return lambda rays: cv2.fisheye.projectPoints(
        with_depth(rays)[:, None], *NOWHERE, np.eye(3), coefficients
    )[0][:, 0]


NOWHERE = (np.zeros(3), np.zeros(3))


def with_depth(rays: np.ndarray) -> np.ndarray:
    return np.concatenate([rays, np.ones((len(rays), 1))], axis=1)


def radius(rays: np.ndarray) -> np.ndarray:
    return np.linalg.norm(rays, axis=1, keepdims=True)


def field_of_view(omega: float) -> Model:
    """Devernay and Faugeras: r' = atan(2 r tan(ω/2)) / ω."""
    return lambda rays: rays / radius(rays) * np.arctan(2.0 * radius(rays) * np.tan(0.5 * omega)) / omega


def division(k: float) -> Model:
    """Fitzgibbon: x = x' / (1 + k r'²), solved for r'."""

    def bent(rays: np.ndarray) -> np.ndarray:
        r = radius(rays)
        return rays / r * (1.0 - np.sqrt(1.0 - 4.0 * k * r**2)) / (2.0 * k * r)

    return bent


def thin_prism(
    k1: float, k2: float, p1: float, p2: float, k3: float, k4: float, s1: float, s2: float
) -> Model:
    """Weng's radial, tangential and thin prism terms, of the equidistant picture (COLMAP's documentation)."""

    def bent(rays: np.ndarray) -> np.ndarray:
        u, v = (rays / radius(rays) * np.arctan(radius(rays))).T
        r2 = u * u + v * v
        radial = k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
        x = u + u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u) + s1 * r2
        y = v + v * radial + 2.0 * p2 * u * v + p1 * (r2 + 2.0 * v * v) + s2 * r2
        return np.stack([x, y], axis=1)

    return bent


def unified(alpha: float, beta: float) -> Model:
    """The extended unified camera model: x' = x / (α √(β r² + 1) + 1 − α) (Khomutenko et al.)."""
    return lambda rays: rays / (alpha * np.sqrt(beta * radius(rays) ** 2 + 1.0) + 1.0 - alpha)


F, C = (88.0, 86.0), (47.0, 37.5)
#: COLMAP's model: its number, how many focal lengths it has, its distortion, and the formula.
COLMAP: dict[str, tuple[int, int, tuple[float, ...], Model]] = {
    "SIMPLE_RADIAL": (2, 1, (0.12,), opencv(0.12, 0, 0, 0)),
    "RADIAL": (3, 1, (0.15, -0.1), opencv(0.15, -0.1, 0, 0)),
    "OPENCV": (4, 2, (-0.2, 0.05, 0.004, -0.006), opencv(-0.2, 0.05, 0.004, -0.006)),
    "OPENCV_FISHEYE": (5, 2, (-0.02, 0.01, -0.002, 0.001), fisheye(-0.02, 0.01, -0.002, 0.001)),
    "FULL_OPENCV": (
        *(6, 2, (0.4, -0.2, 0.003, 0.002, 0.05, 0.5, -0.1, 0.02)),
        opencv(0.4, -0.2, 0.003, 0.002, 0.05, 0.5, -0.1, 0.02),
    ),
    "FOV": (7, 2, (0.8,), field_of_view(0.8)),
    "SIMPLE_RADIAL_FISHEYE": (8, 1, (0.05,), fisheye(0.05)),
    "RADIAL_FISHEYE": (9, 1, (0.05, -0.02), fisheye(0.05, -0.02)),
    "THIN_PRISM_FISHEYE": (
        *(10, 2, (0.05, -0.01, 0.002, 0.003, 0.004, 0.0, 0.01, -0.006)),
        thin_prism(0.05, -0.01, 0.002, 0.003, 0.004, 0.0, 0.01, -0.006),
    ),
    "SIMPLE_DIVISION": (12, 1, (-0.15,), division(-0.15)),
    "DIVISION": (13, 2, (-0.15,), division(-0.15)),
    "SIMPLE_FISHEYE": (14, 1, (), fisheye(0.0)),
    "FISHEYE": (15, 2, (), fisheye(0.0)),
    "EUCM": (16, 2, (0.55, 1.1), unified(0.55, 1.1)),
}


def bent_spots(layouts: ModuleType, index: int, model: Model, f=F, c=C) -> np.ndarray:
    """``[3, 2]``: where camera ``index`` sees the three points through the lens, pixels."""
    rotation, translation = layouts.world_to_camera(index)
    x, y, z = rotation @ layouts.POINTS.T + translation[:, None]
    return model(np.stack([x / z, y / z], axis=1)) * f + c


def draw(layouts: ModuleType, places: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """``[H, W, 3]`` uint8: a spot of each channel."""
    y, x = np.mgrid[0 : size[1], 0 : size[0]] + 0.5
    spots = [np.exp(-0.5 * ((x - u) ** 2 + (y - v) ** 2) / layouts.SPOT**2) for u, v in places]
    return np.round(layouts.background(0) + layouts.PEAK * np.stack(spots, axis=-1)).astype(np.uint8)


def distances(layouts: ModuleType, scene: Scene) -> np.ndarray:
    """How far each view's spots are from where its camera has the points, pixels."""
    found = []
    for view, i in scene.pictures():
        camera = view.camera
        x, y, z, _ = camera.world_to_camera @ np.c_[layouts.POINTS, np.ones(3)].T
        expected = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
        found.append(np.linalg.norm(layouts.spots(view.image(i), 0) - expected, axis=1))
    return np.concatenate(found)


# ---- COLMAP's models ---------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["bin", "txt"])
@pytest.mark.parametrize("name", COLMAP)
def test_each_model_of_colmap(layouts: ModuleType, tmp_path: Path, name: str, form: str) -> None:
    number, focal_lengths, distortion, model = COLMAP[name]
    f = F if focal_lengths == 2 else (F[0], F[0])
    images = {f"{index}.png": index for index in range(3)}
    for file, index in images.items():
        places = bent_spots(layouts, index, model, f)
        layouts.save(tmp_path / "images" / file, draw(layouts, places, (layouts.WIDTH, layouts.HEIGHT)))
    layouts.MODELS[name] = number
    params = (*f[:focal_lengths], *C, *distortion)
    layouts.write_sparse(tmp_path / "sparse" / "0", images, form, model=name, params=params)
    scene = read_scene(tmp_path)
    assert distances(layouts, scene).max() < HIT
    assert any(f"distortion of the lens {name}" in message for message in scene.messages)
    camera = scene.train[0].camera
    assert (camera.fx, camera.fy) == f, "a pinhole of the same focal length"


def test_models_that_bend_nothing_stay_as_they_are(layouts: ModuleType, tmp_path: Path) -> None:
    """And need nothing: not even pycolmap."""
    params = (layouts.FX, layouts.FY, layouts.CX, layouts.CY, 0.0, 0.0, 0.0, 0.0)
    root = layouts.write_colmap(tmp_path / "data", poses=2, model="OPENCV", params=params)
    view = read_scene(root).train[0]
    assert (view.camera.width, view.camera.height) == (layouts.WIDTH, layouts.HEIGHT)
    assert view.sources[0].lens is None and not (root / ".physhdr").exists()


def test_without_pycolmap_the_remedy_is_told(layouts: ModuleType, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    read_scene(layouts.write_nerfstudio(tmp_path / "straight"))
    with pytest.raises(FileMissingError, match=r"\(OPENCV\) are undistorted with pycolmap[\s\S]*pip"):
        read_scene(layouts.write_nerfstudio(tmp_path / "bent", k1=0.1))


# ---- transforms.json ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("told", "model"),
    [
        (
            {"k1": 0.0578, "k2": -0.0805, "p1": -0.00098, "p2": 0.00016},
            opencv(0.0578, -0.0805, -0.00098, 0.00016),
        ),
        ({"camera_model": "SIMPLE_RADIAL", "k1": -0.1}, opencv(-0.1, 0, 0, 0)),
        ({"camera_model": "OPENCV", "k1": 0.1, "k3": -0.05}, opencv(0.1, 0, 0, 0, -0.05)),
        (
            {"camera_model": "FULL_OPENCV", "k1": 0.4, "k2": -0.2, "k4": 0.5, "k5": -0.1, "k6": 0.02},
            opencv(0.4, -0.2, 0, 0, 0, 0.5, -0.1, 0.02),
        ),
        ({"camera_model": "OPENCV_FISHEYE", "k1": -0.02, "k4": 0.003}, fisheye(-0.02, 0, 0, 0.003)),
        ({"is_fisheye": True, "k1": 0.03}, fisheye(0.03)),
    ],
)
@pytest.mark.parametrize("downscale", [None, 2.0])
def test_each_model_of_transforms(
    layouts: ModuleType, tmp_path: Path, told: dict[str, Any], model: Model, downscale: float | None
) -> None:
    size = (2 * layouts.WIDTH, 2 * layouts.HEIGHT)
    f, c = (180.0, 176.0), (94.0, 75.0)
    frames = []
    for index in range(4):
        name = f"images/{index:04d}.png"
        layouts.save(tmp_path / name, draw(layouts, bent_spots(layouts, index, model, f, c), size))
        frames.append({"file_path": name, "transform_matrix": layouts.camera_to_world_opengl(index).tolist()})
    content = {"w": size[0], "h": size[1], "fl_x": f[0], "fl_y": f[1], "cx": c[0], "cy": c[1], **told}
    (tmp_path / "transforms.json").write_text(json.dumps(content | {"frames": frames}))
    scene = read_scene(tmp_path, downscale)
    assert distances(layouts, scene).max() < HIT
    assert scene.train[0].camera.fx == f[0] / (downscale or 1.0)
    assert scene.train[0].cache.reduction.factor == (downscale or 1.0), "what memory's advice counts from"


def test_frames_with_lenses_of_their_own(layouts: ModuleType, tmp_path: Path) -> None:
    """Found for each photo by itself they give one size; another camera and a pinhole have theirs."""
    root = tmp_path
    frames = []
    for index, (k1, size) in enumerate([(0.1, 1), (0.101, 1), (0.099, 1), (-0.1, 2), (0.0, 1)]):
        sides = (size * layouts.WIDTH, size * layouts.HEIGHT)
        f, c = (F[0] * size, F[1] * size), (C[0] * size, C[1] * size)
        name = f"images/{index}.png"
        layouts.save(root / name, draw(layouts, bent_spots(layouts, index, opencv(k1, 0, 0, 0), f, c), sides))
        pose = layouts.camera_to_world_opengl(index).tolist()
        frames.append({"file_path": name, "transform_matrix": pose, "k1": k1, "w": sides[0], "h": sides[1]})
        frames[-1] |= {"fl_x": f[0], "fl_y": f[1], "cx": c[0], "cy": c[1]}
    (root / "transforms.json").write_text(json.dumps({"frames": frames}))
    scene = read_scene(root, 1.0)
    assert distances(layouts, scene).max() < HIT
    views = sorted([*scene.train, *scene.test], key=lambda view: view.index)
    sizes = [(view.camera.width, view.camera.height) for view in views]
    assert len(set(sizes[:3])) == 1 and sizes[3][0] > 192 and sizes[4] == (layouts.WIDTH, layouts.HEIGHT)
    assert any("pictures have 2 sizes (4 of 96×72, 1 of 192×144)" in message for message in scene.messages)
    assert any("distortion of 4 lenses, the first OPENCV" in message for message in scene.messages)


# ---- the lens by itself ------------------------------------------------------------------------------

#: A phone's, as COLMAP found it.
PHONE = ("OPENCV", 270, 480, (344.0, 343.6, 138.6, 241.3, 0.0578, -0.0805, -0.00098, 0.00016))


def test_straight_lines_are_straight() -> None:
    """Lines of a plane that a lens bends by up to 3 pixels, sampled where OpenCV says each pixel looks."""
    model, width, height, params = PHONE
    params = (*params[:4], -0.12, 0.03, 0.001, -0.001)
    fx, fy, cx, cy = params[:4]
    y, x = np.mgrid[0:height, 0:width] + 0.5
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    criteria = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    places = np.stack([x.ravel(), y.ravel()], axis=1)[:, None]
    rays = cv2.undistortPoints(places, K, np.array(params[4:]), R=np.eye(3), P=np.eye(3), criteria=criteria)
    across, down = rays.reshape(height, width, 2).transpose(2, 0, 1)
    lens = make_lens(pycolmap.Camera(model=model, width=width, height=height, params=list(params)), 1.0)

    def photo_of(distance: np.ndarray) -> np.ndarray:
        """A soft dark line where ``distance`` (focal lengths) is 0."""
        codes = 220.0 - 200.0 * np.exp(-0.5 * (distance * fx / 2.0) ** 2)
        return np.repeat(np.round(codes)[..., None], 3, axis=2).astype(np.uint8)

    for slope, offset in ((0.0, -0.33), (0.0, 0.3), (0.2, -0.2), (-0.1, 0.25)):
        dark = 220.0 - lens.picture(photo_of(across - slope * down - offset))[..., 0].astype(float)
        columns, rows = np.arange(lens.width) + 0.5, np.arange(lens.height) + 0.5
        dark = np.where(dark > 12.0, dark, 0.0)
        found = (dark * columns).sum(axis=1) / dark.sum(axis=1)
        expected = lens.fx * (slope * (rows - lens.cy) / lens.fy + offset) + lens.cx
        inside = (expected > 8.0) & (expected < lens.width - 8.0)
        assert inside.sum() > 200
        assert np.abs(found - expected)[inside].max() < 0.1
        bent = np.abs(np.polyval(np.polyfit(rows[inside], found[inside], 1), rows) - found)[inside]
        assert bent.max() < 0.1


def test_a_picture_is_as_exact_as_its_resampling_lets_it() -> None:
    """Sines of up to a quarter of a cycle a pixel: bilinear, as pycolmap has it, is twice as far off."""
    model, width, height, params = PHONE
    camera = pycolmap.Camera(model=model, width=width, height=height, params=list(params))
    lens = make_lens(camera, 1.0)
    waves = np.random.default_rng(0).uniform(-0.16, 0.16, (12, 2))

    def picture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Codes by where on the plane a pixel looks, in pixels of the pinhole camera."""
        each = [9.0 * np.sin(2 * np.pi * (a * x + b * y) + 9 * a) for a, b in waves]
        return 127.5 + np.sum(each, axis=0)

    v, u = np.mgrid[0:height, 0:width] + 0.5
    rays = np.asarray(camera.cam_from_img(np.stack([u.ravel(), v.ravel()], axis=1)))
    bent = picture(*(rays * (lens.fx, lens.fy) + (lens.cx, lens.cy)).T).reshape(height, width)
    codes = np.repeat(np.round(bent)[..., None], 3, axis=2).astype(np.uint8)
    y, x = np.mgrid[0 : lens.height, 0 : lens.width] + 0.5
    inner = (slice(6, -6), slice(6, -6))
    ours = (lens.picture(codes)[..., 0] - picture(x, y))[inner]
    map_x, map_y = np.empty_like(x, np.float32), np.empty_like(x, np.float32)
    on_plane = [(x.ravel() - lens.cx) / lens.fx, (y.ravel() - lens.cy) / lens.fy, np.ones(x.size)]
    places = np.asarray(camera.img_from_cam(np.stack(on_plane, axis=1)))
    map_x[:], map_y[:] = (places - 0.5).T.reshape(2, *x.shape)
    bilinear = cv2.remap(codes, map_x, map_y, cv2.INTER_LINEAR)[..., 0]
    theirs = (bilinear - picture(x, y))[inner]
    assert np.sqrt(np.mean(ours**2)) < 0.8 < 1.6 < np.sqrt(np.mean(theirs**2))
    assert abs(ours.mean()) < 0.02
    sixteen = np.repeat(np.round(bent * 257.0)[..., None], 3, axis=2).astype(np.uint16)
    found = lens.picture(sixteen)
    assert found.dtype == np.uint16
    assert np.sqrt(np.mean((found[..., 0] / 257.0 - picture(x, y))[inner] ** 2)) < 0.7


@pytest.mark.parametrize("scale", [1.0, 0.5, 0.3])
def test_a_mask_is_true_where_all_of_a_pixel_is(scale: float) -> None:
    """Whatever stands where the mask is False, the picture where it is True does not change."""
    model, width, height, params = PHONE
    lens = make_lens(pycolmap.Camera(model=model, width=width, height=height, params=list(params)), scale)
    rng = np.random.default_rng(3)
    photo = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    mask = np.ones((height, width), bool)
    mask[100:150, 60:90] = mask[0:5] = mask[:, -9:] = mask[300, 200] = False
    other = np.where(mask[..., None], photo, 255 - photo)
    compared = lens.mask(mask)
    changed = (lens.picture(photo) != lens.picture(other)).any(axis=2)
    assert not (changed & compared).any()
    # And no more is left out than the filter reaches, two pixels of the photo to each side.
    assert changed[~compared].mean() > 0.6 and 0.8 < compared.mean() < 0.95
    assert lens.mask(np.ones_like(mask)).all()


@pytest.mark.parametrize(
    ("model", "params"),
    [
        *[
            (name, (*((300.0, 310.0)[:focal]), 210.0, 145.0, *extra))
            for name, (_, focal, extra, _) in COLMAP.items()
        ],
        ("OPENCV", (250.0, 250.0, 200.0, 150.0, 0.4, 0.0, 0.0, 0.0)),
        ("RADIAL", (200.0, 200.0, 150.0, -0.3, 0.02)),  # folds back within the photo
        ("OPENCV_FISHEYE", (130.0, 130.0, 200.0, 150.0, 0.0, 0.0, 0.0, 0.0)),  # sees 180° across
    ],
)
def test_no_pixel_of_a_picture_is_blank(model: str, params: tuple[float, ...]) -> None:
    camera = pycolmap.Camera(model=model, width=400, height=300, params=list(params))
    lens = make_lens(camera, 1.0)
    for rows, places in lens._strips():
        del rows
        assert np.isfinite(places).all()
        assert places[..., 0].min() > 0.0 and places[..., 0].max() < 400.0
        assert places[..., 1].min() > 0.0 and places[..., 1].max() < 300.0
        assert (np.diff(places[..., 0], axis=1) > 0.0).all() and (np.diff(places[..., 1], axis=0) > 0.0).all()


def test_of_a_wide_fisheye_what_a_pinhole_can_show_remains(layouts: ModuleType, tmp_path: Path) -> None:
    """180° across: 110° remain, and the message says how much is cut."""
    camera = pycolmap.Camera(
        model="OPENCV_FISHEYE", width=800, height=800, params=[254.6, 254.6, 400, 400, 0, 0, 0, 0]
    )
    lens = make_lens(camera, 1.0)
    across = np.degrees(2.0 * np.arctan(0.5 * lens.width / lens.fx))
    assert across == pytest.approx(110.0, abs=0.2) and lens.width == lens.height
    # Of the photo's area what is within four arcs remains, whose ends are 63.7° from the axis.
    t = np.tan(np.radians(55.0)) * np.linspace(-1.0, 1.0, 4001)
    edge = np.stack([t, np.full_like(t, t[-1])], axis=1)
    u, v = (254.6 * edge / radius(edge) * np.arctan(radius(edge))).T
    shown = 4.0 * 0.5 * np.sum(u[1:] * v[:-1] - u[:-1] * v[1:])
    assert lens.cut == pytest.approx(1.0 - shown / 800**2, abs=1e-3)
    root = layouts.write_nerfstudio(
        tmp_path, camera_model="OPENCV_FISHEYE", fl_x=30.6, fl_y=30.6, cx=48, cy=36
    )
    (told,) = (message for message in read_scene(root).messages if "the distortion of" in message)
    assert "of a photo is beyond what a pinhole camera shows (110° at most)" in told


def test_panoramas_have_a_remedy() -> None:
    with pytest.raises(BadValueError, match=r"360° panoramas[\s\S]*views of 90°"):
        make_lens(RealCamera("EQUIRECTANGULAR", 800, 400, (800.0, 400.0)).pycolmaps(), 1.0)


def test_sizes_of_several_lenses() -> None:
    def camera(k: float, width: int = 400) -> Any:
        return RealCamera("SIMPLE_RADIAL", width, 300, (380.0, 200.0, 150.0, k)).pycolmaps()

    alike = {0: camera(0.1), 1: camera(0.105), 2: camera(-0.2), 3: camera(0.1, 420)}
    by_size = lenses_by_size(alike, 1.0)
    sizes = {key: (lens.width, lens.height) for key, lens in by_size.items()}
    assert sizes[0] == sizes[1] and len({*sizes.values()}) == 3
    # What is cropped is cropped at both edges alike: the same rays are in the picture's middle.
    alone = make_lens(alike[0], 1.0)
    assert alone.cx - by_size[0].cx == 0.5 * (alone.width - by_size[0].width)
