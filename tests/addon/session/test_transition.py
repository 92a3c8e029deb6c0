# SPDX-License-Identifier: GPL-3.0-or-later
"""The state in Blender is a pure function of what happened: no Blender, no process, no socket here."""

import re
from dataclasses import replace

import pytest

from physhdr.addon.session.advice import (
    IMPORTED,
    IN_SCENE,
    SEEN,
    SET_UP,
    SHARED,
    Choices,
    headline,
    next_step,
    problem_of,
    why_not,
)
from physhdr.addon.session.dataset_words import in_the_dialogs_words
from physhdr.addon.session.state import (
    Asked,
    Backend,
    Connect,
    Connected,
    Dataset,
    DatasetChosen,
    Dismissed,
    EndAsked,
    EndBackend,
    FileOpened,
    Found,
    KeepReport,
    KillBackend,
    LinkLost,
    Made,
    MadeDismissed,
    NotEnded,
    NotTaken,
    Photos,
    PhotosChosen,
    Prepared,
    Problem,
    ProcessEnded,
    PythonChosen,
    Received,
    Refused,
    Send,
    StartBackend,
    Started,
    State,
    StopAsked,
    SummariseDataset,
    TaskCancelled,
    TaskMade,
    TaskStarted,
    TimePassed,
    Vanished,
)
from physhdr.addon.session.task import TaskEnded, TaskProgress
from physhdr.addon.session.tasks import TASKS, stage, stage_of_training
from physhdr.addon.session.transition import transition
from physhdr.bridge.messages import (
    Done,
    Failure,
    History,
    HistoryGet,
    JobStatus,
    RunOpen,
    Shutdown,
    StatusGet,
    TrainPause,
    TrainResume,
    TrainStart,
    TrainStop,
    Welcome,
    WhenClosed,
)

WELCOME = Welcome(
    protocol=1,
    version="0.1.0",
    pid=4242,
    log="/tmp/backend.log",
    device="cpu",
    torch="2.13.0",
    presets=("default",),
    in_control=True,
)
START = TrainStart(data="/data", out="/run")
CHOICES = Choices(data="/data", out="/run")
READY = State(backend=Backend("/env/bin/python", {"versions": {"torch": "2.13.0"}, "missing": []}))


def after(state, *events):
    """The state after ``events``, and all that they asked for."""
    effects = []
    for event in events:
        state, more = transition(state, event)
        effects += more
    return state, effects


def connected(state=READY):
    return after(state, Found("/tmp/backend.log", 4242), Connected(WELCOME))[0]


def training(**changes):
    job = {"state": "training", "run": "/run", "iteration": 40, "iterations": 100, "in_control": True}
    return after(connected(), Received(JobStatus(**{**job, **changes})))[0]


def test_an_installation_makes_the_backend_ready_and_is_remembered():
    report = {"versions": {"torch": "2.13.0"}, "environment": "/env/bin/python"}
    state, _ = after(
        State(),
        TaskStarted("install", "/tmp/install.log"),
        TaskProgress("install", 0.5, "fetching torch", 30.0),
    )
    assert headline(state) == "Installing the backend" and state.task("install").fraction == 0.5
    assert why_not(state, "start", CHOICES) == "Wait for the install to end"
    state, effects = after(state, TaskEnded("install", True, result=report))
    assert state.backend.ready and state.backend.python == "/env/bin/python"
    assert effects == [KeepReport("/env/bin/python", report)]
    assert headline(state) == "Ready"


def test_a_failed_check_says_why_and_where_the_log_is():
    state, _ = after(State(), PythonChosen("/other/python"), TaskStarted("check", "/tmp/check.log"))
    state, effects = after(state, TaskEnded("check", False, message="no module torch", hint="Install it."))
    assert not state.backend.ready and not effects
    assert problem_of(state).message == "no module torch" and problem_of(state).log == "/tmp/check.log"
    assert headline(state) == "The backend failed its check"


def test_a_backend_that_works_stays_where_another_one_could_not_be_installed():
    """The installer leaves the former environment until the new one has passed its check."""
    state, _ = after(READY, TaskStarted("install", "/tmp/install.log"))
    state, effects = after(state, TaskEnded("install", False, message="pip cannot reach the index"))
    assert state.backend == READY.backend and not effects
    assert problem_of(state) == Problem("pip cannot reach the index", "", "/tmp/install.log")
    assert why_not(state, "start", CHOICES) == ""
    state, _ = after(state, Dismissed())
    assert problem_of(state) is None and headline(state, CHOICES) == "Ready"


def test_another_python_takes_the_place_of_one_that_works_once_it_has_passed():
    asked, _ = after(READY, TaskStarted("check", "/tmp/check.log", "/other/python"))
    failed, _ = after(asked, TaskEnded("check", False, message="no module torch", code="missing_module"))
    assert failed.backend == READY.backend and problem_of(failed).message == "no module torch"
    cancelled, _ = after(asked, TaskCancelled("check"), TaskEnded("check", False, cancelled=True))
    assert cancelled.backend == READY.backend and problem_of(cancelled) is None
    report = {"versions": {"torch": "2.14.0"}}
    passed, effects = after(asked, TaskEnded("check", True, result=report))
    assert passed.backend == Backend("/other/python", report)
    assert effects == [KeepReport("/other/python", report)]
    # Where none works it is the chosen one at once, and what is wrong with it stands beside it.
    first, _ = after(State(), TaskStarted("check", "/tmp/check.log", "/other/python"))
    assert first.backend == Backend("/other/python")
    failed, _ = after(first, TaskEnded("check", False, message="no module torch"))
    assert failed.backend.python == "/other/python" and failed.backend.problem
    # The chosen one itself, checked again, works no more if it fails.
    broken, _ = after(READY, TaskStarted("check", "/log"), TaskEnded("check", False, message="no torch"))
    assert not broken.backend.ready


def test_a_cancelled_task_is_no_problem():
    state, _ = after(State(), TaskStarted("install", "log"), TaskCancelled("install"))
    assert state.task("install").cancelling
    state, _ = after(state, TaskEnded("install", False, cancelled=True, message="ended by signal 2"))
    assert problem_of(state) is None and not state.tasks


def test_a_rendered_data_set_is_looked_at():
    state, _ = after(READY, TaskStarted("dataset", "log"))
    _, effects = after(state, TaskEnded("dataset", True, result={"folder": "/data"}))
    assert effects == [SummariseDataset("/data")]


def test_photos_are_looked_at_and_what_they_became_is_summarised():
    state, _ = transition(READY, PhotosChosen("/photos", ("--handheld",)))
    state, _ = transition(state, TaskStarted("look", "/log"))
    assert headline(state) == "Looking at the photos" and next_step(state, CHOICES) == ""
    found = {"lines": ["11 photos"], "warnings": ["automatic exposure"], "estimate_seconds": 90}
    found["skipped"] = [{"name": f"{k}.jpg", "why": "damaged"} for k in range(5)]
    state, _ = transition(state, TaskEnded("look", True, result=found))
    photos = state.photos
    assert (photos.folder, photos.options, photos.lines) == ("/photos", ("--handheld",), ("11 photos",))
    assert photos.seconds == 90.0 and photos.warnings[:2] == (
        "automatic exposure",
        "Left out: 0.jpg, damaged",
    )
    assert photos.warnings[-1] == "Left out: 2 more files" and photos.seconds == 90.0
    chosen = replace(CHOICES, photos="/photos", photos_out="/out")
    assert next_step(state, chosen) == "Prepare the photos"
    state, _ = transition(state, TaskStarted("photos", "/log"))
    assert headline(state) == "Preparing the photos"
    assert why_not(state, "look") == why_not(state, "photos", chosen) == "Photos are being prepared"
    result = {"folder": "/out", "placed": 9, "places": 11, "reprojection_error": 0.157}
    result["warnings"] = ["2 left out: --partial uses what was found"]
    done, effects = transition(state, TaskEnded("photos", True, result=result))
    assert effects == (SummariseDataset("/out"),) and done.photos == photos
    found = "9 of 11 places found, reprojection error 0.16 pixels"
    assert done.prepared == Prepared("/out", found, ("2 left out: Use What Was Found uses what was found",))
    # Broken off or failed, it leaves what was understood; the next try begins without the former's result.
    broken, effects = transition(state, TaskEnded("photos", False, cancelled=True))
    assert broken.photos == photos and not effects and not problem_of(broken)
    hint = "Say --bracket 3, or 'physhdr prepare --poses'."  # what the panel has not stays as it is
    failed, _ = transition(state, TaskEnded("photos", False, message="too few", hint=hint))
    told = "Say Photos a Place 3, or 'physhdr prepare --poses'."
    assert failed.photos == photos and problem_of(failed) == Problem("too few", told, "/log")
    again, _ = transition(done, TaskStarted("photos", "/log"))
    assert again.prepared == Prepared()


def test_remedies_of_brackets_are_those_that_the_panel_has():
    hint = "Say --bracket N, name them desk_0.jpg (--group names), or say that there are none (--group none)."
    state, _ = transition(READY, PhotosChosen("/photos"))
    state, _ = transition(state, TaskStarted("look", "/log"))
    failed, _ = transition(state, TaskEnded("look", False, message="not plain", hint=hint))
    assert failed.photos.problem is not None
    assert failed.photos.problem.hint == (
        "Say Photos a Place N, name them desk_0.jpg, or say that there are none (Photos a Place 1)."
    )


def test_what_photos_are_is_told_in_short_lines():
    told = {"photos": 27, "places": 9, "per_place": 3, "exposures": [0.125, 0.5, 2.0], "stops": 4.0}
    told |= {"size": [400, 300], "how": "by order: each 3 photos repeat", "lines": ["27 photos of 400×300 …"]}
    state, _ = transition(READY, PhotosChosen("/photos"))
    found, _ = transition(state, TaskEnded("look", True, result=told))
    assert found.photos.lines == (
        "27 photos, 400 × 300",
        "9 places, 3 photos each",
        "3 exposures: 1/8 s to 2 s, 4.0 stops",
        "Found by order: each 3 photos repeat",
    )
    told["lights"] = [{"group": "pendant off", "levels": {"pendant": 0.0}, "places": 8}, {"group": 3}, 7]
    found, _ = transition(state, TaskEnded("look", True, result=told))
    assert found.photos.lines[4:] == ("pendant off: 8 places",)
    single = {"photos": 11, "places": 11, "per_place": 1, "exposures": [0.0008], "stops": 0.0}
    found, _ = transition(state, TaskEnded("look", True, result=single))
    assert found.photos.lines == ("11 photos", "11 places", "1 exposure: 1/1250 s")


def test_a_failed_look_is_a_problem_of_the_photos_alone():
    state, _ = transition(READY, PhotosChosen("/photos"))
    state, _ = transition(state, TaskStarted("look", "/log"))
    failed, _ = transition(state, TaskEnded("look", False, message="no photos there", hint="choose"))
    problem = Problem("no photos there", "choose", "/log")
    assert problem_of(failed) is None and failed.photos.problem == problem
    chosen = replace(CHOICES, photos="/photos")
    assert next_step(failed, chosen) == "Choose another folder of photos"
    assert why_not(failed, "photos", chosen) == "no photos there"


def test_a_cancelled_look_is_not_begun_again():
    state, _ = transition(READY, PhotosChosen("/photos", ("--handheld",)))
    state, _ = transition(state, TaskStarted("look", "/log"))
    broken, _ = transition(state, TaskEnded("look", False, cancelled=True))
    # As the timer asks: it looks where folder or options are others.
    assert (broken.photos.folder, broken.photos.options) == ("/photos", ("--handheld",))
    assert "was cancelled" in broken.photos.warnings[0] and problem_of(broken) is None
    assert why_not(broken, "photos", replace(CHOICES, photos="/photos", photos_out="/out")) == ""
    # Photos that were left while they were looked at are gone.
    left, _ = after(state, PhotosChosen(""), TaskEnded("look", False, cancelled=True))
    assert left.photos == Photos()


def test_what_was_made_is_said_until_it_is_dismissed_or_something_else_is_begun():
    state, _ = after(READY, TaskStarted("video", "log", makes="/run/video.mp4"))
    state, _ = transition(state, TaskEnded("video", True, result={"folder": "/run"}))
    assert state.made == Made("video", "/run/video.mp4")
    assert transition(state, MadeDismissed())[0].made is None
    assert transition(state, TaskStarted("web", "log"))[0].made is None
    assert transition(state, Asked(START))[0].made is None and transition(state, FileOpened())[0].made is None
    # What the user reads of something that failed is another thing.
    assert transition(state, Dismissed())[0].made == state.made
    state, _ = after(
        READY, TaskStarted("photos", "log"), TaskEnded("photos", True, result={"folder": "/set"})
    )
    assert state.made == Made("photos", "/set")
    # A bake is there once it was taken in.
    state, _ = after(READY, TaskStarted("bake", "log"), TaskEnded("bake", True))
    assert state.made is None and transition(state, TaskMade("bake", "/a.ply"))[0].made == Made(
        "bake", "/a.ply"
    )


@pytest.mark.parametrize(
    "how", [{"ok": False}, {"ok": False, "cancelled": True}, {"ok": True, "cancelled": True}]
)
def test_nothing_is_said_to_be_made_where_it_failed_or_was_cancelled(how):
    state, _ = after(READY, TaskStarted("video", "log", makes="/run/video.mp4"), TaskEnded("video", **how))
    assert state.made is None


def test_a_stage_without_progress_for_20_seconds_says_what_it_does_and_for_how_long():
    state, _ = after(READY, TaskStarted("photos", "log"), TimePassed(100.0), TimePassed(119.0))
    assert stage(state.tasks[0]) == "Photos"
    state, _ = after(
        state, TaskProgress("photos", 0.2, "matching photos"), TimePassed(120.0), TimePassed(139.5)
    )
    assert stage(state.tasks[0]) == "matching photos"
    # The same said again is no progress.
    state, _ = after(state, TaskProgress("photos", 0.2, "matching photos", 9.0), TimePassed(140.2))
    assert stage(state.tasks[0]) == "matching photos: 20 s so far"
    assert transition(state, TimePassed(140.9))[0] is state  # nothing to be drawn anew
    state, _ = after(state, TimePassed(215.0))
    assert stage(state.tasks[0]) == "matching photos: 1 min 35 s so far"
    state, _ = after(state, TaskProgress("photos", 0.3, "matching photos"), TimePassed(216.0))
    assert stage(state.tasks[0]) == "matching photos"


def test_a_training_without_progress_says_what_it_does_but_a_halted_one_does_not():
    state = training()
    state, _ = after(state, TimePassed(100.0), TimePassed(130.0))
    assert stage_of_training(state) == f"Iteration {state.job.iteration}: 30 s so far"
    moved = replace(state.job, iteration=state.job.iteration + 1)
    state, _ = after(state, Received(moved), TimePassed(131.0))
    assert state.pace.quiet == 0 and stage_of_training(state) == ""
    state, _ = after(state, Received(replace(moved, state="paused")), TimePassed(140.0), TimePassed(900.0))
    assert state.pace.quiet == 0


def test_the_environment_is_not_replaced_while_anything_works_by_it():
    for name, words, _ in TASKS:
        state, _ = after(READY, TaskStarted(name, "log"))
        told = {why_not(state, "install"), why_not(state, "extend")}
        if name in ("install", "check"):
            assert told == {f"Wait for the {name} to end, or cancel it"}
        elif name == "dataset":
            assert told == {""}  # Blender's own work
        else:
            assert told == {f"The backend is at work ({words}): wait for that to end, or cancel it"}
    assert why_not(training(), "install") == "Stop the training first"
    starting, _ = after(READY, Asked(START), Started("log"))
    assert "wait until it has" in why_not(replace(starting, job=JobStatus()), "install")
    hangs, _ = after(connected(), LinkLost("it does not answer"))
    assert "end it first" in why_not(hangs, "install")


def test_an_idle_backend_is_shut_down_before_its_environment_is_replaced():
    job = JobStatus(state="open", run="/run", has_model=True, in_control=True)
    state, _ = after(connected(), Received(job))
    assert why_not(state, "install") == ""
    watching, _ = after(state, Received(replace(job, in_control=False, controller="Blender 2")))
    assert "Blender 2 is in control" in why_not(watching, "install")
    state, effects = after(state, TaskStarted("install", "log"))
    assert effects == [Send(Shutdown())]
    state, _ = after(state, LinkLost("Blender shut the backend down", clean=True))
    # Nothing begins another one meanwhile.
    choices = replace(CHOICES, out_has_run=True)
    assert all(
        "Wait for the install" in why_not(state, each, choices) for each in ("start", "resume", "open")
    )
    assert after(READY, TaskStarted("install", "log"))[1] == []
    assert after(connected(), TaskStarted("check", "log"))[1] == []


@pytest.mark.parametrize("value", [None, "x", 3, True, [1], {"a": 1}, [{"name": 1}], float("nan")])
def test_whatever_another_version_says_of_photos_can_be_shown(value):
    names = ("photos", "places", "per_place", "exposures", "stops", "size", "how", "lines", "warnings")
    names += ("skipped", "estimate_seconds", "folder", "placed", "reprojection_error")
    state, _ = transition(READY, PhotosChosen("/photos"))
    result = dict.fromkeys(names, value)
    state, _ = transition(state, TaskEnded("look", True, result=result))
    assert state.photos.lines and all(isinstance(text, str) for text in state.photos.warnings)
    assert state.photos.seconds == (3.0 if value == 3 and value is not True else -1.0)
    state, _ = transition(state, TaskEnded("photos", True, result=result))
    assert isinstance(state.prepared.folder, str)


def test_a_new_data_set_is_trained_before_the_former_result_is_imported():
    former = replace(
        READY, job=JobStatus(state="finished", data="/old", run="/run"), dataset=Dataset("/data")
    )
    assert next_step(former, CHOICES) == "Start the training"
    same = replace(former, job=replace(former.job, data="/data/"))
    assert next_step(same, CHOICES) == "Import the result into the scene"


def test_what_a_check_did_not_find_is_told_and_can_be_added():
    told = {"versions": {"torch": "2.13.0"}, "missing": ["pycolmap>=4.0,<5"]}
    state, _ = transition(READY, TaskStarted("check", "/log"))
    lacking, _ = transition(state, TaskEnded("check", True, result=told))
    chosen = replace(CHOICES, photos="/photos", photos_out="/out")
    assert lacking.backend.ready and lacking.backend.missing == ("pycolmap>=4.0,<5",)
    assert why_not(lacking, "photos", chosen).startswith("The backend lacks pycolmap>=4.0,<5")
    assert why_not(lacking, "start", CHOICES) == ""  # training does without it
    complete, _ = transition(state, TaskEnded("check", True, result={**told, "missing": []}))
    assert why_not(complete, "photos", chosen) == ""
    error = TaskEnded("check", False, message="no module x", hint="install it", code="missing_module")
    failed, _ = transition(state, error)
    assert failed.backend.incomplete and not failed.backend.ready
    assert next_step(failed, CHOICES) == "Add what is missing, or use another Python"
    assert why_not(failed, "extend", replace(CHOICES, online=False)).startswith("Blender may not go online")
    assert why_not(State(), "extend") == "Install the backend first"


def test_a_training_starts_the_backend_waits_for_it_and_is_then_sent():
    state, effects = after(READY, Asked(START))
    assert effects == [StartBackend()] and state.waiting == (START,)
    state, effects = after(state, Started("/tmp/backend.log"), Found("/tmp/backend.log", 4242))
    assert effects == [Connect()] and headline(state) == "The backend starts"
    state, effects = after(state, Connected(WELCOME))
    assert effects == [Send(HistoryGet()), Send(START)]
    assert state.waiting == () and state.active


def test_what_the_backend_says_of_the_former_job_is_not_taken_for_the_new_one():
    finished = JobStatus(state="finished", run="/old", iteration=100, iterations=100, in_control=True)
    state, _ = after(connected(), Received(finished), Asked(START), Received(finished))
    assert state.job.state == "preparing" and state.job.run == "/run"
    state, effects = after(state, Received(Done(), START))
    assert effects == [Send(StatusGet())]
    state, _ = after(state, Received(JobStatus(state="training", run="/run", iteration=1, iterations=9)))
    assert state.job.state == "training"


def test_who_starts_the_backend_is_in_control_and_sees_what_it_does_before_it_has_answered():
    opened = RunOpen(run="/run")
    state, _ = after(READY, Asked(opened), Started("log"), Found("log", 4242), Connected(WELCOME))
    assert why_not(state, "stop") == why_not(state, "shutdown") == ""
    assert why_not(state, "take_control") == "This Blender is in control already"
    told = {"in_control": True, "controller": "Blender"}
    for run, message in (("", "starting: loading torch"), ("/run/", "compiling kernels 3/12")):
        status = JobStatus(state="preparing", run=run, message=message, has_model=True, **told)
        state, _ = after(state, Received(status))
        assert (state.job.state, state.job.run, state.job.message) == ("preparing", "/run", message)
        assert state.job.controller == "Blender" and why_not(state, "stop") == ""
        assert not state.job.has_model  # it is the former run's


def test_a_run_whose_opening_was_stopped_is_no_problem():
    opened = RunOpen(run="/run")
    state, effects = after(connected(), Asked(opened), StopAsked())
    assert Send(TrainStop()) in effects
    stopped = Failure(code="cancelled", message="it was stopped before it was ready")
    state, effects = after(state, Refused(opened, stopped))
    assert problem_of(state) is None and state.beginning is None and effects == [Send(StatusGet())]
    failed, _ = after(connected(), Asked(opened), Refused(opened, replace(stopped, code="file_damaged")))
    assert problem_of(failed) is not None


def test_what_is_told_before_the_answer_says_who_is_in_control():
    watching = replace(WELCOME, in_control=False)
    state, _ = after(READY, Asked(START), Started("log"), Found("log", 4242), Connected(watching))
    assert why_not(state, "stop").startswith("another Blender is in control")
    others = JobStatus(state="finished", run="/old", message="the end", controller="Blender on the left")
    state, _ = after(state, Received(others))
    assert why_not(state, "stop").startswith("Blender on the left is in control")
    assert (state.job.state, state.job.run, state.job.message) == ("preparing", "/run", "")


def test_an_opened_run_brings_its_curves():
    request = RunOpen(run="/run")
    state, effects = after(connected(), Asked(request), Received(Done(), request))
    assert effects == [Send(request), Send(StatusGet()), Send(HistoryGet())]
    opened, _ = after(state, Received(replace(OPEN, monitor={"PSNR": 30.0})), Received(CURVES))
    assert opened.history == CURVES and headline(opened, HERE) == "Trained model open"


def test_a_refused_start_is_shown_and_the_former_job_asked_for():
    state, _ = after(connected(), Asked(START))
    failure = Failure(code="file_missing", message="/data does not exist", hint="Choose another.")
    state, effects = after(state, Refused(START, failure))
    assert problem_of(state).message == "/data does not exist" and effects == [Send(StatusGet())]
    state, _ = after(state, Received(JobStatus(state="idle", in_control=True)))
    assert not state.active and why_not(state, "start", CHOICES) == ""


def test_what_could_not_be_taken_into_the_scene_is_shown_until_it_is_read():
    problem = Problem("the model is no longer in the scene", "Use Light From Here again.")
    state, effects = after(State(), NotTaken(problem))
    assert problem_of(state) == problem and effects == []
    assert problem_of(after(state, Dismissed())[0]) is None


def test_who_does_not_wait_for_a_stop_ends_the_process():
    assert "Stop the training first" in why_not(training(), "end") and after(training(), EndAsked())[1] == []
    state, effects = after(training(), StopAsked())
    assert effects == [Send(TrainStop())] and headline(state) == "Saving and stopping"
    late = JobStatus(state="training", run="/run", iteration=41, iterations=100, in_control=True)
    state, effects = after(state, Received(late))
    assert why_not(state, "end") == ""
    assert after(state, EndAsked())[1] == [KillBackend(4242)]


def test_a_double_click_on_stop_stops_as_one_does():
    state, effects = after(training(), StopAsked(), StopAsked())
    assert KillBackend(4242) not in effects
    assert why_not(state, "stop") == "It is stopping" and why_not(training(), "stop") == ""


def test_a_stop_that_was_heeded_is_over():
    stopped = JobStatus(state="stopped", run="/run", iteration=41, iterations=100, in_control=True)
    state, _ = after(training(), StopAsked(), Received(stopped))
    assert not state.stopping and headline(state) == "Stopped: can be resumed"


def test_a_stop_that_was_refused_can_be_asked_again():
    """Another Blender took control a moment before; the training goes on."""
    refused = Failure(code="not_in_control", message="B steers this backend", hint="Take control.")
    state, _ = after(training(), StopAsked(), Refused(TrainStop(), refused))
    assert problem_of(state).message == "B steers this backend"
    assert headline(state) == "Training" and why_not(state, "stop") == ""


def test_a_backend_that_fails_while_it_starts_says_why():
    """While it loads its packages nothing is known of the training that was asked for, but that is."""
    failure = Failure(code="package_missing", message="No module named 'sympy'", hint="Check the backend.")
    state, _ = after(connected(), Asked(START), Received(JobStatus(state="failed", failure=failure)))
    for ended in (state, after(state, LinkLost("No module named", clean=False))[0]):
        assert ended.job.state == "failed" and ended.job.run == "/run" and not ended.active
        assert problem_of(ended).message == "No module named 'sympy'"
        assert next_step(ended, HERE) == "Check the backend."


@pytest.mark.parametrize("request_", [START, TrainResume(run="/run"), RunOpen(run="/run")])
def test_what_was_asked_for_and_not_begun_is_neither_saved_nor_lost(request_):
    """The process is killed while it loads, or somebody shuts it down before it has taken the request."""
    loading = JobStatus(state="preparing", run="/run", in_control=True)
    asked, _ = after(connected(), Asked(request_))
    begun, _ = after(asked, Received(Done(), request_), Received(loading))
    for state in (asked, begun):
        for clean in (False, True):
            lost, _ = after(state, LinkLost("it was ended by SIGTERM", clean))
            assert lost.job.state == "failed" and "SIGTERM" in problem_of(lost).message
            assert "Nothing that the run had saved is lost" in problem_of(lost).hint
            assert next_step(lost, HERE) == problem_of(lost).hint


def test_a_new_training_that_had_saved_nothing_has_to_start_again():
    state, _ = after(training(has_model=True), LinkLost("the connection broke"))
    assert "saved yet: start again" in problem_of(state).hint


def test_a_backend_of_another_version_is_told_and_left_alone_until_it_is_shut_down():
    """It may be training, for a Blender that was updated since."""
    failure = Failure(
        code="wrong_protocol", message="this backend speaks version 3", hint="It is PhysHDR 0.1.0."
    )
    found = after(READY, Asked(START), Found("/tmp/backend.log", 4242))[0]
    state, _ = after(found, LinkLost(failure.message, refusal=failure))
    assert headline(state, HERE) == "Another version's backend is running"
    assert "speaks version 3" in problem_of(state).message and "PhysHDR 0.1.0" in problem_of(state).hint
    assert "PhysHDR 0.1.0" in next_step(state, HERE) and not state.active
    again, effects = after(state, Found("/tmp/backend.log", 4242), Dismissed(), Asked(START))
    assert effects == [] and "speaks version 3" in problem_of(again).message
    assert "speaks version 3" in why_not(state, "start", CHOICES)
    ended, effects = after(state, Asked(Shutdown()))
    assert effects == [EndBackend(4242)] and headline(ended) == "The backend is ending"  # it may be saving
    ended, effects = after(ended, Found("/tmp/backend.log", 4242), Asked(Shutdown()))
    assert effects == [KillBackend(4242)] and why_not(ended, "shutdown") == "No backend is running"
    gone, _ = after(state, Vanished())
    assert problem_of(gone) is None and after(gone, Asked(START))[1] == [StartBackend()]
    assert after(state, Found("/tmp/backend.log", 4711))[1] == [Connect()]  # another one, perhaps ours


def test_a_process_that_cannot_be_ended_is_named():
    state, _ = after(training(), StopAsked(), NotEnded(4242, "Operation not permitted"))
    assert "4242 cannot be ended: Operation not permitted" in problem_of(state).message


def test_nobody_is_told_of_a_refusal_of_what_nobody_asked_for():
    refused = Refused(WhenClosed(training="stop"), Failure(code="not_in_control", message="A steers"))
    assert problem_of(after(connected(), refused)[0]) is None


def test_a_data_set_of_the_former_file_is_nothing_to_train_on():
    """Its photos were still being prepared when another file was opened, which has chosen none."""
    made = TaskEnded("photos", True, result={"folder": "/former"})
    state, _ = after(READY, TaskStarted("photos", "/log"), FileOpened(), made)
    state, _ = after(state, DatasetChosen(Dataset("/former", ("10 views",))))
    assert "choose one" in next_step(state, Choices(of_file=True))
    assert next_step(state, Choices("/former", "/run", of_file=True)) == "Start the training"


def test_a_backend_that_dies_fails_its_training_and_names_checkpoint_and_log():
    state, _ = after(training(saved_iteration=30), LinkLost("the connection broke"))
    problem = problem_of(state)
    assert state.job.state == "failed" and state.link.status == "off"
    assert "checkpoint of iteration 30" in problem.hint and problem.log == "/tmp/backend.log"
    assert next_step(state, Choices("/data", "/run", True)) == "Resume the training"
    assert why_not(state, "resume", Choices("/data", "/run", True)) == ""


def test_a_backend_that_does_not_answer_can_be_ended_and_is_looked_for_again():
    state, _ = after(training(), LinkLost("it does not answer"))
    assert why_not(state, "shutdown") == ""
    ended, effects = after(state, Asked(Shutdown()))
    assert effects == [KillBackend(4242)] and why_not(ended, "shutdown") == "No backend is running"
    again, effects = after(state, Found("/tmp/backend.log", 4242))
    assert effects == [Connect()] and problem_of(again)  # it is told until there is a connection
    assert problem_of(after(again, Connected(WELCOME), Received(JobStatus(in_control=True)))[0]) is None
    assert why_not(after(state, Vanished())[0], "shutdown") == "No backend is running"


def test_a_dismissed_problem_is_gone_whatever_it_was_and_the_next_one_is_told():
    failed = JobStatus(state="failed", run="/run", failure=Failure(code="x", message="diverged"))
    state, _ = after(training(), Received(failed))
    assert problem_of(state).message == "diverged"
    state, _ = after(state, Dismissed(), Received(failed))
    assert problem_of(state) is None and headline(state) == "Failed"
    again = replace(failed, failure=Failure(code="x", message="diverged again"))
    assert problem_of(after(state, Received(again))[0]).message == "diverged again"
    retried, _ = after(state, Asked(START), Received(Done(), START), Received(failed))
    assert problem_of(retried).message == "diverged"  # the same once more is news
    broken, _ = after(State(), TaskStarted("check", "log"), TaskEnded("check", False, message="no torch"))
    assert problem_of(broken) and problem_of(after(broken, Dismissed())[0]) is None
    lost, _ = after(training(), LinkLost("the connection broke"))
    assert problem_of(lost) and problem_of(after(lost, Dismissed())[0]) is None


def test_a_good_bye_is_no_problem():
    state, _ = after(connected(), Asked(Shutdown()), LinkLost("it said good-bye", clean=True))
    assert problem_of(state) is None and state.link.status == "off"


OPEN = JobStatus(
    state="open", run="/run", data="/data", iteration=100, iterations=100, has_model=True, in_control=True
)
CURVES = History(iterations=(20, 40), losses=(1.0, 0.5))
HERE = Choices(data="/data", out="/run", out_has_run=True, of_file=True)


@pytest.mark.parametrize("state", ["open", "finished", "stopped"])
@pytest.mark.parametrize("how", ["shut down", "idle", "killed", "ended from outside"])
def test_what_a_backend_held_is_gone_with_it(state, how):
    """By the panel's button, by its idle timeout, by kill −9, and where it did not answer."""
    held, _ = after(connected(), Received(replace(OPEN, state=state)), Received(CURVES))
    assert held.job.has_model and why_not(held, "preview", HERE) == why_not(held, "import", HERE) == ""
    events = {
        "shut down": [Asked(Shutdown()), LinkLost("shut down", clean=True)],
        "idle": [LinkLost("nobody was connected", clean=True)],
        "killed": [LinkLost("the connection broke")],
        "ended from outside": [LinkLost("it does not answer"), Dismissed(), Asked(Shutdown()), Vanished()],
    }[how]
    gone, _ = after(held, *events)
    assert gone.job == JobStatus() and gone.history == History() and gone.exported is None
    assert headline(gone, HERE) == ("The backend is gone" if how == "killed" else "Ready")
    assert "no model yet" in why_not(gone, "preview", HERE) and why_not(gone, "open", HERE) == ""
    assert why_not(gone, "import", HERE) == ""  # the file in the run's folder, which stays
    with_data = replace(gone, dataset=Dataset("/data", ("18 views",)))
    assert next_step(with_data, HERE) == "Open the run, or resume its training"


def test_a_training_that_was_saved_as_its_backend_ended_can_be_resumed():
    state, _ = after(training(has_model=True), LinkLost("shut down", clean=True))
    assert (state.job.state, state.job.has_model, state.job.run) == ("stopped", False, "/run")
    assert headline(state, HERE) == "Stopped: can be resumed" and why_not(state, "resume", HERE) == ""
    assert next_step(state, HERE) == "Resume the training, or open the run"
    # Another file does not inherit it.
    assert after(state, FileOpened())[0].job == JobStatus()


def test_a_failure_is_told_until_it_is_read_though_its_backend_is_gone():
    failed = JobStatus(state="failed", run="/run", failure=Failure(code="x", message="diverged"))
    state, _ = after(training(), Received(failed), LinkLost("idle", clean=True))
    assert problem_of(state).message == "diverged" and headline(state) == "Failed"
    read, _ = after(state, Dismissed())
    assert problem_of(read) is None and headline(read) == "Ready"


def test_another_file_has_the_backend_and_nothing_of_the_former_file():
    former, _ = after(connected(), Received(OPEN), Received(CURVES))
    former = replace(
        former,
        dataset=Dataset("/data", ("18 views",)),
        photos=Photos("/photos"),
        prepared=Prepared("/data", "9 of 9 places found"),
        problem=Problem("what was asked for in the former file"),
    )
    assert headline(former, HERE) == "Trained model open"
    state, effects = after(former, FileOpened())
    assert effects == [] and problem_of(state) is None
    assert (state.dataset, state.photos, state.prepared) == (Dataset(), Photos(), Prepared())
    assert state.job == OPEN and state.link == former.link  # the backend has it still
    new = Choices(of_file=True)
    assert headline(state, new) == "Ready" and "data set" in next_step(state, new)
    assert "another run" in why_not(state, "preview", new) and why_not(state, "import", new)
    other = replace(HERE, out="/other", out_has_run=False)
    assert headline(state, other) == "Ready" and "another run" in why_not(state, "preview", other)
    # Back in the former file all is as it was.
    assert headline(state, HERE) == "Trained model open" and why_not(state, "preview", HERE) == ""


def test_a_training_of_another_file_is_named_and_can_be_steered():
    state, _ = after(training(has_model=True), FileOpened())
    other = Choices(data="/data", out="/other", of_file=True)
    assert headline(state, other) == "Training: run" and why_not(state, "stop", other) == ""
    assert why_not(state, "start", other) == "A training is under way"
    assert next_step(state, other) == "Wait for the training of another run, or stop it"


def test_a_folder_beside_a_file_that_is_nowhere_asks_for_saving():
    choices = Choices(data="/data", unsaved="//run", of_file=True)
    for action in ("start", "resume", "open"):
        assert why_not(READY, action, choices) == "Save the .blend first: //run is beside it"
    assert next_step(READY, choices) == "Save the .blend first: //run is beside it"


def test_a_rendered_data_sets_warnings_are_told():
    state, _ = after(READY, TaskStarted("dataset", "log"))
    result = {"folder": "/data", "warnings": ["a light is linked twice"]}
    state, _ = after(state, TaskEnded("dataset", True, result=result))
    assert state.prepared == Prepared("/data", "", ("a light is linked twice",))


#: What synth/ says to who renders the open scene, as far as it names options of its command line.
OF_DATA_SETS = (
    "the exposures … are white: add shorter ones to --exposures",
    "9 of 20 cameras stand behind things: if pictures show walls from within, use a smaller --rig-extent",
    "use a smaller --rig-arc or --rig-distance",
    "add objects, or give --rig-distance",
    "--camera-rig path: the camera 'Camera' stands still over the frames 1 … 250",
    "use the CPU (--device CPU), or choose the GPU in Preferences > System",
    "render without denoising and with more samples (--no-denoise), or use blender.org's Blender",
    "unknown response (--crf) 'x'",
    "'/data/dataset.json' is damaged (no object): delete it, or choose another folder (--out)",
    "cannot write to the output folder '/data': full. Choose another folder (--out)",
    "choose another folder (--out; nothing was changed)",
    "choose another folder (--out), or delete that one (nothing was changed)",
    "--exposures (seconds: EV −3 is 0.125; --evs takes EV): 0 is not within 1e-06 … 1e+06",
    "--lit-views: needs at least one of --train-ambient-levels (or --lit-views 0)",
)


@pytest.mark.parametrize("said", OF_DATA_SETS)
def test_what_a_data_set_says_names_what_the_dialog_has(said):
    running, _ = after(READY, TaskStarted("dataset", "log"))
    failed, _ = after(running, TaskEnded("dataset", False, message=said, hint=said))
    done, _ = after(running, TaskEnded("dataset", True, result={"folder": "/data", "warnings": [said]}))
    for text in (failed.problem.message, failed.problem.hint, *done.prepared.warnings):
        assert text and not re.search("--[a-z]", text)


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("choose another folder (--out), or delete that one", "choose another folder, or delete that one"),
        ("choose another folder (--out; it stays)", "choose another folder (it stays)"),
        ("use the CPU (--device CPU)", "use the CPU ('Device': Processor)"),
        ("--camera-rig path: the camera stands still", "'Camera Animation': the camera stands still"),
        ("'/home/me/a--out/data' is damaged", "'/home/me/a--out/data' is damaged"),
    ],
)
def test_a_data_sets_options_in_the_dialogs_words(said, told):
    assert in_the_dialogs_words(said) == told


def test_a_training_that_is_prepared_can_be_paused():
    preparing = training(state="preparing", iteration=0)
    assert why_not(preparing, "pause") == "" and why_not(preparing, "stop") == ""
    loading, _ = after(connected(), Received(JobStatus(state="preparing", in_control=True)))
    assert why_not(loading, "pause") == "Nothing is training"  # the backend itself, for no run


def test_a_process_that_ends_before_it_can_be_reached_says_its_last_words():
    state, _ = after(READY, Asked(START), Started("/tmp/backend.log"), ProcessEnded(1, "error: no torch"))
    assert "no torch" in problem_of(state).message and state.link.status == "off" and not state.waiting


def test_the_end_of_a_connected_process_is_told_by_the_connection():
    state = training()
    assert transition(state, ProcessEnded(-9)) == (state, ())


def test_curves_grow_with_progress_and_start_anew_with_another_run():
    def progress(iteration, loss, psnr=None, run="/run"):
        monitor = {} if psnr is None else {"PSNR": psnr}
        status = JobStatus(
            state="training", run=run, iteration=iteration, losses={"rec": loss, "unit": 0.5}, monitor=monitor
        )
        return Received(status)

    state, _ = after(connected(), progress(20, 1.0), progress(40, 0.5, 20.0), progress(60, 0.25, 20.0))
    assert state.history == History(
        iterations=(20, 40, 60), losses=(1.5, 1.0, 0.75), psnr_iterations=(40,), psnr=(20.0,)
    )
    state, _ = after(state, progress(20, 2.0, run="/other"))
    assert state.history.iterations == (20,)


def test_only_the_one_in_control_may_steer():
    state = training(in_control=False, controller="Blender on the left")
    assert "Blender on the left" in why_not(state, "stop") and "Blender on the left" in why_not(
        state, "pause"
    )
    assert why_not(state, "take_control") == ""
    assert why_not(training(), "take_control") == "This Blender is in control already"
    # To import what the backend holds it writes a file; where it holds nothing, the run's own is taken.
    watching = training(in_control=False, controller="Blender on the left", has_model=True)
    assert "Blender on the left is in control: take control" in why_not(watching, "import")
    assert why_not(training(has_model=True), "import") == ""
    assert why_not(state, "import", Choices("/data", "/run", True)) == ""
    assert why_not(training(), "pause") == "" and why_not(training(), "continue") == "Nothing is paused"


def test_every_action_has_a_reason_with_no_backend():
    reasons = {
        action: why_not(State(), action)
        for action in (
            "start",
            "resume",
            "pause",
            "continue",
            "stop",
            "open",
            "import",
            "preview",
            "shutdown",
        )
    }
    assert all(reasons.values())
    assert why_not(State(), "install") == ""
    assert "online" in why_not(State(), "install", Choices(online=False))


def test_the_panel_leads_from_nothing_to_a_result():
    """At every step it says what to do next."""
    assert next_step(State(), Choices()) == "Get the trainer, or open a splat"
    assert "data set" in next_step(READY, Choices())
    with_data = replace(READY, dataset=Dataset("/data", ("18 views",)))
    assert next_step(with_data, CHOICES) == "Start the training"
    finished = replace(with_data, job=JobStatus(state="finished"))
    said = []
    for done in range(len(IN_SCENE) + 1):
        chosen = replace(CHOICES, done=frozenset(name for name, *_ in IN_SCENE[:done]))
        said.append(next_step(finished, chosen))
    assert [text.split()[0] for text in said[:-1]] == ["Import", "Look", "Set", "Let", "Export"]
    assert said[-1] == ""


def test_what_is_done_out_of_order_is_not_asked_for_again():
    finished = replace(READY, job=JobStatus(state="finished"), dataset=Dataset("/data", ("18 views",)))
    chosen = replace(CHOICES, done=frozenset({IMPORTED, SET_UP, SHARED}))
    assert next_step(finished, chosen).startswith("Look through")
    assert next_step(finished, replace(chosen, done=chosen.done | {SEEN})).startswith("Let it light")


def test_a_splat_that_was_opened_leads_on_before_a_data_set_is_asked_for():
    assert next_step(READY, Choices(done=frozenset({IMPORTED}))).startswith("Look through")
    everything = frozenset(name for name, *_ in IN_SCENE)
    assert "data set" in next_step(READY, Choices(done=everything))


def test_a_model_without_a_trainer_is_looked_at_and_rendered_before_one_is_installed():
    chosen = Choices(done=frozenset({IMPORTED}))
    assert next_step(State(), chosen).startswith("Look through")
    assert "Get the trainer" in next_step(State(), replace(chosen, done=frozenset({IMPORTED, SEEN, SET_UP})))


def test_a_training_that_was_stopped_early_is_resumed_or_taken_as_it_is():
    stopped = replace(
        READY,
        job=JobStatus(state="stopped", data="/data", run="/run", iteration=50, iterations=2500),
        link=replace(READY.link, status="connected"),
        dataset=Dataset("/data", ("18 views",)),
    )
    assert next_step(stopped, HERE) == "Resume the training, or import what it has learned so far"
    imported = replace(HERE, done=frozenset({IMPORTED}))
    assert next_step(stopped, imported).startswith("Look through")


def test_a_pause_is_asked_for_only_where_there_is_a_connection():
    _, effects = after(training(), Asked(TrainPause()))
    assert effects == [Send(TrainPause())]
