"""The package as others see it: metadata, platforms, licences, and the reference of its public names."""

from __future__ import annotations

import platform
import re
import subprocess
import sys
import tomllib
import zipfile
from email import message_from_string
from itertools import product
from pathlib import Path
from runpy import run_path
from typing import Any

import pytest
import yaml
from hatchling.builders.wheel import WheelBuilder
from hatchling.metadata.core import ProjectMetadata
from hatchling.metadata.spec import get_core_metadata_constructors
from hatchling.plugin.manager import PluginManager
from kit import shards
from kit.mistakes import entry
from kit.needs import lacks
from lxml import html
from markdown_it import MarkdownIt
from packaging.requirements import Requirement

from orchestrator.base import extras
from orchestrator.base.extras import EXTRAS, NO_WHEEL

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
VERSIONS = {"tested": ["-c", "constraints.txt"], "newest": ["--prerelease", "if-necessary"]}
PLATFORMS = {name: tuple(pair) for name, pair in entry(__file__, "platforms").items()}


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def resolve():
    """The command of uv that resolves packages, with the index of pip's settings, which uv does not read."""
    command = [sys.executable, "-m", "pip", "config", "list"]
    settings = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    url = re.search(r"\.index-url='(.+)'", settings)
    resolve = [sys.executable, "-m", "uv", "pip", "compile", "--quiet"]
    resolve += ["--default-index", url[1]] if url else []
    done = subprocess.run([*resolve, "-"], input="packaging", capture_output=True, text=True)
    if done.returncode:
        lacks("a package index", done.stderr.strip()[:300])
    return resolve


def _shard(where: str, python: str, versions: str) -> Any:
    """Each platform tested with the oldest and the newest Python, and newest with one; else no time."""
    ends = python in (PYTHONS[0], PYTHONS[-1])
    one = (PYTHONS.index(python) - list(PLATFORMS).index(where)) % len(PYTHONS) == 0
    return shards.platforms if (ends if versions == "tested" else one) else shards.targets


RESOLUTIONS = [pytest.param(*c, marks=_shard(*c)) for c in product(PLATFORMS, PYTHONS, VERSIONS)]


@pytest.mark.parametrize(("where", "python", "versions"), RESOLUTIONS)
def test_all_extras_together_resolve_to_wheels(where, python, versions, resolve):
    """So each of them does, too: with the versions of constraints.txt, and with the newest ones."""
    asked = ["--only-binary", ":all:", "--python-platform", where, "--python-version", python]
    command = [*resolve, "--all-extras", *asked, *VERSIONS[versions], "pyproject.toml"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("where", PLATFORMS.values(), ids="-".join)
def test_a_command_knows_what_its_platform_lacks(where, monkeypatch):
    """pyproject.toml excludes what NO_WHEEL has, and a command says so instead of what to install."""
    names = {"Linux": "linux", "Windows": "win32", "Darwin": "darwin"}
    here = {"platform_system": where[0], "sys_platform": names[where[0]], "platform_machine": where[1]}
    monkeypatch.setattr(platform, "system", lambda: where[0])
    monkeypatch.setattr(platform, "machine", lambda: where[1])
    monkeypatch.setattr(extras, "_installed", lambda _: False)
    for extra, modules in EXTRAS.items():
        wanted = [Requirement(line) for line in PROJECT["optional-dependencies"][extra]]
        lacking = [module for module in modules if where in NO_WHEEL.get(module, ())]
        assert len([r for r in wanted if r.marker and not r.marker.evaluate(here)]) == len(lacking)
        says = f"no wheel for {' on '.join(where)}" if lacking else "install with: pip install"
        with pytest.raises(extras.MissingExtra, match=f"it needs the packages? {modules[0]}.*{says}"):
            extras.require(extra, "it")


def test_the_table_of_extras_in_the_readme():
    """It has each extra with what needs it, as tools/extras.py prints it; sizes are those of one computer."""
    rows = re.findall(r"^\| (none|`\[\w+\]`) \|.*\| (\d+) \|$", text("README.md"), re.MULTILINE)
    sizes = {name.strip("`[]"): float(size) for name, size in rows}
    assert run_path(str(ROOT / "tools" / "extras.py"))["table"](sizes.pop("none"), sizes) in text("README.md")
    assert [*sizes] == [*EXTRAS, "all"]


def test_the_lock_has_the_tested_versions_with_hashes():
    """`make constraints` writes both files; each package of lock.txt has the SHA-256 of its files."""
    locked = [line.partition("--hash=sha256:") for line in text("lock.txt").replace("\\\n", "").splitlines()]
    versions = [version.strip() for version, _, hashes in locked if hashes]
    assert versions == text("constraints.txt").splitlines()


@pytest.fixture(scope="module")
def metadata():
    """The metadata of the wheel."""
    project = ProjectMetadata(str(ROOT), PluginManager())
    return message_from_string(get_core_metadata_constructors()["2.4"](project))


def test_the_metadata_is_complete(metadata):
    """Authors, licence as SPDX expression with its files, and the versions of Python that are resolved."""
    assert metadata["Author"] == "harvester-cosim contributors"
    assert metadata["License-Expression"] == "MIT"
    assert {"LICENSE", "NOTICES.md"} <= {*metadata.get_all("License-File")}
    classifiers = "\n".join(metadata.get_all("Classifier"))  # hatchling has checked that each exists
    assert re.findall(r"^Programming .* (3\.\d+)$", classifiers, re.MULTILINE) == [*PYTHONS]
    assert metadata["Project-URL"] is None, "CONTRIBUTING.md says that there is no public address"


def test_the_description_has_no_link_into_the_repository(metadata):
    """In a package index such links and pictures lead nowhere; the text around them stays."""
    description = metadata.get_payload()
    page = html.fromstring(MarkdownIt("gfm-like", {"linkify": False}).render(description))
    assert [link for link in page.xpath("//@href | //@src") if not link.startswith("https://")] == []
    assert "measured results by tool (`docs/other-tools.md`)" in description


def test_the_citation_file():
    """It has the keys that the format requires (CFF 1.2.0), version and date of the release, the paper."""
    cited = yaml.safe_load(text("CITATION.cff"))
    assert {"cff-version", "message", "title", "authors"} <= {*cited}
    assert cited["version"] == PROJECT["version"]
    assert f"\n## {cited['version']} - {cited['date-released']}\n" in text("CHANGELOG.md")
    (paper,) = cited["references"]
    assert {"type", "title", "authors", "year"} <= {*paper}
    assert paper["title"] in text("README.md")
    assert all(f"{a['given-names']} {a['family-names']}" in text("README.md") for a in paper["authors"])


@shards.documents
def test_notices_are_in_the_wheel(tmp_path):
    """NOTICES.md names the folder of each file with a licence of its own, and is in the wheel."""
    list(WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"]))
    with zipfile.ZipFile(next(tmp_path.glob("*.whl"))) as wheel:
        names = wheel.namelist()
    assert sum(name.endswith("/NOTICES.md") for name in names) == 2  # next to the code, in dist-info
    own = [name for name in names if re.fullmatch(r"fmus/LICENSE|.*\.dist-info/.*", name)]
    licences = [name for name in {*names} - {*own} if Path(name).stem == "LICENSE"]
    assert [name for name in licences if name.rpartition("/")[0] not in text("NOTICES.md")] == []


def test_every_public_name_is_in_the_reference():
    """What `__all__` of a package has, itself or with its module, and each component."""
    pages = "".join(p.read_text(encoding="utf-8") for p in (ROOT / "docs" / "reference" / "api").glob("*.md"))
    shown = {*re.findall(r"^::: (\S+)$", pages, re.MULTILINE)}
    lacking = []
    for place, names in run_path(str(ROOT / "docs" / "site" / "tables.py"))["public_names"]().items():
        for name in names:  # `fmus` is shown without its names, which are on several pages
            folders = {path.rpartition(".")[0] for path in (place, name)} - {"fmus"}
            lacking += [name] * (not {place, name, *folders} & shown)
    assert lacking == []
    assert {f"fmus.components.{p.stem}" for p in (ROOT / "fmus" / "components").glob("[!_]*.py")} <= shown
