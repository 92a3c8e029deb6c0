# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the Python that .blend files bring may run: what this session allows, another Blender may, no more.

Drivers and texts that register themselves are such Python. One allows it in the preferences, file by file
when it is opened (*Trusted Source*, *Allow Execution*), or by ``blender -y``.
"""

from collections.abc import Iterator

import bpy

#: Characters of a driver's expression in our question: Blender takes 255 in all.
_SHOWN = 150


def may_run() -> bool:
    """Whether Python of the file that is open may run now; False where it has none.

    Blender does not say: preferences are not what was allowed for this file, and a driver that nothing has
    evaluated yet was not refused yet (``bpy.app.autoexec_fail``). So a driver of ours asks, in a scene of its
    own. Where Python is allowed that leaves no trace. Where it is not, Blender's warning names what the file
    brings, which is what will not run.
    """
    python = next(_python(), None)
    if python is None or bpy.app.autoexec_fail:
        return False
    scene = bpy.data.scenes.new("")
    try:
        scene[""] = 0.0
        curve = scene.driver_add('[""]')
        assert isinstance(curve, bpy.types.FCurve) and curve.driver is not None
        # A call of a lambda is what Blender never runs by itself, whatever the file's own expression is.
        curve.driver.expression = f"(lambda: 0.0)() and {python[:_SHOWN]!r}"
        scene.view_layers[0].update()
    finally:
        bpy.data.scenes.remove(scene)
    return not bpy.app.autoexec_fail


def _python() -> Iterator[str]:
    """The Python in the open file: names of registered texts, and expressions that only Python evaluates."""
    yield from (text.name for text in bpy.data.texts if text.use_module)
    for data in bpy.data.user_map():
        for each in (data, getattr(data, "node_tree", None)):
            animation = getattr(each, "animation_data", None)
            for curve in animation.drivers if animation else ():
                driver = curve.driver
                if driver and driver.type == "SCRIPTED" and not driver.is_simple_expression:
                    yield driver.expression


def switch() -> str:
    """Blender's argument, to stand before a file's name, that lets another Blender do as this session does.

    Always one of both: a copy of a file lies elsewhere than where the preferences may exclude its folder.
    """
    return "-y" if may_run() else "-Y"
