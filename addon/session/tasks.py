# SPDX-License-Identifier: GPL-3.0-or-later
"""What child processes do for us, as the panel calls it: every task that can be started, and so cancelled."""

from .light import LIGHT
from .results import BAKE, EVALUATE, VIDEO, WEB
from .state import CHECK, DATASET, INSTALL, LOOK, PHOTOS

#: The task's name, what the panel calls it, what it is.
TASKS = (
    (INSTALL, "Installation", "The installation of the backend"),
    (CHECK, "Check", "The check of the backend"),
    (DATASET, "Data Set", "The rendering of a data set"),
    (LOOK, "Look", "The look at a folder of photos"),
    (PHOTOS, "Photos", "The preparation of photos"),
    (EVALUATE, "Evaluation", "The evaluation of a run"),
    (VIDEO, "Video", "The making of a video"),
    (WEB, "Web Page", "The writing of a web page"),
    (LIGHT, "Light", "The drawing of a model's light"),
    (BAKE, "Bake", "The fit of a model's colours for other viewers"),
)
