# SPDX-License-Identifier: GPL-3.0-or-later
"""What a training will be, asked before it starts: how large, how much memory, how long."""
