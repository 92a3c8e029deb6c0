# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the Python that .blend files bring may run: what this session allows, another Blender may, no more.

Drivers and texts that register themselves are such Python. One allows it in the preferences, file by file
when it is opened (*Trusted Source*, *Allow Execution*), or by ``blender -y``.
"""

import bpy

#: No simple expression: Blender evaluates those by itself, and some others although Python is not allowed.
_QUESTION = "(lambda: physhdr_asked())()"
_NAME = "physhdr_asked"


def may_run() -> bool:
    """Whether Python of the file that is open may run now.

    Blender tells nobody: the preferences are not what was allowed for this file, and that nothing was refused
    yet (``bpy.app.autoexec_fail``) is no permission. So a driver of our own asks, in a scene that is nowhere.
    """
    if was_refused():
        return False
    answers: list[bool] = []
    bpy.app.driver_namespace[_NAME] = lambda: answers.append(True) or 0.0
    scene = bpy.data.scenes.new(_NAME)
    try:
        scene[_NAME] = 0.0
        curve = scene.driver_add(f'["{_NAME}"]')
        assert isinstance(curve, bpy.types.FCurve) and curve.driver is not None
        curve.driver.expression = _QUESTION
        scene.view_layers[0].update()
    finally:
        bpy.data.scenes.remove(scene)
        del bpy.app.driver_namespace[_NAME]
    return bool(answers)


def was_refused() -> bool:
    """Whether Python of the file that is open was refused, other than our own question."""
    return bpy.app.autoexec_fail and _QUESTION not in bpy.app.autoexec_fail_message


def switch() -> str:
    """Blender's argument, to stand before a file's name, that lets another Blender do as this session does.

    Always one of both: a copy of a file lies elsewhere than where the preferences may exclude its folder.
    """
    return "-y" if may_run() else "-Y"
