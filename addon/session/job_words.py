# SPDX-License-Identifier: GPL-3.0-or-later
"""Remedies of the trainer, which name options of its command line, in the words of Blender's panel. Pure."""

import re
from dataclasses import replace

from ...bridge.messages import Failure

#: What the trainer says, as an expression, and the same for who has the panel; whole remedies come first.
PHRASES = (
    (r"physhdr train DATA --out RUN, or name another run", "press Start, or choose another Run"),
    (
        r" \(docs/formats\.md\)\. Of photos, 'physhdr prepare .*' makes one; '.*' renders one",
        ", or make one: Prepare Photos, or Render from This Scene",
    ),
    (r", as given to physhdr train --out\b", ""),
    (r" \(CTRL-C saves\)", ""),
    (r"replace it by --overwrite\b", "replace it (Start, then Replace)"),
    (r"\btrain again with --overwrite\b", "train again (Start, then Replace)"),
    (r"--resume\b", "Resume"),
    (r"--out\b", "Run"),
    (r"--home\b", "Backend's Folder (in the preferences)"),
    (r"\bChoose --device cpu\b", "Set Device to Processor"),
    (r"--device cpu\b", "Device set to Processor"),
    # Of pictures, whose size is chosen when they are rendered or prepared.
    (r" \(--downscale\)", ""),
    (r": --downscale ([\d.]+)(?=\.)", r": 1/\1 of their width and height"),
    (r": --downscale\b", ""),
    # Presets that the panel offers have other values of them; Default's are made for what failed here.
    (
        r"train again with --densify\.reset-every 0, .* with a smaller --densify\.prune-opacity",
        "train again with Method set to Default",
    ),
    (r", (lower --anchors\.voxel-size, )?or train with --initial-points random", ""),
)
#: Below a remedy with an option that the panel has no counterpart of.
OF_THE_COMMAND_LINE = "What begins with -- is an option of physhdr train, on the command line."


def in_panel_words(text: str) -> str:
    """A remedy with the trainer's options as the panel calls them; what it has not stays as it is."""
    for said, meant in PHRASES:
        text = re.sub(said, meant, text)
    return text


def for_panel(failure: Failure) -> Failure:
    """A failure with its remedy in the panel's words; an option that the panel has not is told to be one."""
    hint = in_panel_words(failure.hint)
    if re.search(r"(^|[\s(])--[a-z]", hint):
        hint = f"{hint} {OF_THE_COMMAND_LINE}"
    return replace(failure, hint=hint)
