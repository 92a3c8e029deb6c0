# SPDX-License-Identifier: GPL-3.0-or-later
"""The small networks that make Gaussians of an anchor's feature (Scaffold-GS), and the making itself.

Every head has one hidden ReLU layer. The hidden layers of all heads are one matrix product, as they read the
same input; what a head does not read has weight zero in it.
"""

from collections.abc import Sequence

import torch
from torch import nn

#: Columns of a viewing direction beside the feature.
DIRECTION = 3


class Head(nn.Module):
    """``inputs`` → ``hidden`` (ReLU) → ``outputs``, with torch's own initial values.

    ``starts_at_zero``: the last layer does, so that the head changes nothing before it has learned.
    """

    def __init__(self, inputs: int, hidden: int, outputs: int, *, starts_at_zero: bool = False) -> None:
        super().__init__()
        first, last = nn.Linear(inputs, hidden), nn.Linear(hidden, outputs)
        self.w1, self.b1 = nn.Parameter(first.weight.detach()), nn.Parameter(first.bias.detach())
        self.w2, self.b2 = nn.Parameter(last.weight.detach()), nn.Parameter(last.bias.detach())
        if starts_at_zero:
            nn.init.zeros_(self.w2)
            nn.init.zeros_(self.b2)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """``[V, inputs]`` → ``[V, outputs]``; what ``run_heads`` does for several at once."""
        return torch.relu(x @ self.w1.T + self.b1) @ self.w2.T + self.b2


def run_heads(heads: Sequence[Head], x: torch.Tensor) -> list[torch.Tensor]:
    """Each head's outputs ``[V, outputs]`` at ``x`` ``[V, I]``; a head may read only the first columns."""
    padded = [nn.functional.pad(head.w1, (0, x.shape[1] - head.w1.shape[1])) for head in heads]
    hidden = torch.relu(torch.addmm(torch.cat([head.b1 for head in heads]), x, torch.cat(padded).T))
    parts = hidden.split([head.b1.shape[0] for head in heads], dim=1)
    return [torch.addmm(head.b2, part, head.w2.T) for head, part in zip(heads, parts, strict=True)]
