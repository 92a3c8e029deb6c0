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


#: Blender's panel offers these: by the time that they take …
USUAL = (
    Preset("fast", "Fast", "A look: half of the default's time, not quite as sharp"),
    Preset("default", "Default", "What you want first: good pictures, relights"),
    Preset("high", "High", "Overnight: four times the default's time"),
)

#: … and these where the preferences ask for research methods.
RESEARCH = (
    Preset("paper", "Paper", "The published method (PhysHDR-GS), word by word: slow, to compare with"),
    Preset("baseline", "Baseline", "Plain Gaussian splatting in HDR, to compare with: no relighting"),
    Preset(
        "default-scaffold",
        "Default on Anchors",
        "The default with its splats in groups that share what they learn (Scaffold-GS): twice the time",
    ),
    Preset("gausshdr-short", "GaussHDR", "Another published method, to compare with: no relighting"),
    Preset(
        "hdr-gs-short",
        "HDR-GS",
        "Another published method, to compare with: no relighting, brightness without scale",
    ),
)

IN_PANEL = (*USUAL, *RESEARCH)

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
    Preset("baseline-equal", "Baseline, Equal", "The baseline with the default's start and pictures"),
    Preset("gausshdr-equal", "GaussHDR, Equal", "GaussHDR with the default's start, and rates that suit it"),
    Preset("paper-equal", "Paper, Equal", "The paper's method with the default's start, and such rates"),
)

PRESETS = {preset.name: preset for preset in (*IN_PANEL, *FOR_COMPARISONS)}
