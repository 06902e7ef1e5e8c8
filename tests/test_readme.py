"""The README is also the page of the package: what it shows must be found from there."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from napari_deltamic.cli import build_parser

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"


@pytest.fixture(scope="module")
def raw():
    """Where the repository's files are served from, after the one address in pyproject.toml."""
    if not README.exists():
        pytest.skip("not in a source tree")
    home = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["urls"]["Homepage"]
    return home.replace("https://github.com/", "https://raw.githubusercontent.com/") + "/main/"


def images(text):
    return re.findall(r"!\[[^\]]*\]\(([^)\s]+)", text) + re.findall(
        r"<img[^>]*src=[\"']([^\"']+)", text
    )


def test_every_image_is_absolute_and_in_the_repository(raw):
    found = images(README.read_text())
    assert found
    for link in found:
        assert link.startswith(raw), f"{link} is not below {raw}"
        assert (ROOT / link.removeprefix(raw)).is_file(), f"{link} is not in the repository"


def test_images_are_found_however_they_are_written():
    text = "![a\nb](x.png) ![](y.png \"title\") <img alt='z' src='z.png'>"
    assert images(text) == ["x.png", "y.png", "z.png"]


def test_links_to_files_lead_somewhere():
    """They are whole addresses, so that they lead there from the package's page, too."""
    if not README.exists():
        pytest.skip("not in a source tree")
    links = re.findall(r"\]\(([^)\s]+)\)", README.read_text())
    found = re.findall(
        r"(?:/blob|\.com/[\w-]+/[\w-]+)/main/(.*?)(?:#.*)?\n", "\n".join(links) + "\n"
    )
    assert len(found) >= 10
    assert [link for link in links if "://" not in link and not link.startswith("#")] == []
    assert [path for path in found if not (ROOT / path).exists()] == []


PAGES = [README, *sorted((ROOT / "docs").glob("*.md"))]


def commands(text):
    """The calls of the command line in a page, as words; those that are only named are left out."""
    blocks = re.findall(r"```\w*\n(.*?)```", text, re.S)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines() + re.findall(r"`([^`\n]+)`", text)
    calls = [shlex.split(line, comments=True) for line in lines if "napari-deltamic " in line]
    return [call[1:] for call in calls if call[0] == "napari-deltamic" and len(call) > 2]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_that_are_shown_are_understood(page):
    if not page.exists():
        pytest.skip("not in a source tree")
    for call in commands(page.read_text()):
        build_parser().parse_args(call)


def test_pages_show_commands():
    if not README.exists():
        pytest.skip("not in a source tree")
    assert len([call for page in PAGES for call in commands(page.read_text())]) > 8


def test_times_name_the_machine():
    if not README.exists():
        pytest.skip("not in a source tree")
    timed = r"\b\d[\d.]* (s|ms|seconds|minutes)\b|in (seconds|minutes)|times (as long|slower)"
    paragraphs = [" ".join(p.split()) for p in README.read_text().split("\n\n")]
    found = [p for p in paragraphs if re.search(timed, p)]
    assert found
    for paragraph in found:
        assert re.search(r"cores? of an? [\w ]*\b(server|Xeon)", paragraph), paragraph
