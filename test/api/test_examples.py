# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The examples in docstrings run as written, and every public object has one."""

from __future__ import annotations

import doctest
import importlib
import inspect
import re
from pathlib import Path

import pytest

import allan_ros

PACKAGE = Path(allan_ros.__file__).parent

WITH_EXAMPLES = sorted(
    path
    for path in PACKAGE.rglob('*.py')
    if re.search(r'^ *>>> ', path.read_text(encoding='utf-8'), re.MULTILINE)
)


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix('').parts
    return '.'.join(parts[:-1] if parts[-1] == '__init__' else parts)


@pytest.mark.parametrize('name', [*map(module_name, WITH_EXAMPLES)])
def test_examples_run_as_written(name: str) -> None:
    if name.startswith('allan_ros.nodes.'):
        pytest.importorskip('rclpy')
    done = doctest.testmod(importlib.import_module(name))
    assert done.attempted and not done.failed


@pytest.mark.parametrize('name', allan_ros.__all__)
def test_every_public_object_has_an_example(name: str) -> None:
    assert '>>> ' in (getattr(allan_ros, name).__doc__ or '')


def test_every_public_method_is_in_an_example() -> None:
    classes = [c for name in allan_ros.__all__ if inspect.isclass(c := getattr(allan_ros, name))]
    methods = {
        name: member
        for kind in classes
        for base in kind.__mro__
        for name, member in vars(base).items()
        if name[0] != '_' and (isinstance(member, property) or inspect.isfunction(member))
    }
    functions = [getattr(allan_ros, name) for name in allan_ros.__all__]
    examples = [
        example.source
        for one in (*functions, *methods.values())
        for example in doctest.DocTestParser().get_examples(one.__doc__ or '')
    ]
    code = ''.join(examples)
    assert [name for name in methods if not re.search(rf'\.{name}\b', code)] == []
