# SPDX-License-Identifier: GPL-3.0-or-later
"""The built-in scenes, a module each, and what they are made of; ``synth/built_in.py`` has them by name."""
