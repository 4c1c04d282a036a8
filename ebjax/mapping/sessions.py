"""Which session of a map a run goes on with, which others the engine knows, and which are left over.

A recorded run may be driven several times, as its camera turns out to be mounted or to lean otherwise. Every drive is a
session by itself, an attempt, so that a drive that is killed goes on and those before it can still be read. The last
one stays when the run is finished.
"""

from collections.abc import Iterable
from typing import Any

from ebjax.io.map_file.rows import SessionRow

LOG, FIRST_STAMP_S, AGAIN, AGREES = "log", "first_stamp_s", "again", "agrees"
"""Facts of a session: which run it is, whether it is a later attempt, and what must agree to go on with it."""


def facts_of(log: str, first_stamp_s: float, agrees: dict[str, Any], *, again: bool) -> dict[str, Any]:
    """The facts of a session."""
    return {LOG: log, FIRST_STAMP_S: float(first_stamp_s), AGAIN: again, AGREES: agrees}


def of_run(sessions: Iterable[SessionRow], log: str, first_stamp_s: float) -> list[SessionRow]:
    """The sessions of a run."""
    run = log, first_stamp_s
    return [one for one in sessions if (one.facts.get(LOG), one.facts.get(FIRST_STAMP_S)) == run]


def left_over(of_one_run: list[SessionRow]) -> list[int]:
    """Attempts that nothing goes on with: a finished one has replaced them, or the first of them is gone."""
    last = max((one.id for one in of_one_run if one.finished), default=0)
    unfinished = [one for one in of_one_run if not one.finished]
    goes_on = any(one.id > last and not one.facts[AGAIN] for one in unfinished)
    return [one.id for one in unfinished if one.id < last or not goes_on]


def known(sessions: Iterable[SessionRow], current: SessionRow) -> set[int]:
    """What the engine knows of a map: the session that is added to, finished ones, and first attempts of other runs."""
    run = current.facts.get(LOG), current.facts.get(FIRST_STAMP_S)
    return {
        one.id
        for one in sessions
        if one.id == current.id
        or one.finished
        or ((one.facts.get(LOG), one.facts.get(FIRST_STAMP_S)) != run and not one.facts.get(AGAIN))
    }
