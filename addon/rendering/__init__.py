# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders of models: what they need of a scene, pictures, shots for the trainer."""
