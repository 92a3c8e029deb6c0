# SPDX-License-Identifier: GPL-3.0-or-later
"""What helps with a damaged photo of any kind: said once, for lists of skipped photos leave it out."""

COPY_AGAIN = "Copy it again, or move it away."
