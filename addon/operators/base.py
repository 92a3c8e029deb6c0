# SPDX-License-Identifier: GPL-3.0-or-later
"""What the operators share: a greyed button says why, an error becomes a report."""

import os
from typing import ClassVar

import bpy

from ...bridge.errors import PhysHDRError
from ..runtime import session
from ..session.advice import Choices, why_not

CHECKPOINT_FILE = "checkpoint.safetensors"


def choices(context: bpy.types.Context) -> Choices:
    """What is chosen in the scene's settings, as far as it decides what can be done."""
    settings = context.scene.physhdr
    out = folder_of(settings.out)
    return Choices(
        data=folder_of(settings.data),
        out=out,
        out_has_run=has_run(out),
        online=bpy.app.online_access,
        preview=settings.preview,
        photos=folder_of(settings.photos),
        photos_out=folder_of(settings.photos_out),
    )


def folder_of(chosen: str) -> str:
    """A setting's folder as a whole path; empty where none is chosen."""
    return bpy.path.abspath(chosen) if chosen else ""


def has_run(folder: str) -> bool:
    """Whether a training left a checkpoint in ``folder``."""
    # os.path says False of a name that cannot be, pathlib raises.
    return bool(folder) and os.path.isfile(os.path.join(folder, CHECKPOINT_FILE))


class PhysHDROperator(bpy.types.Operator):
    """An operator that is greyed, with the reason, while ``action`` is impossible (session.advice).

    ``run`` does it; a ``PhysHDRError`` of it is reported and cancels. What the user has not chosen yet does
    not grey it: a script may give it as an argument. The panel greys its button then.
    """

    bl_options: ClassVar[set[str]] = {"REGISTER"}
    action: ClassVar[str]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        given = Choices(
            data="given",
            out="given",
            out_has_run=True,
            online=bpy.app.online_access,
            photos="given",
            photos_out="given",
        )
        reason = why_not(session().state, cls.action, given)
        if reason:
            cls.poll_message_set(reason)
        return not reason

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            return self.run(context)
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def run(self, context: bpy.types.Context) -> set[str]:
        raise NotImplementedError


def report_task(operator: bpy.types.Operator, success: str) -> set[str]:
    """Report how a task ended that a script waited for."""
    state = session().state
    problem = state.problem or state.backend.problem
    if problem is None:
        operator.report({"INFO"}, success)
        return {"FINISHED"}
    operator.report({"ERROR"}, " ".join(filter(None, (problem.message, problem.hint))))
    return {"CANCELLED"}
