# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user's choices set off: ``settings`` tells of a change, and whoever keeps the session follows it.

Blender calls a property's update function, which stands beside the property and knows no session.
"""

from collections.abc import Callable
from typing import Generic, ParamSpec

Arguments = ParamSpec("Arguments")


class Change(Generic[Arguments]):
    """One kind of change. Those who follow it are called, in the order in which they came."""

    def __init__(self) -> None:
        self._followers: list[Callable[Arguments, None]] = []

    def follow(self, follower: Callable[Arguments, None]) -> None:
        """Call ``follower`` at every change from now on."""
        self._followers.append(follower)

    def leave(self, follower: Callable[Arguments, None]) -> None:
        """Call it no more; ``ValueError`` where it did not follow."""
        self._followers.remove(follower)

    def tell(self, *arguments: Arguments.args, **named: Arguments.kwargs) -> None:
        """It has changed."""
        for follower in self._followers:
            follower(*arguments, **named)


#: Another folder is the backend's.
home = Change[[]]()
#: Something else is to become of a training when Blender closes.
when_closed = Change[[]]()
#: A scene has another data set, in the folder that is passed.
dataset = Change[[str]]()
#: The cameras of a data set that is to be rendered would stand elsewhere, or are to be shown.
rig = Change[[]]()
