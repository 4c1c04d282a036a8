"""What would stop a robot's thread for longer than a keyframe takes, kept short.

A full search for cycles of objects stops every thread while it looks at all objects that could be part of one. JAX has
hundreds of thousands of them, for as long as the process lives. They are set aside: only what came later is looked at.

While a program is compiled beside the drive, Python traces it, and a thread that wants a turn gets one after 5 ms. A
keyframe asks for hundreds of turns.
"""

import contextlib
import gc
import sys
from collections.abc import Iterator

TURN_S = 1e-4
"""How long Python may go on in one thread while another waits, when much is traced beside a drive."""


def keep_short() -> None:
    """Sets aside what there is, once in a process: what is a run's own must be found when it is let go of."""
    if not gc.get_freeze_count():
        gc.collect()
        gc.freeze()


@contextlib.contextmanager
def brief_turns() -> Iterator[None]:
    """Inside, no thread waits long for its turn."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(min(usual, TURN_S))
    try:
        yield
    finally:
        sys.setswitchinterval(usual)
