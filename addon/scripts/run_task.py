# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs a program for Blender, and ends it when stdin ends. Standard library only, for Blender's Python.

    python run_task.py GRACE PROGRAM …

stdin is the pipe that Blender holds. It is closed to cancel the program, and by the system when Blender is
gone. The program and all that it started are then interrupted as CTRL-C in a terminal does it, and killed
where they have not ended GRACE seconds later. That must come from here: on Windows, which knows no other way
to ask a program to end, it reaches only what shares a console with the one who asks.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time


def main(grace: float, command: list[str]) -> int:
    """The program's exit status. One that ends by a signal ends this process by the same."""
    # A function, for SIG_IGN would be inherited by the program.
    signal.signal(signal.SIGINT, lambda *_: None)
    if sys.platform == "win32":
        import ctypes

        # Who was started deaf to CTRL-C passes that on: the program shall hear it.
        ctypes.windll.kernel32.SetConsoleCtrlHandler(None, False)
    try:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    except OSError as error:
        message = f"cannot start {command[0]}: {error.strerror or error}"
        content = {"error": {"message": message, "hint": "Check the path."}}
        sys.stdout.write(json.dumps(content) + "\n")
        return 1
    threading.Thread(target=end_with_stdin, args=(process, grace), daemon=True).start()
    status = process.wait()
    if sys.platform != "win32" and status < 0:
        if -status != signal.SIGKILL:
            signal.signal(-status, signal.SIG_DFL)
        os.kill(os.getpid(), -status)
    return status if status < 1 << 31 else status - (1 << 32)  # as Windows' own sign has it


def end_with_stdin(process: "subprocess.Popen[bytes]", grace: float) -> None:
    """Wait for the end of stdin, then end the program."""
    while os.read(0, 1024):
        pass
    if sys.platform == "win32":
        with contextlib.suppress(OSError):  # no console: what follows needs none
            os.kill(0, signal.CTRL_C_EVENT)  # 0: whatever shares this console
    else:
        os.killpg(0, signal.SIGINT)
    time.sleep(grace)  # the process ends meanwhile if the program does
    if sys.platform == "win32":
        subprocess.run(["taskkill", "/PID", str(process.pid), "/T", "/F"], capture_output=True, check=False)
    else:
        os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]), sys.argv[2:]))
