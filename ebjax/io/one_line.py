"""What others say, in one line of ours."""

MOST = 200


def one_line(said: object) -> str:
    """The words of an error, in one line that is not too long."""
    return " ".join(str(said).split())[:MOST] or type(said).__name__


def printable(name: str) -> str:
    """A name as it is, but for characters of a damaged one that no terminal prints."""
    return "".join(letter if letter.isprintable() else "?" for letter in name)
