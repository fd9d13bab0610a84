# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""List the packages that allan_ros requires, with licenses and known vulnerabilities.

    python scripts/audit.py             # exit code 1: a vulnerability; 2: a package was not checked
    python scripts/audit.py --offline   # list the packages and licenses only

pip-audit asks the advisory service of PyPI for each package. If this service is missing, as on a
mirror of PyPI, pip-audit skips the packages and reports no problem. Skipped packages are therefore
counted here.
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
"""Longest name of a license in characters. Some packages state the complete text instead."""

TOOL = [sys.executable, '-m', 'pip_audit']
ASKED = ['--no-deps', '--disable-pip', '--format', 'json', '--requirement']


def required() -> dict[str, metadata.Distribution]:
    """Return name -> installed package that allan_ros or one of its dependencies requires."""
    found: dict[str, metadata.Distribution] = {}
    waiting = [PACKAGE]
    while waiting:
        for name in _requirements(metadata.distribution(waiting.pop())):
            if name not in found:
                try:
                    found[name] = metadata.distribution(name)
                except metadata.PackageNotFoundError:
                    continue  # not required on this system or Python
                waiting.append(name)
    return dict(sorted(found.items()))


def _requirements(distribution: metadata.Distribution) -> Iterator[str]:
    for requirement in distribution.requires or ():
        name = REQUIREMENT.match(requirement)
        if name and 'extra' not in requirement.partition(';')[2]:
            yield re.sub(r'[-_.]+', '-', name[1]).lower()


def license(distribution: metadata.Distribution) -> str:
    """Return the name of the license of a package, from old or new fields of its metadata."""
    about = distribution.metadata
    # for a missing field, `about[...]` raises an error in newer versions of Python only
    classifiers = [c for c in about.get_all('Classifier') or () if c.startswith(CLASSIFIER)]
    named = [*(about.get_all('License-Expression') or ()), *(about.get_all('License') or ())]
    named += [classifier.removeprefix(CLASSIFIER) for classifier in classifiers]
    short = [name for name in named if name and len(name) <= LONGEST_LICENSE]
    return short[0] if short else 'see the package'


def main() -> int:
    """Print packages, licenses and vulnerabilities, and return the exit code."""
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
    """Return the answer of pip-audit for each package: `vulns`, or `skip_reason`."""
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
    """Return why pip-audit skipped the first package that it skipped."""
    return next((a['skip_reason'] for a in answers if 'skip_reason' in a), 'no answer')


if __name__ == '__main__':
    sys.exit(main())
