"""The README's Python runs as it stands, block after block, as a newcomer would type it."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

README = Path(__file__).parents[1] / "README.md"


def blocks() -> list[str]:
    """What stands between ```python and ```."""
    return re.findall(r"^```python\n(.*?)^```$", README.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


@pytest.mark.whole
def test_the_python_of_the_readme_runs_as_it_stands(tmp_path):
    if not blocks():
        pytest.skip("the README has no block of Python")
    script = tmp_path / "readme.py"
    script.write_text("\n".join(blocks()), encoding="utf-8")
    found = subprocess.run([sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    assert "loop closures kept" in found.stdout
