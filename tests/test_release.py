"""What is released: one version everywhere; archives that install and run in an environment of their own."""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml

import cosim

ROOT = Path(__file__).resolve().parents[1]


def test_the_version_is_one():
    """Of the package, its metadata, the citation and the newest dated section of the changelog."""
    metadata = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    dated = re.search(r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d\d-\d\d)$", changelog, re.MULTILINE)
    assert dated is not None
    assert metadata["version"] == cosim.__version__ == dated[1]
    assert re.search(rf"^version: {re.escape(dated[1])}$", citation, re.MULTILINE)
    assert f'date-released: "{dated[2]}"' in citation
    home = (ROOT / "docs/index.md").read_text(encoding="utf-8")
    assert f"cosim-{cosim.__version__}-py3-none-any.whl" in home


def test_the_citation_is_one():
    """What the Citation File Format 1.2.0 requires; cffconvert --validate agrees."""
    text = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(text)
    assert text["cff-version"] == "1.2.0"
    assert text["type"] in ("software", "dataset")
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", text["date-released"])
    assert isinstance(text["version"], str)
    assert text["license"] == tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["license"]
    person = {"family-names", "given-names", "affiliation", "email", "orcid", "alias", "website"}
    for entry in (text, *text.get("references", [])):
        assert entry["title"]
        for author in entry["authors"]:
            assert author
            assert set(author) <= person or "name" in author
    assert all({"type", "title", "authors"} <= set(each) for each in text["references"])
    assert len(set(text["keywords"])) == len(text["keywords"])


def test_readme_and_site_lead_to_what_a_contributor_needs():
    readme, menu = ((ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "mkdocs.yml"))
    for name in ("SECURITY.md", "CONTRIBUTING.md", "ARCHITECTURE.md", "CITATION.cff"):
        assert f"]({name})" in readme
        assert (ROOT / name).is_file()
    for page in ("reference/security.md", "reference/contributing.md"):
        assert page in menu


def run(command, folder, **more):
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, **more)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """Sdist and wheel, built from the tracked files as `make dist` does; the wheel from the sdist."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode != 0:
        pytest.skip("not a checkout: what belongs to it is not known")
    source = tmp_path_factory.mktemp("source")
    for name in filter(None, listed.stdout.split("\0")):
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, source / name)
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(source)}
    run([sys.executable, "-m", "mkdocs", "build", "--strict"], source, env=quiet)
    out = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-m", "build", "--no-isolation", "-o", str(out), str(source)]
    if subprocess.run(build, capture_output=True, check=False).returncode != 0:
        build.remove("--no-isolation")  # fetches the build backend
        run(build, source)
    (sdist,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    return sdist, wheel


@pytest.mark.slow
def test_archives_hold_what_they_need_and_no_more(archives):
    sdist, wheel = archives
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    assert "cosim/data/docs/index.html" in names
    assert "cosim/data/netlists/board2.cir" in names
    assert {"cosim/py.typed", "mech/py.typed", "reports/py.typed"} <= set(names)  # types are for users, too
    assert not [name for name in names if name.startswith(("tests/", "benchmarks/", "examples/"))]
    assert sum(archive.getinfo(name).file_size for name in names) < 30e6
    with tarfile.open(sdist) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    assert {"README.md", "CITATION.cff", "SECURITY.md", "docs/index.md", "site/index.html"} <= held
    assert {"tests/test_release.py", "examples/monte_carlo.ipynb"} <= held


@pytest.mark.slow
@pytest.mark.parametrize("kind", [0, 1], ids=["sdist", "wheel"])
def test_an_archive_lays_out_a_project_and_runs_it_anywhere(kind, archives, tmp_path):
    """In an environment of its own, which borrows only the installed dependencies."""
    venv = tmp_path / "venv"
    run([sys.executable, "-m", "venv", str(venv)], tmp_path)
    python, program = venv / "bin" / "python", venv / "bin" / "cosim"
    packages = next((venv / "lib").glob("python*/site-packages"))
    # an import by path only: the checkout's own editable install is not followed
    dependencies = Path(np.__file__).parents[1]
    (packages / "dependencies.pth").write_text(f"import sys; sys.path.append({str(dependencies)!r})\n")
    install = [python, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--no-build-isolation"]
    if subprocess.run([python, "-c", "import hatchling"], check=False, capture_output=True).returncode:
        install = install[:-2]  # an sdist's build backend is fetched
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    run([*install, str(archives[kind])], tmp_path, env=environment)
    elsewhere = tmp_path / "else where"
    elsewhere.mkdir()

    def typed(*arguments):
        return run([program, *arguments], elsewhere, env=environment)

    where = run([python, "-c", "import cosim; print(cosim.__file__)"], elsewhere, env=environment)
    assert str(venv) in where
    assert typed("--version").strip() == f"cosim {cosim.__version__}"
    assert (Path(typed("docs", "--where").strip()) / "tutorials/first-wall.html").is_file()
    typed("new", "mydevice")
    typed("run", "mydevice/scenes/slope.toml", "-o", "out", "--set", "duration_s=0.5")
    typed("report", "out")
    assert (elsewhere / "out" / "report" / "report.html").stat().st_size > 100_000
    assert "18 amplifiers" in typed("plan", "mydevice/scenes/press.toml")
