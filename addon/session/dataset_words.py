# SPDX-License-Identifier: GPL-3.0-or-later
"""What synth/make_scene.py says of a data set of the open scene, in the words of the dialog. Pure."""

import re

#: The command line's options, as the dialog calls them.
LABELS = {
    "--out": "Folder",
    "--camera-rig": "Cameras",
    "--views": "Views",
    "--rig-distance": "Distance",
    "--rig-extent": "Grid Width and Height",
    "--rig-arc": "Arc",
    "--exposures": "Exposures",
    "--crf": "Camera Response",
    "--resolution": "Width and Height",
    "--samples": "Samples",
    "--seed": "Seed",
    "--device": "Device",
    "--lit-views": "Views Under Other Light",
    "--lit-levels": "Their Levels",
    "--train-ambient-levels": "Their Levels",
    "--lit-lights": "Lights That Vary",
    "--light": "Lights That Vary",
    "--relit-views": "Relit Test Views",
    "--ambient-levels": "At Levels",
}
#: What is said otherwise than option by option.
PHRASES = {
    " (--out)": "",
    "(--out; ": "(",
    " (--no-denoise)": "",
    "; --evs takes EV": "",
    "--camera-rig path": "'Camera Animation'",
    "--device CPU": "'Device': Processor",
}
#: The latter at the beginning of a word alone: a folder may be called like an option.
_SAID = re.compile("|".join(map(re.escape, PHRASES)) + r"|(?<![^\s(])--[a-z][a-z-]*")


def in_the_dialogs_words(text: str) -> str:
    """``--lit-levels: 0 is …`` → ``'Their Levels': 0 is …``."""
    return _SAID.sub(lambda found: _meant(found[0]), text)


def _meant(said: str) -> str:
    if said in PHRASES:
        return PHRASES[said]
    return f"'{LABELS[said]}'" if said in LABELS else said
