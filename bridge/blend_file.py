# SPDX-License-Identifier: GPL-3.0-or-later
"""How what is ours is known in a .blend file, where the extension need not be installed."""

#: Custom property of a model's point cloud: the model's identity.
MODEL_IDENTITY = "physhdr_uuid"
#: Of a world that is lit by a capture: its model, and the world that the scene had before, if it had one.
LIGHT_MODEL, FORMER_WORLD = "physhdr_light_model", "physhdr_former_world"
#: Of an empty at which light was taken: what is known of it.
PROBE = "physhdr_probe"
#: Of what puts CG into a capture (planes, collections, nodes): what it is.
CG = "physhdr_cg"
#: Of a data set's camera: what it is for (``train``, ``test`` …).
SPLIT = "physhdr_split"
