# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Merging into a user's YAML or JSON: only the numbers change, or an error leaves the file as it
was.
"""

from __future__ import annotations

import json

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from allan_ros.core.errors import AllanError
from allan_ros.io.exporters import Entry, ExportOptions, make_export
from allan_ros.io.exporters.forms import BLOCK_BEGIN, BLOCK_END, HEADER_KEY, JsonForm, YamlForm
from allan_ros.io.results import Results

BARE = ExportOptions(fidelity='coefficients')

HEADER = ['first', 'second']
BLOCK = f'# {BLOCK_BEGIN}\n# first\n# second\n# {BLOCK_END}\n'


def merged(existing: str, *entries: Entry, opencv: bool = False) -> str:
    return YamlForm(opencv).merge(existing, entries, HEADER)


def entry(path: str, value: float | str | list[float] = 0.5, keep: bool = False) -> Entry:
    return Entry(tuple(path.split('.')), value, keep=keep)


def test_only_the_value_changes() -> None:
    mine = "# mine\na:   0.1   # why\n\n'b' : 'x'\nc: [1,  2]\n"
    assert merged(mine, entry('a')) == BLOCK + mine.replace('0.1', '0.5')


def test_merging_twice_is_merging_once() -> None:
    once = merged('a: 0.1\n', entry('a'), entry('new'))
    assert merged(once, entry('a'), entry('new')) == once
    assert once.count(BLOCK_BEGIN) == 1


def test_missing_keys_are_added_next_to_their_siblings() -> None:
    mine = 'top:\n    a: 1.0 # first\n    c: 3\n# tail\nother: 1\n'
    wanted = 'top:\n    a: 0.5 # first\n    c: 3\n    b: 0.5\n# tail\nother: 1\n'
    assert merged(mine, entry('top.a'), entry('top.b')) == BLOCK + wanted


def test_a_file_without_a_final_newline() -> None:
    assert merged('a: 1', entry('b')) == f'{BLOCK}a: 1\nb: 0.5\n'


def test_an_empty_file_and_one_of_comments_only() -> None:
    assert yaml.safe_load(merged('', entry('a.b'))) == {'a': {'b': 0.5}}
    assert merged('# mine\n', entry('a')) == f'{BLOCK}# mine\na: 0.5\n'


def test_missing_parents_are_created() -> None:
    assert merged('x: 1\n', entry('p.q.r')).endswith('x: 1\np:\n  q:\n    r: 0.5\n')
    assert merged('p:\n   z: 1\n', entry('p.q.r')).endswith('p:\n   z: 1\n   q:\n     r: 0.5\n')


def test_keys_are_found_under_another_node_name() -> None:
    mine = 'laser_mapping:\n  ros__parameters:\n    mapping: {acc_cov: 0.1, gyr_cov: 0.1}\n'
    found = yaml.safe_load(
        merged(
            mine,
            entry('/**.ros__parameters.mapping.acc_cov'),
            entry('/**.ros__parameters.mapping.n'),
        )
    )
    assert found == {
        'laser_mapping': {
            'ros__parameters': {'mapping': {'acc_cov': 0.5, 'gyr_cov': 0.1, 'n': 0.5}}
        }
    }


def test_a_key_in_two_places_is_rejected() -> None:
    with pytest.raises(AllanError, match='imu0, imu1'):
        merged('imu0:\n  n: 1\nimu1:\n  n: 2\n', entry('imu2_.n'), entry('n'))


def test_a_path_takes_precedence_over_a_name() -> None:
    mine = 'imu0:\n  n: 1\nimu1:\n  n: 2\n'
    assert merged(mine, entry('imu1.n')) == f'{BLOCK}imu0:\n  n: 1\nimu1:\n  n: 0.5\n'


def test_values_that_are_not_measured_stay() -> None:
    mine = 'topic: /mine\n'
    assert merged(mine, entry('topic', '/ours', keep=True)) == BLOCK + mine
    assert merged('a: 1\n', entry('topic', '/ours', keep=True)) == f'{BLOCK}a: 1\ntopic: /ours\n'


def test_lists_of_any_style_are_replaced_by_a_list() -> None:
    lists = ('v: [1, 2, 3]', 'v:\n- 1\n- 2 # two\n- 3', 'v: 7', 'v:', 'v: # none yet')
    for mine in (f'{one}\nw: 1\n' for one in lists):
        text = merged(mine, entry('v', [0.1, 0.2, 0.3]))
        assert yaml.safe_load(text) == {'v': [0.1, 0.2, 0.3], 'w': 1}
        assert 'w: 1\n' in text


def test_opencv_files_keep_their_first_line_and_their_matrices() -> None:
    mine = (
        '%YAML:1.0\n---\n# camera\nIMU.T_b_c1: !!opencv-matrix\n   rows: 1\n   cols: 2\n'
        '   dt: f\n   data: [1.0, 0.0,\n      0.0, 1.0]\nacc_n: 0.1   # tune\n'
    )
    head, tail = '%YAML:1.0\n---\n', mine.removeprefix('%YAML:1.0\n---\n')
    assert merged(mine, entry('acc_n'), opencv=True) == head + BLOCK + tail.replace(
        '0.1  ', '0.5  '
    )
    assert merged('acc_n: 1\n', entry('acc_n'), opencv=True) == f'%YAML:1.0\n{BLOCK}acc_n: 0.5\n'


def test_windows_line_ends_and_a_byte_order_mark_are_kept() -> None:
    assert merged('a: 1\r\nb: 2\r\n', entry('a')) == (BLOCK + 'a: 0.5\nb: 2\n').replace(
        '\n', '\r\n'
    )
    assert merged('\ufeffa: 1\n', entry('a')) == f'\ufeff{BLOCK}a: 0.5\n'


def test_a_value_in_place_of_keys_is_rejected() -> None:
    for mine in ('p: 1\n', 'p: [1]\n', 'p: {q: 1}\n', 'p:\n'):
        with pytest.raises(AllanError, match='is a value, not a mapping'):
            merged(mine, entry('p.q.r'))


@pytest.mark.parametrize(
    ('mine', 'said'),
    [
        ('- 1\n- 2\n', 'no keys at its top'),
        ('a: [1\n', 'is not YAML'),
        ('just words\n', 'no keys at its top'),
        ('a: &x 0.1\nb: *x\n', 'no keys can be added'),
        ('[' * 3000, 'is not YAML|nested too deeply'),
        ('a: 1\n---\na: 2\n', 'is not YAML'),
        ('a:\n  b: 1\n', 'is a mapping, not a number'),
    ],
)
def test_an_unsafe_merge_is_rejected(mine: str, said: str) -> None:
    with pytest.raises(AllanError, match=said) as refusal:
        merged(mine, entry('a'))
    assert '\n' not in str(refusal.value)


scalars = st.one_of(
    st.integers(-9, 9), st.floats(-9, 9), st.text('abé :#\'"[]{}-&*!\n', max_size=6), st.none()
)
keys = st.text('abcdefgh_.', min_size=1, max_size=4)
documents = st.dictionaries(
    keys,
    st.recursive(
        scalars,
        lambda inner: st.one_of(
            st.lists(inner, max_size=3), st.dictionaries(keys, inner, max_size=3)
        ),
        max_leaves=8,
    ),
    max_size=5,
)


@settings(max_examples=60)
@given(
    document=documents,
    flow=st.sampled_from([None, False, True]),
    path=st.lists(keys, min_size=1, max_size=3),
)
def test_a_number_can_be_merged_into_any_document(
    document: dict, flow: bool | None, path: list[str]
) -> None:
    mine = yaml.safe_dump(document, default_flow_style=flow, sort_keys=False)
    wanted = Entry(tuple(path), 0.12345)
    try:
        text = YamlForm().merge(mine, [wanted], HEADER)
    except AllanError:
        return  # nothing is written
    found = numbers(yaml.safe_load(text))
    assert found.count(0.12345) == 1
    given_way = max(map(len, under(document, path[-1])), default=0)
    assert len(found) >= len(numbers(document)) + 1 - given_way
    assert YamlForm().merge(text, [wanted], HEADER) == text


def under(tree: object, name: str) -> list[list[float]]:
    """Return the numbers under every key of that name."""
    if isinstance(tree, dict):
        here = [numbers(value) for key, value in tree.items() if key == name]
        return here + [found for value in tree.values() for found in under(value, name)]
    return []


def numbers(tree: object) -> list[float]:
    if isinstance(tree, dict):
        return [n for value in tree.values() for n in numbers(value)]
    if isinstance(tree, list):
        return [n for value in tree for n in numbers(value)]
    return [tree] if isinstance(tree, float) else []


def test_a_kalibr_file_keeps_its_topic_and_its_comments(known_results: Results) -> None:
    mine = (
        '#Accelerometers\naccelerometer_noise_density: 1.86e-03   #Noise density\n'
        'accelerometer_random_walk: 4.33e-04\n\n#Gyroscopes\n'
        'gyroscope_noise_density: 1.87e-04\ngyroscope_random_walk: 2.66e-05\n\n'
        'rostopic: /imu7      #mine\nupdate_rate: 400.0\n'
    )
    text = make_export(known_results, 'kalibr', BARE, existing=mine).text
    assert text.partition(f'# {BLOCK_END}\n')[2] == (
        '#Accelerometers\naccelerometer_noise_density: 0.002   #Noise density\n'
        'accelerometer_random_walk: 3.0e-05\n\n#Gyroscopes\n'
        'gyroscope_noise_density: 0.001\ngyroscope_random_walk: 1.0e-05\n\n'
        'rostopic: /imu7      #mine\nupdate_rate: 200.0\n'
    )
    named = make_export(known_results, 'kalibr', ExportOptions(topic='/imu9'), mine).text
    assert 'rostopic: /imu9      #mine\n' in named


def test_openvins_keeps_calibrated_values(known_results: Results) -> None:
    mine = '%YAML:1.0\n\nimu0:\n  T_i_b:\n    - [0.0, 1.0]\n  gyroscope_noise_density: 1.0\n'
    found = yaml.safe_load(
        make_export(known_results, 'openvins', existing=mine).text.removeprefix('%YAML:1.0\n')
    )['imu0']
    assert found['T_i_b'] == [[0.0, 1.0]]
    assert found['gyroscope_noise_density'] == 1e-3
    assert found['model'] == 'kalibr'
    assert found['Tw'] == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


ENTRIES = [Entry(('value0', 'rate'), 200.0), Entry(('value0', 'noise'), [1e-3, 2e-3, 3e-3])]
NEW = {'rate': 200.0, 'noise': [1e-3, 2e-3, 3e-3]}

trees = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(-1e9, 1e9), st.text(max_size=5)),
    lambda tree: st.one_of(
        st.lists(tree, max_size=3), st.dictionaries(st.text(max_size=4), tree, max_size=3)
    ),
    max_leaves=8,
)


@given(
    cameras=trees,
    value0=st.dictionaries(st.text(max_size=4), trees, max_size=3),
    again=st.integers(1, 3),
)
def test_all_other_bytes_stay(cameras: object, value0: dict, again: int) -> None:
    text = json.dumps({'value0': value0, 'cameras': cameras})
    for _ in range(again):
        text = JsonForm().merge(text, ENTRIES, ['first', 'second'])
    assert json.loads(text) == {
        'value0': {**value0, **NEW},
        'cameras': cameras,
        HEADER_KEY: ['first', 'second'],
    }


def test_json_keeps_values_that_are_not_measured() -> None:
    kept = [Entry(('value0', 'rate'), 200.0, keep=True)]
    text = JsonForm().merge('{"value0": {"rate": 5}}', kept, [])
    assert json.loads(text)['value0'] == {'rate': 5}


@pytest.mark.parametrize(
    ('mine', 'said'),
    [
        ('', 'not JSON'),
        ('{"value0": NaN}', 'NaN is not a JSON number'),
        ('[1]', 'not a JSON object'),
        ('{"value0": 1}', 'value0 of the file to merge into is not a JSON object'),
        ('[' * 100_000, 'not JSON'),
    ],
)
def test_a_file_that_is_not_a_json_object_is_rejected(mine: str, said: str) -> None:
    with pytest.raises(AllanError, match=said):
        JsonForm().merge(mine, ENTRIES, [])
