# SPDX-License-Identifier: GPL-3.0-or-later
"""An iteration never makes the host wait for a card, and never copies to it.

Shown without a card, on torch's ``meta`` device: its tensors have shapes and no values, so that whatever asks
for one fails; copies from the host and tensors that are made of Python numbers are refused here.
"""

import dataclasses
from pathlib import Path

import pytest
import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from physhdr.backend import rasterize as rasterizers
from physhdr.backend.methods.physhdr_common import PhysHDRConfig
from physhdr.backend.rasterize import Rasterization
from physhdr.backend.scene import read_scene
from physhdr.backend.train import densify
from physhdr.backend.train.begin import begin
from physhdr.backend.train.growing import Growing
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.state import State
from physhdr.backend.train.trainer import step

aten = torch.ops.aten
#: Anchors draw only what is opaque, which a card must tell the host: only 3DGS's backbone never waits.
OURS = [
    name
    for name, config in PRESETS.items()
    if isinstance(config.method, PhysHDRConfig) and config.backbone.name == "gaussians"
]


class RefusedError(AssertionError):
    pass


class RefuseCopies(TorchDispatchMode):
    """No value is read from the device and none is copied to it."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        tensors = [a for a in args if isinstance(a, torch.Tensor)]
        devices = {t.device.type for t in tensors}
        if func is aten._to_copy.default:
            devices.add(torch.device(kwargs.get("device") or tensors[0].device).type)
        if func in (aten._to_copy.default, aten.copy_.default) and len(devices) > 1:
            raise RefusedError(f"{func} between {sorted(devices)}")
        reads = (aten._local_scalar_dense.default, aten.nonzero.default, aten.masked_select.default)
        if func in reads and "meta" in devices:
            raise RefusedError(f"{func} reads from the device")
        return func(*args, **kwargs)


class RefuseNumbers(TorchFunctionMode):
    """No tensor on the device is made of Python numbers: torch copies those from the host."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        device = kwargs.get("device")
        if (
            func in (torch.tensor, torch.as_tensor)
            and device is not None
            and torch.device(device).type != "cpu"
        ):
            raise RefusedError(f"{func.__name__} on {device}")
        if func is torch.Tensor.new_tensor and args[0].device.type != "cpu":
            raise RefusedError("new_tensor")
        return func(*args, **kwargs)


def draw_nothing(means, quaternions, scales, opacities, colours, camera, screen_offsets=None):
    """A rasteriser of the right shapes that depends on every input; gsplat's own read-back is not in it."""
    geometry = sum(t.sum() for t in (means, quaternions, scales, opacities, screen_offsets))
    image = colours.new_zeros(colours.shape[1], camera.height, camera.width) + colours.sum() * geometry
    return Rasterization(image, image[0], means.detach()[:, 0])


@pytest.fixture
def trainer_elsewhere(monkeypatch):
    """Makes a trainer whose tensors are on the meta device, one iteration before its last."""

    def make(preset: str, data: Path) -> State:
        config = PRESETS[preset]
        tone_mapper = dataclasses.replace(config.method.tone_mapper, warm_start_steps=0)
        method = dataclasses.replace(config.method, tone_mapper=tone_mapper)
        config = dataclasses.replace(config, iterations=40, sh_degree_every=2, method=method)
        state = begin(read_scene(data), config)
        device = torch.device("meta")
        state.device = state.data.pictures.device = device
        state.method.to_device(device)
        state.part(Growing).growth.statistics = densify.DensifyState.empty(state.method.gaussians)
        monkeypatch.setattr(rasterizers, "_implementation", lambda name, means: draw_nothing)
        # Torch's fused Adam does not know this device; on CUDA it keeps its step count there.
        monkeypatch.setattr(state.optimiser, "step", lambda iteration: None)
        for view in state.views:  # at first use cameras and pictures are copied
            for k in range(len(view.exposures)):
                state.data.pictures.get(view, k)
        with torch.no_grad():
            for view in state.views:
                state.method.draw(view.camera, tuple(1.0 for _ in state.plan.seen.lights), 1.0, watch=True)
        step(state)
        state.iteration = 19
        return state

    return make


@pytest.mark.parametrize(
    ("preset", "data"),
    [*((p, "tiny_data") for p in OURS), pytest.param("default", "two_lights_data", marks=pytest.mark.long)],
)
def test_a_step_neither_waits_nor_copies(preset, data, request, trainer_elsewhere):
    state = trainer_elsewhere(preset, request.getfixturevalue(data))
    gaussians = state.method.gaussians
    for parameter in gaussians.parameters.values():
        parameter.grad = None
    lit = state.plan.seen.scene.lit[0]
    if data == "two_lights_data":  # an iteration whose levels are not all 1
        state.data.views, state.data.exposures = [lit], [(0,)]
    with RefuseCopies(), RefuseNumbers():
        terms = step(state)
    assert all(term.device.type == "meta" for term in terms.values())
    learned = [name for name, parameter in gaussians.parameters.items() if parameter.grad is not None]
    assert {"means", "opacity_logits", "reflectance_dc", "reflectance_rest"} <= set(learned)
    assert ("light_share_logits" in learned) == state.method.config.has_light_share


@pytest.mark.parametrize(
    ("slip", "error", "said"),
    [
        (lambda t: t.item(), RefusedError, "reads"),
        (lambda t: bool(t > 0), RefusedError, "reads"),
        # Torch's own refusal, before the mode sees it: the size of the result is a value.
        (
            lambda t: torch.zeros(3, device=t.device)[torch.zeros(3, device=t.device) > 0],
            NotImplementedError,
            r"torch\.nonzero\(\) raises unimplemented",
        ),
        (lambda t: torch.tensor([1.0, 2.0], device=t.device), RefusedError, "tensor on meta"),
        (lambda t: t.new_tensor([1.0, 2.0]), RefusedError, "new_tensor"),
        (lambda t: torch.ones(3).to(t), RefusedError, "between"),
        (lambda t: t * torch.tensor(2.0).to(t.device), RefusedError, "between"),
    ],
)
def test_every_slip_is_noticed(slip, error, said):
    with RefuseCopies(), RefuseNumbers(), pytest.raises(error, match=said):
        slip(torch.zeros((), device="meta"))
