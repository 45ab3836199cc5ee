"""Links in the documentation resolve inside the repository, and citations of sections exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
PAGES = sorted([*REPOSITORY.glob("*.md"), *(REPOSITORY / "docs").rglob("*.md")])
SOURCES = sorted(
    path for folder in ("mht_slam", "factors") for path in (REPOSITORY / folder).rglob("*.py")
)
SECTIONS = range(1, 9)


def anchors_of(page: Path) -> set[str]:
    """The names that the headings of a page are linked by."""
    headings = re.findall(r"^#+ +(.+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    kept = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.strip().replace(" ", "-") for heading in kept}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_to_a_file_and_a_heading_of_the_repository(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)[^)]*\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        linked = (page.parent / name).resolve() if name else page
        assert linked.is_relative_to(REPOSITORY), f"{target} leaves the repository"
        assert linked.exists(), f"{target} does not exist"
        assert not anchor or anchor in anchors_of(linked), f"{target} names no heading"


def test_the_method_has_the_sections_that_docstrings_cite() -> None:
    text = (REPOSITORY / "docs" / "method.md").read_text(encoding="utf-8")
    assert [int(n) for n in re.findall(r"^## (\d+)\. ", text, flags=re.MULTILINE)] == [*SECTIONS]
    for path in SOURCES:
        source = path.read_text(encoding="utf-8")
        for number in re.findall(r"docs/method\.md,?`*,? sections? (\d+)", source):
            assert int(number) in SECTIONS, f"{path} cites section {number}"


def test_the_citation_and_the_package_agree() -> None:
    citation = (REPOSITORY / "CITATION.cff").read_text(encoding="utf-8")
    project = (REPOSITORY / "pyproject.toml").read_text(encoding="utf-8")
    versions = [
        re.search(pattern, text, flags=re.MULTILINE)
        for pattern, text in (
            (r"^version: (\S+)$", citation),
            (r'^version = "([^"]+)"$', project),
        )
    ]
    found = [match.group(1) for match in versions if match]
    assert len(found) == 2
    assert found[0] == found[1]
    assert "Bearing-Only SLAM with Indistinguishable Landmarks" in citation
