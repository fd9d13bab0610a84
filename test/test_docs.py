# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Documentation: valid links and commands, and generated pages that are current."""

from __future__ import annotations

import importlib
import re
import shlex
import sys
from pathlib import Path

import pytest

from allan_ros.cli.main import VERBS, build_parser
from allan_ros.export import TARGETS

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / 'README.md', *sorted((ROOT / 'docs').rglob('*.md'))]
LARGEST_PICTURE = 150_000
"""Limit in bytes, so that pages open quickly on a phone."""


def named(path: Path) -> str:
    return path.name


def text_of(page: Path) -> str:
    """Return the page without its code blocks."""
    fenced = re.sub(r'^```.*?^```', '', page.read_text(), flags=re.MULTILINE | re.DOTALL)
    return re.sub(r'^(?:    ).*$', '', fenced, flags=re.MULTILINE)


def anchors_of(page: Path) -> set[str]:
    """Return the anchors that forges give to the headings of a page."""
    headings = re.findall(r'^#+ (.+)$', text_of(page), flags=re.MULTILINE)
    return {
        re.sub(r'[^\w\- ]', '', heading.strip().lower()).replace(' ', '-') for heading in headings
    }


def commands_of(page: Path) -> list[list[str]]:
    """Return the words of each command line of `allan` that starts a line of the page."""
    joined = page.read_text().replace('\\\n', ' ')
    lines = re.findall(r'^(?:    )?(?:\$ )?(?:ros2 run allan_ros )?(allan [a-z-].*)$', joined, re.M)
    words = [shlex.split(line, comments=True) for line in lines]
    return [w[1:] for w in words if w[1] in VERBS and not any(c.endswith(':') for c in w[:2])]


@pytest.mark.parametrize('page', PAGES, ids=named)
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r'\]\(([^)\s]+)\)', text_of(page)):
        if '://' in link:
            continue
        name, _, anchor = link.partition('#')
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors_of(target), link


def test_the_index_leads_to_every_page() -> None:
    index = (ROOT / 'docs' / 'README.md').read_text()
    docs = ROOT / 'docs'
    pages = [str(page.relative_to(docs)) for page in PAGES[1:] if page != docs / 'README.md']
    assert [name for name in pages if f']({name})' not in index] == []


@pytest.mark.parametrize('page', PAGES, ids=named)
def test_commands_are_understood(page: Path) -> None:
    commands = commands_of(page)
    assert commands or page.name != 'README.md' or page.parent != ROOT
    for verb, *words in commands:
        ends = [words.index(sign) for sign in ('>', '|') if sign in words]
        build_parser(verb).parse_args([verb, *words[: min(ends, default=None)]])


@pytest.mark.parametrize('page', PAGES, ids=named)
def test_executables_and_launch_arguments_exist(page: Path) -> None:
    text, setup = page.read_text().replace('\\\n', ' '), (ROOT / 'setup.py').read_text()
    launch = (ROOT / 'launch' / 'allan_ros.launch.py').read_text()
    for name in re.findall(r'ros2 run allan_ros (\w+)', text):
        assert f"'{name} = " in setup, name
    for line in re.findall(r'ros2 launch allan_ros allan_ros\.launch\.py (.*)', text):
        for argument in re.findall(r'(\w+):=', line):
            assert f"'{argument}'" in launch, argument


def test_generated_pages_are_current(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / 'scripts'))
    reference = importlib.import_module('reference')
    for name, text in reference.pages().items():
        assert (ROOT / 'docs' / name).read_text() == text, f'{name}: run `make docs`'
    sys.modules.pop('reference')


def test_pictures_are_small_and_shown() -> None:
    pictures = sorted((ROOT / 'docs' / 'images').glob('*.png'))
    assert pictures
    assert [p.name for p in pictures if p.stat().st_size > LARGEST_PICTURE] == []
    text = ''.join(page.read_text() for page in PAGES)
    assert [p.name for p in pictures if f'images/{p.name})' not in text] == []


NUMBER = re.compile(r'\d+(?:\.\d+)?')


@pytest.mark.parametrize('pages', [['README.md', 'docs/start.md'], ['docs/filter.md']])
def test_quoted_output_is_current(pages: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Other versions of numpy may change the last digit, so numbers are compared to 5 %.

    README.md and docs/start.md use the same simulated recording, which is written once.
    """
    monkeypatch.syspath_prepend(str(ROOT / 'scripts'))
    text = ''.join((ROOT / page).read_text() for page in pages)
    new = importlib.import_module('quoted_output').with_new_output(text)
    sys.modules.pop('quoted_output')
    hint = 'run `python scripts/quoted_output.py`'
    assert re.sub(r' +', ' ', NUMBER.sub('0', new)) == re.sub(r' +', ' ', NUMBER.sub('0', text)), (
        hint
    )
    numbers = ([float(n) for n in NUMBER.findall(each)] for each in (new, text))
    assert list(next(numbers)) == pytest.approx(next(numbers), rel=0.05), hint


def test_the_readme_counts_the_export_targets() -> None:
    assert f'[{len(TARGETS)} export targets]' in (ROOT / 'README.md').read_text(encoding='utf-8')
