# SPDX-License-Identifier: GPL-3.0-or-later
"""USD's particle fields: what is written, as OpenUSD reads and judges it; others' files, and bad ones."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from physhdr.backend.formats.usd import extent_of, read_usd, write_usd
from physhdr.backend.optional import PackageMissingError
from physhdr.bridge.affine import matrices_of
from physhdr.bridge.errors import BadValueError, FileDamagedError, OutputError, PhysHDRError
from physhdr.bridge.splat_files import read_splat_file

pytest.importorskip("pxr.UsdVol", reason="needs usd-core: pip install usd-core")
from pxr import Gf, Usd, UsdGeom, UsdValidation, UsdVol, Vt

NAMES = ("a.usdc", "a.usda", "a.usd", "a.usdz")


def assert_same(one, other, tolerance: float = 0.0) -> None:
    for name in ("position", "scale", "opacity", "colour_sh"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(matrices_of(one.rotation), matrices_of(other.rotation), atol=3e-6 + tolerance)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("up", ["y", "z"])
def test_what_is_written_is_read(cloud, tmp_path: Path, name: str, up) -> None:
    write_usd(tmp_path / name, cloud, up)
    read = read_usd(tmp_path / name)
    assert_same(read.cloud, cloud)
    assert read.is_radiance and read.cloud.up == up and not read.cloud.notes
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_openusd_reads_the_schemas_attributes(cloud, tmp_path: Path) -> None:
    write_usd(tmp_path / "a.usdc", cloud, "z", "where it is from")
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetRootLayer().comment == "where it is from"
    prim = stage.GetDefaultPrim()
    field = UsdVol.ParticleField3DGaussianSplat(prim)
    assert prim.GetTypeName() == "ParticleField3DGaussianSplat"
    assert Usd.ColorSpaceAPI(prim).GetColorSpaceNameAttr().Get() == "lin_rec709_scene"
    assert Gf.ColorSpace.IsValid("lin_rec709_scene")
    assert field.GetRadianceSphericalHarmonicsDegreeAttr().Get() == 3
    flat = np.array(field.GetRadianceSphericalHarmonicsCoefficientsAttr().Get())
    np.testing.assert_array_equal(flat, cloud.colour_sh.reshape(-1, 3))  # a Gaussian after the other
    quaternion = field.GetOrientationsAttr().Get()[5]
    np.testing.assert_array_equal([quaternion.GetReal(), *quaternion.GetImaginary()], cloud.rotation[5])
    assert field.GetOpacitiesAttr().Get()[1] == 1.0


@pytest.mark.parametrize("name", NAMES)
def test_openusds_validators_find_nothing_wrong(cloud, tmp_path: Path, name: str) -> None:
    write_usd(tmp_path / name, cloud)
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 10
    errors = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(tmp_path / name)))
    assert not errors, [error.GetErrorAsString() for error in errors]


def test_the_extent_holds_three_standard_deviations(cloud) -> None:
    """Points on the ellipsoids' surfaces reach it and do not leave it."""
    random = np.random.default_rng(0).standard_normal((4000, 3))
    surface = 3.0 * random / np.linalg.norm(random, axis=1, keepdims=True)
    axes = matrices_of(cloud.rotation) * cloud.scale[:, None, :]
    points = cloud.position[:, None] + np.einsum("nij,pj->npi", axes, surface)
    low, high = extent_of(cloud)
    assert (points.min(axis=(0, 1)) >= low - 1e-6).all() and (points.max(axis=(0, 1)) <= high + 1e-6).all()
    np.testing.assert_allclose(
        np.stack([points.min(axis=(0, 1)), points.max(axis=(0, 1))]), [low, high], atol=0.05
    )


def test_nvidias_converter_writes_display_colours_and_says_nothing_of_them(files: Path) -> None:
    read = read_usd(files / "gaussians.usdc")
    source = read_splat_file(files / "source.ply")
    assert_same(read.cloud, source, 1e-6)
    assert not read.is_radiance and read.cloud.up == "y" and "no colour space" in read.cloud.notes[0]


def test_units_nodes_halves_and_absent_arrays_are_as_the_schema_has_them(tmp_path: Path) -> None:
    """Two fields: centimetres under a node that turns; half floats; arrays that are absent, long or short."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "a.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    above = UsdGeom.Xform.Define(stage, "/above")
    above.AddTranslateOp().Set(Gf.Vec3d(100.0, 0.0, 0.0))
    above.AddRotateZOp().Set(90.0)
    Usd.ColorSpaceAPI.Apply(above.GetPrim()).CreateColorSpaceNameAttr("lin_rec709_scene")
    one = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/above/one")
    one.CreatePositionsAttr([(100.0, 0.0, 0.0), (0.0, 200.0, 0.0)])
    one.CreateRadianceSphericalHarmonicsDegreeAttr(0)
    one.CreateRadianceSphericalHarmonicsCoefficientsAttr([(1.0, 2.0, 3.0), (4.0, 5.0, 6.0), (7.0, 8.0, 9.0)])
    one.CreateOpacitiesAttr([0.25])  # too short: as if it were not there
    two = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/above/two")
    two.CreatePositionshAttr(Vt.Vec3hArray([Gf.Vec3h(0.0, 0.0, 50.0)]))
    two.CreateScaleshAttr(Vt.Vec3hArray([Gf.Vec3h(1.0, 2.0, 4.0)]))
    two.CreateOpacitieshAttr(Vt.HalfArray([0.5]))
    two.CreateRadianceSphericalHarmonicsDegreeAttr(1)
    stage.Save()
    read = read_usd(tmp_path / "a.usda")
    cloud = read.cloud
    np.testing.assert_allclose(cloud.position, [[1, 1, 0], [-1, 0, 0], [1, 0, 0.5]], atol=1e-6)
    np.testing.assert_allclose(cloud.scale, [[0.01] * 3, [0.01] * 3, [0.01, 0.02, 0.04]], rtol=1e-6)
    np.testing.assert_allclose(cloud.opacity, [1.0, 1.0, 0.5])
    np.testing.assert_allclose(cloud.colour_sh[:, 0], [[1, 2, 3], [4, 5, 6], [0, 0, 0]])
    assert cloud.colour_sh.shape == (3, 1, 3)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(np.abs(cloud.rotation[0]), [half, 0, 0, half], atol=1e-6)
    assert read.is_radiance and cloud.up == "y"


def test_instances_are_read_where_each_of_them_stands(cloud, tmp_path: Path) -> None:
    write_usd(tmp_path / "one.usda", cloud)
    stage = Usd.Stage.CreateNew(str(tmp_path / "a.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    for index in range(3):
        node = UsdGeom.Xform.Define(stage, f"/node{index}")
        node.AddTranslateOp().Set(Gf.Vec3d(10.0 * index, 0.0, 0.0))
        prototype = UsdGeom.Xform.Define(stage, f"/node{index}/splats").GetPrim()
        prototype.GetReferences().AddReference("whole.usda")
        prototype.SetInstanceable(True)
    whole = Usd.Stage.CreateNew(str(tmp_path / "whole.usda"))
    whole.SetDefaultPrim(UsdGeom.Xform.Define(whole, "/whole").GetPrim())
    whole.DefinePrim("/whole/field").GetReferences().AddReference("one.usda")
    whole.Save()
    stage.Save()
    read = read_usd(tmp_path / "a.usda").cloud
    assert read.count == 3 * cloud.count
    for index in range(3):
        rows = slice(index * cloud.count, (index + 1) * cloud.count)
        np.testing.assert_allclose(read.position[rows], cloud.position + [10.0 * index, 0, 0], atol=1e-5)


@pytest.mark.long
def test_instances_within_instances_are_no_bomb(cloud, tmp_path: Path) -> None:
    """Thirty files of two instances each name 2³⁰ fields, and 13 as many Gaussians as nobody draws."""
    write_usd(tmp_path / "0.usda", cloud)
    for depth in range(1, 31):
        stage = Usd.Stage.CreateNew(str(tmp_path / f"{depth}.usda"))
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/whole").GetPrim())
        for name in "ab":
            prim = stage.DefinePrim(f"/whole/{name}")
            prim.GetReferences().AddReference(f"{depth - 1}.usda")
            prim.SetInstanceable(True)
        stage.Save()
    with pytest.raises(BadValueError, match="more than 100000 prims"):
        read_usd(tmp_path / "30.usda")
    with pytest.raises(BadValueError, match=r"repeats its \d+ Gaussians"):
        read_usd(tmp_path / "13.usda")


# -- bad files -----------------------------------------------------------------------------------------------


@pytest.mark.long
def test_files_that_are_cut_off_are_refused(cloud, tmp_path: Path) -> None:
    for name in ("a.usdc", "a.usda", "a.usdz"):
        write_usd(tmp_path / name, cloud)
        raw = (tmp_path / name).read_bytes()
        for size in [0, 5, 60, len(raw) // 2, len(raw) - 1]:
            (tmp_path / f"b{name}").write_bytes(raw[:size])
            if name != "a.usdc" and size == len(raw) - 1:
                continue  # it lacks an empty line, or the length of a comment on the zip: nothing
            with pytest.raises(PhysHDRError) as caught:
                read_usd(tmp_path / f"b{name}")
            assert isinstance(caught.value, FileDamagedError | BadValueError) and caught.value.hint


@pytest.mark.parametrize("name", NAMES)
def test_a_full_disk_is_an_error_and_what_was_there_stays(cloud, tmp_path: Path, name: str) -> None:
    """No file may grow beyond a limit: below the first page, in the middle, and a byte short."""
    resource = pytest.importorskip("resource")
    path = tmp_path / name
    write_usd(path, cloud)
    whole = path.read_bytes()
    path.write_bytes(b"older")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    for limit in (100, len(whole) // 2, len(whole) - 1):
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
        try:
            with pytest.raises(OutputError, match=r"cannot write .*OpenUSD could not write[\s\S]*space"):
                write_usd(path, cloud)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert path.read_bytes() == b"older" and list(tmp_path.iterdir()) == [path]


def test_a_file_that_openusd_does_not_write_is_none(cloud, tmp_path: Path, monkeypatch) -> None:
    """It may say so by what it returns alone."""
    monkeypatch.setattr("pxr.UsdUtils.CreateNewUsdzPackage", lambda *given: False)
    with pytest.raises(OutputError, match=r"OpenUSD could not write the package"):
        write_usd(tmp_path / "a.usdz", cloud)
    assert not list(tmp_path.iterdir())


@pytest.mark.long
def test_a_stage_without_gaussians_and_an_unknown_colour_space_are_named(cloud, tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "a.usda"))
    UsdGeom.Cube.Define(stage, "/cube")
    stage.Save()
    with pytest.raises(BadValueError, match="no Gaussians"):
        read_usd(tmp_path / "a.usda")
    write_usd(tmp_path / "b.usda", cloud)
    text = (tmp_path / "b.usda").read_text().replace("lin_rec709_scene", "lin_ap1_scene")
    (tmp_path / "b.usda").write_text(text)
    with pytest.raises(BadValueError, match="lin_ap1_scene"):
        read_usd(tmp_path / "b.usda")


def test_colmaps_up_cannot_be_said(cloud, tmp_path: Path) -> None:
    with pytest.raises(BadValueError, match="up axis colmap"):
        write_usd(tmp_path / "a.usda", cloud, "colmap")


def test_without_usd_core_what_installs_it_is_named(cloud, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    for name in ("Gf", "Sdf", "Usd", "UsdGeom", "UsdUtils", "UsdVol", "Vt"):
        monkeypatch.delitem(sys.modules, f"pxr.{name}", raising=False)
    with pytest.raises(PackageMissingError, match="-m pip install usd-core"):
        write_usd(tmp_path / "a.usda", cloud)
    assert not list(tmp_path.iterdir())


def test_it_is_imported_only_for_usd() -> None:
    script = (
        "import sys, physhdr.backend.cli.convert, physhdr.backend.formats.usd; print('pxr' in sys.modules)"
    )
    told = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "False"
