# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Take the screenshot of a report for the documentation, with a browser.

usage: report_pictures.py FOLDER

The IMU is simulated as with `allan simulate --preset paper`. The simulated recording contains a
vibration of 0.4 Hz, a motion, and a gap of half a minute.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image  # Pillow, a dependency of matplotlib

from allan_ros.cli.main import main as allan

BROWSERS = ('chromium', 'chromium-browser', 'google-chrome')

WINDOW = (1280, 1000)
"""Width and height of the screenshot in pixels."""

COLORS = 96
"""Number of colors of the picture, with which text is smooth and the file three times smaller."""

FAULTS = (
    '{vibration_gyro: 8.0e-5, vibration_frequency: 0.4, motion: [[1500, 60]], gaps: [[2600, 30]]}'
)
"""Faults of the simulated recording, as in the files of `allan simulate --spec`."""


def photograph(page: Path, picture: Path, scratch: Path) -> None:
    """Write a screenshot of the top of ``page`` to the file ``picture``."""
    browser = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if browser is None:
        sys.exit(f'no browser here: install one of {", ".join(BROWSERS)}')
    size = ','.join(map(str, WINDOW))
    how = ['--headless', '--no-sandbox', '--disable-gpu', '--no-first-run', '--hide-scrollbars']
    how += [f'--user-data-dir={scratch}', f'--window-size={size}', f'--screenshot={picture}']
    subprocess.run([browser, *how, page.as_uri()], check=True, capture_output=True)


def main() -> int:
    """Simulate and analyze the recording, and write the screenshot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('folder', type=Path)
    folder = parser.parse_args().folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as made:
        scratch = Path(made)
        bag, results, spec = (str(scratch / name) for name in ('tuesday.npz', 'tuesday', 'spec'))
        Path(spec).write_text(f'faults: {FAULTS}\n')
        how = ['--preset', 'paper', '--hours', '1', '--seed', '2', '--spec', spec]
        for words in (
            ['simulate', bag, *how],
            ['analyze', bag, '-o', results, '-q', '--sensor', 'adis16475-3'],
        ):
            if code := allan(words):
                return code
        photograph(scratch / 'tuesday/report.html', scratch / 'report.png', scratch / 'browser')
        path = folder / 'report.png'
        picture = Image.open(scratch / 'report.png').convert('RGB')
        picture.quantize(COLORS).save(path, optimize=True)
        print(f'{path}: {path.stat().st_size / 1000:.0f} kB')
    return 0


if __name__ == '__main__':
    sys.exit(main())
