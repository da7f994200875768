"""What README and the page on the paper name is there; `test_docs.py` runs what they tell to type."""

import re
from pathlib import Path

from doc_blocks import blocks, commands

from cosim.newproject import new_project

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAPER = (ROOT / "docs/paper.md").read_text(encoding="utf-8")


def test_what_the_readme_names_exists():
    for text in (README, PAPER):
        for target in re.findall(r"^make (\w+)", text, re.M):
            assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.M), target
    for target in re.findall(r"\]\(([^):]+)\)", README):
        assert (ROOT / target).exists(), target


def test_the_readme_is_short_and_gets_to_a_run():
    """What it is, one picture, one line for the system, two commands, five minutes, links: two screens."""
    assert len(README.splitlines()) < 120
    assert README.count("![") == 1
    assert commands(README)[:2] == [". .venv/bin/activate", "cosim new mydevice"]
    assert any(block.kind == "python" for block in blocks(README))


def test_studies_that_the_pages_name_are_where_they_say(tmp_path):
    """In the tutorial's project of two joints, or, told so, in one of one joint."""
    for joints in (1, 2):
        new_project(tmp_path / str(joints), joints)
    held = {j: {path.name for path in (tmp_path / str(j) / "scenes/paper").glob("*.toml")} for j in (1, 2)}
    for page in (ROOT / "docs/how-to").glob("*.md"):
        for paragraph in page.read_text(encoding="utf-8").split("\n\n"):
            for name in re.findall(r"(\d\w*_\w+\.toml)", paragraph):
                assert name in held[1 if "--joints 1" in paragraph else 2], name
    shipped = {path.name for path in (ROOT / "scenes/paper").glob("*.toml")}
    assert set(re.findall(r"(\d\w*_\w+\.toml)", PAPER)) <= shipped
