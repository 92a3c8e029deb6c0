# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of an archive's members, which come from a stranger: a path that stays in its folder, or none.

The same answer on every platform: what Windows would read as a drive, a share, a device or another stream of
a file is refused on Linux too.
"""

import re
from pathlib import PurePosixPath

#: What no name may hold: control characters, and those that Windows forbids or reads as part of a path.
FORBIDDEN = re.compile(r'[\x00-\x1f\x7f<>:"|?*\\]')
#: Windows' devices, in any folder and with any suffix; ¹²³ count as digits there.
DEVICES = re.compile(r"(?:CON|PRN|AUX|NUL|CONIN\$|CONOUT\$|(?:COM|LPT)[0-9¹²³])", re.IGNORECASE)


def inner_path(name: str) -> PurePosixPath | None:
    """``name`` as a relative path that stays inside any folder it is joined to, on Linux, macOS and Windows.

    ``None`` where it would not: absolute, with a drive (``D:/x``), a share, a backslash, ``..``, an empty
    part, a device (``NUL.png``), a stream (``a:b``), or an end in a dot or space (Windows drops it).
    """
    parts = name.split("/")
    return PurePosixPath(*parts) if all(map(_is_plain, parts)) else None


def _is_plain(part: str) -> bool:
    return (
        part != ""
        and part[-1] not in ". "
        and not FORBIDDEN.search(part)
        and not DEVICES.fullmatch(part.partition(".")[0].rstrip(" "))
    )
