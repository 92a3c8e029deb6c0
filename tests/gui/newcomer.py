# SPDX-License-Identifier: GPL-3.0-or-later
"""A newcomer's first half hour by mouse and keys: from a fresh profile to a relit F12, once of photographs
and once of Blender's default cube with two lamps. Clicks, scrolled screens, boxes and warnings are counted;
OUT/newcomer.md is the table.

Buttons are found as a person finds them, by looking over the sidebar from its top: over each thing that may
be a button Blender is asked by Ctrl+C what it would do. What no newcomer does is left out: the trainer is
there already (its two clicks are counted, as is the one on the tab), and rendering and training are short.
"""

import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
import numpy as np
from driver import Window, drive, slowness
from photos import ROOM, TAKE_PHOTOS

#: Codes by which text differs from its background.
WORDS = 40
#: Until something can be seen.
ITERATIONS = 150
#: Pixels from one look down the sidebar to the next, half a button.
LOOK = 10
#: Where in a row buttons are looked for, of its width: one alone, or two side by side.
ACROSS = (0.3, 0.62)
#: Seconds in which an idle Blender reacts to the mouse or a key.
HAND_SECONDS = 0.12
#: An answer that came late is another place's: so many places before it are asked again, patiently.
LATE_PLACES, LATE_SECONDS = 5, 0.6
#: Where the file browser is put, on the screen.
BROWSER = 100, 60
#: Screens that are scrolled before a button counts as not there, and notches of the wheel for one.
SCREENS, NOTCHES = 4, 12
#: The goal, beside typing folders.
CLICKS_AT_MOST = 12
#: Of the default scene's data set, small: views, pixels, samples.
VIEWS, LIT_VIEWS, WIDTH, SAMPLES = 8, 2, 96, 8
#: The key's code: by its name xdotool would press Ctrl and Alt as well, which is another operator.
F12 = 96
#: Of F12, with EEVEE; processors draw it here.
RENDER_SAMPLES = 16


@dataclass
class Counted:
    """What a way took. ``warnings``: the sentences; ``steps``: what was clicked."""

    clicks: int = 0
    screens: int = 0
    boxes: int = 0
    warnings: dict[str, None] = field(default_factory=dict)
    steps: list[str] = field(default_factory=list)

    @property
    def row(self) -> str:
        return f"{self.clicks} | {self.screens} | {self.boxes} | {len(self.warnings)}"


class Newcomer:
    """A hand and an eye: clicks what is seen in the sidebar, and keeps count."""

    def __init__(self, window: Window) -> None:
        self.window = window
        self.counted = Counted()

    @property
    def sidebar(self) -> bpy.types.Region:
        return next(region for region in self.window.area.regions if region.type == "UI")

    def press(self, operator: str, what: str) -> Iterator[float]:
        """``yield from``: the button of ``operator`` was found and clicked."""
        place = yield from self._found(operator)
        self.click(*place, what)
        yield HAND_SECONDS

    def click(self, column: int, row: int, what: str) -> None:
        self.counted.clicks += 1
        self.counted.steps.append(what)
        hand("mousemove", column - 2, row, "sleep", 0.3, "mousemove", column, row, "sleep", 0.3)
        hand("mousedown", 1, "sleep", 0.1, "mouseup", 1)

    def set(self, path: str, value: float, what: str) -> Iterator[float]:
        """``yield from``: the slider of a property's path was found, and a number typed into it."""
        column, row = yield from self._found(path)
        self.counted.clicks += 1
        self.counted.steps.append(what)
        # A person double-clicks between a slider's arrows, whose places Blender does not tell; Return does
        # the same.
        hand("mousemove", column, row, "sleep", 0.3, "key", "Return")
        yield 0.5
        hand("key", "ctrl+a")
        hand("type", value)
        hand("key", "Return")
        yield HAND_SECONDS

    def shot(self, name: str) -> Iterator[float]:
        """``yield from``: a screenshot; what is warned of now is noted."""
        yield from self.window.redrawn()
        self.window.screenshot(name)
        session, scene = self.window.session, bpy.context.scene
        problem = self.window.module("addon.session.advice").problem_of(session.state)
        problems = self.window.module("addon.rendering.render_setup").render_problems(scene)
        said = [problem.message] if problem else []
        said += [*session.state.dataset.warnings, *session.state.photos.warnings]
        self.counted.warnings |= dict.fromkeys([*said, *(each.text for each in problems)])
        if bpy.app.autoexec_fail:
            self.counted.boxes += 1

    def _found(self, wanted: str) -> Iterator[float]:
        """``yield from``: where on the screen the button is that does ``wanted``, scrolled to if need be."""
        for _ in range(SCREENS):
            yield from self.window.redrawn()
            places = self._buttons()
            for index, (column, row) in enumerate(places):
                seconds = HAND_SECONDS * max(1.0, slowness() / 3.0)
                if wanted not in (yield from self._asked(column, row, wanted, seconds)):
                    continue
                for place in places[max(0, index - LATE_PLACES) : index + 1]:
                    if wanted in (yield from self._asked(*place, wanted, LATE_SECONDS)):
                        return place
            self.counted.screens += 1
            region = self.sidebar
            column, row = self._on_screen(region, 0.5, 0.5)
            hand("mousemove", column, row, "sleep", 0.1, "click", "--repeat", NOTCHES, "--delay", 30, 5)
            yield HAND_SECONDS
        self.window.screenshot(f"no_{wanted.rpartition('.')[2]}")
        raise AssertionError(f"{wanted} is not to be found in {SCREENS} screens")

    def _buttons(self) -> list[tuple[int, int]]:
        """Columns and rows of the sidebar where there is anything, from its top."""
        region, pixels = self.sidebar, self.window.grab_pixels().astype(int)
        top, bottom = (self._on_screen(region, 0.5, y)[1] for y in (1.0, 0.0))
        places = []
        for row in range(top + LOOK, bottom - LOOK, LOOK):
            columns = [self._on_screen(region, across, 0.5)[0] for across in ACROSS]
            around = pixels[row - 2 : row + 3, columns[0] : columns[-1]]
            if np.ptp(around, axis=(0, 1)).max() > WORDS:
                places += [(column, row) for column in columns]
        return places

    def _asked(self, column: int, row: int, wanted: str, seconds: float) -> Iterator[float]:
        """``yield from``: what Blender says is under the mouse there: an operator's call, or a path."""
        manager = bpy.context.window_manager
        manager.clipboard = ""
        hand("mousemove", column, row)
        yield seconds
        hand("key", "ctrl+c" if wanted.startswith("physhdr.") else "ctrl+shift+alt+c")
        yield seconds
        return manager.clipboard

    def _on_screen(self, region: bpy.types.Region, x: float, y: float) -> tuple[int, int]:
        height = bpy.context.window_manager.windows[0].height
        tabs = 30  # of the sidebar's width, on its right
        return round(region.x + x * (region.width - tabs)), round(height - region.y - y * region.height)


def hand(*words: object) -> None:
    subprocess.run(["xdotool", *map(str, words)], check=True)


def test(window: Window) -> Iterator[float]:
    window.install()
    yield from window.redrawn()
    ways = {"photographs": Newcomer(window), "the default cube and two lamps": Newcomer(window)}
    failed = []
    for way, walk in zip(ways.values(), (from_photos, from_scene), strict=True):
        try:
            yield from walk(way)
        except Exception:  # noqa: BLE001 (the table says how far the other way went)
            way.window.screenshot(f"lost_{len(way.counted.steps)}")
            failed.append(traceback.format_exc())
            way.counted.steps.append("lost here")
    lines = ["| from | clicks | screens scrolled | boxes | warnings |", "|---|---|---|---|---|"]
    lines += [f"| {name} | {way.counted.row} |" for name, way in ways.items()]
    for name, way in ways.items():
        lines += ["", f"{name}: {'; '.join(way.counted.steps)}."]
        lines += [f"- warned: {text}" for text in way.counted.warnings]
    (window.options.out / "newcomer.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert not failed, "\n".join(failed)
    for each in ways.values():
        counted = each.counted
        assert counted.boxes == counted.screens == 0 and counted.clicks <= CLICKS_AT_MOST, "\n".join(lines)


def from_photos(way: Newcomer) -> Iterator[float]:
    """``yield from``: photographs are prepared, trained on, relit and rendered."""
    window, session = way.window, way.window.session
    photos, settings = Path.home() / "holiday", bpy.context.scene.physhdr
    subprocess.run([window.options.python, "-c", TAKE_PHOTOS, ROOM, photos], check=True)
    yield from first_screen(way)
    yield from way.shot("1_first_screen")
    yield from way.press("physhdr.photos_look", "Prepare Photos")
    yield from typed_folder(way, photos)
    yield from window.until(lambda: session.state.photos.lines, 120, "looked at")
    yield from way.shot("2_understood")
    yield from way.press("physhdr.photos_prepare", "Prepare")
    yield from window.until(lambda: settings.data, 300, "prepared")
    yield from trained(way, "photos")
    yield from relit(way, "photos")


def from_scene(way: Newcomer) -> Iterator[float]:
    """``yield from``: Blender's own default scene, with two lamps more, is photographed, trained on, relit
    and rendered."""
    window, session = way.window, way.window.session
    yield from window.shut_down()
    bpy.ops.wm.read_homefile()
    yield from window.redrawn()
    for place in ((-3.0, -2.0, 3.0), (2.5, 3.0, 4.0)):
        bpy.ops.object.light_add(type="POINT", location=place)
        bpy.context.object.data.energy = 300.0
    made = window.module("addon.dataset.dataset_settings").settings_of(bpy.context.scene)
    made.views, made.lit_views, made.relit_views = VIEWS, LIT_VIEWS, 0
    made.resolution_x, made.samples = WIDTH, SAMPLES
    yield from first_screen(way)
    yield from way.press("physhdr.dataset_render", "Render from This Scene")
    yield from window.until(lambda: made.out, 30, "opened")
    yield from window.still()
    window.screenshot("scene_dialog")
    way.counted.clicks += 1
    way.counted.steps.append("Render")
    hand("key", "Return")
    yield from window.until(lambda: session.state.task("dataset") is not None, 30, "begun")
    yield from window.until(lambda: bpy.context.scene.physhdr.data, 600, "rendered")
    yield from trained(way, "scene")
    if window.module("addon.capture.originals").is_offered(bpy.context.scene):
        yield from way.press("physhdr.originals_hide", "Hide Originals")
    yield from relit(way, "scene")


def first_screen(way: Newcomer) -> Iterator[float]:
    """``yield from``: the tab PhysHDR, with a trainer."""
    yield from way.window.point(0.5, 0.5)
    hand("key", "n")
    yield from way.window.redrawn()
    way.window.show_tab()
    way.counted.clicks += 3
    way.counted.steps += ["the tab PhysHDR", "Get the Trainer", "its dialog"]


def trained(way: Newcomer, name: str) -> Iterator[float]:
    """``yield from``: the data set that is chosen was trained on for a moment, and its model is imported."""
    window, session, settings = way.window, way.window.session, bpy.context.scene.physhdr
    yield from window.until(lambda: session.state.dataset.lines, 30, "summarised")
    settings.iterations = ITERATIONS
    yield from way.shot(f"{name}_3_prepared")
    yield from way.press("physhdr.train_start", "Start")
    yield from window.until(lambda: session.state.active, 60, "begun")
    yield from window.until(lambda: session.state.job.state == "training", 300, "training")
    yield from way.shot(f"{name}_4_training")
    yield from window.until(lambda: session.state.job.state == "finished", 600, "trained")
    yield from way.shot(f"{name}_5_trained")
    yield from way.press("physhdr.result_import", "Import Result")
    yield from window.until(lambda: is_model(window), 60, "imported")
    yield from window.drawn()
    yield from way.shot(f"{name}_6_first_look")


def relit(way: Newcomer, name: str) -> Iterator[float]:
    """``yield from``: the active model is brighter lit, set up to render, and rendered by F12."""
    window, scene = way.window, bpy.context.scene
    nodes = window.module("addon.model.nodes")
    problems = window.module("addon.rendering.render_setup").render_problems
    if name == "photos":  # Blender's camera stands anywhere
        yield from way.press("physhdr.look_through", "Look Through")
        yield from window.drawn()
    modifier = nodes.find_modifier(bpy.context.object)
    socket = nodes.input_identifier(modifier, nodes.LIGHTING_LEVEL)
    yield from way.set(socket, 2, "Lighting Level")
    yield from window.until(lambda: nodes.get_input(modifier, nodes.LIGHTING_LEVEL) == 2.0, 10, "relit")
    yield from window.drawn()
    yield from way.shot(f"{name}_7_relit")
    if problems(scene):
        yield from way.press("physhdr.render_setup", "Set Up Render")
        yield from window.until(lambda: not problems(scene), 30, "set up")
    scene.render.resolution_percentage, scene.eevee.taa_render_samples = 25, RENDER_SAMPLES
    rendered: list[bool] = []
    bpy.app.handlers.render_complete.append(lambda *_: rendered.append(True))
    yield from window.point(0.4, 0.5)
    hand("key", F12)
    yield from window.until(lambda: rendered, 300, "rendered")
    yield from window.still()
    window.screenshot(f"{name}_8_rendered")
    hand("key", "Escape")
    yield from window.still()


def is_model(window: Window) -> bool:
    return window.module("addon.model.look").is_model(bpy.context.object)


def typed_folder(way: Newcomer, folder: Path) -> Iterator[float]:
    """``yield from``: in the file browser, a window of its own, the folder was typed, and chosen."""
    manager = bpy.context.window_manager
    browsers: Callable[[], list] = lambda: [  # noqa: E731
        (window, area)
        for window in manager.windows
        for area in window.screen.areas
        if area.type == "FILE_BROWSER"
    ]
    yield from way.window.until(lambda: bool(browsers()), 30, "opened")
    yield from way.window.still()
    ((browser, area),) = browsers()
    # Nobody manages windows here: a new one may be partly off the screen.
    found = subprocess.run(
        ["xdotool", "search", "--onlyvisible", "--name", "Blender File"],
        capture_output=True,
        text=True,
        check=True,
    )
    hand("windowmove", found.stdout.split()[-1], *BROWSER)
    yield from way.window.still()
    way.window.screenshot("file_browser")
    line = next(region for region in area.regions if region.type == "UI")
    column = BROWSER[0] + line.x + round(0.4 * line.width)
    row = BROWSER[1] + browser.height - line.y - line.height // 2
    hand("mousemove", column, row, "sleep", 0.5, "click", "--repeat", 2, "--delay", 80, 1)
    yield 1.0
    hand("key", "ctrl+a")
    hand("type", "--delay", 30, f"{folder}/")

    def is_there() -> bool:
        return Path(area.spaces.active.params.directory.decode()) == folder

    for _ in range(3):  # the first may only end what is offered to complete it
        yield 1.5
        if is_there():
            break
        hand("key", "Return")
    yield from way.window.until(is_there, 5, "typed")
    yield from way.window.still()
    done = next(region for region in area.regions if region.type == "EXECUTE")
    column = BROWSER[0] + done.x + round(0.91 * done.width)
    row = BROWSER[1] + browser.height - done.y - done.height // 2
    way.click(column, row, "the folder")
    yield 2.0
    if browsers():  # a line that is still being typed in takes the first click
        hand("click", 1)
    yield from way.window.until(lambda: not browsers(), 10, "closed")


if __name__ == "__main__":
    drive(test)
