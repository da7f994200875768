"""The pages: the site builds without a warning, and what they tell a reader to type does what they say."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from browser import Browser
from contrast import faint_texts, prefer
from doc_blocks import RUN, Reader, band, blocks, check_python, check_scene, commands, lacking, words

from cosim.cli import build_parser, main
from cosim.newproject import new_project

ROOT = Path(__file__).resolve().parents[1]
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
}
QUICK = [name for name, text in PAGES.items() if "<!-- slow: " not in text and blocks(text)]
SLOW = [name for name, text in PAGES.items() if "<!-- slow: " in text]


def read(name, folder):
    """Do what a page says."""
    text = PAGES[name]
    if missing := lacking(text):
        pytest.skip(f"{', '.join(missing)}: not here")
    reader = Reader(folder)
    typed = commands(text)
    if not any(line.startswith(("cosim new", "pip")) for line in typed[:2]):
        new_project(folder / "mydevice", 2)
        reader.folder = folder / "mydevice"
    reader.follow(text)


@pytest.mark.filterwarnings("ignore::cosim.caution.Doubt")
@pytest.mark.parametrize("name", QUICK)
def test_a_page_does_what_it_says(name, tmp_path):
    read(name, tmp_path)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::cosim.caution.Doubt")
@pytest.mark.parametrize("name", SLOW)
def test_a_long_page_does_what_it_says(name, tmp_path):
    read(name, tmp_path)


@pytest.mark.parametrize("name", PAGES)
def test_code_of_a_page_is_understood(name):
    """The quick look: commands parse, scenes hold known keys, Python compiles, what is not run says why."""
    for block in blocks(PAGES[name]):
        where = f"{name}:{block.line}"
        if block.kind == "check" or block.title or block.why_not:
            assert len(block.why_not) != 1, where
        else:
            assert block.kind in RUN, f"{where}: is not run and does not say why not"
        if block.kind == "text" and not block.why_not:
            band(block.mark)
        if block.kind == "toml" and not block.why_not and not block.title:
            check_scene(block.text)
        if block.kind == "python" and not block.why_not:
            check_python(block.text)
    for line in commands(PAGES[name]):
        (program, *arguments), _ = words(line)
        if program == "cosim" and arguments[0] != "--completion":
            build_parser().parse_args(arguments)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site as `make docs` builds it; every warning is an error."""
    folder = tmp_path_factory.mktemp("built") / "site"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_site_builds(site):
    """Pages and headings that links name are there, all pages in the menu; nothing comes from the network."""
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|link|iframe)\b[^>]*?(?:src|href)=[\"']?([^\"' >]+)", text)
        assert not [each for each in loaded if each.startswith(("http", "//"))], page.name
        for picture in re.findall(r"<img\b[^>]*>", text):
            assert re.search(r'alt="[^"]{12,}"', picture), f"{page.name}: {picture}"
        assert "$$" not in re.sub(r"<(pre|code)\b.*?</\1>", "", text, flags=re.DOTALL), page.name


@pytest.mark.parametrize("name", [name for name, text in PAGES.items() if "![" in text])
def test_a_picture_says_what_to_see(name):
    """A caption of a sentence or more stands right below it."""
    picture = re.compile(r"^!\[([^\]]*)\]\([^)]+\)\n\s*(.*?)\n\n", re.MULTILINE | re.DOTALL)
    match = picture.findall(PAGES[name])
    assert len(match) == PAGES[name].count("![")
    for alternative, caption in match:
        assert len(alternative) > 30
        assert re.fullmatch(r"\*[^*]{60,}\.\*", caption, re.DOTALL), caption


#: What a designer asks, and the page that answers it.
ASKED = {
    "op-amp": "how-to/vendor-part.html",
    "held contact": "glossary.html",
    "csv": "how-to/read-results.html",
    "tolerance one resistor": "tutorials/first-monte-carlo.html",
    "not modelled": "explanation/not-modelled.html",
    "slurm": "how-to/cluster.html",
    "unstable refused": "how-to/own-board.html",
    "how accurate": "tutorials/how-accurate.html",
    "kicad": "how-to/kicad-ltspice.html",
    "control law": "how-to/own-law.html",
}
_SEARCH = """
(async () => {
  const field = document.querySelector('.md-search__input');
  document.getElementById('__search').click();
  field.focus();
  field.value = ASKED;
  field.dispatchEvent(new KeyboardEvent('keyup', {bubbles: true}));
  for (let tries = 0; tries < 200; tries++) {
    await new Promise(done => setTimeout(done, 50));
    const links = [...document.querySelectorAll('.md-search-result__item > .md-search-result__link')];
    if (links.length) return links.slice(0, 3).map(link => link.pathname.split('/site/').pop());
  }
  return [];
})()
"""


@pytest.mark.browser
@pytest.mark.few(2)
@pytest.mark.parametrize("asked", ASKED)
def test_a_question_finds_its_page_without_a_server(site, asked):
    """Pages opened from disk search as well: the answer is among the first three, and no network is asked."""
    with Browser() as browser:
        visit = browser.visit(site / "index.html")
        assert visit.complaints == []
        assert all(request.startswith("file:") for request in visit.requests)
        assert ASKED[asked] in browser.evaluate(_SEARCH.replace("ASKED", json.dumps(asked)))


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.slow)])
def test_pages_can_be_read_on_a_telephone_and_in_the_dark(site, scheme):
    pages = ("paper", "glossary", "tutorials/first-monte-carlo", "explanation/exact-propagation",
             "how-to/cluster", "reference/scene", "reference/python")  # fmt: skip
    with Browser() as browser:
        prefer(browser, scheme)
        for page in pages:
            browser.visit(site / f"{page}.html")
            for width in (420, 1280):
                browser.resize(width, 800)
                browser.evaluate("new Promise(done => setTimeout(done, 300))")  # the menu slides
                assert browser.evaluate("document.documentElement.scrollWidth") <= width, page
                seen, faint = faint_texts(browser, ".md-search, .md-skip, .headerlink, .md-top, .md-tabs")
                assert seen > 50
                assert faint == {}, page


def test_the_command_tells_where_the_pages_are(tmp_path, monkeypatch, capsys):
    """With a built site it names the folder; without, it says how to make one."""
    from cosim import assets

    monkeypatch.setattr(assets, "_PACKAGE", tmp_path / "cosim")
    assert main(["docs", "--where"]) == 1
    assert "make docs" in capsys.readouterr().err
    (tmp_path / "cosim/data/docs").mkdir(parents=True)
    (tmp_path / "cosim/data/docs/index.html").write_text("pages")
    assert main(["docs", "--where"]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "cosim/data/docs")


def test_the_command_serves_the_pages(tmp_path):
    """A browser of this machine gets the first page; Ctrl-C ends it well."""
    import signal
    from urllib.request import urlopen

    (tmp_path / "index.html").write_text("first page")
    code = (
        "import sys; from pathlib import Path; import cosim.assets as a;"
        "a.docs_folder = lambda: Path(sys.argv[1]); from cosim.cli import main; sys.exit(main(['docs']))"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as server:
        address = server.stdout.readline().split()[0]
        with urlopen(address) as page:
            assert page.read() == b"first page"
        server.send_signal(signal.SIGINT)
        rest, _ = server.communicate(timeout=20)
        assert (rest.strip(), server.returncode) == ("ended", 0)
