"""Which columns of a table hold a pose and its time."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Layout:
    """Columns, counted from 0.

    Attributes:
      time: one column, or two: whole seconds and the nanoseconds beside them; none for a file without times.
      position: x and y, or x, y and z.
      quaternion: w, x, y, z.
      angles: roll, pitch and yaw, or yaw alone.
      matrix: the 12 or 16 numbers of a matrix, row-major, in place of all these.
      time_unit: s, ms, us or ns; "" where the file does not say.
      position_unit: m, cm or mm.
      angle_unit: rad or deg; "" where the file does not say.
      named: whether the columns are known by name: from a header, or from the program that writes them so.
      says: how the columns were understood, for notes.
    """

    time: tuple[int, ...] = ()
    position: tuple[int, ...] = ()
    quaternion: tuple[int, ...] = ()
    angles: tuple[int, ...] = ()
    matrix: tuple[int, ...] = ()
    time_unit: str = ""
    position_unit: str = "m"
    angle_unit: str = ""
    named: bool = False
    says: tuple[str, ...] = ()

    @property
    def pose(self) -> tuple[int, ...]:
        """Every column but the time's."""
        return self.position + self.quaternion + self.angles + self.matrix
