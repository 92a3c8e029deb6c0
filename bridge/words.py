# SPDX-License-Identifier: GPL-3.0-or-later
"""Words that both sides tell people."""


def counted(count: int, thing: str) -> str:
    """``1 view``, ``2 views``, ``0 views``; of things whose plural ends in s."""
    return f"{count} {thing}{'' if count == 1 else 's'}"
