"""The things that were asked for last, so many at most."""

from collections import OrderedDict
from typing import Generic, TypeVar

Key = TypeVar("Key")
Thing = TypeVar("Thing")


class Latest(Generic[Key, Thing]):
    """By key; one that comes when there are `most` drops the one that was not asked for the longest."""

    def __init__(self, most: int):
        self._most = most
        self._things: OrderedDict[Key, Thing] = OrderedDict()

    def __contains__(self, key: Key) -> bool:
        return key in self._things

    def __getitem__(self, key: Key) -> Thing:
        self._things.move_to_end(key)
        return self._things[key]

    def __setitem__(self, key: Key, thing: Thing) -> None:
        self._things[key] = thing
        if len(self._things) > self._most:
            self._things.popitem(last=False)
