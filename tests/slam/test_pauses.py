"""The search for cycles leaves out what was there before the first run, and turns are brief."""

import gc
import sys
import weakref

from ebjax.slam import pauses


class Knot:
    """An object that only the search for cycles frees."""

    def __init__(self):
        self.self = self


def test_what_was_there_is_set_aside_and_what_comes_later_is_freed():
    gc.unfreeze()
    try:
        old = weakref.ref(Knot())
        pauses.keep_short()
        assert old() is None, "what nobody holds is not set aside"
        count = gc.get_freeze_count()
        assert count > 1000
        new, _ = weakref.ref(Knot()), [[] for _ in range(1000)]
        pauses.keep_short()
        assert gc.get_freeze_count() <= count, "once in a process"
        gc.collect()
        assert new() is None
    finally:
        gc.unfreeze()


def test_turns_are_brief_for_a_while():
    usual = sys.getswitchinterval()
    with pauses.brief_turns():
        assert sys.getswitchinterval() < usual / 10
    assert sys.getswitchinterval() == usual
