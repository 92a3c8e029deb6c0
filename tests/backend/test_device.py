# SPDX-License-Identifier: GPL-3.0-or-later
"""The CPU is chosen, with a reason, wherever the CUDA path cannot be used; nothing of it crashes."""

import sys

import pytest
import torch

from physhdr.backend import device as devices
from physhdr.backend.device import choose_device
from physhdr.backend.rasterize import card as cards
from physhdr.bridge.errors import BadValueError


@pytest.fixture
def card(monkeypatch):
    """A machine that has a card, as far as torch says."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "a card")
    forget(monkeypatch)


def forget(monkeypatch) -> None:
    """Find out anew what works at every call."""
    anew = cards.unavailable_reason.__wrapped__
    for module in (cards, devices):
        monkeypatch.setattr(module, "unavailable_reason", anew)


def test_without_a_card(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    forget(monkeypatch)
    assert choose_device("auto") == (torch.device("cpu"), "on the CPU (torch sees no CUDA device)")


def test_without_warp(card, monkeypatch):
    for name in [name for name in sys.modules if name.startswith("physhdr.backend.rasterize.warp")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "warp", None)
    device, why = choose_device("auto")
    assert device.type == "cpu" and why == "on the CPU (warp-lang is not installed)"
    with pytest.raises(BadValueError, match="cannot compute on CUDA: warp-lang is not installed") as caught:
        choose_device("cuda")
    assert "pip install warp-lang" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("error", "why"),
    [
        (1e-6, "on a card"),
        (0.1, "on the CPU (Warp's kernels draw a Gaussian wrongly (by 0.1))"),
        (float("nan"), "on the CPU (Warp's kernels draw a Gaussian wrongly (by nan))"),
        (RuntimeError("no driver\nmore"), "on the CPU (Warp's kernels do not run: no driver)"),
    ],
)
def test_kernels_that_do_not_work_are_not_used(card, monkeypatch, error, why):
    def tried(draw, device):
        if isinstance(error, Exception):
            raise error
        return error

    monkeypatch.setattr(cards, "warp_rasterize", lambda: None)
    monkeypatch.setattr(cards, "try_out", tried)
    assert choose_device("auto") == (torch.device("cuda" if why == "on a card" else "cpu"), why)
