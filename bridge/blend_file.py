# SPDX-License-Identifier: GPL-3.0-or-later
"""How what is ours is known in a .blend file, where the extension need not be installed."""

#: Custom property of a model's point cloud: the model's identity.
MODEL_IDENTITY = "physhdr_uuid"
