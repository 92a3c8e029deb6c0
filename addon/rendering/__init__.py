# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders of models: what they need of a scene, the compositor's part, pictures, shots for the trainer."""
