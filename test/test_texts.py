# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Texts: shapes and units in public docstrings, short module texts, and one word for one thing."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'allan_ros'
MODULES = sorted(PACKAGE.rglob('*.py'))
PYTHON = sorted(
    path
    for folder in ('allan_ros', 'launch', 'scripts', 'bench', 'fuzz', 'test')
    for path in (ROOT / folder).rglob('*.py')
    if path != Path(__file__)
)
PAGES = [
    *sorted(ROOT.glob('*.md')),
    *sorted((ROOT / 'docs').rglob('*.md')),
    PACKAGE / 'view' / 'findings.md',
    ROOT / 'bench' / 'README.md',
]
CONFIGURATION = sorted(
    path for path in (ROOT / 'config').rglob('*') if path.suffix in ('.yaml', '.xml')
)

LONGEST_MODULE_TEXT = 60
"""Words of a module docstring before its first heading, without indented examples and formulas. The
text says what the module does."""

ARRAY = re.compile(r'\b(Floats|Floating|Ints|Flags|Stamps|NDArray|ArrayLike|ndarray)\b')
QUANTITY = re.compile(r'\b(Floats|Floating|Stamps|ArrayLike|float64)\b')
"""Arrays whose values may have a unit, unlike whole numbers and flags."""

SIDE = r'(?:[\w.`]+(?: ?[*+/-] ?[\w.]+)*)'
SHAPE = re.compile(rf'\({SIDE},(?: {SIDE}(?:, {SIDE})*)?\)|\b(?:shape|scalar|elements)\b')
"""A tuple such as (n,), (n, 6) or (axes, k * size), or one of three words."""

UNIT = re.compile(
    r'\bunits?\b|\b(?:SI|ns|ms|Hz|degC|rad|deg|m/s\^2)\b|\bs\b(?!\))|\b(?:in|per|of) samples?\b'
)
WITHOUT_UNIT = re.compile(
    r'\b(?:ratios?|factors?|shares?|relative|normali[sz]ed|standardi[sz]ed|dimensionless'
    r'|logarithms?|correlations?|probabilit\w+|quantiles?|degrees of freedom|chi\^2|numbers? of'
    r'|counts?|ind(?:ex|ices)|positions|flags?|masks?|which|whether|scores?|gains?|weights?)\b',
    re.IGNORECASE,
)
"""Words for quantities without a unit."""

ANY_UNIT = {
    'AxisData.moments',
    'Fields.numbers',
    'Fields.table',
    'cross_matrices',
    'inverse',
    'nonnegative_least_squares',
}
"""Functions for numbers of any unit: algebra, and reading of a document."""

REPLACED = {
    r'knock(?:s|ed|ing)?': 'shock',
    r'bump(?:s|ed|ing|y)?': 'shock, hump',
    'louder': 'more noise',
    'bridged': 'interpolated',
    'misfits?': 'lack of fit',
    'withdrawn': 'invalidated',
    'calm': 'at rest',
    '(?:those|that) of': 'the noun again',
    'left out': 'excluded, omitted',
    'dropped': 'excluded, lost, discarded',
    'environments? of (?:its|their) own': 'separate virtual environment',
    'own environments?': 'separate virtual environment',
    'Allan variance sums': 'Allan sums',
    r'(?:deg|m)/sqrt h': 'deg/sqrt(h)',
}
"""Expression -> what to write instead (docs/glossary.md)."""

REPLACED_WORD = re.compile(rf'\b(?:{"|".join(REPLACED)})\b', re.IGNORECASE)


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


@cache
def parsed(source: str) -> ast.Module:
    """Return the syntax tree of a module, which several tests read."""
    return ast.parse(source)


class ArrayFunction(NamedTuple):
    """A public function with arrays: name, annotations, docstring, and the texts around it."""

    name: str
    annotations: str
    docstring: str
    context: str


def public_functions(
    node: ast.Module | ast.ClassDef, prefix: str = '', context: str = ''
) -> Iterator[tuple[str, ast.FunctionDef, str]]:
    """Yield the name, the node, and the docstrings of the classes around each public function."""
    for each in node.body:
        if isinstance(each, ast.ClassDef | ast.FunctionDef) and not each.name.startswith('_'):
            name = f'{prefix}{each.name}'
            if isinstance(each, ast.ClassDef):
                yield from public_functions(
                    each, f'{name}.', f'{context} {ast.get_docstring(each)} {fields_of(each)}'
                )
            else:
                yield name, each, context


def fields_of(node: ast.ClassDef) -> str:
    """Return the docstrings of the fields of a class."""
    constants = (e.value for e in node.body if isinstance(e, ast.Expr))
    return ' '.join(str(c.value) for c in constants if isinstance(c, ast.Constant))


def documented_methods() -> set[str]:
    """Return the names of all public methods with a docstring."""
    return {
        name.rpartition('.')[2]
        for path in MODULES
        for name, node, _ in public_functions(parsed(path.read_text(encoding='utf-8')))
        if '.' in name and ast.get_docstring(node)
    }


def array_functions(source: str) -> Iterator[ArrayFunction]:
    """Yield the public functions with array parameters or an array result.

    A method without a docstring has the docstring of the method that it overrides.
    """
    tree = parsed(source)
    for name, node, context in public_functions(tree):
        arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
        annotations = [ast.unparse(a.annotation) for a in arguments if a.annotation]
        annotations += [ast.unparse(node.returns)] if node.returns else []
        docstring = ast.get_docstring(node)
        is_override = '.' in name and docstring is None and name.split('.')[-1] in OVERRIDDEN
        if ARRAY.search(' '.join(annotations)) and not is_override:
            module = ast.get_docstring(tree) or ''
            yield ArrayFunction(name, ' '.join(annotations), docstring or '', module + context)


OVERRIDDEN = documented_methods()


def without_shape(source: str) -> list[str]:
    return [f.name for f in array_functions(source) if not SHAPE.search(f.docstring)]


def without_unit(source: str) -> list[str]:
    """Return functions of quantities whose unit neither they nor their class or module states."""
    return [
        f.name
        for f in array_functions(source)
        if QUANTITY.search(f.annotations)
        and f.name not in ANY_UNIT
        and not WITHOUT_UNIT.search(f.docstring)
        and not UNIT.search(f.docstring + f.context)
    ]


def is_help(path: Path) -> bool:
    """Return whether the text of a module is the help of a command, which describes its options."""
    return 'Command(__doc__' in path.read_text(encoding='utf-8')


def module_text(docstring: str) -> str:
    """Return a docstring up to its first heading, without indented lines."""
    text = re.split(r'^.+\n[-=~]{3,}$', docstring, maxsplit=1, flags=re.MULTILINE)[0]
    return re.sub(r'^ .*$', '', text, flags=re.MULTILINE)


def texts_of_python(source: str) -> Iterator[str]:
    """Yield comments, docstrings and messages; neighboring lines of a comment are joined."""
    strings = {tokenize.STRING, getattr(tokenize, 'FSTRING_MIDDLE', tokenize.STRING)}
    comment: list[str] = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            comment.append(token.string.lstrip('#'))
        elif token.type in strings or token.type == tokenize.NAME:
            yield ' '.join(comment)
            comment = []
            if token.type in strings and ' ' in token.string:
                yield re.sub(r'^ *(?:>>>|\.\.\.).*$|\{[^{}]*\}', '', token.string, flags=re.M)
    yield ' '.join(comment)


def prose_of(path: Path) -> Iterator[str]:
    text = path.read_text(encoding='utf-8')
    if not REPLACED_WORD.search(re.sub(r'[\s#]+', ' ', text)):
        return  # without the slow search for comments and strings
    if path.suffix == '.py':
        yield from texts_of_python(text)
    elif path.suffix == '.md':
        yield re.sub(r'^```.*?^```', '', text, flags=re.MULTILINE | re.DOTALL)
    else:
        yield re.sub(r'^\s*#', '', text, flags=re.MULTILINE)


def replaced_words(texts: Iterator[str]) -> list[str]:
    """Return each replaced word with the words around it."""
    found = []
    for text in texts:
        prose = ' '.join(re.sub(r'``.*?``|`.*?`', '_', text, flags=re.DOTALL).split())
        found += [
            prose[max(match.start() - 40, 0) : match.end() + 20]
            for match in REPLACED_WORD.finditer(prose)
        ]
    return found


@pytest.mark.parametrize('path', MODULES, ids=named)
def test_public_docstrings_of_arrays_state_shapes_and_units(path: Path) -> None:
    source = path.read_text(encoding='utf-8')
    assert without_shape(source) == []
    assert without_unit(source) == []


@pytest.mark.parametrize('path', [p for p in MODULES if not is_help(p)], ids=named)
def test_module_texts_are_short(path: Path) -> None:
    docstring = ast.get_docstring(parsed(path.read_text(encoding='utf-8'))) or ''
    assert len(module_text(docstring).split()) <= LONGEST_MODULE_TEXT


@pytest.mark.parametrize('path', [*PYTHON, *PAGES, *CONFIGURATION], ids=named)
def test_replaced_words_do_not_occur(path: Path) -> None:
    assert replaced_words(prose_of(path)) == [], f'write instead: {REPLACED}'


def test_the_checks_find_what_they_should() -> None:
    bare = 'def f(x: Floats) -> Floats:\n    """Return the mean."""'
    assert without_shape(bare) == without_unit(bare) == ['f']
    clear = 'def f(x: Floats) -> Floats:\n    """Return the mean of x, (n, axes), in SI."""'
    assert without_shape(clear) == without_unit(clear) == []
    text = 'Two words.\n\n  an example\n\nHeading\n-------\nNot counted.'
    assert module_text(text).split() == ['Two', 'words.']
    source = '# as that\n# of x\nx = f"{a.dropped} were left out"\n"""Not `dropped` here."""\n'
    assert len(replaced_words(texts_of_python(source))) == 2
