# SPDX-License-Identifier: GPL-3.0-or-later
"""Remedies of the trainer name what the panel has: who sees them in Blender has no command line."""

import pytest

from physhdr.addon.session.advice import problem_of
from physhdr.addon.session.job_words import OF_THE_COMMAND_LINE, for_panel
from physhdr.addon.session.state import (
    Asked,
    Backend,
    Link,
    Problem,
    ProcessEnded,
    Received,
    Refused,
    State,
)
from physhdr.addon.session.transition import transition
from physhdr.bridge.errors import PhysHDRError
from physhdr.bridge.messages import Failure, JobStatus, TrainStart

START = TrainStart(data="/data", out="/run")
TRAINS = State(backend=Backend("/env/bin/python", {"versions": {}}), link=Link("connected"))


def shown(failure: Failure) -> list[Problem]:
    """What the panel tells of a start that is refused, and of a training that fails, for that reason."""
    refused, _ = transition(transition(TRAINS, Asked(START))[0], Refused(START, failure))
    told = JobStatus(state="failed", run="/run", failure=failure)
    failed, _ = transition(TRAINS, Received(told))
    return [problem for state in (refused, failed) if (problem := problem_of(state))]


def test_a_folder_that_cannot_be_trained_in_is_called_as_in_the_panel(tmp_path, monkeypatch):
    pytest.importorskip("torch", reason="the trainer's own errors need its environment")
    from physhdr.backend.runs import files, lock
    from physhdr.backend.serve.failures import failure_of

    def hint(attempt) -> str:
        with pytest.raises(PhysHDRError) as refused:
            attempt()
        [of_refusal, of_job] = shown(failure_of(refused.value))
        assert of_refusal == of_job and refused.value.message == of_job.message
        return of_job.hint

    (tmp_path / "file").touch()
    assert hint(lambda: files.writable_folder(tmp_path / "file" / "run")) == (
        "Choose another Run, or make it writable."
    )
    monkeypatch.setattr(lock, "WAIT_SECONDS", 0.0)
    with lock.hold(tmp_path, print):
        told = hint(lambda: lock.hold(tmp_path, print).__enter__())
    assert told == "Wait for its end, stop it, or choose another Run."
    (tmp_path / files.CHECKPOINT_FILE).touch()
    assert hint(lambda: files.refuse_a_run(tmp_path)) == (
        "Go on with it by Resume, replace it (Start, then Replace), or choose another Run."
    )


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (
            "Train on smaller pictures: --downscale 4. Close other programs.",
            "Train on smaller pictures: 1/4 of their width and height. Close other programs.",
        ),
        (
            "Train on smaller pictures (--downscale) and with fewer Gaussians, or on another machine.",
            "Train on smaller pictures and with fewer Gaussians, or on another machine.",
        ),
        (
            "End what else computes on the card, or train with --device cpu.",
            "End what else computes on the card, or train with Device set to Processor.",
        ),
        (
            "Restore a copy, or train again with --overwrite.",
            "Restore a copy, or train again (Start, then Replace).",
        ),
        (
            "They turn: train again with --densify.reset-every 0, as the preset default has it, or with a "
            "larger --densify.prune-scale; where they are transparent, with a smaller "
            "--densify.prune-opacity. It stays.",
            "They turn: train again with Method set to Default. It stays.",
        ),
        (
            "Give the data set a points3d.ply with more points, or train with --initial-points random.",
            "Give the data set a points3d.ply with more points.",
        ),
        (
            "Give the folder of a data set (docs/formats.md). Of photos, 'physhdr prepare PHOTOS FOLDER' "
            "makes one; 'python synth/make_scene.py -- --out FOLDER' renders one.",
            "Give the folder of a data set, or make one: Prepare Photos, or Render from This Scene.",
        ),
        # What the panel has not stays, for it helps all the same, and says of what it is.
        (
            "Train fewer Gaussians: --densify.budget 60000.",
            f"Train fewer Gaussians: --densify.budget 60000. {OF_THE_COMMAND_LINE}",
        ),
    ],
)
def test_options_are_called_as_in_the_panel_or_told_to_be_the_command_lines(said, told):
    assert for_panel(Failure(code="x", message="too much", hint=said)).hint == told
    assert [problem.hint for problem in shown(Failure(code="x", message="too much", hint=said))] == [told] * 2


def test_a_backend_that_cannot_begin_names_the_preference():
    starting = State(link=Link("starting"))
    ended, _ = transition(starting, ProcessEnded(1, "  Choose a --home on a disk of this machine."))
    assert (problem := problem_of(ended))
    assert "Choose a Backend's Folder (in the preferences) on a disk" in problem.message
