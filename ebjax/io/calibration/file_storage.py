"""OpenCV's FileStorage as plain values: its XML, and YAML that only OpenCV reads."""

import re
from typing import Any

from ebjax.io.json_text import MOST_DEPTH

BRACKET = re.compile(r"(?P<opens>[\[{])|[\]}]")
TAG = re.compile(r"(?P<opens><\w[^<>]*(?<!/)>)|</\w")


class _TooDeepError(Exception):
    """Nodes lie in each other more than MOST_DEPTH times."""


def _is_deep(text: str) -> bool:
    """Whether brackets or tags lie in each other more than MOST_DEPTH times; OpenCV's own stack would overflow."""
    depth = 0
    for mark in (TAG if text.startswith("<") else BRACKET).finditer(text):
        depth += 1 if mark["opens"] else -1
        if depth > MOST_DEPTH:
            return True
    return False


def _plain(node: Any, depth: int = 0) -> Any:
    if depth > MOST_DEPTH:
        raise _TooDeepError
    if node.isMap():
        return {key: _plain(node.getNode(key), depth + 1) for key in node.keys()}  # noqa: SIM118
    if node.isSeq():
        return [_plain(node.at(index), depth + 1) for index in range(node.size())]
    if node.isInt() or node.isReal():
        return node.real()
    return node.string() if node.isString() else None


def file_storage(text: str) -> dict[str, Any] | None:
    """The values of a text that cv2.FileStorage reads; None where it does not."""
    import cv2

    text = text.lstrip()
    if (text[:1] != "<" and ":" not in text) or _is_deep(text):
        return None
    if text[:1] not in ("<", "{") and not text.startswith("%YAML"):
        text = f"%YAML:1.0\n---\n{text}"
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        values = _plain(storage.root())
    except (cv2.error, SystemError, _TooDeepError):
        return None
    finally:
        cv2.utils.logging.setLogLevel(level)
    return values if isinstance(values, dict) and values else None
