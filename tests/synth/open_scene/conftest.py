# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixture: the user's scene, fresh for each test."""

import pytest

from physhdr.tests.synth.open_scene import user_scene


@pytest.fixture
def scene():
    return user_scene.opened()
