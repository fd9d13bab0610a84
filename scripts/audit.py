# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""List the packages that allan_ros installs, with version and license, and query known
vulnerabilities.

    python scripts/audit.py             # exit 1: something is vulnerable; 2: some was not audited
    python scripts/audit.py --offline   # the list alone, no query

The list contains the installed packages that ``install_requires`` of setup.py requires, directly or
not. pip-audit asks the advisory service of PyPI for each of them, by name and version. A mirror of
PyPI may not have this service. pip-audit then skips each package and reports no problem, so skipped
packages are counted here.
"""

from __future__ import annotations

import argparse
import importlib.metadata as metadata
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from typing import Any

PACKAGE = 'allan_ros'
VULNERABLE, NOT_AUDITED = 1, 2
CLASSIFIER = 'License :: OSI Approved :: '
REQUIREMENT = re.compile(r'([A-Za-z0-9._-]+)')
LONGEST_LICENSE = 60
"""Longest license name in characters; some packages contain the complete text instead."""

TOOL = [sys.executable, '-m', 'pip_audit']
ASKED = ['--no-deps', '--disable-pip', '--format', 'json', '--requirement']


def required() -> dict[str, metadata.Distribution]:
    """Return the installed packages that allan_ros requires, directly or not, by name."""
    found: dict[str, metadata.Distribution] = {}
    waiting = [PACKAGE]
    while waiting:
        for name in _requirements(metadata.distribution(waiting.pop())):
            if name not in found:
                try:
                    found[name] = metadata.distribution(name)
                except metadata.PackageNotFoundError:
                    continue  # its marker excludes this system or Python
                waiting.append(name)
    return dict(sorted(found.items()))


def _requirements(distribution: metadata.Distribution) -> Iterator[str]:
    for requirement in distribution.requires or ():
        name = REQUIREMENT.match(requirement)
        if name and 'extra' not in requirement.partition(';')[2]:
            yield re.sub(r'[-_.]+', '-', name[1]).lower()


def license(distribution: metadata.Distribution) -> str:
    """Return the name of the license, from the metadata fields of old and new packages."""
    about = distribution.metadata
    # get_all: newer readers of metadata raise an error for a missing field, older ones return None
    classifiers = [c for c in about.get_all('Classifier') or () if c.startswith(CLASSIFIER)]
    named = [*(about.get_all('License-Expression') or ()), *(about.get_all('License') or ())]
    named += [classifier.removeprefix(CLASSIFIER) for classifier in classifiers]
    short = [name for name in named if name and len(name) <= LONGEST_LICENSE]
    return short[0] if short else 'see the package'


def main() -> int:
    """Print the list and the answer of the service."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else '')
    parser.add_argument('--offline', action='store_true', help='ask nobody')
    options = parser.parse_args()
    packages = required()
    for name, distribution in packages.items():
        print(f'{name:20} {distribution.version:16} {license(distribution)}')
    if options.offline:
        print(f'{len(packages)} packages; vulnerabilities were not checked')
        return 0
    answers = audited(packages)
    for answer in answers:
        for found in answer.get('vulns', ()):
            fixed = ', '.join(found['fix_versions']) or 'no version yet'
            which = f'{answer["name"]} {answer["version"]}'
            print(f'VULNERABLE: {which}: {found["id"]}, fixed in {fixed}')
    known = [answer for answer in answers if 'vulns' in answer]
    if left := len(packages) - len(known):
        print(
            f'NOT AUDITED: {left} of {len(packages)} packages: {_reason(answers)}', file=sys.stderr
        )
    if any(answer['vulns'] for answer in known):
        return VULNERABLE
    if left:
        return NOT_AUDITED
    print(f'{len(packages)} packages, no known vulnerability')
    return 0


def audited(packages: dict[str, metadata.Distribution]) -> list[dict[str, Any]]:
    """Return the result of pip-audit for each package: `vulns`, or why it was skipped."""
    with tempfile.NamedTemporaryFile('w', suffix='.txt') as file:
        file.write('\n'.join(f'{name}=={found.version}' for name, found in packages.items()))
        file.flush()
        asked = subprocess.run([*TOOL, *ASKED, file.name], capture_output=True, text=True)
    try:
        answers: list[dict[str, Any]] = json.loads(asked.stdout)['dependencies']
    except ValueError:
        reason = (asked.stderr.strip() or f'exit {asked.returncode}').splitlines()[-1]
        return [{'skip_reason': f'pip-audit gave no answer: {reason}'}]
    return answers


def _reason(answers: list[dict[str, Any]]) -> str:
    """Return the first reason why a package was skipped."""
    return next((a['skip_reason'] for a in answers if 'skip_reason' in a), 'no answer')


if __name__ == '__main__':
    sys.exit(main())
