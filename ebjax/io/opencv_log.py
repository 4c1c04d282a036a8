"""OpenCV's own log, which would stand between the lines of a command."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import cv2

SILENT = 0
_one_at_a_time = threading.Lock()


def set_log_level(level: int) -> int:
    """Sets OpenCV's log level and returns the one before; OpenCV 5 has moved the function."""
    return cv2.setLogLevel(level) if hasattr(cv2, "setLogLevel") else cv2.utils.logging.setLogLevel(level)


@contextmanager
def quiet() -> Iterator[None]:
    """Silences OpenCV's own log. Its FFmpeg has a level that is fixed at first use, so it is left alone."""
    with _one_at_a_time:
        level = set_log_level(SILENT)
        try:
            yield
        finally:
            set_log_level(level)
