"""OpenCV's FileStorage as plain values: its XML, and YAML that only OpenCV reads."""

from typing import Any


def _plain(node: Any) -> Any:
    if node.isMap():
        return {key: _plain(node.getNode(key)) for key in node.keys()}  # noqa: SIM118
    if node.isSeq():
        return [_plain(node.at(index)) for index in range(node.size())]
    if node.isInt() or node.isReal():
        return node.real()
    return node.string() if node.isString() else None


def file_storage(text: str) -> dict[str, Any] | None:
    """The values of a text that cv2.FileStorage reads; None where it does not."""
    import cv2

    text = text.lstrip()
    if text[:1] != "<" and ":" not in text:
        return None
    if text[:1] not in ("<", "{") and not text.startswith("%YAML"):
        text = f"%YAML:1.0\n---\n{text}"
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        values = _plain(storage.root())
    except (cv2.error, SystemError):
        return None
    finally:
        cv2.utils.logging.setLogLevel(level)
    return values if isinstance(values, dict) and values else None
