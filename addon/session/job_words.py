# SPDX-License-Identifier: GPL-3.0-or-later
"""What the backend says, with the options of its command line in the words of Blender's panel. Pure."""

import re
from collections.abc import Iterable
from dataclasses import replace

from ...bridge.messages import Failure
from .light import LIGHT
from .results import BAKE, EVALUATE, VIDEO, WEB

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
        r"train again with --set backbone\.reset_every=0, .* with a smaller --set backbone\.prune_opacity",
        "train again with Method set to Default",
    ),
    (r", (lower --set backbone\.voxel_size, )?or train with --initial-points random", ""),
)
#: The same for what is made of a run or a model; then options one by one, and the words for where the result
#: goes, by task.
PHRASES_OF_RESULTS = (
    (r", where --path \w+ stays", ""),
    (r"\bAdd --sweep exposure or lighting\b", "Set Change to Exposure or Light"),
    (r"\bUse --sweep exposure, .* with light \(default\)", "Set Change to Exposure, or train with Default"),
    (r"\bGive a --sweep-range whose ends differ\b", "Set Change to something else"),
    (r"\bwrite numbered pictures instead \(--out FOLDER\)", "set Format to Pictures"),
    (r"\bwrite an \.mp4", "set Format to MP4"),
    (r": --data DATA\b", ": Data Set"),
)
OPTIONS_OF_RESULTS = {
    "--seconds": "Length",
    "--fps": "Frames a Second",
    "--width": "Width",
    "--exposure": "Exposure (s)",
    "--exposure-ev": "Exposure (EV)",
    "--lighting-levels": "Light",
    "--lpips-weights": "LPIPS Weights",
}
TARGETS = {EVALUATE: "Run", VIDEO: "File", WEB: "File", BAKE: "temporary folder", LIGHT: "folder"}
#: At the beginning of a word: a folder may be called like an option.
OPTION = re.compile(r"(?<![^\s(])--[a-z][a-z-]*")
#: Below a remedy with an option that the panel has no counterpart of.
OF_THE_COMMAND_LINE = "What begins with -- is an option of physhdr {}, on the command line."
#: The commands of the tasks that are called otherwise.
COMMANDS = {VIDEO: "render", WEB: "export", BAKE: "export", LIGHT: "render"}


def in_panel_words(text: str) -> str:
    """A remedy with the trainer's options as the panel calls them; what it has not stays as it is."""
    return _replaced(text, PHRASES)


def for_panel(failure: Failure) -> Failure:
    """A failure with its remedy in the panel's words; an option that the panel has not is told to be one."""
    return replace(failure, hint=_explained(in_panel_words(failure.hint), "train"))


def of_result(message: str, hint: str, task: str) -> tuple[str, str]:
    """The same of a task that makes something of a run or a model: what failed, and the remedy."""
    names = OPTIONS_OF_RESULTS | {"--out": TARGETS[task]}

    def told(text: str) -> str:
        text = _replaced(text, PHRASES_OF_RESULTS)
        return OPTION.sub(lambda found: names.get(found[0], found[0]), text)

    return told(message), _explained(told(hint), COMMANDS.get(task, task))


def _replaced(text: str, phrases: Iterable[tuple[str, str]]) -> str:
    for said, meant in phrases:
        text = re.sub(said, meant, text)
    return text


def _explained(hint: str, command: str) -> str:
    return f"{hint} {OF_THE_COMMAND_LINE.format(command)}" if OPTION.search(hint) else hint
