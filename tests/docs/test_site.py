"""The site builds strictly without network, loads nothing from other servers, and has no dead link."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from docs.generator import hooks, roles
from tests.docs.pages import ROOT

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
LOADED = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src"}


class Links(HTMLParser):
    """Files that a page loads, its links, and its anchors."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.led: list[str] = []
        self.places: set[str] = set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if place := given.get("id") or (tag == "a" and given.get("name")):
            self.places.add(place)
        if (name := LOADED.get(tag)) and (target := given.get(name)):
            self.loaded.append(target)
        if tag == "a" and (target := given.get("href")):
            self.led.append(target)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the site built as by ``make docs``, with a dead proxy instead of a network."""
    out = tmp_path_factory.mktemp("site")
    nowhere = dict.fromkeys(("http_proxy", "https_proxy", "all_proxy"), "http://127.0.0.1:9")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(out)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env={**os.environ, **nowhere, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return out


@pytest.fixture(scope="module")
def links(site: Path) -> dict[Path, Links]:
    return {page: Links(page) for page in site.rglob("*.html")}


@pytest.mark.costly
def test_nothing_is_loaded_from_elsewhere(site: Path, links: dict[Path, Links]) -> None:
    assert len(links) > 40
    for page, found in links.items():
        for target in found.loaded:
            parts = urlsplit(target)
            assert not parts.netloc and parts.scheme in ("", "data"), f"{page.name}: {target}"
    for style in (file for ending in ("css", "js") for file in site.rglob(f"*.{ending}")):
        assert "fonts.g" not in style.read_text(encoding="utf-8"), style.name


@pytest.mark.costly
def test_no_link_is_dead(site: Path, links: dict[Path, Links]) -> None:
    dead = []
    for page, found in links.items():
        if page.name == "404.html":
            continue
        for target in (*found.loaded, *found.led):
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            file = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            file = file / "index.html" if file.is_dir() else file
            place = unquote(parts.fragment)
            known = links[file].places if file in links else None
            if not file.exists() or (place and known is not None and place not in known):
                dead.append(f"{page.relative_to(site)}: {target}")
    assert not dead


@pytest.mark.skipif(BROWSER is None, reason="there is no chromium")
def test_search_works_on_pages_read_from_the_disk(site: Path, tmp_path: Path) -> None:
    assert BROWSER is not None
    page = f"{(site / 'theory' / 'laws.html').as_uri()}?q=referee"
    words = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}"]
    done = subprocess.run(
        [*words, "--virtual-time-budget=20000", "--dump-dom", page],
        capture_output=True,
        text=True,
        timeout=120,
    )
    found = re.findall(r"(\d+) matching documents", done.stdout)
    assert found and int(found[0]) > 5, done.stderr[-2000:]


def test_links_of_the_readme_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", (ROOT / "README.md").read_text()):
        assert (ROOT / target).exists(), target


def test_folders_of_the_navigation_become_their_pages(tmp_path: Path) -> None:
    for name in ("a/z.md", "a/index.md", "a/b/c.md", "a/y.md", "top.md"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "a" / "index.md").write_text("First [y](y.md), [deep](b/c.md), again [y](y.md#x).")
    nav = [{"Top": "top.md"}, {"A": "a/"}, {"None": "none/"}, {"Deep": [{"B": "a/b/"}, "top.md"]}]
    nav += [{"Both": ["a/b/", "top.md", "none/"]}]
    assert hooks.expanded(nav, tmp_path) == [
        {"Top": "top.md"},
        {"A": ["a/index.md", "a/y.md", "a/b/c.md", "a/z.md"]},
        {"Deep": [{"B": ["a/b/c.md"]}, "top.md"]},
        {"Both": ["a/b/c.md", "top.md"]},
    ]


def test_roles_of_docstrings_become_links() -> None:
    text = "See :func:`~ocp.solve.solve.solve` and :mod:`ocp.mpcc`::\n\n    x = 1"
    solve, mpcc = (
        f'<autoref optional identifier="{name}"><code>{shown}</code></autoref>'
        for name, shown in (("ocp.solve.solve.solve", "solve"), ("ocp.mpcc", "ocp.mpcc"))
    )
    assert roles.linked(text) == f"See {solve} and {mpcc}:\n\n    x = 1"
