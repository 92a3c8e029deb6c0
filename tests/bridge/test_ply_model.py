# SPDX-License-Identifier: GPL-3.0-or-later
"""Other programs' PLYs as models, our lossless PLY as the model it came from, and the way back."""

import base64
import json
import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import plyfile
import pytest

from physhdr.bridge import display, srgb
from physhdr.bridge.errors import BadValueError, FileDamagedError, PhysHDRError
from physhdr.bridge.gaussian_ply import standard_columns, write_lossless_ply, write_standard_ply
from physhdr.bridge.lossless_form import form_columns, tensor_comments, tensors_from_comments, words_of
from physhdr.bridge.model_file import Model
from physhdr.bridge.ply_model import light_shares, read_ply_model, warning_of
from physhdr.bridge.spherical_harmonics import C0, basis


def random_directions(count: int) -> np.ndarray:
    directions = np.random.default_rng(9).normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def gaussians(count: int = 60, coefficients: int = 16, spread: float = 0.05) -> dict[str, np.ndarray]:
    """Gaussians as 3DGS trains them: any base colour, some variation with the view."""
    rng = np.random.default_rng(1)
    colour_sh = rng.normal(0.0, spread, (count, coefficients, 3))
    colour_sh[:, 0] = (rng.uniform(0.0, 1.1, (count, 3)) - 0.5) / C0
    arrays = {
        "positions": rng.normal(size=(count, 3)),
        "rotations": 3.0 * rng.normal(size=(count, 4)),
        "scales": rng.lognormal(-4.0, 1.0, size=(count, 3)),
        "opacities": rng.uniform(0.01, 0.99, size=count),
        "colour_sh": colour_sh,
    }
    return {name: array.astype(np.float32) for name, array in arrays.items()}


def test_shape_and_opacity_arrive(tmp_path: Path):
    given = gaussians(coefficients=4)
    write_standard_ply(tmp_path / "a.ply", **given)
    found = read_ply_model(tmp_path / "a.ply")
    unit = given["rotations"] / np.linalg.norm(given["rotations"], axis=1, keepdims=True)
    np.testing.assert_array_equal(found.model.position, given["positions"])
    np.testing.assert_allclose(found.model.rotation, unit, atol=1e-6)
    np.testing.assert_allclose(found.model.scale, given["scales"], rtol=1e-5)
    np.testing.assert_allclose(found.model.opacity, given["opacities"], atol=1e-6)
    np.testing.assert_array_equal(found.colour_sh, given["colour_sh"])
    np.testing.assert_array_equal(found.model.light_share, np.ones((len(found.model.position), 1, 3)))
    assert found.model.lights == ("ambient",)
    assert found.model.tone_curve is None and found.left_out == 0


def test_degree_0_is_exact(tmp_path: Path):
    """The radiance is the linearised colour; black is lifted to the floor."""
    given = gaussians(count=4, coefficients=1)
    given["colour_sh"][:, 0, 0] = (np.array([0.5, 0.03, -0.4, 1.5]) - 0.5) / C0
    write_standard_ply(tmp_path / "a.ply", **given)
    radiance = read_ply_model(tmp_path / "a.ply").model.radiance(random_directions(4))
    np.testing.assert_allclose(radiance[:, 0], [0.214041, 0.03 / 12.92, 0.01 / 12.92, 2.5371544], rtol=1e-4)
    linear = read_ply_model(tmp_path / "a.ply", "LINEAR").model.radiance(random_directions(4))
    np.testing.assert_allclose(linear[:, 0], [0.5, 0.03, 0.01 / 12.92, 1.5], rtol=1e-4)


@pytest.mark.parametrize(("spread", "allowed"), [(0.02, 0.002), (0.05, 0.006), (0.1, 0.018)])
@pytest.mark.parametrize("coefficients", [4, 9, 16])
def test_the_fitted_radiance_shows_the_files_colour(tmp_path: Path, coefficients, spread, allowed):
    """Root mean square over directions of the difference on a display, where 3DGS clamps at 0."""
    given = gaussians(count=400, coefficients=coefficients, spread=spread)
    write_standard_ply(tmp_path / "a.ply", **given)
    model = read_ply_model(tmp_path / "a.ply").model
    degree = model.sh_degree
    errors = []
    for direction in random_directions(50):
        Y = basis(direction[None], degree)[0]
        colour = np.maximum(0.5 + np.einsum("k,nkc->nc", Y, given["colour_sh"]), 0.0)
        shown = srgb.to_srgb(model.radiance(np.broadcast_to(direction, (400, 3))))
        errors.append(shown - colour)
    assert np.sqrt(np.mean(np.square(errors))) < allowed


def test_baked_again_it_is_the_file(tmp_path: Path):
    given = gaussians(count=400, spread=0.03)
    given["colour_sh"][:, 0] = np.abs(given["colour_sh"][:, 0])  # bright enough to be above the floor
    write_standard_ply(tmp_path / "a.ply", **given)
    model = read_ply_model(tmp_path / "a.ply").model
    baked = display.display_colour_sh(model, tone="SRGB")
    np.testing.assert_allclose(baked, given["colour_sh"], atol=0.03)
    assert np.sqrt(np.mean(np.square(baked - given["colour_sh"]))) < 0.003


@pytest.mark.parametrize(
    ("column", "value"),
    [("x", np.nan), ("f_rest_3", np.inf), ("opacity", np.nan), ("scale_1", np.inf), ("scale_1", 200.0)],
)
def test_gaussians_that_nobody_can_draw_are_left_out(tmp_path: Path, column: str, value: float):
    given = gaussians(count=10, coefficients=4)
    write_standard_ply(tmp_path / "a.ply", **given)
    spoil_rows(tmp_path / "a.ply", column, [2, 7], value)
    found = read_ply_model(tmp_path / "a.ply")
    assert (found.left_out, found.model.count) == (2, 8)
    assert found.notes[0].startswith("2 Gaussians")
    np.testing.assert_array_equal(found.model.position, np.delete(given["positions"], [2, 7], axis=0))


def spoil_rows(path: Path, column: str, rows: list[int], value: float) -> None:
    ply = plyfile.PlyData.read(str(path), mmap=False)
    ply["vertex"].data[column][rows] = value
    ply.write(str(path))


def test_only_unusable_gaussians_or_none(tmp_path: Path):
    write_standard_ply(tmp_path / "a.ply", **gaussians(count=3, coefficients=1))
    spoil_rows(tmp_path / "a.ply", "y", [0, 1, 2], np.nan)
    with pytest.raises(BadValueError, match=r"a\.ply: every Gaussian"):
        read_ply_model(tmp_path / "a.ply")
    empty = {name: array[:0] for name, array in gaussians().items()}
    write_standard_ply(tmp_path / "b.ply", **empty)
    with pytest.raises(BadValueError, match=r"b\.ply has no Gaussians"):
        read_ply_model(tmp_path / "b.ply")


# ---- lossless ----------------------------------------------------------------------------------------


def lossless(path: Path, comments: list[str], lights: tuple[str, ...] = ("ambient",)) -> Model:
    """A lossless PLY of random parameters, by the formulae of docs/method.md; the model it must become."""
    count = 30
    rng = np.random.default_rng(4)
    given = gaussians(count)
    reflectance = rng.normal(0.0, 0.3, (count, 16, 3)).astype(np.float32)
    illumination = rng.normal(0.0, 1.0, count).astype(np.float32)
    logits = rng.normal(0.0, 2.0, (count, 3 * len(lights))).astype(np.float32)
    weights = np.exp(logits.reshape(count, len(lights), 3).astype(np.float64))
    extra = {f"phys_reflectance_dc_{c}": reflectance[:, 0, c] for c in range(3)}
    rest = reflectance[:, 1:].reshape(count, 45)
    extra |= {f"phys_reflectance_rest_{i}": rest[:, i] for i in range(45)}
    extra |= {"phys_log_illumination_0": illumination}
    name = "phys_light_share_logits" if len(lights) > 1 else "phys_ambient_share_logits"
    extra |= {f"{name}_{c}": logits[:, c] for c in range(3 * len(lights))}
    write_lossless_ply(path, standard_columns(**given), extra, comments)
    # ln(H_r · L_a) at any direction: the constant term takes ln L_a / Y_0
    reflectance[:, 0] += illumination[:, None] / np.float32(C0)
    return Model(
        position=given["positions"],
        rotation=given["rotations"],
        scale=given["scales"],
        opacity=given["opacities"],
        log_radiance_sh=reflectance,
        light_share=(weights / (1.0 + weights.sum(axis=1, keepdims=True))).astype(np.float32),
        lights=lights,
    )


def test_a_lossless_ply_is_the_model_itself(tmp_path: Path):
    x, curve = np.linspace(-9, 9, 200, dtype=np.float32), np.random.rand(200, 3).astype(np.float32)
    comments = ["phys_form product additive", "PhysHDR scene: kitchen"]
    comments += tensor_comments("phys_curve", {"tone_curve_log_exposure": x, "tone_curve": curve})
    expected = lossless(tmp_path / "a.ply", comments)
    found = read_ply_model(tmp_path / "a.ply")
    directions = random_directions(expected.count)
    for level in (0.0, 0.25, 1.0, 4.0):
        np.testing.assert_allclose(
            found.model.radiance(directions, level),
            expected.radiance(directions, level),
            rtol=1e-5,
            atol=1e-6,
        )
    np.testing.assert_array_equal(found.model.tone_curve, curve)
    np.testing.assert_array_equal(found.model.tone_curve_log_exposure, x)
    assert found.model.metadata["scene"] == "kitchen"
    assert found.colour_sh is None and found.notes == ()


def test_a_lossless_ply_of_several_lights(tmp_path: Path):
    lights = ("ambient", "desk lamp", "screen")
    form = ["phys_form product additive-lights", f"phys_lights {json.dumps(lights)}"]
    expected = lossless(tmp_path / "a.ply", form, lights)
    found = read_ply_model(tmp_path / "a.ply").model
    assert found.lights == lights
    np.testing.assert_allclose(found.light_share, expected.light_share, rtol=1e-5, atol=1e-7)
    directions = random_directions(expected.count)
    levels = (0.0, 3.0, 0.25)
    np.testing.assert_allclose(
        found.radiance(directions, levels), expected.radiance(directions, levels), rtol=1e-5
    )
    for line in ('phys_lights ["ambient", "desk lamp", "screen", "sun"]', "phys_lights 7", "phys_lights ["):
        lossless(tmp_path / "b.ply", [form[0], line], lights)
        with pytest.raises(BadValueError, match=r"b\.ply: its phys_lights"):
            read_ply_model(tmp_path / "b.ply")


def test_a_lossless_ply_is_developed_at_the_exposure_of_its_model(tmp_path: Path):
    """The middle one of 1/8, 1/3 and 2 s."""
    form, line = "phys_form product additive", f"phys_exposures {json.dumps((2.0, 1.0 / 3.0, 0.125))}"
    lossless(tmp_path / "a.ply", [form, line])
    for _ in range(2):
        found = read_ply_model(tmp_path / "a.ply").model
        assert found.exposures == (2.0, 1.0 / 3.0, 0.125)
        assert found.developed_ev == pytest.approx(-1.58496, abs=1e-5)
        without_comments(tmp_path / "a.ply")
    lossless(tmp_path / "b.ply", [form])
    assert read_ply_model(tmp_path / "b.ply").model.exposures == ()
    for wrong in ("7", "[1.0, null]", '["half"]', "[", "[[1.0]]"):
        lossless(tmp_path / "c.ply", [form, f"phys_exposures {wrong}"])
        with pytest.raises(BadValueError, match=r"c\.ply: its phys_exposures line"):
            read_ply_model(tmp_path / "c.ply")
    lossless(tmp_path / "d.ply", [form, "phys_exposures [-1.0]"])
    with pytest.raises(BadValueError, match=r"d\.ply: an exposure"):
        read_ply_model(tmp_path / "d.ply")


def test_shares_of_huge_logits_are_whole():
    """exp overflows float32 at 88.7: what must come out are 0, 1 and equal parts."""
    logits = np.array([[200.0, -200.0], [0.0, 0.0], [500.0, 500.0]], np.float32)[:, :, None].repeat(3, axis=2)
    expected = np.array([[1.0, 0.0], [1 / 3, 1 / 3], [0.5, 0.5]])[:, :, None].repeat(3, axis=2)
    np.testing.assert_allclose(light_shares(logits), expected, rtol=1e-6, atol=1e-7)


def test_the_header_of_a_baked_ply_names_the_lights():
    assert display.look_comment(1.0, 0.5, "SRGB").endswith("baked at EV 1, lighting level 0.5")
    comment = display.look_comment(-2.0, (4.0, 0.25), "SRGB", ("ambient", "pendant"))
    assert comment.endswith("baked at EV -2, lighting levels ambient 4 + pendant 0.25")


def test_learned_parts_point_to_the_model_file(tmp_path: Path):
    lossless(tmp_path / "a.ply", ["phys_form learned additive"])
    with pytest.raises(BadValueError, match=r"composer learned[\s\S]*model\.safetensors"):
        read_ply_model(tmp_path / "a.ply")


def test_a_lossless_ply_that_lost_its_comments_is_the_baked_look(tmp_path: Path):
    lossless(tmp_path / "a.ply", [])
    found = read_ply_model(tmp_path / "a.ply")
    assert any("comments are gone" in note for note in found.notes)
    np.testing.assert_array_equal(found.colour_sh, gaussians(30)["colour_sh"])


@pytest.mark.parametrize("farthest", [1.0, 1e5])
def test_light_is_turned_with_gaussians_that_another_program_has_turned(tmp_path: Path, farthest: float):
    """By 90° about Z; where one Gaussian is a runaway, the others show it."""
    lossless(tmp_path / "a.ply", ["phys_form product additive"])
    before = read_ply_model(tmp_path / "a.ply").model
    position = before.position.copy()
    position[0] *= farthest / np.abs(position[0]).max()
    for axis in range(3):
        with_column(tmp_path / "a.ply", f"phys_means_{axis}", position[:, axis])
    turned = np.stack([-position[:, 1], position[:, 0], position[:, 2]], axis=1)
    ply = plyfile.PlyData.read(str(tmp_path / "a.ply"), mmap=False)
    for axis, name in enumerate("xyz"):
        ply["vertex"].data[name] = turned[:, axis]
    ply.write(str(tmp_path / "a.ply"))
    found = read_ply_model(tmp_path / "a.ply")
    assert any("turned" in note for note in found.notes)
    directions = random_directions(before.count)
    there = np.stack([-directions[:, 1], directions[:, 0], directions[:, 2]], axis=1)
    np.testing.assert_allclose(found.model.radiance(there), before.radiance(directions), rtol=1e-4)


# ---- programs that keep columns and drop comments --------------------------------------------------------


def without_comments(path: Path, rows: np.ndarray | slice = slice(None)) -> None:
    """Rewrite a PLY as splat-transform does: every column of ``rows``, no comment."""
    ply = plyfile.PlyData.read(str(path), mmap=False)
    table = ply["vertex"].data[rows]
    plyfile.PlyData([plyfile.PlyElement.describe(table, "vertex")], byte_order="<").write(str(path))
    assert b"comment" not in path.read_bytes()


def response(samples: int) -> dict[str, np.ndarray]:
    """A response of which two samples are equal in value: only their exposures tell them apart."""
    x = np.linspace(-9, 9, samples, dtype=np.float32)
    curve = np.sort(np.random.default_rng(3).random((samples, 3), dtype=np.float32), axis=0)
    curve[1] = curve[0]
    return {"tone_curve_log_exposure": x, "tone_curve": curve}


def test_without_comments_the_names_of_the_columns_say_it(tmp_path: Path):
    """All of it: form, lights of any name, response; with the Gaussians in another order, and some gone."""
    lights = ("ambient", "desk__lamp_2d", "Küche ☀")
    curve = response(10)
    comments = ["phys_form product additive-lights", f"phys_lights {json.dumps(lights)}"]
    lossless(tmp_path / "a.ply", [*comments, *tensor_comments("phys_curve", curve)], lights)
    expected = read_ply_model(tmp_path / "a.ply").model
    rows = np.random.default_rng(5).permutation(30)
    rows = rows[np.isin(rows, [*range(3, 16), 21, 22])]  # one of each sample is left, in no order
    without_comments(tmp_path / "a.ply", rows)
    found = read_ply_model(tmp_path / "a.ply")
    assert found.notes == () and found.colour_sh is None and found.up == "z"
    assert found.model.lights == lights
    for name, array in expected.tensors().items():
        wanted = array if name.startswith("tone") else array[rows]
        np.testing.assert_array_equal(found.model.tensors()[name], wanted, err_msg=name)


def test_names_of_columns_are_ascii_words():
    columns = form_columns(["phys_form product additive", 'phys_lights ["a b", "_", "☀"]'], 2)
    assert list(columns) == ["phys_form__product__additive", "phys_lights__a_20b___5f___e2_98_80"]
    assert words_of("phys_lights", columns) == ["a b", "_", "☀"]
    assert words_of("phys_lights", ["phys_lights___ff"]) is None  # no UTF-8


@pytest.mark.parametrize("spoil", ["too few", "mixed"])
def test_a_response_that_is_not_whole_is_none(tmp_path: Path, spoil: str):
    """Fewer Gaussians than samples, or Gaussians that a program has merged."""
    comments = [
        "phys_form product additive",
        *tensor_comments("phys_curve", response(31 if spoil == "too few" else 15)),
    ]
    lossless(tmp_path / "a.ply", comments)
    assert read_ply_model(tmp_path / "a.ply").model.tone_curve is not None
    without_comments(tmp_path / "a.ply")
    if spoil == "mixed":
        spoil_rows(tmp_path / "a.ply", "phys_curve__15__x", [3], 0.123)
    found = read_ply_model(tmp_path / "a.ply")
    assert found.model.tone_curve is None
    assert ["learned response is lost" in note for note in found.notes] == [True]


def test_learned_parts_are_named_without_comments_too(tmp_path: Path):
    lossless(tmp_path / "a.ply", ["phys_form learned additive"])
    without_comments(tmp_path / "a.ply")
    with pytest.raises(BadValueError, match=r"composer learned[\s\S]*model\.safetensors"):
        read_ply_model(tmp_path / "a.ply")


def test_splat_transform_keeps_a_lossless_ply(tmp_path: Path, splat_transform: Callable[..., None]):
    comments = ["phys_form product additive", *tensor_comments("phys_curve", response(12))]
    expected = lossless(tmp_path / "a.ply", comments)
    splat_transform(tmp_path / "a.ply", tmp_path / "b.ply")
    assert b"phys_form product" not in (tmp_path / "b.ply").read_bytes(), "the comments are gone"
    found = read_ply_model(tmp_path / "b.ply").model
    order = np.linalg.norm(found.position[:, None] - expected.position, axis=2).argmin(axis=0)
    directions = random_directions(expected.count)
    for level in (0.25, 4.0):
        back = np.empty_like(directions)
        back[order] = directions
        np.testing.assert_allclose(
            found.radiance(back, level)[order], expected.radiance(directions, level), rtol=1e-5
        )
    np.testing.assert_array_equal(found.tone_curve, response(12)["tone_curve"])


# ---- saturated values --------------------------------------------------------------------------------------


def test_infinite_logits_and_logarithms_are_values(tmp_path: Path):
    """splat-transform writes an opacity of 1 as +∞; a scale of −∞ is flat. NaN is damage in either."""
    given = gaussians(count=6, coefficients=1)
    write_standard_ply(tmp_path / "a.ply", **given)
    for row, value in enumerate([np.inf, -np.inf, 3e38, -3e38, np.nan]):
        spoil_rows(tmp_path / "a.ply", "opacity", [row], value)
    for row, value in enumerate([-np.inf, -3e38, -90.0]):
        spoil_rows(tmp_path / "a.ply", "scale_1", [row], value)
    found = read_ply_model(tmp_path / "a.ply")
    assert found.left_out == 1
    np.testing.assert_array_equal(found.model.opacity[:4], [1.0, 0.0, 1.0, 0.0])
    np.testing.assert_array_equal(found.model.scale[:2, 1], 0.0)
    assert 0.0 < found.model.scale[2, 1] < 1e-38
    np.testing.assert_array_equal(found.model.position, given["positions"][[0, 1, 2, 3, 5]])


@pytest.mark.parametrize("form", ["product additive", ""])
def test_only_columns_that_are_used_are_tested(tmp_path: Path, form: str):
    """Of a lossless PLY the look is not used, of another one its normals and what nobody knows are not."""
    lossless(tmp_path / "a.ply", [f"phys_form {form}"] if form else [])
    others = ["nx", "phys_means_0"] if not form else ["nx", "f_dc_0", "f_rest_7", "phys_means_0"]
    ply = plyfile.PlyData.read(str(tmp_path / "a.ply"), mmap=False)
    names = [p.name for p in ply["vertex"].properties]
    for row, name in enumerate(name for name in others if name in names):
        spoil_rows(tmp_path / "a.ply", name, [row], np.nan)
    found = read_ply_model(tmp_path / "a.ply")
    assert (found.left_out, found.model.count) == (0, 30)


def test_a_written_flat_gaussian_is_as_good_as_flat(tmp_path: Path):
    given = gaussians(count=3, coefficients=1)
    given["scales"][:, 2] = 0.0
    write_standard_ply(tmp_path / "a.ply", **given)
    assert (read_ply_model(tmp_path / "a.ply").model.scale[:, 2] < 1e-37).all()


def test_2dgs_is_read_flat_and_degree_4_without_its_highest_band(tmp_path: Path):
    columns = standard_columns(**gaussians(count=4, coefficients=16))
    del columns["scale_2"]
    wide = {f"f_rest_{i}": np.full(4, i, np.float32) for i in range(72)}
    columns = {name: column for name, column in columns.items() if not name.startswith("f_rest")} | wide
    table = np.rec.fromarrays(list(columns.values()), names=list(columns))
    plyfile.PlyData([plyfile.PlyElement.describe(np.asarray(table), "vertex")]).write(str(tmp_path / "a.ply"))
    found = read_ply_model(tmp_path / "a.ply")
    np.testing.assert_array_equal(found.model.scale[:, 2], 0.0)
    assert found.colour_sh is not None
    for channel in range(3):
        np.testing.assert_array_equal(found.colour_sh[0, 1:, channel], 24 * channel + np.arange(15))


def with_column(path: Path, name: str, values: np.ndarray) -> None:
    """Rewrite a PLY with one more column, as others' trainers have them."""
    table = plyfile.PlyData.read(str(path))["vertex"].data
    wider = np.zeros(len(table), [*table.dtype.descr, (name, "<f4")])
    for column in table.dtype.names:
        wider[column] = table[column]
    wider[name] = values
    plyfile.PlyData([plyfile.PlyElement.describe(wider, "vertex")]).write(str(path))


def test_the_filter_of_mip_splatting_is_part_of_the_gaussians(tmp_path: Path):
    """Convolved with a round Gaussian, one keeps its integral: opacity × √|Σ| stays, and variances add up."""
    given = gaussians(count=20, coefficients=1)
    given["scales"][7, 2] = 0.0
    wide = np.random.default_rng(2).uniform(0.0, 0.1, 20).astype(np.float32)
    wide[3] = 0.0
    write_standard_ply(tmp_path / "a.ply", **given)
    with_column(tmp_path / "a.ply", "filter_3D", wide)
    found = read_ply_model(tmp_path / "a.ply")
    assert any("filter_3D" in note for note in found.notes)
    variance = given["scales"].astype(np.float64) ** 2
    scale = found.model.scale.astype(np.float64)
    np.testing.assert_allclose(scale**2, variance + wide[:, None] ** 2, rtol=1e-4)
    expected = given["opacities"] * np.prod(np.sqrt(variance), axis=1)
    np.testing.assert_allclose(found.model.opacity * np.prod(scale, axis=1), expected, rtol=1e-4, atol=1e-30)


@pytest.mark.parametrize(
    ("comment", "up"),
    [
        ("space: metres, Z up (Blender's world); rot_0..3 = w x y z", "z"),
        ("space: metres, Y up (glTF's axes); rot_0..3 = w x y z", "y"),
        ("space: metres, Y down, Z forward (COLMAP's axes)", "colmap"),
        ("Vertical Axis: z", "z"),
        ("Vertical axis: y", "colmap"),
        ("", "colmap"),
    ],
)
def test_which_way_is_up_by_the_files_own_word(tmp_path: Path, comment: str, up: str):
    columns = standard_columns(**gaussians(count=4, coefficients=1))
    table = np.rec.fromarrays(list(columns.values()), names=list(columns))
    element = plyfile.PlyElement.describe(np.asarray(table), "vertex")
    plyfile.PlyData([element], comments=[comment] if comment else []).write(str(tmp_path / "a.ply"))
    assert read_ply_model(tmp_path / "a.ply").up == up


# ---- tensors in comments -----------------------------------------------------------------------------------


def test_tensors_in_comments_survive_and_damaged_ones_are_left_out():
    tensors = {"a": np.arange(1000, dtype=np.float32).reshape(10, 100), "b": np.float32([])}
    lines = tensor_comments("kind", tensors)
    assert max(map(len, lines)) < 450
    back = tensors_from_comments("kind", ["kind c [3] 0 AAAA", "kind d [x 0 AAAA", "other line", *lines])
    assert set(back) == {"a", "b"}
    np.testing.assert_array_equal(back["a"], tensors["a"])
    assert base64.b64decode(lines[0].split()[-1])[:8] == np.float32([0, 1]).tobytes()


# ---- baking ------------------------------------------------------------------------------------------


def hdr_model(count: int = 50, degree: int = 1, curve: bool = True) -> Model:
    rng = np.random.default_rng(7)
    sh = rng.normal(0.0, 0.2, (count, (degree + 1) ** 2, 3))
    sh[:, 0] = rng.normal(-4.0, 4.0, (count, 3))
    x = np.linspace(-12.0, 8.0, 256, dtype=np.float32)
    response = {
        "tone_curve_log_exposure": x,
        "tone_curve": 1.0 / (1.0 + np.exp(-np.outer(x, [0.8, 1.0, 1.2]) - 0.2)).astype(np.float32),
    }
    given = gaussians(count)
    return Model(
        position=given["positions"],
        rotation=given["rotations"],
        scale=given["scales"],
        opacity=given["opacities"],
        log_radiance_sh=sh.astype(np.float32),
        light_share=rng.random((count, 1, 3), dtype=np.float32),
        **(response if curve else {}),
    )


def test_without_a_response_there_is_none_to_bake():
    with pytest.raises(BadValueError, match=r"no learned tone mapper[\s\S]*SRGB"):
        display.display_colour_sh(hdr_model(curve=False))


@pytest.mark.parametrize("tone", ["LEARNED", "SRGB"])
def test_baked_colour_is_the_look_in_every_direction(tone):
    model = hdr_model()
    exposure, level = 4.0, 0.5
    sh = display.display_colour_sh(model, exposure, level, tone)
    errors = []
    for direction in random_directions(40):
        radiance = exposure * model.radiance(np.broadcast_to(direction, (50, 3)), level)
        if tone == "LEARNED":
            expected = 1.0 / (1.0 + np.exp(-np.log(radiance) * [0.8, 1.0, 1.2] - 0.2))
        else:
            expected = srgb.to_srgb(radiance)
        shown = 0.5 + np.einsum("k,nkc->nc", basis(direction[None], 1)[0], sh)
        errors.append((shown - expected) / np.maximum(expected, 1.0))
    assert np.sqrt(np.mean(np.square(errors))) < 0.01


def test_baking_into_a_turned_world_turns_the_colours():
    """Seen along ω in the world, a Gaussian of a turned object has the colour of turned-back ω."""
    model = hdr_model(degree=3)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    at_home = display.display_colour_sh(model)
    in_world = display.display_colour_sh(model, to_world=2.5 * turn)
    for direction in random_directions(10):
        here = np.einsum("k,nkc->nc", basis(direction[None], 3)[0], at_home)
        there = np.einsum("k,nkc->nc", basis((turn @ direction)[None], 3)[0], in_world)
        np.testing.assert_allclose(there, here, atol=0.02)


def test_level_0_of_all_ambient_light_is_black_and_finite():
    model = hdr_model(degree=0)
    model.light_share[:] = 1.0
    sh = display.display_colour_sh(model, level=0.0, tone="SRGB")
    assert np.isfinite(sh).all() and (0.5 + C0 * sh[:, 0]).max() < 0.02


# ---- hostile files -----------------------------------------------------------------------------------


def own_layout(path: Path, count: int = 8, **changes: np.ndarray | None) -> Path:
    """A lossless PLY of degree 1; ``changes``: columns that are other, or left out (None)."""
    given = gaussians(count, coefficients=4)
    columns = standard_columns(**given)
    extra = {f"phys_reflectance_dc_{c}": given["colour_sh"][:, 0, c].copy() for c in range(3)}
    extra |= {f"phys_reflectance_rest_{k}": np.zeros(count, np.float32) for k in range(9)}
    extra |= {f"phys_log_illumination_{c}": np.zeros(count, np.float32) for c in range(3)}
    extra = {name: column for name, column in (extra | changes).items() if column is not None}
    curve = {
        "tone_curve_log_exposure": np.linspace(-5, 5, 8),
        "tone_curve": np.linspace(0, 1, 24).reshape(8, 3),
    }
    write_lossless_ply(
        path, columns, extra, ["phys_form product additive", *tensor_comments("phys_curve", curve)]
    )
    return path


@pytest.mark.filterwarnings("error::RuntimeWarning")  # arithmetic that overflows
@pytest.mark.parametrize("kind", ["standard", "lossless"])
def test_damaged_files_become_models_of_finite_numbers_or_errors(tmp_path: Path, fuzzing: ModuleType, kind):
    path = tmp_path / "a.ply"
    if kind == "lossless":
        own_layout(path)
    else:
        write_standard_ply(path, **gaussians(8, coefficients=4))
    for case, damaged in enumerate(fuzzing.mutations(path.read_bytes(), 300, 3)):
        path.write_bytes(damaged)
        try:
            model = read_ply_model(path).model
            assert all(np.isfinite(array).all() for array in model.tensors().values()), f"case {case}"
        except PhysHDRError as error:
            assert error.message, f"case {case}"


@pytest.mark.parametrize("name", ["phys_reflectance_dc_2", "phys_reflectance_rest_5"])
def test_a_lossless_file_without_one_of_its_columns(tmp_path: Path, name: str):
    with pytest.raises(FileDamagedError, match=rf"a\.ply: the columns of its reflectance .*it has no {name}"):
        read_ply_model(own_layout(tmp_path / "a.ply", **{name: None}))


@pytest.mark.parametrize("name", ["x", "rot_2", "f_dc_0"])
def test_a_gaussian_of_an_absurd_value_is_left_out(tmp_path: Path, name: str):
    """A square of 3e38 overflows: the rotation would become 0."""
    columns = standard_columns(**gaussians(8, coefficients=1))
    columns[name][2] = -3e38
    write_lossless_ply(tmp_path / "a.ply", columns, {})
    found = read_ply_model(tmp_path / "a.ply")
    assert found.left_out == 1 and found.model.count == 7
    np.testing.assert_allclose(np.linalg.norm(found.model.rotation, axis=1), 1.0, atol=1e-6)


@pytest.mark.parametrize("brightest", [400.0, 1e14])
def test_a_gaussian_brighter_than_can_be_drawn_is_left_out(tmp_path: Path, brightest: float):
    """ln radiance is what our own columns hold: exp of it would be infinite."""
    illumination = np.zeros(8, np.float32)
    illumination[3] = brightest
    path = own_layout(tmp_path / "a.ply", phys_log_illumination_1=illumination)
    found = read_ply_model(path)
    assert found.left_out == 1 and found.model.count == 7 and found.notes[0].startswith("1 Gaussians")
    assert np.isfinite(found.model.radiance(np.tile(np.float32([0.0, 0.0, 1.0]), (7, 1)))).all()
    with pytest.raises(BadValueError, match=r"a\.ply: every Gaussian"):
        read_ply_model(own_layout(path, phys_log_illumination_1=np.full(8, brightest, np.float32)))


def test_gaussians_larger_than_the_world_are_left_out(tmp_path: Path):
    given = gaussians(4, coefficients=1)
    given["scales"][1, 2], given["scales"][2, 2] = 1.1e6, 0.9e6
    write_standard_ply(tmp_path / "a.ply", **given)
    assert read_ply_model(tmp_path / "a.ply").left_out == 1


def test_gaussians_in_the_coordinates_of_a_map(tmp_path: Path):
    given = gaussians(8, coefficients=1)
    given["positions"] += np.float32([5e5, 5.3e6, 0.0])
    write_standard_ply(tmp_path / "a.ply", **given)
    with pytest.raises(
        BadValueError, match=r"a\.ply: its first Gaussian is at .*5.3e\+06.*(.|\n)*world's origin"
    ):
        read_ply_model(tmp_path / "a.ply")


@pytest.mark.parametrize(
    "header",
    [
        "format ascii 1.0\nelement vertex 100000000000\nproperty list uchar int x",
        "format binary_little_endian 1.0\nelement face 9000000000\nproperty list uchar int x",
        "format binary_little_endian 1.0\nelement vertex 99999999999999999999999\nproperty float x",
        "format binary_little_endian 1.0\nelement vertex " + "9" * 5000 + "\nproperty float x",
        "format ascii 1.0\nelement vertex 30\n" + "\n".join(f"property float c{k}" for k in range(40)),
    ],
)
def test_a_header_that_claims_more_than_there_is_takes_no_memory(tmp_path: Path, header: str):
    (tmp_path / "a.ply").write_text(f"ply\n{header}\nend_header\n1 2 3\n")
    with pytest.raises(
        FileDamagedError,
        match=r"a\.ply is not a (readable PLY .(it claims|a row|Exceeds)|PLY of Gaussians: it has no vertex)",
    ):
        read_ply_model(tmp_path / "a.ply")


@pytest.mark.usefixtures("never_waits")
def test_a_pipe_is_no_ply(tmp_path: Path):
    os.mkfifo(tmp_path / "a.ply")
    with pytest.raises(FileDamagedError, match=r"a\.ply is a pipe, not a file"):
        read_ply_model(tmp_path / "a.ply")


def test_a_file_of_fitted_colours_names_the_model_file_to_import(tmp_path: Path):
    """Its codes are right only where codes are blended: in Blender, which blends light, they flare."""
    path, model = tmp_path / "baked.ply", tmp_path / "model.safetensors"
    write_standard_ply(path, **gaussians(), comments=[display.FITTED_COMMENT])
    notes = read_ply_model(path).notes
    assert any("fitted for viewers" in note and "that it was baked from" in note for note in notes)
    assert not any("linearised" in note for note in notes)
    model.touch()
    assert any(f"import {model} instead" in note for note in read_ply_model(path).notes)
    assert f"import {model} instead" in warning_of(path)


def test_other_files_of_display_colours_say_that_blends_differ(tmp_path: Path):
    path = tmp_path / "scan.ply"
    write_standard_ply(path, **gaussians())
    assert any("Viewers blend these codes" in note for note in read_ply_model(path).notes)
    assert "Viewers blend these codes" in warning_of(path)
    assert not any("blend" in note for note in read_ply_model(path, "LINEAR").notes)
    assert warning_of(tmp_path / "gone.ply") == ""


def test_fitted_codes_above_white_do_not_flare(tmp_path: Path):
    """Where codes are blended others make up for them; as radiance, code 3 would be 13 times white."""
    given = gaussians(coefficients=1)
    given["colour_sh"][:, 0] = (3.0 - 0.5) / C0
    for name, comments in (("fitted", [display.FITTED_COMMENT]), ("other", [])):
        write_standard_ply(tmp_path / f"{name}.ply", **given, comments=comments)
    fitted, other = (read_ply_model(tmp_path / f"{name}.ply").model for name in ("fitted", "other"))
    np.testing.assert_allclose(np.exp(fitted.log_radiance_sh[:, 0] * C0), 1.0, rtol=1e-4)
    np.testing.assert_allclose(np.exp(other.log_radiance_sh[:, 0] * C0), srgb.to_linear(3.0), rtol=1e-4)
