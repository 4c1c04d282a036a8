"""What was written of a log, in lines and for JSON."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SHOWN = 5
ROUNDED_MM = 0.05


@dataclass
class Written:
    """A folder in TUM layout.

    Attributes:
      out: the folder.
      colour: stamp -> file name.
      depth: stamp -> file name.
      left_out: why, a line each.
      rounded_mm: the most that depth was rounded by, in this call.
      too_far: pixels whose depth does not fit into the file, in this call.
    """

    out: Path
    colour: dict[str, str] = field(default_factory=dict)
    depth: dict[str, str] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    rounded_mm: float = 0.0
    too_far: int = 0

    def lines(self) -> list[str]:
        """To print."""
        said = [f"left out: {fault}" for fault in self.left_out[:SHOWN]]
        if len(self.left_out) > SHOWN:
            said.append(f"left out: {len(self.left_out)} in all, {self.out / 'left_out.txt'} lists them")
        if self.rounded_mm > ROUNDED_MM:
            said.append(f"depth is rounded to millimetres, by {self.rounded_mm:.1f} mm at most")
        if self.too_far:
            said.append(f"depth beyond 65.534 m is left out, {self.too_far} pixels")
        counts = f"{len(self.colour)} images, {len(self.depth)} depth images"
        return [*said, f"{self.out}: {counts} written; run python -m ebjax.slam {self.out}"]

    def facts(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "path": str(self.out),
            "images": len(self.colour),
            "depth": len(self.depth),
            "left_out": self.left_out,
            "depth_rounded_mm": self.rounded_mm,
            "depth_too_far": self.too_far,
        }
