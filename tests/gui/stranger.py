# SPDX-License-Identifier: GPL-3.0-or-later
"""A stranger's .blend in a real window: nothing that it names is looked at before the button is pressed."""

import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(1, str(Path(__file__).resolve().parents[1] / "stress"))

import bpy
from driver import Window, drive
from torture_attacks.watch import COMPUTER, NETWORK, watched

#: Looks of the session's timer, which are a second apart.
LOOKS = 4.0


def test(window: Window) -> Iterator[float]:
    yield from window.open()
    yield from window.checked()
    data, photos, file = Path.home() / "room", Path.home() / "photos", Path.home() / "stranger.blend"
    photos.mkdir()
    chosen = bpy.context.scene.physhdr
    with window.module("addon.settings").respelling():  # as a stranger's file has them
        chosen.data, chosen.photos, chosen.out = str(data), str(photos), f"{NETWORK}\\run"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    with watched(str(data), str(photos), COMPUTER) as found:
        bpy.ops.wm.open_mainfile(filepath=str(file))
        yield from window.redrawn()
        yield LOOKS
        yield from window.redrawn()
    window.screenshot("1_not_looked_at")
    state = window.session.state
    assert found == [] and not state.tasks and not state.dataset.folder, (found, state)

    with watched(COMPUTER) as found:
        with window.override():
            bpy.ops.physhdr.outside_look("INVOKE_DEFAULT")
        yield from window.until(lambda: window.session.state.dataset.lines, 20, "looked at")
        yield from window.until(lambda: window.session.state.photos.folder, 20, "photos looked at")
        yield from window.redrawn()
    window.screenshot("2_looked_at")
    assert [line for line in found if COMPUTER in line] == []
    yield from window.until(lambda: not window.session.state.tasks, 60, "done with the photos")


drive(test)
