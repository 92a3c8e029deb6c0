# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr serve``: runs the backend as a process that Blender finds by its connection file."""

import logging
import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ...bridge.connection import Connection, new_token
from ...bridge.errors import BadValueError
from ...bridge.limits import THREADS_MAX, whole
from ...bridge.messages import PROTOCOL_VERSION, JobStatus, Welcome
from ...bridge.presets import PRESETS
from ...bridge.signals import UNREPEATED, catch
from ..project import version, version_of
from ..serve.curves import Curves
from ..serve.failures import PackageMissingError, failure_of
from ..serve.home import announced, own_home
from ..serve.inbox import Ending, Inbox
from ..serve.server import Server

log = logging.getLogger(__name__)

#: Presets that Blender can show; sent to clients before torch is loaded.
PRESET_NAMES = tuple(preset.name for preset in PRESETS.values() if preset.splats)


@dataclass(frozen=True)
class Serve:
    """Train and render on request while clients need it. For Blender; docs/protocol.md."""

    #: Folder of the connection file, which stores the port and the token.
    home: Path
    #: Seconds without clients and training after which the process ends; 0: never.
    idle_timeout: float = 60.0
    #: CPU threads; 0: one per core.
    threads: int = 0
    #: Where to compute, unless a request says otherwise.
    device: Literal["auto", "cpu", "cuda"] = "auto"
    #: The file that stdout and stderr are redirected to, if any, so that messages can name it.
    log: str = ""

    def run(self) -> int:
        if not self.idle_timeout >= 0.0:
            raise BadValueError(
                f"--idle-timeout must be 0 or more seconds, got {self.idle_timeout}", "0 means never."
            )
        whole("--threads", self.threads, 0, THREADS_MAX)
        logging.basicConfig(
            stream=sys.stderr, level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s"
        )
        inbox, curves, token = Inbox(), Curves(), new_token()
        with own_home(self.home):
            server = Server(inbox, token, self._welcome(), curves.history, self.idle_timeout)
            port = server.start()
            _end_on_signals(inbox)
            connection = Connection(PROTOCOL_VERSION, port, token, os.getpid(), version(), self.log)
            reason, failed = "the backend failed; see its log", True
            with announced(self.home, connection):
                try:
                    log.info("process %d listens on port %d, home %s", os.getpid(), port, self.home)
                    reason, failed = self._engine(inbox, server, curves), False
                except Exception as error:
                    log.exception("the backend failed")
                    failure = failure_of(error, self.log)
                    server.publish(JobStatus(state="failed", message=failure.message, failure=failure))
                    reason = failure.message
                    return 1
                finally:
                    log.info("ending: %s", reason)
                    server.close(reason, failed=failed)
        return 0

    def _engine(self, inbox: Inbox, server: Server, curves: Curves) -> str:
        try:
            # Imports torch: seconds, in which clients are answered.
            from ..serve.engine import Engine, Options
        except (ImportError, OSError) as error:  # OSError on Windows, if a library's dependency is missing
            raise PackageMissingError(
                f"the backend's packages cannot be loaded: {error}",
                "Check the backend: the check reports what is missing and how to fix it.",
            ) from error
        options = Options(device=self.device, threads=self.threads, log=self.log)
        return Engine(inbox, server, curves, options).run()

    def _welcome(self) -> Welcome:
        return Welcome(
            protocol=PROTOCOL_VERSION,
            version=version(),
            pid=os.getpid(),
            log=self.log,
            device="",
            torch=version_of("torch"),
            presets=PRESET_NAMES,
            in_control=False,
        )


def _end_on_signals(inbox: Inbox) -> None:
    """The first signal saves and ends; a second CTRL-C or SIGTERM ends at once."""
    former: dict[signal.Signals, Any] = {}

    def end(number: signal.Signals) -> None:
        for each in former:
            if each.name not in UNREPEATED:
                signal.signal(each, signal.SIG_DFL)
        inbox.put(Ending(f"it was ended by {number.name}"))

    former |= catch(end)
