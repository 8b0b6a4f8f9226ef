"""Runs a command on a GPU that no other worker of this machine uses.

    lease.py 0,1 ffgs run ...        waits until GPU 0 or 1 is free, and adds --device gpu:N
    lease.py '' ffgs run ...         adds --device cpu

The lock is the system's: it ends with the processes that hold it, however they end.
"""

import fcntl
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def run(gpus, command):
    """Returns the command's exit status."""
    if not gpus:
        return subprocess.call([*command, "--device", "cpu"])
    while True:
        for gpu in gpus:
            with open(Path(tempfile.gettempdir()) / f"ffgs-gpu-{gpu}.lock", "w") as lock:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    continue
                # The command holds the lock too: it may outlive this process.
                return subprocess.call([*command, "--device", f"gpu:{gpu}"], pass_fds=[lock.fileno()])
        time.sleep(1)


if __name__ == "__main__":
    sys.exit(run([gpu for gpu in sys.argv[1].split(",") if gpu], sys.argv[2:]))
