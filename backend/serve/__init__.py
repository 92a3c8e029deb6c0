# SPDX-License-Identifier: GPL-3.0-or-later
"""The backend as a process that Blender steers: one thread talks, one works (docs/protocol.md).

The *server* (``server``; ``admission`` lets clients in, ``control`` says who of them steers, ``client`` is
one of them, ``frames`` ends a connection) runs an asyncio loop in a thread of its own. The *engine*
(``engine``; ``requests`` checks what is asked, ``training`` does it, ``status`` tells of it, ``preview``
draws, with what ``machine`` has) runs in the main thread and alone touches torch, the trainer and the model.
Between them are the ``inbox`` (what is asked) and the server's few thread-safe functions (what is told).
Nothing of the server imports torch, so that clients are answered while it loads.
"""
