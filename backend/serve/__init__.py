# SPDX-License-Identifier: GPL-3.0-or-later
"""The backend as a process that Blender steers: one thread talks, one works (docs/protocol.md).

The *server* (``server``, ``client``) runs an asyncio loop in a thread of its own. The *engine* (``engine``,
``preview``) runs in the main thread and alone touches torch, the trainer and the model. Between them are the
``inbox`` (what is asked) and the server's few thread-safe functions (what is told). Nothing in here but
``engine`` and ``preview`` imports torch, so that clients are answered while it loads.
"""
