# SPDX-License-Identifier: GPL-3.0-or-later
"""What a training starts from: points, and how bright they are, found in the brackets that it may see."""
