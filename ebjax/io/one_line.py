"""What another library says, in one line of ours."""

MOST = 200


def one_line(said: object) -> str:
    """The words of an error, in one line that is not too long."""
    return " ".join(str(said).split())[:MOST] or type(said).__name__
