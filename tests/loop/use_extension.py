# SPDX-License-Identifier: GPL-3.0-or-later
"""What a user does with the extension, as a script: run inside Blender by test_extension.py.

The zip is installed, and through it the trainer; a training is started, paused, continued, killed in the
middle, found dead, resumed; its result is imported and rendered relit. What was seen goes to OUT/seen.json
for the test to judge.
"""

import argparse
import importlib
import json
import os
import signal
import sys
import time
from pathlib import Path

import bpy

EXTENSION = "bl_ext.user_default.physhdr"


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    for name in ("zip", "python", "data", "out"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    parser.add_argument("--iterations", type=int, required=True)
    parser.add_argument("--size", type=int, required=True)
    return parser.parse_args(sys.argv[sys.argv.index("--") + 1 :])


def install(path: Path) -> None:
    bpy.ops.extensions.package_install_files(filepath=str(path), repo="user_default", enable_on_install=True)


def module(name: str):
    return importlib.import_module(f"{EXTENSION}.addon.{name}")


def main() -> None:
    options = arguments()
    seen: dict = {}
    install(options.zip)
    ops = bpy.ops.physhdr
    session = module("runtime").session()
    seen["operators"] = sorted(dir(ops))
    seen["torch"] = "torch" in sys.modules
    seen["start_without_backend"] = ops.train_start.poll()

    # A Python with no torch is found out, with the reason.
    seen["wrong_python"] = attempt(lambda: ops.backend_use(filepath=sys.executable))
    seen["install_offline"] = ops.backend_install.poll()
    bpy.context.preferences.system.use_online_access = True
    ops.backend_install(python=str(options.python), torch="pip")
    seen["report"] = session.state.backend.report
    seen["python"] = session.state.backend.python
    ops.backend_check()

    run = options.out / "run"
    bpy.context.scene.physhdr.data = str(options.data)
    session.wait(lambda state: bool(state.dataset.lines), 60.0)
    seen["dataset"] = list(session.state.dataset.lines)
    bpy.context.scene.physhdr.out = str(run)
    seen["missing_data"] = attempt(lambda: ops.train_start(data="/no/such/folder"))

    ops.train_start(iterations=options.iterations, wait=False)
    wait("iteration", iteration=20)
    ops.train_pause()
    wait("paused")
    paused_at = session.state.job.iteration
    ops.wait(until="seconds", seconds=1.0)
    seen["went_on_while_paused"] = session.state.job.iteration - paused_at
    seen["poll_while_paused"] = [ops.train_pause.poll(), ops.train_continue.poll(), ops.train_start.poll()]
    ops.train_continue()
    wait("iteration", iteration=paused_at + 20)
    ops.train_stop()
    wait("ended")
    seen["stopped"] = [session.state.job.state, session.state.job.iteration]

    # A backend that hangs: noticed by its heartbeat, ended from the panel.
    hung = session.state.link.welcome.pid
    begun = time.monotonic()
    os.kill(hung, signal.SIGSTOP)
    wait("gone")
    seen["hang_noticed_after"] = time.monotonic() - begun
    ops.backend_shutdown()
    ops.wait(until="seconds", seconds=0.5)
    seen["hung_is_alive"] = module("session.process").is_alive(hung)

    # kill −9 in the middle: noticed, told with the log and the checkpoint, resumed.
    ops.train_resume(wait=False)
    wait("iteration", iteration=session.state.job.iteration + 20)
    pid = session.state.link.welcome.pid
    begun = time.monotonic()
    os.kill(pid, signal.SIGKILL)
    wait("gone")
    seen["noticed_after"] = time.monotonic() - begun
    problem = module("session.advice").problem_of(session.state)
    seen["killed"] = [session.state.job.state, problem.message, problem.hint, problem.log]
    # A Blender that starts while the training runs finds it, and goes on steering it.
    ops.train_resume(wait=False)
    wait("iteration", iteration=session.state.job.iteration + 20)
    bpy.ops.preferences.addon_disable(module=EXTENSION)
    seen["off"] = hasattr(bpy.types.Scene, "physhdr")
    bpy.ops.preferences.addon_enable(module=EXTENSION)
    session = module("runtime").session()
    wait("connected")
    wait("iteration", iteration=1)
    seen["found_again"] = [session.state.job.state, session.state.job.in_control]
    wait("ended")
    job = session.state.job
    seen["finished"] = [job.state, job.iteration, job.gaussians]
    seen["history"] = len(session.state.history.iterations)

    ops.result_import(name="result")
    target = bpy.data.objects["result"]
    seen["imported"] = len(target.data.points)
    render(options, target)
    log = session.state.link.log
    seen["log"] = log
    ops.log_open(filepath=log)
    ops.backend_shutdown()
    wait("gone")
    seen["after_shutdown"] = module("session.advice").problem_of(session.state) is None

    # Off and on again, twice: nothing is left behind, and everything comes back.
    for _ in range(2):
        bpy.ops.preferences.addon_disable(module=EXTENSION)
        seen["off"] |= hasattr(bpy.types.Scene, "physhdr")
        bpy.ops.preferences.addon_enable(module=EXTENSION)
    seen["on"] = hasattr(bpy.types.Scene, "physhdr")
    (options.out / "seen.json").write_text(json.dumps(seen))


def wait(until: str, **values) -> None:
    result = bpy.ops.physhdr.wait(until=until, seconds=180.0, **values)
    assert result == {"FINISHED"}, f"not {until}: {module('runtime').session().state}"


def attempt(action) -> str:
    """The error that an operator reports."""
    try:
        action()
    except RuntimeError as error:
        return str(error)
    return ""


def render(options: argparse.Namespace, target: bpy.types.Object) -> None:
    """The imported Gaussians at level 4 from the first test camera, as Cycles draws them."""
    nodes, drawing, cameras = module("model.nodes"), module("rendering.render"), module("layouts.cameras")
    scene = bpy.context.scene
    pose = cameras.read_pose(options.data / "transforms_test.json", 0)
    for other in [other for other in scene.objects if other != target]:
        bpy.data.objects.remove(other)
    drawing.prepare_cycles(scene)
    drawing.set_resolution(scene, options.size, options.size)
    drawing.add_camera(scene, pose.camera_to_world, pose.angle_x)
    modifier = target.modifiers[nodes.MODIFIER_NAME]
    nodes.set_input(modifier, nodes.CAMERA_SPLATS, True)
    nodes.set_input(modifier, nodes.IMAGE_WIDTH, options.size)
    nodes.set_input(modifier, nodes.LIGHTING_LEVEL, 4.0)
    drawing.render_exr(scene, options.out / "relit.exr")


main()
