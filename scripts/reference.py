# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write the generated pages: docs/parameters.md, options.md, api.md and messages.md.

usage: reference.py

The texts come from the code and from view/findings.md. A test fails if a page is stale.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import re
import sys
from collections.abc import Iterator
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import allan_ros
from allan_ros.cli.console import COMMON_OPTIONS
from allan_ros.cli.main import EXITS, VERBS, command_of
from allan_ros.cli.options import declare
from allan_ros.core.findings import CATALOG
from allan_ros.core.settings import ParameterInfo, describe
from allan_ros.nodes.node_settings import GROUPS
from allan_ros.view.finding_text import FIELD, words

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / 'docs'

WRITTEN_BY = '<!-- Written by scripts/reference.py (`make docs`): change the code. -->'

PARAMETERS_HEAD = """# Parameters of the nodes

Every parameter with its default, range and unit. `config/allan_ros.yaml` is a template with the
same parameters; `ros2 param describe NODE NAME` shows them for a running node. A parameter marked ●
can be set while the node runs; the others are read once, at the start. A value outside
its range is rejected, and the reason is reported.

Topics, services and diagnostics are in [diagnostics.md](diagnostics.md).
"""

LAUNCH_HEAD = """## Launch arguments

    ros2 launch allan_ros allan_ros.launch.py imu:=/camera/imu

| argument | default | |
|---|---|---|
"""

CLI_HEAD = """# Options of `allan`

Every option with its default. `allan VERB --help` prints the same list. Inside a ROS workspace put
`ros2 run allan_ros` before each command.
"""

API_HEAD = """# Python API

All functions raise `AllanError`, with a message of one line, if an argument is wrong or a file
cannot be read. [notebook.ipynb](notebook.ipynb) shows a complete example. The examples begin with

```python
>>> import numpy as np
>>> import allan_ros as ar
```
"""

EVERY_VERB = """## Options of every verb

| option | |
|---|---|
{options}

Results go to stdout, all else to stderr. `analyze --json` prints the content of
`results.json`. Progress is drawn on a terminal only.

| exit code | |
|---|---|
{exits}

The environment variable `NO_COLOR` turns colors off, and `FORCE_COLOR` turns colors on unless
`NO_COLOR` is set ([no-color.org](https://no-color.org)). The variable `COLUMNS` sets the width. By
default, the terminal determines colors and width.
"""


SHARED_HEAD = """## Options of several verbs

| option | | verbs |
|---|---|---|
"""


def parameters_page() -> str:
    """Return the page about the parameters of the nodes."""
    nodes = _nodes_of_groups((ROOT / 'config' / 'allan_ros.yaml').read_text())
    parts = [WRITTEN_BY, PARAMETERS_HEAD]
    for group, settings in GROUPS.items():
        what, where = nodes[group]
        parts.append(
            f'## `{group}`\n\n{what} Used by: {where}.\n\n'
            '| parameter | | default | range | |\n|---|---|---|---|---|\n'
            + '\n'.join(
                _parameter_row(f'{group}.{name}', info, getattr(settings(), name))
                for name, info in describe(settings).items()
            )
            + '\n'
        )
    parts.append(LAUNCH_HEAD + '\n'.join(_launch_rows()) + '\n')
    return '\n'.join(parts)


def _nodes_of_groups(config: str) -> dict[str, tuple[str, str]]:
    """Return group of parameters -> (purpose, nodes), from the comments of the parameter file."""
    found = re.findall(r'^    # (.+?) \(([^()]+)\)\.\n    (\w+):$', config, re.MULTILINE)
    return {group: (f'{what}.', where) for what, where, group in found}


def _parameter_row(name: str, info: ParameterInfo, default: Any) -> str:
    words = info.doc.replace('|', '\\|').replace('<', '&lt;')
    unit = f' {info.unit}' if info.unit else ''
    mark = '' if info.read_only else '●'
    return f'| `{name}` | {mark} | `{_shown(default)}`{unit} | {_range(info)} | {words} |'


def _range(info: ParameterInfo) -> str:
    if info.choices:
        return ', '.join(f'`{c}`' for c in info.choices)
    if info.low is None and info.high is None:
        return ''
    return f'{_bound(info.low)} … {_bound(info.high)}'


def _bound(value: float | None) -> str:
    return '' if value is None else f'{value:g}' if abs(value) < 1e5 else f'{value:,.0f}'


def _shown(default: Any) -> str:
    """Return the default of a parameter in YAML notation."""
    if isinstance(default, tuple):
        return '[' + ', '.join(_shown(value) for value in default) + ']'
    if isinstance(default, bool):
        return str(default).lower()
    return f'"{default}"' if isinstance(default, str) else f'{default}'


def _launch_rows() -> Iterator[str]:
    tree = ast.parse((ROOT / 'launch' / 'allan_ros.launch.py').read_text())
    (arguments,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == 'ARGUMENTS'
    )
    for name, (default, what) in arguments.items():
        yield f'| `{name}` | {f"`{default}`" if default else ""} | {what} |'
    yield "| `config` | the package's `allan_ros.yaml` | parameter file of the nodes |"


def cli_page() -> str:
    """Return the page about the options of the command line."""
    common = argparse.ArgumentParser(add_help=False)
    declare(common, COMMON_OPTIONS)
    every = EVERY_VERB.format(
        options='\n'.join(_option_row(action) for action in common._actions),
        exits='\n'.join(f'| {code} | {what} |' for code, what in EXITS.items()),
    )
    rows = {verb: _option_rows(verb) for verb in VERBS}
    users = {row: [verb for verb in VERBS if row in rows[verb]] for row in chain(*rows.values())}
    shared = '\n'.join(
        f'{row} {", ".join(f"`{verb}`" for verb in verbs)} |'
        for row, verbs in users.items()
        if len(verbs) > 1
    )
    parts = [WRITTEN_BY, CLI_HEAD, every, f'{SHARED_HEAD}{shared}\n']
    for verb, known in VERBS.items():
        what = known.help
        own = '\n'.join(row for row in rows[verb] if len(users[row]) == 1)
        head = f'## `allan {verb}`\n\n{what[0].upper()}{what[1:]}.\n\n'
        parts.append(f'{head}| option | |\n|---|---|\n{own}\n')
    return '\n'.join(parts)


def _option_rows(verb: str) -> list[str]:
    parser = argparse.ArgumentParser(prog=f'allan {verb}', add_help=False)
    declare(parser, command_of(verb).options)
    return [_option_row(each) for each in parser._actions if each.help != argparse.SUPPRESS]


def _option_row(action: argparse.Action) -> str:
    words = (action.help or '').replace('%%', '%').replace('|', '\\|').replace('<', '&lt;')
    metavar = action.metavar or ('' if action.nargs == 0 else (action.dest or '').upper())
    if not action.option_strings:
        return f'| `{metavar}` | {words} |'
    names = ', '.join(f'`{name}`' for name in action.option_strings)
    shown = f' `{metavar}`'.replace('|', '\\|') if metavar and action.nargs != 0 else ''
    return f'| {names}{shown} | {words} |'


def api_page() -> str:
    """Return the page about the public Python API, with the docstrings of functions and classes."""
    names = sorted(allan_ros.__all__, key=lambda name: inspect.isclass(getattr(allan_ros, name)))
    return '\n'.join([WRITTEN_BY, API_HEAD, *map(_object_section, names)])


def _object_section(name: str) -> str:
    thing = getattr(allan_ros, name)
    is_class = inspect.isclass(thing)
    parts = [f'## `{name}`']
    if not is_class:
        parts.append(f'    {name}{_signature(thing)}')
    parts.append(_as_markdown(thing))
    if is_class and not issubclass(thing, Exception):
        members = list(_members(thing))
        if members:
            parts.append('| member | |\n|---|---|\n' + '\n'.join(members))
    return '\n\n'.join(parts) + '\n'


STARS: dict[object, str] = {
    inspect.Parameter.VAR_POSITIONAL: '*',
    inspect.Parameter.VAR_KEYWORD: '**',
}
"""Kind of a parameter -> stars before its name in a signature."""


def _signature(thing: Any) -> str:
    """Return the signature of a function: names and defaults of the parameters, without types."""
    words, starred = [], False
    for parameter in inspect.signature(thing).parameters.values():
        if parameter.kind is parameter.VAR_POSITIONAL:
            starred = True
        if parameter.kind is parameter.KEYWORD_ONLY and not starred:
            words.append('*')
            starred = True
        mark = STARS.get(parameter.kind, '')
        default = parameter.default
        shown = '' if default is parameter.empty else f'={default!r}'
        words.append(f'{mark}{parameter.name}{shown}')
    return f'({", ".join(words)})'


def _as_markdown(thing: Any) -> str:
    """Return a docstring as Markdown, with its sections as lists and its examples as code."""
    text = inspect.cleandoc(thing.__doc__ or '')
    head, *sections = re.split(r'^(\w+)\n-{3,}\n', text, flags=re.MULTILINE)
    parts = [_code(head.strip())]
    for title, body in zip(sections[::2], sections[1::2]):
        if title == 'Examples':
            parts.append(f'```python\n{_session(body)}\n```')
            continue
        if title == 'Raises':
            continue  # the head of the page states the errors
        if title == 'Returns':
            parts.append('**Returns** ' + ' '.join(each[2:] for each in _items(body.strip())))
            continue
        heading = '' if title == 'Parameters' else f'**{title}**\n\n'
        parts.append(heading + '\n'.join(_items(body.strip())))
    return '\n\n'.join(parts)


def _session(example: str) -> str:
    """Return an example without the imports that all examples have in common."""
    common = ('>>> import allan_ros as ar', '>>> import numpy as np')
    return '\n'.join(line for line in example.strip().splitlines() if line not in common)


def _items(body: str) -> Iterator[str]:
    """Yield the entries of a numpydoc section as items of a Markdown list."""
    for name, text in re.findall(r'^(\S.*)\n?((?:(?:[ ].*)?\n?)*?)(?=^\S|\Z)', body, re.MULTILINE):
        term, _, kind = name.partition(' : ')
        words = _code(' '.join(text.split()))
        yield f'- `{term}`{f" ({kind})" if kind else ""}{f": {words}" if words else ""}'


def _code(text: str) -> str:
    """Return a text of a docstring with its literals in Markdown."""
    return text.replace('``', '`').replace('<', '&lt;')


def _members(thing: type) -> Iterator[str]:
    inherited = {name: m for kind in reversed(thing.__mro__[:-1]) for name, m in vars(kind).items()}
    for name, member in inherited.items():
        if name.startswith('_') or not getattr(member, '__doc__', None):
            continue
        is_property = isinstance(member, (property, cached_property))
        if is_property or inspect.isfunction(member):
            call = (
                ''
                if is_property
                else _signature(member).replace('(self, ', '(').replace('(self)', '()')
            )
            shown = name if is_property else f'{name}{call}'
            what = inspect.cleandoc(member.__doc__ or '').split('\n\n')[0]
            yield f'| `{shown}` | {_code(" ".join(what.split()))} |'


def messages_page(text: str) -> str:
    """Return the page about messages, with the findings between its first and last section."""
    head, tail = text.partition('## ')[0], text[text.rindex('\n## ') + 1 :]
    parts = []
    section = ''
    for id, known in words().items():
        if known.section != section:
            section = known.section
            parts.append(f'## {section}\n')
        message, remedy = map(_without_numbers, (known.message, known.remedy))
        parts.append(f'### {id}\n> *{CATALOG[id].severity}:* {message} **{remedy}**\n')
        parts += [f'{known.explanation}\n'] if known.explanation else []
    return '\n'.join([head.rstrip(), '', *parts, tail])


def _without_numbers(template: str) -> str:
    """Return the template of a finding in the plural form, with … instead of each number."""
    text = re.sub(r'\[\[|\]\]', '', template.replace('{when}', ''))
    return FIELD.sub(lambda field: (field[2] or '').partition('|')[2] or '…', text)


def pages() -> dict[str, str]:
    """Return name of the file in docs -> text of the generated page."""
    return {
        'parameters.md': parameters_page(),
        'options.md': cli_page(),
        'api.md': api_page(),
        'messages.md': messages_page((DOCS / 'messages.md').read_text(encoding='utf-8')),
    }


def main() -> int:
    """Write all generated pages."""
    for name, text in pages().items():
        (DOCS / name).write_text(text, encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())
