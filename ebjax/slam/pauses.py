"""Python's search for cycles of objects, kept short while a robot drives.

A full search stops every thread while it looks at all objects that could be part of a cycle. JAX and its programs have
four hundred thousand of them, which takes longer than some keyframes together. Objects that are there already are set
aside: what is new since then is all that is looked at.
"""

import gc


def keep_short(keyframes: int) -> None:
    """Sets aside all that there is, each time that the number of keyframes has doubled."""
    if keyframes & (keyframes - 1) == 0:
        gc.freeze()


def over() -> None:
    """Lets everything be looked at again."""
    gc.unfreeze()
