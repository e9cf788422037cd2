"""The documentation site: it builds without a warning, shows everything, and needs no other server."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from kit import shards
from kit.driven_page import Opened, assert_same_motion
from lxml import html
from markdown_it import MarkdownIt

pytestmark = shards.documents

ROOT = Path(__file__).parents[2]
# those of docs/reference are filled in by the site
LEFT_OUT = r"(\.|build/|docs/reference/|orchestrator/pages/vendor/)"
NAMES = (p.relative_to(ROOT).as_posix() for p in ROOT.rglob("*.md"))
DOCUMENTS = sorted(name for name in NAMES if not re.match(LEFT_OUT, name))
FETCHING = "//script/@src | //img/@src | //iframe/@src | //source/@src | //link[@rel != 'canonical']/@href"


@pytest.fixture(scope="session")
def site(fmu_dir, once):
    """The site, built as `make docs` does, once for all test processes."""
    return once("site", lambda folder: build_site(folder, fmu_dir / "harvester.ssp"))


def build_site(folder, system):
    """Build the site with the machine of a system on its home page."""
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-c", "docs", ".", str(folder)]
    command += ["-D", f"machine_system={system}"]
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def pages(site):
    """All pages by their path in the site."""
    return {p.relative_to(site).as_posix(): html.parse(str(p)).getroot() for p in site.rglob("*.html")}


@pytest.mark.parametrize("document", DOCUMENTS)
def test_a_page_shows_what_a_git_server_shows(pages, document):
    """Two readers of Markdown, the site's and one like that of git servers, find as many of everything."""
    text = (ROOT / document).read_text(encoding="utf-8")
    plain = html.fromstring(f"<div>{MarkdownIt('gfm-like', {'linkify': False}).render(text)}</div>")
    (page,) = pages[document.replace(".md", ".html")].xpath("//article")
    for tag in ("h1", "h2", "h3", "table", "tr", "pre", "img", "strong"):
        assert len(page.xpath(f".//{tag}")) == len(plain.xpath(f".//{tag}")), tag


def test_links_lead_somewhere(site, pages):
    """Every link inside the site leads to a file, and to a place in it."""
    for name, page in pages.items():
        for link in page.xpath(f"//a/@href | {FETCHING}"):
            if link.startswith(("http:", "https:", "mailto:", "data:", "tcp:")):
                continue
            path, _, anchor = link.partition("#")
            path = path.partition("?")[0]
            there = (site / name).parent / path if path else site / name
            there = there / "index.html" if there.is_dir() else there
            assert there.is_file(), f"{name}: {link}"
            if anchor and there.suffix == ".html":
                known = pages[there.resolve().relative_to(site.resolve()).as_posix()]
                assert known.xpath("//*[@id=$id]", id=anchor), f"{name}: {link}"


def test_nothing_comes_from_other_servers(site, pages):
    """No page and no style names a script, a font, a style or a picture elsewhere."""
    for name, page in pages.items():
        assert [u for u in page.xpath(FETCHING) if re.match(r"(https?:)?//", u)] == [], name
    for style in site.rglob("*.css"):
        text = style.read_text(encoding="utf-8")
        assert not re.search(r"(url\(|@import)\s*[\"']?(https?:)?//", text), style


def test_the_reference_is_complete(pages):
    """It has every command, variant, parameter, rule of the check, and each public name as an anchor."""
    import fmus
    import orchestrator.studies
    from fmus.contract import quantities
    from fmus.machine.parts import FAMILIES
    from orchestrator.check.checking import RULES
    from orchestrator.cli import app

    def text(name: str) -> str:
        return pages[f"docs/reference/{name}.html"].xpath("string(//article)")

    for command in app.registered_commands:
        assert pages["docs/reference/commands.html"].xpath("//section[@id=$id]", id=command.callback.__name__)
    for family in FAMILIES.values():
        for variant, sub in family.items():
            assert variant in text("variants")
            declared = quantities(sub.parameters)  # of a list, the name of the whole
            rows = (f"{n.rpartition('_')[0]}s" if q.listed else n for n, q in declared.items())
            assert all(name in text("parameters") for name in rows)
            assert all(name in text("ports") for name in quantities(sub.outputs))
    assert all(rule.id in text("check-rules") for rule in RULES)
    anchors = [a for name, page in pages.items() if "/api/" in name for a in page.xpath("//article//@id")]
    for package in (fmus, orchestrator, orchestrator.studies):
        names = [f"{package.__name__}.{name}" for name in package.__all__]
        assert [name for name in names if anchors.count(name) != 1] == []


def test_tables_of_docstrings_and_equations(pages):
    """What `run` says of its arguments, with continued lines; the browser itself sets formulas."""
    rows = pages["docs/reference/api/running.html"].xpath("//tr[td[1]//code='step']/td[2]")
    assert "Communication step [s]" in rows[0].text_content()
    assert "1e-3" in rows[0].text_content()
    assert len(pages["docs/equations.html"].xpath("//*[local-name()='math']")) > 20
    for name, page in pages.items():
        assert "\\frac" not in page.xpath("string(//article)"), name


def test_the_search_works_in_a_page_opened_as_a_file(site, chromium):
    """A browser without a server finds physics before Python, and asks no other server for anything."""
    asked, faults = [], []
    page = chromium.new_page()
    page.set_default_timeout(60e3)  # ms; only bounds a failure, on a computer that does much else
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda fault: faults.append(str(fault)))
    page.goto((site / "index.html").as_uri())
    page.fill(".sidebar-search", "cavitation")
    page.keyboard.press("Enter")
    page.wait_for_selector("#search-results li")
    page.wait_for_function("document.querySelector('.search-summary').innerText.includes('found')")
    found = page.eval_on_selector_all("#search-results li a", "links => links.map((link) => link.pathname)")
    page.close()
    physics, python = ([k for k, x in enumerate(found) if kind in x] for kind in ("docs/equations", "/api/"))
    assert max(physics) < min(python)
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:", "about:"))] == []
    assert faults == []


def test_the_machine_on_the_home_page(site, fmi3_dir, chromium, tmp_path):
    """The home page opened from disk has the machine, which keys move as `harvester run` does."""
    page = Opened(chromium, site / "docs" / "index.html")
    assert_same_motion(page, fmi3_dir / "harvester.fmu", tmp_path)
    page.context.close()


# the scripts of the home page and the largest page take longest; both colour schemes have one style sheet
ACCESSIBLE = [(name, scheme) for name in ("docs/index", "search") for scheme in ("light", "dark")]
ACCESSIBLE += [("docs/equations", "light"), ("docs/reference/api/running", "dark")]


@pytest.mark.parametrize(("name", "scheme"), ACCESSIBLE)
def test_pages_are_accessible(site, chromium, name, scheme):
    """axe-core finds no violation on the home page, among equations and signatures, in the search."""
    context = chromium.new_context(color_scheme=scheme, reduced_motion="reduce")
    page = context.new_page()
    page.goto((site / f"{name}.html").as_uri())
    found = Axe().run(page).response["violations"]
    context.close()
    assert [(v["id"], [n["target"] for n in v["nodes"]]) for v in found] == []
