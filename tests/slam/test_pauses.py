"""The search for cycles looks at what is new, and at everything again when the drive is over; turns are brief."""

import gc
import sys

from ebjax.slam import pauses


def test_objects_are_set_aside_each_time_the_keyframes_have_doubled():
    gc.unfreeze()
    try:
        grew, new = [], []
        for keyframes in range(1, 10):
            new += [[] for _ in range(1000)]
            before = gc.get_freeze_count()
            pauses.keep_short(keyframes)
            grew.append(gc.get_freeze_count() - before >= 1000)
        assert grew == [keyframes in (1, 2, 4, 8) for keyframes in range(1, 10)]
    finally:
        pauses.over()
    assert gc.get_freeze_count() == 0


def test_turns_are_brief_for_a_while():
    usual = sys.getswitchinterval()
    with pauses.brief_turns():
        assert sys.getswitchinterval() < usual / 10
    assert sys.getswitchinterval() == usual
