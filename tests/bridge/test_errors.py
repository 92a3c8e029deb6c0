# SPDX-License-Identifier: GPL-3.0-or-later
"""What an error tells: its cause for programs, and a message that can be read."""

from physhdr.bridge.errors import LONGEST_MESSAGE, FileDamagedError


def test_the_code_is_the_class_in_small_letters() -> None:
    assert FileDamagedError("a").code == "file_damaged"
    assert str(FileDamagedError("what", "how")) == "what\n  how"


def test_of_a_message_of_any_length_both_ends_are_told() -> None:
    error = FileDamagedError("plan.toml: " + "9" * 10_000 + " is no number", "Fix it.")
    assert len(error.message) <= LONGEST_MESSAGE + 3
    assert error.message.startswith("plan.toml: 999") and error.message.endswith("999 is no number")
    assert FileDamagedError("x" * LONGEST_MESSAGE).message == "x" * LONGEST_MESSAGE
