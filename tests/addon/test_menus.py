# SPDX-License-Identifier: GPL-3.0-or-later
"""F3 finds what is in menus, by its text: all that the extension does is in one, by its verb."""

from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.model import native  # noqa: E402

#: What an entry begins with.
VERBS = (
    *("Add", "Bake", "Check", "Continue", "Develop", "Draw", "End", "Evaluate", "Export", "Find", "Get"),
    *(
        "Hide",
        "Import",
        "Install",
        "Light",
        "Look",
        "Make",
        "Measure",
        "Open",
        "Pause",
        "Prepare",
        "Put",
        "Remove",
    ),
    *("Render", "Reset", "Restore", "Resume", "Save", "Select", "Set", "Show", "Shut", "Start", "Stop"),
    *("Take", "Try", "Use"),
)
MENUS = "VIEW3D_MT_object", "VIEW3D_MT_add", "TOPBAR_MT_file_import", "TOPBAR_MT_file_export"


class Recorder:
    """A layout that keeps the operators of a menu, and of the menus in it, with the texts that F3 shows."""

    def __init__(self) -> None:
        self.shown: list[tuple[str, str]] = []
        self.arguments: list[tuple[str, SimpleNamespace]] = []
        self.called_by = ""

    @property
    def operator_context(self) -> str:
        return self.called_by

    @operator_context.setter
    def operator_context(self, value: str) -> None:
        self.called_by = value

    def operator(self, name: str, text: str | None = None, icon: str = "NONE") -> SimpleNamespace:
        kind = class_of(name)
        self.shown.append((name, kind.bl_label if text is None else text))
        self.arguments.append((name, SimpleNamespace()))
        return self.arguments[-1][1]

    def operator_menu_enum(self, name: str, by: str, text: str, icon: str = "NONE") -> None:
        assert by in properties_of(name)
        self.shown.append((name, text))

    def menu(self, name: str) -> None:
        menu = getattr(bpy.types, name)
        if not hasattr(menu, "poll") or menu.poll(bpy.context):
            menu.draw(SimpleNamespace(layout=self, rows=menu.rows), bpy.context)

    def separator(self) -> None:
        pass


def operators() -> dict[str, type]:
    """The registered ones of the extension, by name."""
    kinds, found = [bpy.types.Operator], {}
    while kinds:
        kind = kinds.pop()
        kinds += kind.__subclasses__()
        if getattr(kind, "bl_idname", "").startswith("physhdr.") and kind.is_registered:
            found[kind.bl_idname] = kind
    return found


def class_of(name: str) -> type:
    return operators()[name]


def properties_of(name: str):
    return getattr(bpy.ops.physhdr, name.removeprefix("physhdr.")).get_rna_type().properties


def drawn(menu: str) -> Recorder:
    """What the extension adds to one of Blender's menus."""
    layout = Recorder()
    kind = getattr(bpy.types, menu)
    for draw in kind.draw._draw_funcs:
        if draw.__module__.startswith("physhdr."):
            draw(type(menu, (), {"layout": layout})(), bpy.context)
    assert all(
        argument in properties_of(name) for name, given in layout.arguments for argument in vars(given)
    )
    return layout


def test_all_that_the_extension_does_is_in_a_menu(registered, monkeypatch):
    monkeypatch.setattr(native, "available", lambda: True)
    found = operators()
    public = {name for name, kind in found.items() if "INTERNAL" not in kind.bl_options}
    assert len(public) > 40
    reached = {name for menu in MENUS for name, _ in drawn(menu).shown}
    assert public - reached == set()


def test_what_f3_shows_begins_with_a_verb(registered, monkeypatch):
    monkeypatch.setattr(native, "available", lambda: True)
    shown = drawn("VIEW3D_MT_object").shown
    texts = [text for _, text in shown]
    assert len(set(texts)) == len(texts)
    names = {kind.bl_label for kind in operators().values() if "INTERNAL" not in kind.bl_options}
    assert [text for text in {*texts, *names} if text.split()[0] not in VERBS] == []


def test_files_are_where_blender_has_them(registered):
    added = drawn("VIEW3D_MT_add")
    assert [name for name, _ in added.shown] == ["physhdr.model_import"]
    # Add lets operators act at once: an import without its file browser would fail.
    assert added.called_by == "INVOKE_REGION_WIN"
    exported = [name for name, _ in drawn("TOPBAR_MT_file_export").shown]
    assert exported == ["physhdr.model_save", "physhdr.model_bake", "physhdr.results_web"]


def test_switched_off_nothing_is_left_in_menus(registered):
    import physhdr

    assert drawn("VIEW3D_MT_object").shown
    physhdr.unregister()
    left = [draw for menu in MENUS for draw in getattr(bpy.types, menu).draw._draw_funcs]
    physhdr.register()
    assert [draw for draw in left if draw.__module__.startswith("physhdr.")] == []
