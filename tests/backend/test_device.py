# SPDX-License-Identifier: GPL-3.0-or-later
"""The CPU is chosen, with a reason, wherever the CUDA path cannot be used; nothing of it crashes."""

import sys
import types

import pytest
import torch

from physhdr.backend import device as devices
from physhdr.backend.device import BUILDING, choose_device
from physhdr.backend.rasterize import card as cards
from physhdr.backend.rasterize import cuda
from physhdr.bridge.errors import BadValueError


@pytest.fixture
def card(monkeypatch):
    """A machine that has a card, as far as torch says."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "a card")
    forget(monkeypatch)
    # No Warp either: neither it nor ours that were imported with it.
    for name in [name for name in sys.modules if name.startswith("physhdr.backend.rasterize.warp")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "warp", None)


def forget(monkeypatch) -> None:
    """Find out anew what works at every call."""
    monkeypatch.setattr(cuda, "unavailable_reason", cuda.unavailable_reason.__wrapped__)
    of_warp = cards.warp_unavailable_reason.__wrapped__
    for module in (cards, devices):
        monkeypatch.setattr(module, "warp_unavailable_reason", of_warp)
    monkeypatch.setattr(cards, "_working", cards._working.__wrapped__)


def install_gsplat(monkeypatch, backend: types.ModuleType | Exception) -> None:
    class Backend(types.ModuleType):
        def __getattr__(self, name: str):
            if isinstance(backend, Exception):
                raise backend
            return getattr(backend, name)

    package = types.ModuleType("gsplat")
    package.__path__ = []
    monkeypatch.setitem(sys.modules, "gsplat", package)
    monkeypatch.setitem(sys.modules, "gsplat.cuda", types.ModuleType("gsplat.cuda"))
    monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", Backend("gsplat.cuda._backend"))


def backend_with(kernels: object) -> types.ModuleType:
    module = types.ModuleType("backend")
    module._C = kernels
    return module


def test_without_a_card(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    forget(monkeypatch)
    assert choose_device("auto") == (torch.device("cpu"), "on the CPU (torch sees no CUDA device)")


def test_without_gsplat(card, monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    device, why = choose_device("auto")
    assert device.type == "cpu" and "gsplat cannot be imported" in why and "warp-lang is not installed" in why


def test_warp_computes_and_gsplat_is_not_built(card, monkeypatch):
    install_gsplat(monkeypatch, RuntimeError("this would compile for minutes"))
    monkeypatch.setattr(devices, "is_built", lambda: False)
    monkeypatch.setattr(cards, "warp_rasterize", lambda: None)
    monkeypatch.setattr(cards, "try_out", lambda draw, device: 1e-6)
    said: list[str] = []
    assert choose_device("auto", said.append) == (torch.device("cuda"), "on a card, by Warp's kernels")
    assert cards.way() == "warp" and said == []
    monkeypatch.setattr(cards, "try_out", lambda draw, device: 0.1)
    assert "Warp's kernels draw a Gaussian wrongly (by 0.1)" in choose_device("auto")[1]
    monkeypatch.setattr(cards, "try_out", lambda draw, device: 1 / 0)
    assert choose_device("auto")[1].startswith("on the CPU (Warp's kernels do not run: division by zero; ")


@pytest.mark.parametrize(
    ("backend", "reason"),
    [
        (RuntimeError("ninja: build stopped\nmore"), "could not be built: ninja: build stopped"),
        (backend_with(None), "there is no nvcc"),
        (backend_with(object()), "gsplat's kernels do not run"),
    ],
)
def test_kernels_that_cannot_be_used(card, monkeypatch, backend, reason):
    install_gsplat(monkeypatch, backend)
    monkeypatch.setattr(devices, "is_built", lambda: True)
    device, why = choose_device("auto")
    assert device.type == "cpu" and reason in why and "\n" not in why
    with pytest.raises(BadValueError, match="cannot compute on CUDA"):
        choose_device("cuda")


def test_kernels_that_draw_wrongly_are_not_used(card, monkeypatch):
    install_gsplat(monkeypatch, backend_with(object()))
    monkeypatch.setattr(devices, "is_built", lambda: True)
    monkeypatch.setattr(cuda, "try_out", lambda draw, device: float("nan"))
    assert "draw a Gaussian wrongly" in choose_device("auto")[1]
    monkeypatch.setattr(cuda, "try_out", lambda draw, device: 1e-6)
    assert choose_device("auto") == (torch.device("cuda"), "on a card")


def test_a_build_is_announced_before_it_begins(card, monkeypatch):
    said: list[str] = []
    monkeypatch.setattr(devices, "is_built", lambda: False)
    monkeypatch.setattr(devices, "unavailable_reason", lambda: said.append("built") or None)
    choose_device("auto", report=said.append)
    assert said == [BUILDING, "built"]


def test_whether_the_kernels_are_built_is_seen_without_importing_gsplat(tmp_path, monkeypatch):
    package, builds = tmp_path / "gsplat", tmp_path / "builds"
    package.mkdir()
    (package / "__init__.py").write_text("raise ImportError('something it needs is missing')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("TORCH_EXTENSIONS_DIR", str(builds))
    assert not cuda.is_built()
    (builds / "py311" / "gsplat_cuda").mkdir(parents=True)
    (builds / "py311" / "gsplat_cuda" / "gsplat_cuda.so").touch()
    assert cuda.is_built()
    monkeypatch.setenv("TORCH_EXTENSIONS_DIR", str(tmp_path / "nothing"))
    assert not cuda.is_built()
    (package / "csrc.cpython-311-x86_64-linux-gnu.so").touch()
    assert cuda.is_built()
