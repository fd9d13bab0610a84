# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Options generated from settings: one for every field, with its default."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, fields

import pytest

from allan_ros.cli.main import build_parser
from allan_ros.cli.options import Option, OptionGroup, add_settings, declare, settings_of
from allan_ros.core.errors import AllanError
from allan_ros.core.settings import CheckedSettings, SegmenterSettings, parameter


@dataclass(frozen=True)
class Some(CheckedSettings):
    """Settings with one field of each type."""

    limit: float = parameter(2.5, 'A limit of 50 %.', unit='s', low=0.0)
    count: int = parameter(3, 'A count.')
    gate: bool = parameter(True, 'The gate.')
    loud: bool = parameter(False, 'Be loud.')
    names: tuple[str, ...] = parameter((), 'Names.')
    kind: str = parameter('a', 'A kind.', choices=('a', 'b'))
    unit: str = parameter('', 'A unit.', choices=('', 'm', 'km'))


def parsed(words: list[str], settings_type: type = Some) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_settings(parser, 'some', settings_type)
    return parser.parse_args(words)


def test_every_type_of_field_has_an_option() -> None:
    assert settings_of(Some, parsed([])) == Some()
    assert settings_of(Some, parsed([]), count=9).count == 9
    with pytest.raises(AllanError, match='limit is -1'):
        settings_of(Some, parsed(['--limit', '-1']))
    words = ['--limit=7', '--count=4', '--no-gate', '--loud', '--names=t,-,gx', '--kind=b']
    assert settings_of(Some, parsed(words)) == Some(7.0, 4, False, True, ('t', '-', 'gx'), 'b')


def test_the_help_states_unit_and_default() -> None:
    parser = argparse.ArgumentParser()
    add_settings(parser, 'some', Some)
    said = ' '.join(parser.format_help().split())
    assert 'A limit of 50 % [s] (default 2.5)' in said
    assert all(f.name in said for f in fields(Some))


def test_an_empty_choice_is_only_a_default(capsys: pytest.CaptureFixture[str]) -> None:
    assert parsed([]).unit == ''
    with pytest.raises(SystemExit):
        parsed(['--unit', 'mile'])
    assert "''" not in capsys.readouterr().err


def test_a_list_of_columns_may_begin_with_a_dash() -> None:
    words = ['analyze', 'a.csv', '--columns=-,t,gx', '-o', 'out']
    args = build_parser('analyze').parse_args(words)
    assert args.columns == ('-', 't', 'gx')
    assert (args.inputs, args.output) == (['a.csv'], 'out')


DECLARED = (
    Option(('inputs',), 'one or several', 'INPUT', nargs='+'),
    OptionGroup(
        'group',
        (
            Option(('-q', '--quiet'), 'a switch', exclusive=True),
            Option(('--level',), 'a word', 'LEVEL', choices=('low', 'high'), exclusive=True),
            Option(('--rate',), 'a number', 'HZ', float, 100.0),
            Option(('--to',), 'a text', 'TARGET', default=''),
        ),
    ),
)


def test_options_and_groups_are_declared() -> None:
    parser = argparse.ArgumentParser()
    declare(parser, DECLARED)
    none = argparse.Namespace(inputs=['a'], quiet=False, level=None, rate=100.0, to='')
    assert parser.parse_args(['a']) == none
    words = ['a', 'b', '--level=low', '--rate=2', '--to=z']
    known = argparse.Namespace(inputs=['a', 'b'], quiet=False, level='low', rate=2.0, to='z')
    assert parser.parse_args(words) == known
    for wrong in (['-q', '--level=low'], ['--level=middle'], ['--rate=fast']):
        with pytest.raises(SystemExit):
            parser.parse_args(['a', *wrong])
    said = ' '.join(parser.format_help().split())
    assert 'group: -q' in said and 'a number (default 100)' in said and 'a text (' not in said


@pytest.mark.parametrize(
    ('text', 'seconds'), [('300', 300.0), ('300s', 300.0), ('5m', 300.0), ('.5h', 1800.0)]
)
def test_a_time_may_have_a_unit(text: str, seconds: float) -> None:
    assert parsed(['--skip', text], SegmenterSettings).skip == seconds
    assert parsed(['--skip', 'auto'], SegmenterSettings).skip == SegmenterSettings().skip


@pytest.mark.parametrize('text', ['5x', 'min', '5 minutes', ''])
def test_a_wrong_time_is_answered_with_the_expected_form(
    text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        parsed(['--skip', text], SegmenterSettings)
    assert 'write a time in seconds, or with a unit: 300, 5min, 2h' in capsys.readouterr().err
