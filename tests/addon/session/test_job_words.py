# SPDX-License-Identifier: GPL-3.0-or-later
"""Remedies of the trainer name what the panel has: who sees them in Blender has no command line."""

from typing import Any

import pytest

from physhdr.addon.session.advice import problem_of
from physhdr.addon.session.job_words import OF_THE_COMMAND_LINE, TARGETS, for_panel
from physhdr.addon.session.results import EVALUATE, VIDEO, WEB
from physhdr.addon.session.state import (
    Asked,
    Backend,
    Link,
    Problem,
    ProcessEnded,
    Received,
    Refused,
    State,
    TaskStarted,
)
from physhdr.addon.session.task import TaskEnded
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
            "They turn: train again with --set backbone.reset_every=0, as the preset default has it, or with "
            "a larger --set backbone.prune_scale; where they are transparent, with a smaller "
            "--set backbone.prune_opacity. It stays.",
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
            "Train fewer Gaussians: --set backbone.budget=60000.",
            f"Train fewer Gaussians: --set backbone.budget=60000. {OF_THE_COMMAND_LINE.format('train')}",
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


def said_of(task: str, message: str, hint: str) -> tuple[str, str]:
    """What the panel tells of a task that failed: what, and the remedy."""
    running, _ = transition(TRAINS, TaskStarted(task, "log"))
    failed, _ = transition(running, TaskEnded(task, False, message=message, hint=hint))
    assert failed.problem
    return failed.problem.message, failed.problem.hint


def test_what_a_video_or_a_web_page_fails_of_is_called_as_in_the_panel(tmp_path):
    pytest.importorskip("torch", reason="the commands' own errors need their environment")
    from physhdr.backend.cli.video import Video
    from physhdr.backend.export import web_page

    def told(task, attempt) -> str:
        with pytest.raises(PhysHDRError) as refused:
            attempt()
        return ": ".join(said_of(task, refused.value.message, refused.value.hint))

    of: dict[str, Any] = {"source": tmp_path, "out": [tmp_path / "video.webp"]}
    short = Video(**of, seconds=0.1, fps=1)
    assert told(VIDEO, short._check) == (
        "Length 0.1 at Frames a Second 1 is too short: a video needs 2 frames: Raise one of them."
    )

    def unchanging():
        raise Video(**of, path="orbit")._unchanging()

    assert told(VIDEO, unchanging) == (
        "all frames would be the same: the training cameras are all in one place: "
        "Set Change to Exposure or Light."
    )

    def one_exposure():
        raise Video(**of, sweep="exposure")._unchanging()

    assert told(VIDEO, one_exposure).endswith("the data set has one exposure: Set Change to something else.")
    (page := tmp_path / "page.html").write_text("mine")
    assert told(WEB, lambda: web_page.refuse_what_is_not_ours(page)) == (
        f"{page} exists, and PhysHDR did not write it: Choose another place, or move it away."
    )


@pytest.mark.parametrize(
    ("task", "said", "told"),
    [
        (
            VIDEO,
            "Use --sweep exposure, or train a preset with light (default).",
            "Set Change to Exposure, or train with Default.",
        ),
        (
            VIDEO,
            "Check the disk's space, or write numbered pictures instead (--out FOLDER).",
            "Check the disk's space, or set Format to Pictures.",
        ),
        (
            VIDEO,
            "Lower --seconds, --fps or --width, or write an .mp4.",
            "Lower Length, Frames a Second or Width, or set Format to MP4.",
        ),
        (WEB, "Choose another --out, or make room.", "Choose another File, or make room."),
        (
            EVALUATE,
            "Choose another --out, or make it writable.",
            "Choose another Run, or make it writable.",
        ),
        (WEB, "Move /home/me/a--out/--web.html away.", "Move /home/me/a--out/--web.html away."),
        # What the panel has not stays, for it helps all the same, and says of what it is.
        (
            EVALUATE,
            "Evaluate the validation views: --split val.",
            f"Evaluate the validation views: --split val. {OF_THE_COMMAND_LINE.format('evaluate')}",
        ),
    ],
)
def test_remedies_of_results_are_called_as_in_the_panel(task, said, told):
    assert said_of(task, "it failed", said) == ("it failed", told)


@pytest.mark.parametrize("task", TARGETS)
def test_where_a_result_goes_has_a_name_in_every_task(task):
    _, hint = said_of(task, "it failed", "Choose another --out, or make it writable.")
    assert hint == f"Choose another {TARGETS[task]}, or make it writable."
