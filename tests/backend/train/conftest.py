# SPDX-License-Identifier: GPL-3.0-or-later
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
import torch

from physhdr.backend.scene.scene import Scene
from physhdr.backend.train.begin import begin, resume
from physhdr.backend.train.checkpoint import load_checkpoint
from physhdr.backend.train.config import TrainConfig
from physhdr.backend.train.trainer import run
from physhdr.bridge.run_folder import CHECKPOINT_FILE

Tensors = dict[str, torch.Tensor]


@pytest.fixture
def whole_and_in_parts(tmp_path: Path) -> Callable[[Scene, TrainConfig, Sequence[int]], list[Tensors]]:
    """What two equal trainings save at their ends, the second stopped and resumed at given iterations."""

    def saved(scene: Scene, config: TrainConfig, stops: Sequence[int]) -> list[Tensors]:
        found = []
        for name, each in (("whole", ()), ("parts", stops)):
            folder = tmp_path / name
            folder.mkdir()
            state = begin(scene, config)
            for stop in (*each, config.iterations):
                for _ in run(state, folder, should_stop=lambda t=state, s=stop: t.iteration >= s):
                    pass
                state = resume(folder, scene, config)
            found.append(load_checkpoint(folder / CHECKPOINT_FILE)[0])
        return found

    return saved
