# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write docs/parameters.md, options.md, api.md and the messages quoted in docs/messages.md.

usage: reference.py

All texts come from the code; a test compares the pages with the output of this script.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import allan_ros
from allan_ros.cli.console import OPTIONS
from allan_ros.cli.main import EXITS, VERBS, command_of
from allan_ros.cli.options import add_options
from allan_ros.core.findings import CATALOG, FIELD
from allan_ros.core.settings import ParameterInfo, describe
from allan_ros.nodes.settings import GROUPS

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

Importing `allan_ros` takes less than 50 ms: each name is loaded at its first use. Functions report
errors as `AllanError`. [notebook.ipynb](notebook.ipynb) shows a complete example.

```python
import allan_ros as ar

results = ar.analyze('my_bag')  # a recording, or an array with rate=200
results['gyro_z'].N.to('deg/sqrt(h)')
results.plot('gyro')
results.export('kalibr', 'imu.yaml')
```
"""

EVERY_VERB = """## Options of every verb

| option | |
|---|---|
{options}

Results go to stdout, all else to stderr. `analyze --json` and `merge --json` print the content of
`results.json`: `allan analyze my_bag --json | jq .axes.gyro_x.noise.N`. Progress is drawn on a
terminal only.

| exit code | |
|---|---|
{exits}

`NO_COLOR` and `FORCE_COLOR` turn colors off and on ([no-color.org](https://no-color.org)),
`COLUMNS` sets the width. By default, colors and width are those of the terminal.

**Completion** of verbs, options, datasheets, targets and topics of a bag, by
[argcomplete](https://kislyuk.github.io/argcomplete/), where `allan` is on the PATH:

    eval "$(allan --completion bash)"      # in ~/.bashrc; for zsh in ~/.zshrc, after compinit
    allan --completion fish | source       # in ~/.config/fish/config.fish
"""


def parameters_page() -> str:
    """Return the page of the nodes' parameters."""
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
    """Return group -> purpose and nodes, from the comments of the parameter file."""
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
    """Return a default in YAML notation."""
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
    """Return the page of the command line's options."""
    common = argparse.ArgumentParser(add_help=False)
    add_options(common, OPTIONS)
    every = EVERY_VERB.format(
        options='\n'.join(_option_row(action) for action in common._actions),
        exits='\n'.join(f'| {code} | {what} |' for code, what in EXITS.items()),
    )
    return '\n'.join([WRITTEN_BY, CLI_HEAD, every, *(_verb_section(verb) for verb in VERBS)])


def _verb_section(verb: str) -> str:
    parser = argparse.ArgumentParser(prog=f'allan {verb}', add_help=False)
    command_of(verb).declare(parser)
    rows = '\n'.join(
        _option_row(action) for action in parser._actions if action.help != argparse.SUPPRESS
    )
    what = VERBS[verb][0].upper() + VERBS[verb][1:]
    return f'## `allan {verb}`\n\n{what}.\n\n| option | |\n|---|---|\n{rows}\n'


def _option_row(action: argparse.Action) -> str:
    words = (action.help or '').replace('%%', '%').replace('|', '\\|').replace('<', '&lt;')
    metavar = action.metavar or ('' if action.nargs == 0 else (action.dest or '').upper())
    if not action.option_strings:
        return f'| `{metavar}` | {words} |'
    names = ', '.join(f'`{name}`' for name in action.option_strings)
    shown = f' `{metavar}`'.replace('|', '\\|') if metavar and action.nargs != 0 else ''
    return f'| {names}{shown} | {words} |'


def api_page() -> str:
    """Return the page of the public Python API, from the docstrings."""
    return '\n'.join([WRITTEN_BY, API_HEAD, *map(_object_section, allan_ros.__all__)])


def _object_section(name: str) -> str:
    thing = getattr(allan_ros, name)
    is_class = inspect.isclass(thing)
    signature = name if is_class else f'{name}{_signature(thing)}'
    parts = [f'## `{name}`', f'```python\nallan_ros.{signature}\n```', _as_markdown(thing)]
    if is_class and not issubclass(thing, Exception):
        members = list(_members(thing))
        if members:
            parts.append('| member | |\n|---|---|\n' + '\n'.join(members))
    return '\n\n'.join(parts) + '\n'


def _signature(thing: Any) -> str:
    """Return the parameters with defaults, without types."""
    words, starred = [], False
    for parameter in inspect.signature(thing).parameters.values():
        if parameter.kind is parameter.VAR_POSITIONAL:
            starred = True
        if parameter.kind is parameter.KEYWORD_ONLY and not starred:
            words.append('*')
            starred = True
        mark = {parameter.VAR_POSITIONAL: '*', parameter.VAR_KEYWORD: '**'}.get(parameter.kind, '')
        default = parameter.default
        shown = '' if default is parameter.empty else f'={default!r}'
        words.append(f'{mark}{parameter.name}{shown}')
    return f'({", ".join(words)})'


def _as_markdown(thing: Any) -> str:
    """Return a docstring with its sections as lists, and its examples as code."""
    text = inspect.cleandoc(thing.__doc__ or '')
    head, *sections = re.split(r'^(\w+)\n-{3,}\n', text, flags=re.MULTILINE)
    parts = [_code(head.strip())]
    for title, body in zip(sections[::2], sections[1::2]):
        if title == 'Examples':
            parts.append(f'```python\n{body.strip()}\n```')
            continue
        parts.append(f'**{title}**\n\n' + '\n'.join(_items(body.strip())))
    return '\n\n'.join(parts)


def _items(body: str) -> Iterator[str]:
    """Yield the entries of a numpy section as a list."""
    for name, text in re.findall(r'^(\S.*)\n?((?:(?:[ ].*)?\n?)*?)(?=^\S|\Z)', body, re.MULTILINE):
        term, _, kind = name.partition(' : ')
        words = _code(' '.join(text.split()))
        yield f'- `{term}`{f" ({kind})" if kind else ""}{f": {words}" if words else ""}'


def _code(text: str) -> str:
    """Convert the literals of reStructuredText to Markdown."""
    return text.replace('``', '`').replace('<', '&lt;')


def _members(thing: type) -> Iterator[str]:
    for name, member in vars(thing).items():
        if name.startswith('_') or not getattr(member, '__doc__', None):
            continue
        if isinstance(member, property) or inspect.isfunction(member):
            call = (
                ''
                if isinstance(member, property)
                else _signature(member).replace('(self, ', '(').replace('(self)', '()')
            )
            shown = name if isinstance(member, property) else f'{name}{call}'
            what = inspect.cleandoc(member.__doc__).split('\n\n')[0]
            yield f'| `{shown}` | {_code(" ".join(what.split()))} |'


def messages_page(text: str) -> str:
    """Return the page with the current messages of all findings below their headings.

    Raises
    ------
    SystemExit
        If a finding has no heading or two, or a heading has no finding.
    """
    head, *entries = re.split(r'^### ', text, flags=re.MULTILINE)
    ids = [entry.split('\n', 1)[0].strip() for entry in entries]
    wrong = sorted({id for id in ids if ids.count(id) > 1} | (set(ids) ^ set(CATALOG)))
    if wrong:
        raise SystemExit(f'docs/messages.md: each finding once, as ### id: {wrong}')
    return head + ''.join(f'### {_with_words(entry)}' for entry in entries)


def _with_words(entry: str) -> str:
    """Return an entry with the current message below its heading."""
    id, _, rest = entry.partition('\n')
    rest = '\n'.join(line for line in rest.lstrip('\n').split('\n') if not line.startswith('> '))
    words = CATALOG[id.strip()]
    message, remedy = map(_without_numbers, (words.message_template, words.remedy_template))
    return f'{id}\n\n> *{words.severity}:* {message} **{remedy}**\n\n{rest.lstrip()}'


def _without_numbers(template: str) -> str:
    """Return a template of a finding in the plural, with … in place of its fields."""
    text = re.sub(r'\[\[|\]\]', '', template.replace('{when}', ''))
    return FIELD.sub(lambda field: (field[2] or '').partition('|')[2] or '…', text)


def pages() -> dict[str, str]:
    """Return file in docs -> its generated text."""
    findings = DOCS / 'messages.md'
    return {
        'parameters.md': parameters_page(),
        'options.md': cli_page(),
        'api.md': api_page(),
        findings.name: messages_page(findings.read_text(encoding='utf-8')),
    }


def main() -> int:
    """Write the pages."""
    for name, text in pages().items():
        (DOCS / name).write_text(text, encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())
