# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Architecture: permitted imports, and where ROS, files and printing are permitted."""

from __future__ import annotations

import ast
import functools
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / 'allan_ros'

ROOMS = ('core', 'readers', 'results', 'export', 'view', 'api', 'cli', 'nodes')
"""The packages, from the bottom to the top. Each imports only what is below it; `cli`
and `nodes` do not import each other."""

MAY_IMPORT = {
    room: set(ROOMS[: i + 1]) - ({'cli'} if room == 'nodes' else set())
    for i, room in enumerate(ROOMS)
}

ROS = {
    'ament_index_python',
    'builtin_interfaces',
    'diagnostic_msgs',
    'geometry_msgs',
    'rcl_interfaces',
    'rclpy',
    'rosgraph_msgs',
    'sensor_msgs',
    'std_msgs',
    'std_srvs',
}

CORE_LIBRARIES = {'numpy', 'scipy'}
"""Packages that `core` may import in addition to the standard library."""

TOUCHES_THE_WORLD = {'datetime', 'io', 'logging', 'os', 'pathlib', 'shutil', 'subprocess', 'time'}
"""Modules of the standard library that `core` must not import: files and wall clocks."""

FILES = sorted(
    path for path in PACKAGE.rglob('*.py') if path.relative_to(PACKAGE).parts[0] in ROOMS
)


def package_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0]


@functools.cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding='utf-8'))


def imports_of(path: Path) -> Iterator[tuple[str, ...]]:
    """Yield the absolute dotted name of everything the file imports, as parts."""
    package = ('allan_ros', *path.relative_to(PACKAGE).parts[:-1])
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            yield from (tuple(alias.name.split('.')) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = (*base, *(node.module.split('.') if node.module else ()))
            yield from ((*module, alias.name) for alias in node.names)


def named(path: Path) -> str:
    return str(path.relative_to(PACKAGE))


@pytest.mark.parametrize('path', FILES, ids=named)
def test_a_package_imports_only_the_packages_below_it(path: Path) -> None:
    packages = {
        parts[1] for parts in imports_of(path) if parts[0] == 'allan_ros' and len(parts) > 1
    }
    assert not packages & {*ROOMS} - MAY_IMPORT[package_of(path)]


@pytest.mark.parametrize('path', [f for f in FILES if package_of(f) != 'nodes'], ids=named)
def test_only_the_nodes_know_ros(path: Path) -> None:
    assert not {parts[0] for parts in imports_of(path)} & ROS


@pytest.mark.parametrize('path', [f for f in FILES if package_of(f) == 'core'], ids=named)
def test_core_is_arithmetic_only(path: Path) -> None:
    tops = {parts[0] for parts in imports_of(path)} - {'allan_ros'}
    assert not tops & TOUCHES_THE_WORLD
    assert tops <= CORE_LIBRARIES | sys.stdlib_module_names


@pytest.mark.parametrize('path', [f for f in FILES if package_of(f) in ROOMS[:5]], ids=named)
def test_below_the_shells_nothing_prints_or_exits(path: Path) -> None:
    calls = {
        ast.unparse(node.func) for node in ast.walk(tree_of(path)) if isinstance(node, ast.Call)
    }
    assert not calls & {'print', 'sys.exit', 'exit', 'quit'}


def test_the_scan_finds_a_forbidden_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[__name__], 'PACKAGE', tmp_path)
    file = tmp_path / 'core' / 'fit' / 'bad.py'
    file.parent.mkdir(parents=True)
    file.write_text('from ...readers import bag\nfrom ..errors import AllanError\nimport rclpy.qos')
    assert list(imports_of(file)) == [
        ('allan_ros', 'readers', 'bag'),
        ('allan_ros', 'core', 'errors', 'AllanError'),
        ('rclpy', 'qos'),
    ]


EVERY_MODULE = """
import importlib, pkgutil
for package in ('core', 'readers', 'results', 'export', 'view', 'cli'):
    path = f'{allan_ros.__path__[0]}/{package}'
    for module in pkgutil.walk_packages([path], f'allan_ros.{package}.'):
        if module.name != 'allan_ros.view.plots':
            importlib.import_module(module.name)
"""
HELP = """
from allan_ros.cli.main import main
try:
    main(['--help'])
except SystemExit as stop:
    assert stop.code == 0
"""
ANALYZE = """
import numpy as np
allan_ros.analyze(np.random.default_rng(0).normal(size=4000), rate=100)
"""
BIAS = """
from allan_ros.core.noise import Model
from allan_ros.core.filters.state_space import state_space
assert state_space(Model.of(N=1.0, B=1.0)).processes
"""
CHECKPOINT = """
import numpy as np
from allan_ros.core.imu import ImuBatch
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.results.checkpoint import Checkpoint
from allan_ros.readers.recording_sums import Provenance
stream = ImuStream()
stamps = np.arange(20000) * 10**7
stream.update(ImuBatch(stamps, np.random.default_rng(0).normal(size=(20000, 6))))
result = stream.result()
assert result.sums
Checkpoint('', None).total(result.sums, Provenance())
"""
ALL = 'numpy scipy matplotlib pandas rosbags yaml rclpy'
LARGE = 'scipy.optimize scipy.signal scipy.spatial scipy.stats matplotlib pandas rosbags'


STARTS = {
    'package': ("assert 'analyze' in dir(allan_ros)", ALL),
    'help': (HELP, ALL),
    'every module': (EVERY_MODULE, f'{LARGE} rclpy'),
    'pipeline': ('import allan_ros.core.stream.pipeline', 'scipy'),
    'plots': ('import allan_ros.view.plots', 'matplotlib.pyplot'),
    'analyze': (ANALYZE, LARGE),
    'bias': (BIAS, LARGE),
    'monitor': ('import allan_ros.nodes.monitor', f'{LARGE} scipy'),
    'checkpoint': (CHECKPOINT, 'scipy'),
}


@pytest.mark.parametrize('start', STARTS)
def test_no_large_library_is_loaded_before_it_is_needed(start: str) -> None:
    """Each library costs 0.2 to 1 s of CPU time at every start of `allan` or a node, and up to
    20 MB.
    """
    code, libraries = STARTS[start]
    if start == 'monitor':
        pytest.importorskip('rclpy')
    check = (
        f'import sys, allan_ros\n{code}\nsys.exit(str({{*{libraries.split()}}} & {{*sys.modules}}))'
    )
    done = subprocess.run([sys.executable, '-c', check], capture_output=True, text=True)
    assert done.stderr == 'set()\n', done.stderr


def module_of(path: Path) -> tuple[str, ...]:
    parts = ('allan_ros', *path.relative_to(PACKAGE).with_suffix('').parts)
    return parts[:-1] if parts[-1] == '__init__' else parts


def imported_by(path: Path, modules: set[tuple[str, ...]]) -> set[tuple[str, ...]]:
    """Return the modules of the package that a module imports anywhere, also in functions, for
    type checking, and by `import_module` with a constant.
    """
    package = ('allan_ros', *path.relative_to(PACKAGE).parts[:-1])
    found = set()
    for parts in imports_of(path):
        found.add(parts if parts in modules else parts[:-1])
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith('import_module'):
            name = node.args[0]
            if isinstance(name, ast.Constant) and name.value.startswith('.'):
                found.add((*package, name.value[1:]))
    return found & modules - {module_of(path)}


def test_no_import_cycle() -> None:
    """Imports inside functions count as well: they hide a circle, they do not remove it."""
    modules = {module_of(path) for path in FILES}
    needs = {module_of(path): imported_by(path, modules) for path in FILES}
    reached = {module: set(direct) for module, direct in needs.items()}
    grown = True
    while grown:
        grown = False
        for module, far in reached.items():
            more = far.union(*(reached[other] for other in far))
            grown |= len(more) > len(far)
            reached[module] = more
    circle = {'.'.join(module[1:]) for module, far in reached.items() if module in far}
    assert not circle, sorted(circle)


def test_no_class_name_is_used_twice() -> None:
    """Only a class of `api` has the name of the class of `results` that it extends."""
    places: dict[str, list[str]] = {}
    for path in FILES:
        for node in ast.walk(tree_of(path)):
            extends = isinstance(node, ast.ClassDef) and f'Plain{node.name}' in {
                ast.unparse(base) for base in node.bases
            }
            if isinstance(node, ast.ClassDef) and not extends:
                places.setdefault(node.name.lstrip('_'), []).append(named(path))
    assert {name: where for name, where in places.items() if where[1:]} == {}
