# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panels show in each state: no text is cut at the sidebar's default width, nothing jumps, and the
words are an artist's.

Panels draw onto a layout that keeps what is put on it, with the room that Blender would give each text.
"""

from dataclasses import replace
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon import plot, runtime, settings  # noqa: E402
from physhdr.addon.capture import originals  # noqa: E402
from physhdr.addon.model import origin  # noqa: E402
from physhdr.addon.panels import backend, dataset, parts, status, status_bar, training  # noqa: E402
from physhdr.addon.panels.capture import PHYSHDR_PT_capture, PHYSHDR_PT_capture_behind  # noqa: E402
from physhdr.addon.panels.cleaning import PHYSHDR_PT_cleaning  # noqa: E402
from physhdr.addon.panels.lighting import PHYSHDR_PT_light  # noqa: E402
from physhdr.addon.panels.model import PHYSHDR_PT_look, PHYSHDR_PT_model  # noqa: E402
from physhdr.addon.panels.render import (  # noqa: E402
    PHYSHDR_PT_render,
    PHYSHDR_PT_render_properties,
)
from physhdr.addon.panels.scale import PHYSHDR_PT_scale  # noqa: E402
from physhdr.addon.panels.status import PHYSHDR_PT_status  # noqa: E402
from physhdr.addon.session import tasks  # noqa: E402
from physhdr.addon.session.state import (  # noqa: E402
    Backend,
    Dataset,
    Link,
    Made,
    Pace,
    Photos,
    Problem,
    Running,
    State,
)
from physhdr.addon.session.tasks import TASKS  # noqa: E402
from physhdr.bridge.messages import Failure, History, JobStatus, Welcome  # noqa: E402

#: Of Blender's sidebar as it comes, and of a text button beside its text, an enumeration's arrow, an icon.
WIDTH, PADDING, ARROW, ICON = 280, 12, 16, 22
#: Of a row that is split into label and value.
LABEL_SHARE = 0.4
PANELS = (PHYSHDR_PT_status, PHYSHDR_PT_capture, PHYSHDR_PT_model)
#: Words that an artist has no use for.
JARGON = ("exp1", "exp3", "first points", "anchor", "Gaussians", "PSNR 3")


class Layout:
    """Keeps what is drawn: ``kept`` has (kind, text, room, icon, name, enabled) in order, down the panel."""

    def __init__(self, room, root=None, row=None):
        self.__dict__.update(
            room=room, root=root or self, kept=[], rows=0, parent=row, cells=[], use_property_split=False
        )
        self.__dict__.update(enabled=True, heading="", scale_y=1.0)

    def __setattr__(self, name, value):
        self.__dict__[name] = value

    def child(self, is_row=False, **more):
        made = Layout(self.room, self.root, self if is_row else None)
        made.is_row, made.use_property_split = is_row, self.use_property_split
        made.enabled, made.above = self.enabled, self
        made.heading = more.get("heading", "")
        self.cells.append(made)
        return made

    def split(self, factor=0.5, **more):
        made = self.child(True, **more)
        made.factor = factor
        return made

    def row(self, **more):
        return self.child(True, **more)

    def column(self, **more):
        return self.child(False, **more)

    def box(self):
        made = self.child()
        made.room -= 14
        return made

    def panel(self, idname, default_closed=False):
        return self.row(), self.column() if self.unfold or not default_closed else None

    def panel_prop(self, data, name):
        return self.row(), self.column() if getattr(data, name) else None

    def separator(self, **_):
        pass

    def label(self, text="", icon="NONE"):
        self.put("label", text, icon)

    def operator(self, name, text=None, icon="NONE", **_):
        self.put("operator", name if text is None else text, icon, name)
        return SimpleNamespace()

    def menu(self, name, text="", icon="NONE"):
        self.put("menu", text, icon, name)

    def operator_menu_enum(self, name, of, text="", icon="NONE"):
        self.put("menu", text, icon, name)

    def progress(self, factor=0.0, text=""):
        self.put("progress", text, "NONE")

    def template_icon(self, number, scale=1.0):
        self.put("picture", "", "NONE", scale=scale)

    def prop_enum(self, data, name, value, text=None, icon="NONE"):
        found = data.bl_rna.properties[name].enum_items[value].name
        self.put("button", found if text is None else text, icon, name)

    def prop(self, data, name, text=None, icon="NONE", toggle=False, placeholder="", **_):
        found = data.bl_rna.properties[name]
        shown = found.name if text is None else text
        if toggle:
            self.put("button", shown, icon, name)
            return
        if found.type == "BOOLEAN":
            self.put("switch", shown, icon, name)
            return
        self.put("value", shown, icon, name)
        if found.type == "ENUM":
            for item in found.enum_items:
                self.put("choice", item.name, "NONE", name)

    def put(self, kind, text, icon, name="", scale=1.0):
        self.cells.append((kind, text, icon, name, self.is_enabled, self.use_property_split, scale))

    @property
    def scale(self):
        return self.scale_y * (self.above.scale if "above" in self.__dict__ else 1.0)

    @property
    def is_enabled(self):
        here, found = self, True
        while here is not None:
            found = found and here.enabled
            here = here.__dict__.get("above")
        return found


Layout.is_row, Layout.factor, Layout.unfold = False, 0.0, False


def texts(layout, room=None):
    """(kind, text, pixels it may have, name, enabled) of everything drawn, by the width that rows share."""
    room = layout.room if room is None else room
    shown = [cell for cell in layout.cells if isinstance(cell, Layout) or cell[0] != "choice"]
    wide = [cell for cell in shown if isinstance(cell, Layout) or cell[1]]
    narrow = len(shown) - len(wide)
    each = (room - narrow * ICON) / max(len(wide), 1) if layout.is_row else room
    if layout.heading:
        yield "label", layout.heading, LABEL_SHARE * room, "", True
        each = (1.0 - LABEL_SHARE) * room - narrow * ICON
    for index, cell in enumerate(layout.cells):
        if layout.factor:
            each = room * (1.0 - layout.factor if index else layout.factor)
        if isinstance(cell, Layout):
            yield from texts(cell, each)
            continue
        kind, text, icon, name, enabled, split, _ = cell
        free = each - (ICON if icon != "NONE" else 0)
        free -= PADDING if kind in ("operator", "menu", "button", "progress") else 0
        if kind == "value" and split:
            free = LABEL_SHARE * room
        if kind == "switch":
            # Beside its box, and the dot of a keyframe.
            free = (1.0 - LABEL_SHARE) * room - 2 * ICON if split else each - ICON
        if kind == "choice":
            free = ((1.0 - LABEL_SHARE) * room if split else room) - ARROW - PADDING
        yield kind, text, free, name, enabled


def height(cells):
    """Rows that it takes, in order: where each operator's button is."""
    places, at = {}, 0.0

    def walk(layout):
        nonlocal at
        here = at
        highest = here
        for cell in layout.cells:
            if layout.is_row:
                at = here
            if isinstance(cell, Layout):
                walk(cell)
            elif cell[0] != "choice":
                places.setdefault((cell[0], cell[3] or cell[1]), (at, cell[4]))
                at += cell[6] * layout.scale
            highest = max(highest, at)
        at = highest

    walk(cells)
    return places, at


def draw(panel, state=None):
    """The layout on which a panel was drawn, or a part of one (a module), and what was asked of it."""
    if state is not None:
        runtime.session().state = state
    context = SimpleNamespace(
        scene=bpy.context.scene,
        preferences=bpy.context.preferences,
        object=bpy.context.view_layer.objects.active,
        selected_objects=(),
        view_layer=bpy.context.view_layer,
        region=SimpleNamespace(width=WIDTH),
        space_data=SimpleNamespace(
            region_3d=SimpleNamespace(is_perspective=True),
            shading=SimpleNamespace(type="SOLID"),
            overlay=SimpleNamespace(show_overlays=True),
        ),
    )
    layout = Layout(WIDTH - parts.FRAME)
    if isinstance(panel, ModuleType):
        panel.draw(context, layout, runtime.session().state)
    else:
        if hasattr(panel, "draw_header"):
            panel.draw_header(SimpleNamespace(layout=layout.row()), context)
        panel.draw(SimpleNamespace(layout=layout), context)
    return layout


@pytest.fixture
def chosen(registered, tmp_path, monkeypatch):
    """The scene's settings with a data set chosen, in a Blender whose sidebar has its default width."""
    region = SimpleNamespace(width=WIDTH)
    monkeypatch.setattr(parts, "room", lambda context: region.width - parts.FRAME)
    folder = tmp_path / "kitchen"
    folder.mkdir()
    registered.physhdr.data = str(folder)
    plot.update(History())
    return registered.physhdr


LIGHTS = ("ambient", "pendant lamp", "window")
WELCOME = Welcome(
    protocol=2,
    version="",
    pid=29444,
    log="/tmp/log",
    device="cpu",
    torch="2.13.0",
    presets=(),
    in_control=True,
)


def states(data):
    """The states of a session, by name."""
    report = {"versions": {"torch": "2.13.0+cpu", "numba": "0.68.1"}, "device": "cpu", "missing": []}
    ready = State(
        backend=Backend("/home/somebody/.config/blender/5.2/extensions/backend/bin/python", report),
        link=Link("connected", replace(WELCOME, version=runtime.session().version), pid=29444),
        job=JobStatus(in_control=True),
        dataset=Dataset(
            data,
            (
                "interior: 18 training views, 17 test, 12 under other light, 200 × 200",
                "5 exposures: EV -3, -1, +1, +3, +5",
                "Dynamic range: 15.2 stops (measured)",
            ),
        ),
    )
    job = JobStatus(
        state="training",
        run=f"{data}_run",
        data=data,
        preset="default",
        iteration=1234,
        iterations=25000,
        gaussians=1_160_000,
        iterations_per_second=14.5,
        seconds_left=5000.0,
        losses={"rec": 0.0134},
        monitor={"PSNR": 33.81},
        has_model=True,
        can_relight=True,
        lights=LIGHTS,
        in_control=True,
    )
    curves = History(iterations=(20, 40), losses=(1.0, 0.5))
    message = "pictures are used as they are, 0.04 megapixels: 2,500 iterations, at most 60,000 Gaussians"
    failure = Failure(
        code="backend_gone",
        message="The backend is gone: the connection broke",
        hint="Resume continues from the checkpoint of iteration 841.",
    )
    return {
        "nothing": State(),
        "installing": State(
            tasks=(Running("install", "log", 0.4, "downloading torch-2.13.0 (200 MB)", 90.0),)
        ),
        "checking": State(
            tasks=(Running("check", "log", 0.4, "compiling kernels 3/14: response curves, elu"),)
        ),
        "broken": State(
            backend=Backend("/usr/bin/python3", problem=Problem("no module torch", "Install it"))
        ),
        "ready": replace(ready, link=Link()),
        "warned": replace(
            ready,
            dataset=replace(ready.dataset, warnings=("There is no test split: quality is not measured.",)),
        ),
        "photos": replace(
            ready,
            photos=Photos(
                "/photos",
                lines=(
                    "27 photos, 400 × 300",
                    "9 exposures: 1/1250 s to 1/8 s, 4.0 stops, found by their names",
                ),
                warnings=("Left out: IMG_20260712_181502.jpg, it is not of the others' size",),
                seconds=75.0,
            ),
        ),
        "rendering": replace(ready, tasks=(Running("dataset", "log", 0.4, "view 12 of 40", 90.0),)),
        "preparing": replace(ready, job=replace(job, state="preparing", message=message, iteration=0)),
        "training": replace(ready, job=job, history=curves),
        "paused": replace(ready, job=replace(job, state="paused"), history=curves),
        "stopping": replace(ready, job=replace(job, state="stopping"), history=curves, stopping=True),
        "stopped": replace(ready, job=replace(job, state="stopped"), history=curves),
        "finished": replace(ready, job=replace(job, state="finished", iteration=25000), history=curves),
        "failed": replace(ready, job=replace(job, state="failed", failure=failure, has_model=False)),
        "open": replace(ready, job=replace(job, state="open"), history=curves),
        "others": replace(
            ready, job=replace(job, in_control=False, controller="Blender 5.2.2 (kitchen.blend)")
        ),
    }


NAMES = list(states("/data"))


@pytest.mark.parametrize("name", NAMES)
def test_no_text_is_cut_at_the_default_width(chosen, name, tmp_path, monkeypatch):
    """By the widths that Blender's own font has; and no word that only the trainer's authors know."""
    monkeypatch.setattr(Layout, "unfold", True)
    state = states(chosen.data)[name]
    if name == "photos":
        (tmp_path / "photos").mkdir()
        chosen.photos, chosen.photos_out = str(tmp_path / "photos"), str(tmp_path / "photos_dataset")
        state = replace(state, photos=replace(state.photos, folder=chosen.photos))
        for word in ("off", "factor"):
            light = chosen.photos_lights.add()
            light.folder, light.light, light.word = str(tmp_path / "lamp"), "lamp", word
    for live, automatic in ((False, True), (True, False)):
        chosen.preview, chosen.iterations_automatic = live, automatic
        settings.follow_lights(chosen, LIGHTS, [1.0] * len(LIGHTS))
        for panel in PANELS:
            for kind, text, free, *_ in texts(draw(panel, state)):
                wide = parts.text_width(text)
                assert wide <= free, f"{panel.__name__}: {kind} {text!r} is {wide:.0f} px, has {free:.0f}"
                assert not any(word in text for word in JARGON), f"{panel.__name__}: {text!r}"


def test_what_a_file_names_outside_it_is_shown_with_its_buttons(chosen, tmp_path):
    """One button for what is on this computer, one for each place in a network; none where all is chosen."""
    ready = states(chosen.data)["ready"]
    assert "physhdr.outside_look" not in [name for *_, name, _ in texts(draw(PHYSHDR_PT_status, ready))]
    network = "\\\\server\\share\\a folder with a name that is a little longer than the panel"
    with settings.respelling():  # as a file names them
        chosen.out = network
    shown = list(texts(draw(PHYSHDR_PT_status, ready)))
    buttons = [text for _, text, _, name, _ in shown if name == "physhdr.outside_look"]
    assert buttons == [""]
    with settings.respelling():
        chosen.photos = str(tmp_path / "photographs that were taken in the kitchen of a friend")
    shown = list(texts(draw(PHYSHDR_PT_status, ready)))
    buttons = [text for _, text, _, name, _ in shown if name == "physhdr.outside_look"]
    assert buttons == ["", "physhdr.outside_look"]  # the second's text is the operator's own name
    assert any(text.endswith("kitchen of a friend") for _, text, *_ in shown)
    for kind, text, free, name, _ in shown:
        text = "Look at Them" if text == name else text
        assert parts.text_width(text) <= free, f"{kind} {text!r} is cut"


def test_no_text_of_a_models_sliders_is_cut(chosen, make_model, write):
    """Those of the selected model, which its modifier calls by longer names."""
    steps = np.linspace(-8.0, 8.0, 32, dtype=np.float32)
    curve = np.repeat(1.0 / (1.0 + np.exp(-steps))[:, None], 3, axis=1).astype(np.float32)
    model = make_model(lights=("ambient", "pendant"))
    model = replace(model, tone_curve_log_exposure=steps, tone_curve=curve)
    bpy.ops.physhdr.model_import(filepath=str(write(model)), name="kitchen")
    shown = [*texts(draw(PHYSHDR_PT_model, State())), *texts(draw(PHYSHDR_PT_look))]
    for kind, text, free, *_ in shown:
        assert parts.text_width(text) <= free, f"{kind} {text!r} is cut"
    there = {text for _, text, *_ in shown}
    assert {"kitchen", "Exposure (EV)", "ambient", "pendant"} <= there
    assert {"Learned Tones", "View Dependent", "Camera Splats", "Image Width", "3D View"} <= there
    assert not any("no model yet" in text for _, text, *_ in shown)  # it needs no backend


def test_sliders_of_the_model_that_an_instance_shows(chosen, make_model, write):
    """As from an asset: the model is in a collection that the view layer has not."""
    bpy.ops.physhdr.model_import(filepath=str(write(make_model())), name="kitchen")
    scene, model, apart = bpy.context.scene, bpy.context.object, bpy.data.collections.new("apart")
    scene.collection.objects.unlink(model)
    apart.objects.link(model)
    within, holder, other = (bpy.data.objects.new(name, None) for name in ("within", "holder", "other"))
    outer = bpy.data.collections.new("outer")
    outer.objects.link(within)
    for empty, collection in ((within, apart), (holder, outer)):
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
    scene.collection.objects.link(holder)
    scene.collection.objects.link(other)
    for active, selected in ((holder, True), (other, False)):
        bpy.context.view_layer.objects.active = active
        shown = [text for _, text, *_ in texts(draw(PHYSHDR_PT_model, State()))]
        told = " ".join(shown)
        assert ("kitchen" in shown) == ("all of its instances follow" in told) == selected
        assert ("Select a model for its sliders" in told) == (not selected)
        assert "no model yet" not in told


def test_nothing_of_the_training_stands_elsewhere_while_it_goes_on(chosen):
    """Each button is where it was, whatever is pressed: greyed, not gone. Two that are never wanted at once
    share a place: Start and Resume, Pause and Continue."""
    found = states(chosen.data)
    names = (
        "ready",
        "preparing",
        "training",
        "paused",
        "stopping",
        "stopped",
        "finished",
        "open",
        "rendering",
    )
    begun, halted = ("train_start", "train_resume"), ("train_pause", "train_continue")
    places = {name: height(draw(training, found[name]))[0] for name in names}
    there = {name: [word.removeprefix("physhdr.") for _, word in places[name]] for name in names}
    for group in (begun, halted, ("train_stop",), ("run_open",), ("result_import",)):
        shown = {name: [each for each in group if each in there[name]] for name in names}
        assert all(len(each) == 1 for each in shown.values()), shown
        rows = {places[name]["operator", f"physhdr.{each}"][0] for name, (each,) in shown.items()}
        assert len(rows) == 1, (group, rows)
    assert {places[name]["button", "preview"][0] for name in names} == {
        places["ready"]["button", "preview"][0]
    }
    wanted = (*begun, *halted, "train_stop", "run_open")
    enabled = {
        name: {each for each in wanted if places[name].get(("operator", f"physhdr.{each}"), (0.0, False))[1]}
        for name in names
    }
    assert enabled["ready"] == {"train_start"}
    assert enabled["training"] == enabled["preparing"] == {"train_pause", "train_stop"}
    assert enabled["paused"] == {"train_continue", "train_stop"}
    assert "train_start" in enabled["finished"] and enabled["stopping"] == set()
    # What ends the process is never where Stop was when it was pressed, and its room is below.
    with_end = {name for name in names if ("operator", "physhdr.train_end") in places[name]}
    assert with_end == {"stopping"} and places["stopping"]["operator", "physhdr.train_end"][1]
    above = [
        places["stopping"]["operator", f"physhdr.{each}"][0]
        for each in (*wanted, "result_import")
        if each in there["stopping"]
    ]
    assert places["stopping"]["operator", "physhdr.train_end"][0] > max(above)
    # What stands above it keeps its height as well: the first panel, whose bar comes and goes.
    heights = {name: height(draw(PHYSHDR_PT_status, found[name]))[1] for name in names}
    assert max(heights.values()) == pytest.approx(min(heights.values())), heights


def test_the_sliders_of_the_preview_stay_where_they_are(chosen):
    found = states(chosen.data)
    settings.follow_lights(chosen, LIGHTS, [1.0] * len(LIGHTS))
    rows = {}
    for name in ("training", "finished", "open"):
        for live in (False, True):
            chosen.preview = live
            places, _ = height(draw(PHYSHDR_PT_model, found[name]))
            rows[name, live] = places["value", "exposure_ev"][0]
    assert set(rows.values()) == {0.0}


def test_the_report_is_folded_and_its_warnings_are_not(chosen):
    found = states(chosen.data)
    for name, is_open in (("ready", False), ("warned", True)):
        shown = [text for _, text, *_ in texts(draw(dataset, found[name]))]
        assert "interior: 18 training views" in shown
        assert any("stops" in text for text in shown) == is_open
        assert any("no test split" in text for text in shown) == is_open


def test_photos_under_other_light_have_a_row_each(chosen, tmp_path):
    photos = states(chosen.data)["photos"]
    chosen.photos = str(tmp_path / "photos")
    shown = [(text, name) for _, text, _, name, _ in texts(draw(dataset, photos)) if "light" in name]
    assert shown == [("Other Light…", "physhdr.photos_light_add")]
    light = chosen.photos_lights.add()
    light.folder, light.light, light.word = str(tmp_path / "lamp"), "lamp", "on"
    names = [name for *_, name, _ in texts(draw(dataset, photos))]
    assert {"light", "word", "folder", "physhdr.photos_light_remove"} <= set(names) and "factor" not in names
    light.word = "factor"
    assert "factor" in [name for *_, name, _ in texts(draw(dataset, photos))]


def test_a_data_set_that_is_looked_at_says_so(chosen):
    """On a slow drive nothing is known of it for a while."""
    ready = states(chosen.data)["ready"]
    looking = replace(ready, dataset=Dataset(ready.dataset.folder))
    shown = [text for _, text, *_ in texts(draw(dataset, looking))]
    assert "Looking at it" in shown


def test_capture_is_open_until_a_model_is_there_and_while_it_trains(chosen, make_model, write):
    """One of the two that are the same, of which the other begins folded."""
    found = states(chosen.data)

    def shown(name):
        runtime.session().state = found[name]
        return [cls for cls in (PHYSHDR_PT_capture, PHYSHDR_PT_capture_behind) if cls.poll(bpy.context)]

    assert shown("nothing") == [PHYSHDR_PT_capture_behind]  # the first screen has two ways in
    assert shown("ready") == shown("finished") == [PHYSHDR_PT_capture]
    bpy.ops.physhdr.model_import(filepath=str(write(make_model())), name="kitchen")
    assert shown("ready") == shown("finished") == [PHYSHDR_PT_capture_behind]
    assert shown("training") == [PHYSHDR_PT_capture]
    assert "DEFAULT_CLOSED" in PHYSHDR_PT_capture_behind.bl_options


def test_the_first_screen_is_the_two_ways_in(chosen):
    """Until there is a trainer; what then stands in its place says how it is."""
    ways = ["physhdr.backend_install", "physhdr.model_import"]
    for name, there in (("nothing", ways), ("ready", [])):
        shown = [each for *_, each, _ in texts(draw(PHYSHDR_PT_status, states(chosen.data)[name]))]
        assert [each for each in shown if each in ways] == there


def test_room_for_a_bar_is_kept_only_where_a_training_begins(chosen, make_model, write):
    """Capture must not jump when Start is pressed; above a folded one the room would be a hole."""
    ready = states(chosen.data)["ready"]
    before = height(draw(PHYSHDR_PT_status, ready))[1]
    bpy.ops.physhdr.model_import(filepath=str(write(make_model())), name="kitchen")
    after = height(draw(PHYSHDR_PT_status, ready))[1]
    assert before - after == pytest.approx(1.0 + 0.8 * status.PROGRESS_LINES)


def test_another_blenders_trainer_is_seen_whatever_is_folded(chosen):
    shown = [each for *_, each, _ in texts(draw(PHYSHDR_PT_status, states(chosen.data)["others"]))]
    assert "physhdr.control_take" in shown


def test_methods_for_research_are_offered_where_the_preferences_say_so(chosen, monkeypatch):
    state = states(chosen.data)["ready"]

    def shown():
        drawn = texts(draw(training, state))
        return [(kind, text) for kind, text, _, name, _ in drawn if name == "preset"]

    usual = [("button", "Fast"), ("button", "Default"), ("button", "High")]
    assert chosen.preset == "default" and shown() == usual
    chosen.preset = "paper"  # by a script, or a file: it is seen
    assert shown()[0] == ("value", "Method")
    chosen.preset = "high"
    assert shown() == usual
    monkeypatch.setattr(settings._Defaults, "research", True)
    assert shown()[0] == ("value", "Method")


def test_renders_are_set_up_in_the_sidebar_and_among_blenders_own_settings(chosen, make_model, write):
    panels = PHYSHDR_PT_render, PHYSHDR_PT_render_properties
    assert not any(panel.poll(bpy.context) for panel in panels)
    bpy.ops.physhdr.model_import(filepath=str(write(make_model())), name="kitchen")
    assert all(panel.poll(bpy.context) for panel in panels)
    drawn = [list(texts(draw(panel))) for panel in panels]
    assert drawn[0] == drawn[1] and "physhdr.render_setup" in [name for *_, name, _ in drawn[0]]
    assert PHYSHDR_PT_render_properties.bl_context == "render"


def test_what_the_check_found_odd_is_told(chosen, monkeypatch):
    state = states(chosen.data)["ready"]
    report = {**state.backend.report, "warnings": ["torch 2.20.0 was not tested: torch>=2.8,<2.14"]}
    monkeypatch.setattr(Layout, "unfold", True)
    shown = texts(draw(backend, replace(state, backend=replace(state.backend, report=report))))
    assert "was not tested" in " ".join(text for _, text, *_ in shown)


@pytest.mark.parametrize(
    ("torch", "device", "told"),
    [("2.13.0+cu126", "cpu", True), ("2.13.0+cu126", "cuda", False), ("2.13.0+cpu", "cpu", False)],
)
def test_why_a_card_is_not_used_is_told_where_torch_is_for_one(chosen, monkeypatch, torch, device, told):
    state = states(chosen.data)["ready"]
    why = "on the CPU (Warp's kernels draw a Gaussian wrongly (by 1))"
    report = {**state.backend.report, "versions": {"torch": torch}, "device": device, "why": why}
    monkeypatch.setattr(Layout, "unfold", True)
    shown = texts(draw(backend, replace(state, backend=replace(state.backend, report=report))))
    assert ("draw a Gaussian wrongly" in " ".join(text for _, text, *_ in shown)) == told


def test_iterations_are_automatic_until_a_number_is_wanted(chosen, monkeypatch):
    monkeypatch.setattr(Layout, "unfold", True)
    state = states(chosen.data)["ready"]

    def shown():
        return {name: text for kind, text, _, name, _ in texts(draw(training, state)) if name}

    assert chosen.iterations == 0 and shown()["iterations_automatic"] == "Automatic"
    assert "iterations" not in shown()
    before = height(draw(training, state))[1]
    chosen.iterations_automatic = False
    assert chosen.iterations > 0 and "iterations" in shown()
    assert height(draw(training, state))[1] == before
    chosen.iterations = 0  # as scripts say it
    assert chosen.iterations_automatic


def test_all_that_is_under_way_is_at_the_top_and_in_the_status_bar(chosen):
    """Whichever panel its button is in; with its name, its time left and a way to cancel it."""
    for name, title, _ in TASKS:
        state = State(tasks=(Running(name, "log", 0.4, "half way", 90.0),))
        told = " ".join(text for _, text, *_ in texts(draw(PHYSHDR_PT_status, state)))
        assert f"{title} 40%" in told and "1 min 30 s left" in told
        assert list(status_bar.at_work(state)) == [(f"{title} 40%, 1 min 30 s left", 0.4, name, "")]
    job = replace(states(chosen.data)["training"], tasks=(Running("web", "log", 0.5, ""),))
    assert [work.text for work in status_bar.at_work(job)] == [
        "Training 1234 / 25000, 1 h 23 min left",
        "Web Page 50%",
    ]
    assert not list(status_bar.at_work(states(chosen.data)["ready"]))


def test_a_stage_without_progress_says_what_it_does_in_the_panel_and_in_the_status_bar(chosen):
    task = Running("photos", "log", 0.4, "matching photos", pace=Pace(95))
    said = "matching photos: 1 min 35 s so far"
    assert said in [text for _, text, *_ in texts(draw(PHYSHDR_PT_status, State(tasks=(task,))))]
    assert [work.stage for work in status_bar.at_work(State(tasks=(task,)))] == [said]
    state = replace(states(chosen.data)["training"], pace=Pace(40))
    said = "Iteration 1234: 40 s so far"
    assert said in [text for _, text, *_ in texts(draw(PHYSHDR_PT_status, state))]
    assert [work.stage for work in status_bar.at_work(state)] == [said]


@pytest.mark.parametrize("name", tasks.ENDED)
def test_every_long_task_ends_with_a_word_and_a_way_to_what_it_made(chosen, name, tmp_path):
    """It stays where the bar was; nothing below moves, and no text is cut."""
    made = tmp_path / "made.html"
    made.write_text("", encoding="utf-8")
    state = states(chosen.data)["finished"]
    said = replace(state, made=Made(name, str(made)))
    shown = list(texts(draw(PHYSHDR_PT_status, said)))
    assert ("label", f"{tasks.ENDED[name]}: made.html") in [each[:2] for each in shown]
    buttons = [text for kind, text, *_ in shown if kind == "operator"]
    assert buttons == (["Open"] if name in tasks.SHOWN else []) + ["Open Folder", ""]
    assert not [each for each in shown if parts.text_width(each[1]) > each[2]]
    bar = SimpleNamespace(layout=Layout(1000))
    runtime.session().state = said
    status_bar.draw(bar, bpy.context)
    assert f"{tasks.ENDED[name]}: made.html" in [text for _, text, *_ in texts(bar.layout)]
    for much in ("a rather long name " * 4, "a_name_that_is_longer_than_the_line"):
        long = list(texts(draw(PHYSHDR_PT_status, replace(state, made=Made(name, f"/home/somebody/{much}")))))
        assert not [each for each in long if parts.text_width(each[1]) > each[2]]
        assert [text for _, text, *_ in long if text.startswith(f"{tasks.ENDED[name]}: {much[:3]}")]
    assert height(draw(PHYSHDR_PT_status, said))[1] <= height(draw(PHYSHDR_PT_status, state))[1]


def test_hide_originals_is_offered_once_where_model_and_originals_are_in_each_others_way(chosen, monkeypatch):
    monkeypatch.setattr(originals, "is_offered", lambda scene: True)
    state = states(chosen.data)["open"]
    shown = [each for panel in PANELS for each in texts(draw(panel, state))]
    assert [text for kind, text, *_ in shown if kind == "operator" and "Originals" in text] == [
        "Hide Originals"
    ]
    assert "photographed from" in " ".join(text for kind, text, *_ in shown if kind == "label")


def test_who_previews_while_another_runs_model_is_open_is_given_the_button(chosen, tmp_path):
    state = states(chosen.data)["open"]
    chosen.out = str(tmp_path / "mine")
    chosen.preview = True
    shown = list(texts(draw(PHYSHDR_PT_model, state)))
    assert "Open Run" in [text for kind, text, *_ in shown if kind == "operator"]
    told = " ".join(text for kind, text, *_ in shown if kind == "label")
    assert "another run open, kitchen_run: open this file's instead" in told
    assert not [each for each in shown if parts.text_width(each[1]) > each[2]]


def test_no_text_of_what_is_done_with_a_model_is_cut(chosen, make_model, write, tmp_path):
    """Scale and ground as far as they are known, light, cleaning and render."""
    bpy.ops.physhdr.model_import(filepath=str(write(make_model())), name="a kitchen with a long name")
    known = chosen.captures.add()
    known.name = origin.capture_of(bpy.context.object)
    for has_scale, has_floor in ((False, False), (True, True)):
        known.has_scale, known.has_floor = has_scale, has_floor
        for panel in (PHYSHDR_PT_scale, PHYSHDR_PT_light, PHYSHDR_PT_cleaning, PHYSHDR_PT_render):
            for kind, text, free, *_ in texts(draw(panel, State())):
                named = getattr(bpy.types, text.replace("physhdr.", "PHYSHDR_OT_"), None)
                text = getattr(named, "bl_label", text)  # an operator's own name
                assert parts.text_width(text) <= free, f"{panel.__name__}: {kind} {text!r} is cut"
