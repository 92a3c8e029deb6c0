# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels of the 3D view's sidebar, a file each; ``parts`` is what they are made of."""
