# SPDX-License-Identifier: GPL-3.0-or-later
"""What a model is in Blender: its point cloud, the nodes that light and draw it, import, cleaning, saving."""
