# SPDX-License-Identifier: GPL-3.0-or-later
"""The presets by name, for people to choose from: what Blender's panel lists and the backend trains.

Their settings are the backend's (``backend/train/presets.py``): one for each row here, and no others.
"""

from typing import NamedTuple


class Preset(NamedTuple):
    """A row: ``name`` in files and on command lines, ``label`` on a panel, and what it is in one sentence.

    ``splats``: it makes Gaussians, which Blender can show.
    """

    name: str
    label: str
    description: str
    splats: bool = True


#: Blender's panel offers these. New ones come last: a .blend keeps the place in this list.
IN_PANEL = (
    Preset("default", "Default", "PhysHDR with the physical product: good pictures, relights"),
    Preset("fast", "Fast", "A look: the default with half of its iterations, more at half resolution"),
    Preset("paper", "Paper", "PhysHDR-GS as the paper states it: both branches, learned networks; slow"),
    Preset("baseline", "Baseline", "Plain 3DGS with a learned response: no relighting"),
    Preset("default-scaffold", "Default on Anchors", "The default on Scaffold-GS's anchors: twice the time"),
    Preset("gausshdr-short", "GaussHDR", "GaussHDR on the default's schedule: no relighting"),
    Preset("hdr-gs-short", "HDR-GS", "HDR-GS on the default's schedule: no relighting, no absolute scale"),
    Preset("high", "High", "Over night: the default with four times the iterations, more Gaussians"),
)

#: Those for comparisons, which take long or answer a question that few have: on the command line alone.
FOR_COMPARISONS = (
    Preset("paper-scaffold", "Paper on Anchors", "The paper's method on Scaffold-GS's anchors; slow"),
    Preset("baseline-scaffold", "Baseline on Anchors", "The baseline on Scaffold-GS's anchors"),
    Preset("gausshdr", "GaussHDR, Published", "GaussHDR on 3DGS for 30,000 iterations"),
    Preset("gausshdr-scaffold", "GaussHDR, Released", "GaussHDR as its released code has it, on anchors"),
    Preset("hdr-gs", "HDR-GS, Published", "HDR-GS for 30,000 iterations, without true HDR pictures"),
    Preset(
        "hdr-nerf",
        "HDR-NeRF, Published",
        "HDR-NeRF for 200,000 iterations, which call for a card",
        splats=False,
    ),
    Preset("paper-short", "Paper, Short", "The paper's method on the default's schedule"),
    Preset("paper-scaffold-short", "Paper on Anchors, Short", "The same on Scaffold-GS's anchors"),
    Preset("gausshdr-scaffold-short", "GaussHDR on Anchors", "The same on the default's schedule"),
    Preset(
        "hdr-nerf-small", "HDR-NeRF, Small", "HDR-NeRF with smaller networks and fewer samples", splats=False
    ),
)

PRESETS = {preset.name: preset for preset in (*IN_PANEL, *FOR_COMPARISONS)}
