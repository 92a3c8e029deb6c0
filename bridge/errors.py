# SPDX-License-Identifier: GPL-3.0-or-later
"""The base of every error that a user may see: what was wrong, and what to do next.

A subclass names one cause. Command lines print ``str(error)`` without a traceback and exit with 1.
"""

import re

#: Characters of a message; a file's own words in it may be of any length, and who reads wants the end, too.
LONGEST_MESSAGE = 1600


class PhysHDRError(Exception):
    """Something the user can fix.

    ``message`` says what was wrong, with the file or value; ``hint`` says what to do next. Of a very long
    message the middle is left out.
    """

    def __init__(self, message: str, hint: str = "") -> None:
        if len(message) > LONGEST_MESSAGE:
            half = LONGEST_MESSAGE // 2
            message = f"{message[:half]} … {message[-half:]}"
        super().__init__(message)
        self.message = message
        self.hint = hint

    @property
    def code(self) -> str:
        """The cause for programs: ``FileMissingError`` → ``file_missing``."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", type(self).__name__.removesuffix("Error")).lower()

    def __str__(self) -> str:
        return f"{self.message}\n  {self.hint}" if self.hint else self.message


class FileMissingError(PhysHDRError):
    """A file or folder that is needed is not there."""


class FileDamagedError(PhysHDRError):
    """A file is there, but what it holds cannot be read as what it should be."""


class DataMismatchError(PhysHDRError):
    """Two things that must agree do not: sizes, counts, keys."""


class BadValueError(PhysHDRError):
    """A value is outside what is allowed: NaN, an unknown name, a wrong range."""


class OutputError(PhysHDRError):
    """Something cannot be written: no permission, a full disk, a path in the way."""
