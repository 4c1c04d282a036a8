"""What the repository as a whole promises: its top level, its configs, its dependencies, its two README commands."""

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from ebjax.__main__ import commands
from ebjax.config import dump_config, load_config

ROOT = Path(__file__).parents[1]
TOP = {"pyproject.toml", "ebjax", "notebooks", "tests", "configs", "README.md", "LICENSE"}
CONFIGS = sorted((ROOT / "configs").rglob("*.yaml"))
# Where it is not the module's own name:
DISTRIBUTION = {
    "backports": "backports.zstd",
    "cv2": "opencv-python-headless",
    "faiss": "faiss-cpu",
    "orbax": "orbax-checkpoint",
    "rerun": "rerun-sdk",
    "yaml": "pyyaml",
}

# Configs that are named by what they describe:
ROOM = {"worlds": "floors"}


def tracked() -> list[Path]:
    """Every file of the project, those included that are new and not ignored."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    try:
        listed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True, text=True).stdout
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("not a git checkout")
    return [Path(name) for name in listed.split("\0") if name and (ROOT / name).is_file()]


def test_top_level():
    top = {file.parts[0] for file in tracked()}
    assert {name for name in top if not name.startswith(".")} == TOP


def test_no_file_names_a_machine():
    path = re.compile(r"(?<![\w.~}/])/(?:work|home|root|farm|opt|Users)/[\w.]")
    host = re.compile("pythonhosted" + r"\.org|pypi" + r"\.org|conda" + r"\.anaconda|registry" + r"\.npmjs")
    for file in tracked():
        try:
            text = (ROOT / file).read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        for pattern in (path, host):
            found = pattern.search(text)
            assert not found, f"{file} names {found.group() if found else ''}"


def test_constraints_are_names_and_versions():
    for line in (ROOT / "configs" / "constraints.txt").read_text(encoding="utf-8").splitlines():
        assert re.fullmatch(r"[a-z0-9.-]+==[0-9][0-9a-z.]*( ; [a-z_]+ (==|!=|<|>=) .+)?", line), line
        assert "/" not in line and "@" not in line


def requirements(specifiers: list[str]) -> set[str]:
    return {re.split(r"[<>=!~\[; ]", text)[0].lower() for text in specifiers}


def imported(folder: str) -> set[str]:
    """Distributions whose modules the Python files of a folder import, inside functions too."""
    modules: set[str] = set()
    for file in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                modules |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                modules.add(node.module)
    own = {"ebjax", *(file.stem for file in (ROOT / folder).rglob("*.py"))} if folder == "tests" else {"ebjax"}
    names = {module.split(".")[0] for module in modules} - set(sys.stdlib_module_names) - own
    return {DISTRIBUTION.get(name, name).lower() for name in names}


def test_every_import_is_a_declared_dependency():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    core = requirements(project["dependencies"])
    extras = {name: requirements(names) for name, names in project["optional-dependencies"].items()}
    test = extras["test"]
    assert imported("ebjax") <= core.union(*extras.values()), "what ebjax imports, it or one of its extras must bring"
    assert imported("tests") <= core | test
    pinned = {line.split("==")[0] for line in (ROOT / "configs" / "constraints.txt").read_text().splitlines()}
    assert core | test <= pinned, "resolve configs/constraints.txt again (ebjax/README.md)"


def test_the_readme_sets_up_and_tests_as_the_checks_do():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    lines = [line.strip() for line in readme.splitlines() if line.strip().startswith("python3 -m venv .venv && ")]
    assert len(lines) == 2, "one line that sets up for the main job, one that passes the tests"
    setup, test = ([part.strip() for part in line.split("&&")] for line in lines)
    assert setup[-1] == "pip install -c configs/constraints.txt -e ."
    assert f"{lines[0]}\n    python -m ebjax.slam --out runs/demo\n" in readme
    checks = (ROOT / ".ci" / "run").read_text(encoding="utf-8").replace("--quiet ", "").splitlines()
    assert test[-2] in checks
    assert any(line.startswith(test[-1].removesuffix(' -m "not slow and not whole"')) for line in checks), "others too"


def test_the_readme_names_every_command():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    named = set(re.findall(r"python -m (ebjax\.\w+)", readme))
    assert named == set(commands()), "the README names exactly the commands that exist"


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: str(path.relative_to(ROOT / "configs")))
def test_config_is_read_by_the_command_it_names(path, tmp_path):
    header = [line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("#")]
    assert [line.partition(":")[0] for line in header[:3]] == ["# command", "# time", "# result"]
    words = header[0].split()
    module = words[words.index("-m") + 1]
    assert module == f"ebjax.{ROOM.get(path.parent.name, path.parent.name)}" and str(path.relative_to(ROOT)) in words
    command = importlib.import_module(f"{module}.__main__")
    by_task = path.parent.name == "train"
    config_class = command.command(command.task_of(["--config", str(path)])) if by_task else command.Config
    config = load_config(path, config_class)
    assert config != config_class(), "a config that changes nothing"
    dump_config(config, tmp_path / "again.yaml")
    assert load_config(tmp_path / "again.yaml", config_class) == config


def test_there_are_configs():
    assert CONFIGS
