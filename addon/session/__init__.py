# SPDX-License-Identifier: GPL-3.0-or-later
"""What runs beside Blender: child processes, the backend's connection, and the state that panels show."""
