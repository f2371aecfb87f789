"""What the workers of test_fleet do; in a module of its own, so that they start soon."""

import os
import signal
from pathlib import Path


def doubled(number: int, dies: str) -> int:
    """Twice the number. A worker that has 3 is killed: "always", or until the named file is there."""
    if number == 3 and dies:
        if dies == "always":
            os.kill(os.getpid(), signal.SIGKILL)
        if not Path(dies).exists():
            Path(dies).touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number
