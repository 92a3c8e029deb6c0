# SPDX-License-Identifier: GPL-3.0-or-later
"""Scaffold-GS's backbone against its formulas, written out anchor by anchor in float64."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from physhdr.backend.model.backbone import Attributes, Start
from physhdr.backend.rasterize.reference import rasterize
from physhdr.backend.scene.camera import Camera
from physhdr.bridge.errors import BadValueError
from physhdr.lab.anchors.backbone import Anchors
from physhdr.lab.anchors.config import AnchorsConfig

K = 3
CONFIG = AnchorsConfig(offsets=K, voxel_size=0.05)
ATTRIBUTES = Attributes(context_size=4, lights=2)


def camera(x: float = 0.0, size: int = 48) -> Camera:
    """At (x, 0, 0), looking down −Z."""
    pose = np.eye(4)
    pose[0, 3] = x
    return Camera.from_field_of_view(pose, size, size, 0.9)


def points(count: int = 40, seed: int = 0) -> np.ndarray:
    """In front of the cameras and beside their pictures."""
    return np.random.default_rng(seed).uniform([-3, -3, -5], [3, 3, -2], (count, 3))


def placed(config: AnchorsConfig = CONFIG, attributes: Attributes = ATTRIBUTES, count: int = 40) -> Anchors:
    torch.manual_seed(0)
    anchors = Anchors(config, attributes)
    anchors.place(points(count), np.random.default_rng(1).normal(size=(count, 3)), Start())
    return anchors


def trained(anchors: Anchors, dtype: torch.dtype = torch.float64) -> Anchors:
    """As after training: nothing is where it started."""
    generator = torch.Generator().manual_seed(2)
    anchors.networks.to(dtype)
    with torch.no_grad():
        for name, tensor in anchors.parameters.items():
            moved = 0.3 * torch.randn(tensor.shape, generator=generator) * (name != "anchors")
            anchors.parameters[name] = (tensor + moved).to(dtype).requires_grad_()
        for parameter in anchors.networks.parameters():
            parameter += 0.2 * torch.randn(parameter.shape, generator=generator)
    return anchors


def test_gaussians_are_those_of_the_formulas():
    """μ = a + o exp(s₁), scale = exp(s₂) σ(m₁), quaternion m₂, α = tanh, drawn where α > 0."""
    anchors, view = trained(placed()), camera(0.3)
    splats = anchors.splats(view, 3)
    net, p = anchors.networks, anchors.parameters
    wanted = {name: [] for name in ("means", "quaternions", "scales", "opacities", "log_reflectance")}
    wanted |= {name: [] for name in ("log_illumination", "light_share", "context")}
    for i in anchors.in_frustum(view).tolist():
        a = p["anchors"][i]
        direction = a - torch.tensor([0.3, 0.0, 0.0], dtype=a.dtype)
        x = torch.cat([p["features"][i], direction / direction.norm()])[None]
        alpha = net["opacity"](x)[0].tanh()
        shape, colour = net["covariance"](x).reshape(K, 7), net["colour"](x).reshape(K, 3)
        dark = net["illumination"](x[:, :-3])[0]
        share = net["light_share"](x[:, :-3]).reshape(K, 2, 3).exp()
        for j in range(K):
            if alpha[j] <= 0:
                continue
            wanted["means"].append(a + p["offsets"][i, j] * p["log_scaling"][i, :3].exp())
            wanted["scales"].append(p["log_scaling"][i, 3:].exp() * shape[j, :3].sigmoid())
            wanted["quaternions"].append(shape[j, 3:])
            wanted["opacities"].append(alpha[j])
            wanted["log_reflectance"].append(colour[j] + p["base_log_radiance"][i])
            wanted["log_illumination"].append(dark[j : j + 1])
            wanted["light_share"].append(share[j] / (1.0 + share[j].sum(0)))
            wanted["context"].append(net["context"].weight @ p["features"][i])
    assert 10 < len(wanted["means"]) < len(anchors) * K
    for name, rows in wanted.items():
        assert torch.allclose(getattr(splats, name), torch.stack(rows), rtol=1e-10, atol=1e-12), name
    alphas = anchors.outputs(splats.seen, _directions(anchors, splats.seen, 0.3))["opacity"].reshape(-1, K)
    assert torch.allclose(splats.opacity_sum, alphas.clamp_min(0.0).sum(1), rtol=1e-10)


def _directions(anchors: Anchors, seen: torch.Tensor, x: float) -> torch.Tensor:
    from_camera = anchors.positions[seen] - torch.tensor([x, 0.0, 0.0], dtype=anchors.positions.dtype)
    return from_camera / from_camera.norm(dim=1, keepdim=True)


def test_float32_and_its_gradients_are_those_of_float64_through_the_reference_rasteriser():
    """Every parameter and every network, from the loss of a picture of all that a splat carries."""
    gradients = {}
    for dtype in (torch.float64, torch.float32):
        anchors, view = trained(placed(), dtype), camera()
        splats = anchors.splats(view, 3)
        colours = torch.cat([splats.log_reflectance, splats.log_illumination], dim=1)
        colours = torch.cat([colours, splats.light_share.flatten(1), splats.context], dim=1)
        shape = splats.means, splats.quaternions, splats.scales, splats.opacities
        image = rasterize(*(t.double() for t in (*shape, colours)), view).image
        weights = torch.randn(image.shape, generator=torch.Generator().manual_seed(5)).double()
        (image * weights).sum().backward()
        gradients[dtype] = {name: t.grad for name, t in anchors.parameters.items() if name != "anchors"}
        gradients[dtype] |= {name: t.grad for name, t in anchors.networks.named_parameters()}
        assert anchors.positions.grad is None  # anchors never move
    for name, exact in gradients[torch.float64].items():
        assert exact.abs().max() > 0, name
        error = (gradients[torch.float32][name] - exact).abs().max() / exact.abs().max()
        assert error < 2e-4, (name, error)


def test_the_frustum_holds_all_that_the_rasteriser_draws_and_little_more():
    anchors = trained(placed(count=400))
    with torch.no_grad():
        anchors.parameters["log_scaling"] -= 1.5  # so that many lie outside
    view = camera()
    seen = torch.zeros(len(anchors), dtype=torch.bool)
    seen[anchors.in_frustum(view)] = True
    count = len(anchors)
    upright = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).double().repeat(count, 1)
    # An opacity for which the rasteriser's footprint ends at three standard deviations, too.
    opacity = torch.full((count,), math.exp(4.5) / 255.0).double()
    scales = anchors.parameters["log_scaling"][:, :3].exp()
    drawn = rasterize(anchors.positions, upright, scales, opacity, torch.ones(count, 1).double(), view)
    on_screen = drawn.radii > 0
    assert 20 < int(on_screen.sum()) < count - 20
    assert bool(seen[on_screen].all())
    assert int((seen & ~on_screen).sum()) <= 0.05 * count


def test_anchors_are_cells_and_begin_as_bright_as_their_points():
    config = dataclasses.replace(CONFIG, voxel_size=0.5, placement=2)
    torch.manual_seed(0)
    anchors = Anchors(config, Attributes())
    position, radiance = points(300), np.random.default_rng(1).normal(size=(300, 3))
    anchors.place(position, radiance, Start())
    cells = np.round(position)  # of one metre: two voxels
    assert len(anchors) == len(np.unique(cells, axis=0)) < 300
    splats = anchors.splats(camera(), 3)
    assert len(splats.means) > 20
    for j, row in enumerate(torch.div(splats.drawn, K, rounding_mode="floor").tolist()):
        anchor = anchors.positions[splats.seen[row]].detach().numpy()
        inside = (cells == anchor).all(axis=1)
        expected = torch.tensor(radiance[inside].mean(axis=0), dtype=torch.float32)
        assert torch.allclose(splats.log_reflectance[j], expected, atol=1e-5)
    assert splats.log_illumination.abs().max() == 0
    assert torch.equal(splats.means.detach(), anchors.positions.detach()[splats.seen[splats.drawn // K]])


@pytest.mark.parametrize("seed", [81, 98, 286, 2])  # blank from everywhere but the last, which is from some
def test_new_anchors_are_seen_from_everywhere(seed):
    """Of Gaussians that are not drawn nothing has a gradient: blank anchors would remain blank for ever."""
    config = AnchorsConfig(offsets=5)
    torch.manual_seed(seed)
    anchors = Anchors(config, Attributes())
    drawn = {name: tensor.clone() for name, tensor in anchors.networks.state_dict().items()}
    anchors.place(points(), np.zeros((40, 3)), Start())
    around = np.random.default_rng(0).normal(size=(2000, 3))
    around = torch.tensor(around / np.linalg.norm(around, axis=1, keepdims=True), dtype=torch.float32)
    opacities = anchors.outputs(torch.zeros(2000, dtype=torch.int64), around)["opacity"]
    assert opacities.reshape(2000, 5).amax(1).min() > 0.05
    others = [name for name in drawn if name != "opacity.b2"]
    assert all(torch.equal(drawn[name], anchors.networks.state_dict()[name]) for name in others)


@pytest.mark.parametrize(("seed", "k"), [(0, 5), (1, 5), (0, 10), (2, 10)])
def test_networks_whose_draw_shows_new_anchors_stay_as_they_are_drawn(seed, k):
    torch.manual_seed(seed)
    anchors = Anchors(AnchorsConfig(offsets=k), Attributes())
    drawn = anchors.networks["opacity"].get_parameter("b2").clone()
    anchors.place(points(), np.zeros((40, 3)), Start())
    assert torch.equal(drawn, anchors.networks["opacity"].get_parameter("b2"))


def test_without_a_base_the_network_alone_has_the_colour():
    anchors = placed(dataclasses.replace(CONFIG, base_radiance=False))
    assert "base_log_radiance" not in anchors.parameters
    assert anchors.splats(camera(), 3).log_reflectance.abs().max() > 0.01


def test_the_voxel_that_is_chosen_follows_the_points():
    """ε = the median distance to the neighbours / 16: twice as far apart, twice as large."""
    sizes = []
    for scale in (1.0, 2.0):
        anchors = Anchors(dataclasses.replace(CONFIG, voxel_size=0.0), Attributes())
        grid = np.stack(np.meshgrid(*[np.arange(5.0)] * 3), axis=-1).reshape(-1, 3) * scale
        anchors.place(grid, np.zeros_like(grid), Start())
        sizes.append(anchors.voxel_size)
        assert torch.allclose(anchors.parameters["log_scaling"].exp(), torch.tensor(scale))
    assert sizes == pytest.approx([1.0 / 16, 2.0 / 16])


def test_too_few_points_are_named():
    with pytest.raises(BadValueError, match="3 initial points"):
        Anchors(CONFIG, Attributes()).place(np.eye(3), np.zeros((3, 3)), Start())


def test_the_regulariser_is_the_mean_volume():
    anchors = trained(placed())
    splats = anchors.splats(camera(), 3)
    volumes = [x * y * z for x, y, z in splats.scales.tolist()]
    expected = 0.01 * sum(volumes) / len(volumes)
    assert anchors.regulariser(splats).item() == pytest.approx(expected, rel=1e-9)
    literal_zero = trained(placed(dataclasses.replace(CONFIG, volume_weight=0.0)))
    assert literal_zero.regulariser(splats) is None


def test_a_camera_that_sees_nothing_is_no_error():
    anchors = placed()
    pose = np.diag([-1.0, 1.0, -1.0, 1.0])  # looks the other way
    splats = anchors.splats(Camera.from_field_of_view(pose, 32, 32, 0.9), 3)
    assert splats.means.shape == (0, 3) and anchors.regulariser(splats).item() == 0.0


def test_every_group_has_a_rate_of_its_own():
    anchors = placed()
    groups = {*anchors.parameters, *anchors.networks}
    assert groups == set(anchors.rates())
    assert anchors.rates()["anchors"].at(0.5, 1.0) == 0.0
    assert anchors.rates()["offsets"].at(1.0, 2.0) == pytest.approx(2e-4)
    assert anchors.rates()["colour"].at(0.5, 2.0) == pytest.approx(math.sqrt(0.008 * 5e-5))


# -- fixed ---------------------------------------------------------------------------------------------------


def picture(backbone, view: Camera) -> torch.Tensor:
    s = backbone.splats(view, 3)
    share = s.light_share.flatten(1)
    colours = torch.cat([s.log_reflectance + s.log_illumination, share, s.context], dim=1)
    return rasterize(s.means, s.quaternions, s.scales, s.opacities, colours, view).image.detach()


CAMERAS = [camera(x) for x in np.linspace(-1.0, 1.0, 7)]


def test_anchors_that_do_not_know_the_direction_are_fixed_without_loss():
    anchors = trained(placed())
    with torch.no_grad():
        for name in ("opacity", "covariance", "colour"):
            anchors.networks[name].w1[:, -3:] = 0.0
    fixed = anchors.fixed(CAMERAS)
    assert 0 < len(fixed) < len(anchors) * K  # what nobody sees, or never has an opacity, is left out
    for view in CAMERAS:
        # Opacities near 0 and 1 are held off by OPACITY_MARGIN.
        assert (picture(fixed, view) - picture(anchors, view)).abs().max() < 5e-3


def test_colours_that_harmonics_can_say_are_found():
    """A colour linear in the direction is in the harmonics' span: the fit finds it where cameras look."""
    anchors = trained(placed())
    with torch.no_grad():
        for name in ("opacity", "covariance"):
            anchors.networks[name].w1[:, -3:] = 0.0
        for tensor in anchors.networks["colour"].parameters():
            tensor.zero_()
        head = anchors.networks["colour"]
        head.w1[:3, -3:] = torch.eye(3, dtype=head.w1.dtype)
        head.b1[:] = 2.0  # never below zero, where ReLU bends
        head.w2[:, :3] = 0.2
        anchors.parameters["offsets"].zero_()  # seen from where the anchor is
    fixed = anchors.fixed(CAMERAS)
    for view in CAMERAS:
        assert (picture(fixed, view) - picture(anchors, view)).abs().max() < 1e-2


def test_fixed_needs_cameras_that_see_something():
    anchors = trained(placed())
    with pytest.raises(BadValueError, match="training cameras"):
        anchors.fixed([])
    with pytest.raises(BadValueError, match="none of the cameras"):
        anchors.fixed([Camera.from_field_of_view(np.diag([-1.0, 1.0, -1.0, 1.0]), 32, 32, 0.9)])
