import re
import sqlite3
from contextlib import closing

import pytest

from ebjax.io.logs.open import kind_of, open_log
from ebjax.io.map_file.file import MapFile


@pytest.mark.parametrize("name", ["building.ebmap", "building.db", "building", "building.db3"])
def test_a_map_is_no_log(tmp_path, name):
    path = tmp_path / name
    MapFile.create(path, {}).close()
    words = f"^{re.escape(str(path))}: a map of ebjax; give it with --map to `python -m ebjax.slam`$"
    for ask in (kind_of, open_log):
        with pytest.raises(ValueError, match=words):
            ask(path)


def test_a_damaged_map_is_known_by_its_name(tmp_path):
    path = tmp_path / "building.ebmap"
    path.write_bytes(b"?" * 200)
    with pytest.raises(ValueError, match="a map of ebjax"):
        kind_of(path)


@pytest.mark.parametrize(("name", "kind"), [("a.db", "rtabmap"), ("a.db3", "bag"), ("a.sqlite", "rtabmap")])
def test_other_databases_are_what_they_were(tmp_path, name, kind):
    with closing(sqlite3.connect(tmp_path / name)) as database:
        database.execute("CREATE TABLE Node(id INTEGER)")
    assert kind_of(tmp_path / name) == kind
