# SPDX-License-Identifier: GPL-3.0-or-later
"""The capture that a model is of: where it stands in the scene, its cameras, its original objects."""
