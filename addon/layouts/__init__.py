# SPDX-License-Identifier: GPL-3.0-or-later
"""What the folders of data sets hold, in whichever layout: a summary, cameras, exposures. No bpy."""
