"""What would stop a robot's thread for longer than a keyframe takes, kept short.

A full search for cycles of objects stops every thread while it looks at all objects that could be part of one. JAX and
its programs have four hundred thousand of them. Objects that are there already are set aside: what is new since then is
all that is looked at.

While a program is compiled beside the drive, Python traces it, and a thread that wants a turn gets one after 5 ms. A
keyframe asks for hundreds of turns.
"""

import contextlib
import gc
import sys
from collections.abc import Iterator

TURN_S = 1e-4
"""How long Python may go on in one thread while another waits, when much is traced beside a drive."""


def keep_short(keyframes: int) -> None:
    """Sets aside all that there is, each time that the number of keyframes has doubled."""
    if keyframes & (keyframes - 1) == 0:
        gc.freeze()


def over() -> None:
    """Lets everything be looked at again."""
    gc.unfreeze()


@contextlib.contextmanager
def brief_turns() -> Iterator[None]:
    """Inside, no thread waits long for its turn."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(min(usual, TURN_S))
    try:
        yield
    finally:
        sys.setswitchinterval(usual)
