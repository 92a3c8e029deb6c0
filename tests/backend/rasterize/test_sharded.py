# SPDX-License-Identifier: GPL-3.0-or-later
"""What lab/scale.md plans for several cards, by two processes: Gaussians are dealt out, each process draws
one view of all of them; records go to who draws, sums come back. A program, this file is one of them."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.distributed

from physhdr.backend.rasterize import rasterize
from physhdr.backend.scene.camera import Camera

ROOT = Path(__file__).resolve().parents[3]
COUNT, CHANNELS = 1000, 6
#: Floats of a Gaussian that are sent: its record, depth and count of tiles; and that come back.
SENT, RETURNED = 6 + CHANNELS + 2, 6 + CHANNELS


def gaussians():
    """Means, quaternions, scales, opacities, colours, zero screen offsets; some are seen by one camera."""
    generator = torch.Generator().manual_seed(0)
    return [
        torch.randn(COUNT, 3, generator=generator) * torch.tensor([1.5, 0.7, 0.7])
        - torch.tensor([0, 0, 3.0]),
        torch.randn(COUNT, 4, generator=generator),
        0.02 + 0.1 * torch.rand(COUNT, 3, generator=generator),
        0.05 + 0.9 * torch.rand(COUNT, generator=generator),
        torch.rand(COUNT, CHANNELS, generator=generator),
        torch.zeros(COUNT, 2),
    ]


def cameras():
    """One for each process."""
    aside = np.eye(4)
    aside[0, 3] = 1.0
    return [Camera(pose, 53, 38, 40.0, 44.0, 25.0, 20.0) for pose in (np.eye(4), aside)]


def owned(rank):
    """The numbers of a process's Gaussians, dealt out at random."""
    return torch.randperm(COUNT, generator=torch.Generator().manual_seed(1))[rank::2].sort().values


def weights(view):
    """∂L/∂ the picture of a view."""
    return torch.randn(CHANNELS, 38, 53, generator=torch.Generator().manual_seed(2 + view))


def exchange(parts):
    """Rows of float32 for every process → the rows that came, and how many of each process."""
    sizes = torch.tensor([len(part) for part in parts])
    coming = torch.empty_like(sizes)
    torch.distributed.all_to_all_single(coming, sizes)
    rows = torch.cat(parts)
    came = rows.new_empty(int(coming.sum()), rows.shape[1])
    torch.distributed.all_to_all_single(came, rows, coming.tolist(), sizes.tolist())
    return came, coming.tolist()


def process(rank, folder):
    """One iteration, by one of the two."""
    from physhdr.backend.rasterize.warp import stages

    torch.distributed.init_process_group(
        "gloo", init_method=(folder / "meet").as_uri(), rank=rank, world_size=2
    )
    tensors = [t[owned(rank)].contiguous() for t in gaussians()]
    seen = [stages.project(camera, *tensors) for camera in cameras()]
    shown = [torch.nonzero(each.counts)[:, 0] for each in seen]
    parts = [
        torch.cat([each.records, each.depths[:, None], each.counts.view(torch.float32)[:, None]], dim=1)[rows]
        for each, rows in zip(seen, shown, strict=True)
    ]
    came, sizes = exchange(parts)
    records, depths, counts = came.split([SENT - 2, 1, 1], dim=1)
    drawn = stages.draw(
        cameras()[rank],
        stages.Projected(
            records.contiguous(),
            depths[:, 0].contiguous(),
            torch.empty(0),
            counts.contiguous().view(torch.int32)[:, 0],
        ),
        CHANNELS,
    )
    sums = stages.draw_backward(drawn, weights(rank), torch.zeros_like(drawn.alpha))
    back, _ = exchange(list(sums.split(sizes)))
    gradients = [torch.zeros_like(t) for t in tensors]
    views = zip(cameras(), seen, shown, back.split([len(rows) for rows in shown]), strict=True)
    for camera, each, rows, of_rows in views:
        of_view = back.new_zeros(len(tensors[0]), RETURNED)
        of_view[rows] = of_rows
        found = stages.project_backward(camera, *tensors[:4], each.radii, of_view)
        for total, part in zip(gradients, found[:6], strict=True):
            total += part
    sent = 4 * parts[1 - rank].numel(), 4 * sums.split(sizes)[1 - rank].numel()
    torch.save((drawn.image, gradients, sent), folder / f"{rank}.pt")
    torch.distributed.destroy_process_group()


@pytest.mark.long
def test_two_processes_draw_what_one_does(tmp_path):
    pytest.importorskip("warp", reason="warp-lang is not installed")
    if not torch.distributed.is_available() or not torch.distributed.is_gloo_available():
        pytest.skip("this torch has no gloo")
    loopback = {"GLOO_SOCKET_IFNAME": "lo"} if sys.platform == "linux" else {}
    running = [
        subprocess.Popen(
            [sys.executable, __file__, str(rank), str(tmp_path)], cwd=ROOT, env={**os.environ, **loopback}
        )
        for rank in range(2)
    ]
    try:
        assert [each.wait(120) for each in running] == [0, 0]
    finally:
        for each in running:
            each.kill()
    results = [torch.load(tmp_path / f"{rank}.pt") for rank in range(2)]

    leaves = [t.double().requires_grad_() for t in gaussians()]
    both = []
    for view, camera in enumerate(cameras()):
        both.append(rasterize(*leaves[:5], camera, screen_offsets=leaves[5], implementation="reference"))
        (both[view].image * weights(view)).sum().backward()
    for rank, (image, gradients, sent) in enumerate(results):
        assert (image - both[rank].image).norm() <= 1e-5 * both[rank].image.norm()
        for ours, leaf in zip(gradients, leaves, strict=True):
            truth = leaf.grad[owned(rank)]
            assert (ours - truth).norm() <= 2e-5 * truth.norm()
        # The page's bytes: what the other view sees of mine goes there, what mine sees of its own goes back.
        other = 1 - rank
        there = int((both[other].radii[owned(rank)] > 0).sum())
        here = int((both[rank].radii[owned(other)] > 0).sum())
        assert 0.95 <= sent[0] / (4 * SENT * there) <= 1.0  # some reach no pixel's centre
        assert 0.95 <= sent[1] / (4 * RETURNED * here) <= 1.0


if __name__ == "__main__":
    process(int(sys.argv[1]), Path(sys.argv[2]))
