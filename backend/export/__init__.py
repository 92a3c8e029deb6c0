# SPDX-License-Identifier: GPL-3.0-or-later
"""A trained method as files for others, and what these are called in a run's folder."""

from ...bridge.run_folder import CAMERAS_FILE, MODEL_FILE, WEB_FILE

BAKED_FILE = "baked.ply"
LOSSLESS_FILE = "lossless.ply"
FILES = (MODEL_FILE, CAMERAS_FILE, BAKED_FILE, LOSSLESS_FILE, WEB_FILE)
