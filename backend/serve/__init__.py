# SPDX-License-Identifier: GPL-3.0-or-later
"""The backend as a process controlled by Blender: one thread communicates, one computes (docs/protocol.md).

The *server* (``server``; ``admission`` authenticates clients, ``control`` decides which one is in control,
``client`` is one of them, ``frames`` ends a connection) runs an asyncio loop in its own thread. The *engine*
(``engine``; ``requests`` checks requests, ``training`` trains, ``status`` holds the state, ``preview``
renders, ``machine`` manages threads and devices) runs in the main thread, the only one to use torch, the
trainer and the model. Requests go through the ``inbox``, replies through a few thread-safe functions of the
server. The server does not import torch, so that clients are answered while it loads.
"""
